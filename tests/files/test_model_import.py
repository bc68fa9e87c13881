"""Mechanisms from URDF and MJCF against MuJoCo, which computes the same accelerations of the same
file.

Tolerance 1e-9 of the largest acceleration: both work in float64; a body between two joints of one
body has 1e-12 of its mass."""

import warnings

import numpy as np
import pytest

import jaxclear as jc

pytest.importorskip("mujoco")

from tests.rigs.mujoco_trees import ROBOTS, largest_difference

TREE = """
<mujoco><compiler angle="degree"/><option gravity="0.3 -1 -9.7"/>
 <default><joint damping="0.3"/></default>
 <worldbody>
  <body name="cart" pos="0 0 1" euler="10 20 30">
   <joint name="rail" type="slide" axis="1 2 0" stiffness="30" springref="0.1" ref="0.2"/>
   <geom name="box" type="box" size="0.1 0.2 0.3" density="500"/>
   <body name="frame" pos="0.1 0 0" euler="0 0 40">
    <body name="arm" pos="0.5 0.1 0" quat="0.8 0.2 0.3 0.1">
     <joint name="yaw" axis="0 0 -1" pos="0.05 0 0"/>
     <joint name="pitch" axis="0 1 0.2" range="-30 40" armature="0.2"/>
     <geom name="rod" type="capsule" fromto="0 0 0 0.4 0 0.1" size="0.03"/>
     <site name="tip"/>
     <body name="weight" pos="0.4 0 0.1"><geom type="sphere" size="0.05"/></body>
    </body>
   </body>
  </body>
 </worldbody>
</mujoco>
"""
LARGER = """
<mujoco><option gravity="0 0 -9.81"/>
 <worldbody>
  <body name="ship" pos="0 0 1"><freejoint/>
   <geom type="box" size="0.3 0.2 0.1" pos="0.1 0 0"/>
   <body name="mast" pos="0 0 0.2"><joint type="ball" pos="0 0 0.02"/>
    <geom type="capsule" fromto="0 0 0 0.1 0 0.6" size="0.03"/>
    <body name="boom" pos="0 0 0.3">
     <joint name="up" type="slide" axis="0 0 1"/><joint name="round" axis="0 0 1"/>
     <joint name="tilt" axis="0 1 0"/>
     <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02"/>
    </body>
   </body>
  </body>
 </worldbody>
</mujoco>
"""
# Arms, hands, legged and humanoid robots; roots fixed but where said.
PUBLIC = {
    "double_pendulum_description/urdf/double_pendulum.urdf": False,
    "ur_description/urdf/ur5_robot.urdf": False,
    "panda_description/urdf/panda.urdf": False,
    "kinova_description/robots/kinova.urdf": False,
    "z1_description/urdf/z1.urdf": False,
    "solo_description/robots/solo12.urdf": True,
    "bolt_description/robots/bolt.urdf": True,
}


@pytest.fixture
def tree(tmp_path):
    path = tmp_path / "tree.xml"
    path.write_text(TREE)
    return path


@pytest.mark.parametrize(
    ("text", "joints"), [(TREE, 3), pytest.param(LARGER, 12, marks=pytest.mark.slow)]
)
def test_a_tree_accelerates_as_in_mujoco(text, joints, tmp_path):
    """The larger one has free and ball joints, and three joints of a body."""
    path = tmp_path / "tree.xml"
    path.write_text(text)
    worst, count = largest_difference(path)
    assert count == joints and worst < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLIC)
def test_public_models_accelerate_as_in_mujoco(name):
    if not ROBOTS.exists():
        pytest.skip("example-robot-data is not installed")
    worst, _ = largest_difference(ROBOTS / name, floating=PUBLIC[name])
    assert worst < 1e-9


def test_names_joints_and_loads_are_the_files_own(tree):
    with pytest.warns(jc.NotImported, match="not taken over") as warned:
        mechanism = jc.read_mjcf(tree)
    sentence = str(warned[0].message)
    assert "armature" not in sentence and "limits" not in sentence
    assert "contacts between geometries" in sentence
    assert warned[0].filename == __file__
    assert list(mechanism.bodies) == ["cart", "yaw carrier", "arm", "weight"]
    kinds = {name: type(c.joint).__name__ for name, c in mechanism.connections.items()}
    turning = dict.fromkeys(("yaw", "pitch"), "Revolute")
    assert kinds == {"rail": "Prismatic", "weight weld": "Fixed"} | turning
    springs = {"rail spring", "yaw spring", "pitch spring", "gravity"}
    assert set(mechanism.loads) == springs | {"pitch armature", "pitch limits"}
    stop = mechanism.loads["pitch limits"]
    np.testing.assert_allclose([stop.lower, stop.upper], np.deg2rad([-30, 40]))
    spring = mechanism.loads["rail spring"]
    assert float(spring.stiffness) == 30.0
    # From the reference at 0.2 the spring rests at 0.1.
    np.testing.assert_allclose(float(spring.rest), -0.1)


def test_what_is_taken_over_whole_gives_no_warning(tmp_path):
    path = tmp_path / "ship.xml"
    path.write_text(LARGER.replace("<geom", '<geom contype="0" conaffinity="0"'))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mechanism = jc.read_mjcf(path)
    assert len(mechanism.bodies) == 5


def test_an_imported_mechanism_is_a_file_like_any_other(tree, tmp_path):
    with pytest.warns(jc.NotImported):
        mechanism = jc.read_mjcf(tree)
    jc.write_scene(mechanism, tmp_path / "tree.yaml")
    again = jc.read_scene(tmp_path / "tree.yaml").mechanism
    assert str(again) == str(mechanism)


def test_what_is_no_mechanism_is_refused_with_a_sentence(tmp_path):
    path = tmp_path / "model.xml"
    for text, sentence in (
        ("no xml", "MuJoCo cannot read model.xml: .*XML"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "mass and inertia"),
        ("<mujoco/>", "model.xml has no body with mass"),
        ("<robot name='r'><link name='a'/></robot>", "model.xml has no body with mass"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=sentence):
            jc.read_urdf(path)
    with pytest.raises(ValueError, match="none.urdf is no file"):
        jc.read_urdf(tmp_path / "none.urdf")


def test_what_mujoco_warns_of_is_told_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    link = """<inertial><mass value='1'/>
      <inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>"""
    robot = f"""<robot name='r'><link name='a'>{link}</link><link name='b'>{link}</link>
      <joint name='turn' type='revolute'><parent link='a'/><child link='b'/>
      <limit lower='0' upper='0' effort='1' velocity='1'/></joint></robot>"""
    (tmp_path / "r.urdf").write_text(robot)
    with pytest.warns(jc.NotImported, match="MuJoCo says: .*equal lower and upper limits"):
        jc.read_urdf("r.urdf")
    assert [path.name for path in tmp_path.iterdir()] == ["r.urdf"]


HINGE = """
<mujoco><option gravity="0 0 0" timestep="0.002" tolerance="0" iterations="200"/>
 <worldbody><body name="arm"><joint name="hinge" axis="0 1 0" pos="0.1 0 0" {}/>
  <geom type="box" size="0.2 0.05 0.04" density="600" contype="0" conaffinity="0"/></body>
 </worldbody>
</mujoco>
"""


def hinge(tmp_path, attributes):
    """The model of a hinge in MuJoCo, and what acts on its coordinate here by inertia there."""
    import mujoco

    path = tmp_path / "hinge.xml"
    path.write_text(HINGE.format(attributes))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mechanism = jc.read_mjcf(path, stops="impact")
    return mujoco.MjModel.from_xml_path(str(path)), mechanism.loads


@pytest.mark.parametrize("solref", ["0.02 1", "0.05 0.3", "-900 -40", "-900 40", "0.05 0"])
def test_a_limit_pushes_a_hinge_as_in_mujoco(solref, tmp_path):
    """Deeper than the width of the impedance's ramp; also where the damper would pull."""
    import mujoco

    model, loads = hinge(
        tmp_path,
        f'limited="true" range="-30 40" margin="0.01" armature="0.03" solreflimit="{solref}"',
    )
    data = mujoco.MjData(model)
    inertia = 1 / float(model.dof_invweight0[0])
    for angle in (0.75, -0.6, 0.2):
        for speed in (-6.0, -0.5, 0.0, 0.5, 6.0):
            data.qpos[0], data.qvel[0] = angle, speed
            mujoco.mj_forward(model, data)
            ours = float(loads["hinge limits"].force(0.0, angle, speed)[0]) / inertia
            np.testing.assert_allclose(ours, data.qacc[0], rtol=1e-9, atol=1e-9)


FLAGS = ["", "limit", "frictionloss", "constraint", "refsafe", "gravity", "spring", "damper"]


@pytest.mark.parametrize("flag", FLAGS)
def test_what_a_flag_disables_acts_no_more_as_in_mujoco(flag, tmp_path):
    """Beyond a limit shorter than two steps; by the torques of all loads on the coordinate."""
    import mujoco

    said = f'<flag {flag}="disable"/>' if flag else ""
    text = HINGE.replace('gravity="0 0 0"', 'gravity="0 0 -10"')
    text = text.replace('timestep="0.002"', 'timestep="0.01"').replace('"200"/>', f'"200">{said}')
    text = text.replace(" <worldbody>", "</option> <worldbody>").format(
        'limited="true" range="-30 40" solreflimit="0.001 1" stiffness="3" damping="0.1" '
        'frictionloss="0.02"'
    )
    (tmp_path / "hinge.xml").write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    loads = dict(jc.read_mjcf(tmp_path / "hinge.xml", stops="impact").loads)
    pulled = np.array(loads.pop("gravity").acceleration) if "gravity" in loads else np.zeros(3)
    np.testing.assert_allclose(pulled[2], 0.0 if flag == "gravity" else -10.0)
    limits = loads.pop("hinge limits", None)
    assert (limits is None) == (flag in ("limit", "constraint"))
    assert ("hinge friction" in loads) == (flag not in ("frictionloss", "constraint"))
    spring = loads.get("hinge spring")
    assert (spring.stiffness is None) == (flag == "spring")
    assert (spring.damping is None) == (flag == "damper")
    if limits is not None:
        shortest = 0.001 if flag == "refsafe" else 0.02
        inertia = 1 / float(model.dof_invweight0[0])
        np.testing.assert_allclose(float(limits.stiffness), inertia / shortest**2)


def test_dry_friction_of_a_sliding_hinge_is_that_of_mujoco(tmp_path):
    import mujoco

    model, loads = hinge(tmp_path, 'frictionloss="0.02"')
    data, friction = mujoco.MjData(model), loads["hinge friction"]
    inertia = 1 / float(model.dof_invweight0[0])
    for speed in (-3.0, 1.0, 4.0):
        data.qvel[0] = speed
        mujoco.mj_forward(model, data)
        yielding = (np.sign(speed) * float(friction.states()[0].saturation),)
        ours = friction.effect(0.0, (0.0,), (speed,), yielding).forces[0] / inertia
        np.testing.assert_allclose(float(ours), data.qacc[0], rtol=1e-9)


def test_what_a_free_joint_has_besides_is_named(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(
        LARGER.replace('type="ball"', 'type="ball" armature="0.1" frictionloss="1" damping="2"')
    )
    with pytest.warns(jc.NotImported) as warned:
        jc.read_mjcf(path)
    for what in ("armature", "dry friction", "damping"):
        assert f'{what} of "mast joint"' in str(warned[0].message)


def test_geometries_keep_their_names_and_places(tree, tmp_path):
    """The box of a welded part stands in the body that it became a part of; volumes by Gauss."""
    found = jc.read_shapes(tree)
    assert {body: list(own) for body, own in found.items()} == {
        "cart": ["box"],
        "arm": ["rod"],
        "weight": ["weight geometry 0"],
    }
    points, corners = found["cart"]["box"]
    np.testing.assert_allclose(np.ptp(points, axis=0), (0.2, 0.4, 0.6))
    ends = points[corners]
    volume = np.einsum("ti,ti->t", ends[:, 0], np.cross(ends[:, 1], ends[:, 2])).sum() / 6
    np.testing.assert_allclose(abs(volume), 0.2 * 0.4 * 0.6)
    rod = found["arm"]["rod"].points
    np.testing.assert_allclose(rod.min(), -0.03, atol=0.002)
    np.testing.assert_allclose(rod[:, 0].max(), 0.43, atol=0.002)


def test_a_robot_is_drawn_by_what_is_to_be_seen_of_it(tmp_path):
    mass = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/>"
    shape = "<{0} name='{1}'><origin xyz='0 0 0.5'/><geometry>{2}</geometry></{0}>"
    seen = shape.format("visual", "hull", "<cylinder radius='0.1' length='1'/>")
    met = shape.format("collision", "block", "<box size='1 1 1'/>")
    (tmp_path / "r.urdf").write_text(
        f"<robot name='r'><link name='base'/><link name='a'>{mass}</inertial>{seen}{met}</link>"
        "<joint name='j' type='continuous'><parent link='base'/><child link='a'/></joint></robot>"
    )
    assert {body: list(own) for body, own in jc.read_shapes(tmp_path / "r.urdf").items()} == {
        "a": ["hull"]
    }


KEYED = """
<mujoco><compiler autolimits="true"/><worldbody>
 <body name="base" pos="0 0 1"><freejoint/><geom type="box" size="0.2 0.1 0.1"/>
  <body name="thigh" pos="0.1 0 0"><joint name="hip" type="ball"/>
   <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03"/>
   <body name="toe" pos="0 0 -0.3"><joint name="ankle" axis="0 1 0" range="-140 -30" ref="10"/>
    <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.02"/></body></body></body>
</worldbody><keyframe>
 <key name="home" qpos="0.1 0.2 0.9 0.8 0 0.6 0 0.6 0.8 0 0 -1.2"/>
</keyframe></mujoco>"""


def test_a_keyframe_is_where_a_mechanism_starts_or_is_named(tmp_path):
    """Centres of mass beside those of MuJoCo at the keyframe. At the reference the ankle is 0.7 rad
    beyond its limit."""
    import mujoco

    file = tmp_path / "leg.xml"
    file.write_text(KEYED)
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        rig = jc.read_mjcf(file, keyframe="home")
    how = {"save": 2, "integrator": jc.integrator.FixedStep(1e-3, "semi_implicit")}
    run = jc.simulate(rig, 1e-3, **how)
    assert not run.warnings
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    for name in ("base", "thigh", "toe"):
        there = data.xipos[model.body(name).id]
        np.testing.assert_allclose(run.body(name).com[0], there, atol=1e-9)
    with pytest.warns(jc.NotImported, match='keyframes "home"'):
        plain = jc.read_mjcf(file)
    (said,) = jc.simulate(plain, 1e-3, **how).warnings
    assert 'rad beyond stop "ankle' in said and "keyframe=" in said
    with pytest.raises(ValueError, match='keyframe "hom".*"home"'):
        jc.read_mjcf(file, keyframe="hom")
