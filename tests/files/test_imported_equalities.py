"""Equality constraints of MJCF as joints, against MuJoCo: its own residuals of our positions, and
its own motion where it holds constraints stiffly."""

import warnings

import numpy as np
import pytest

import jaxclear as jc

mujoco = pytest.importorskip("mujoco")

FOUR_BAR = """<mujoco><option gravity="0 0 0"/><worldbody>
 <body name="crank"><joint name="O" axis="0 0 1"/>
  <inertial pos="0.05 0 0" mass="0.2" diaginertia="1e-4 3e-4 3e-4"/>
  <body name="coupler" pos="0.1 0 0" euler="0 0 50"><joint name="A" axis="0 0 1"/>
   <inertial pos="0.2 0 0" mass="0.5" diaginertia="1e-4 4e-3 4e-3"/></body></body>
 <body name="rocker" pos="0.35 0 0" euler="0 0 90"><joint name="C" axis="0 0 1"/>
  <inertial pos="0.15 0 0" mass="0.4" diaginertia="1e-4 2e-3 2e-3"/></body>
</worldbody><equality><connect name="B" body1="coupler" body2="rocker" anchor="0.4 0 0"/></equality>
</mujoco>"""
PAIR = """<mujoco><worldbody>
 <body name="arm"><joint name="turn" axis="0 1 0"/>
  <inertial pos="0.1 0 0" mass="1" diaginertia="1e-2 1e-2 1e-2"/>
  <site name="here" pos="0.1 0.2 0.3" euler="10 0 0"/>
  <body name="tip" pos="0.3 0 0"><site pos="0 0 0.1"/></body></body>
 <body name="load" pos="0.3 0.05 0.02" euler="20 30 40"><freejoint name="free"/>
  <inertial pos="0 0 0.05" mass="0.5" diaginertia="1e-2 2e-2 2e-2"/>
  <site name="there" pos="0.1 0.2 0.1"/></body>
</worldbody><equality>{}</equality></mujoco>"""
WELD, BALL = (jc.joint.Fixed, jc.joint.Spherical)
# What an equality says, the joint that it becomes, and whether it is open in the reference
# configuration.
HELD = {
    "weld": ('<weld name="w" body1="tip" body2="load" anchor="0.02 0.01 0"/>', WELD, False),
    "weld given": (
        '<weld name="w" body1="load" body2="arm" relpose="0.1 0 0.1 0.9 0.1 0.2 0" '
        'anchor="0.02 0.01 0"/>',
        WELD,
        True,
    ),
    "weld of sites": ('<weld name="w" site1="here" site2="there"/>', WELD, True),
    "connect of sites": ('<connect name="w" site1="there" site2="here"/>', BALL, True),
    "connect to the ground": ('<connect name="w" body1="load" anchor="0.1 0 0"/>', BALL, False),
    "no torques": ('<weld name="w" body1="tip" body2="load" torquescale="0"/>', BALL, False),
}


def imported(tmp_path, text, **asked):
    """The mechanism, and what is said of it."""
    (tmp_path / "model.xml").write_text(text)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = jc.read_mjcf(tmp_path / "model.xml", **asked)
    return found, [str(one.message) for one in said]


def stiff(text):
    """The model in MuJoCo, its constraints with a time constant of 0.1 ms, and its data."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = 2e-5, mujoco.mjtIntegrator.mjINT_RK4
    model.eq_solref[:], model.eq_solimp[:] = (1e-4, 1), (0.9999, 0.9999, 1e-3, 0.5, 2)
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("what", HELD)
def test_an_equality_holds_bodies_where_mujoco_has_them(what, tmp_path):
    text, kind, opened = HELD[what]
    rig, said = imported(tmp_path, PAIR.format(text))
    assert type(rig.connections["w"].joint) is kind
    assert bool(said) == opened
    if opened:
        assert "the reference configuration, in which" in said[0] and '"w" is open by 0.' in said[0]
    run = jc.simulate(rig, 1e-3, save=2, integrator=jc.integrator.FixedStep(1e-3))
    model = mujoco.MjModel.from_xml_string(PAIR.format(text))
    data = mujoco.MjData(model)
    data.qpos[0] = float(run.coordinate("turn")[0])
    data.qpos[1:4] = np.asarray(run.body("load").origin)[0]
    mujoco.mju_mat2Quat(data.qpos[4:8], np.asarray(run.body("load").rotation)[0].ravel())
    if not opened:
        # Everything stands where it did.
        np.testing.assert_allclose(data.qpos, model.qpos0, atol=1e-9)
    mujoco.mj_forward(model, data)
    assert data.nefc
    np.testing.assert_allclose(data.efc_pos[: 3 if kind is BALL else 6], 0.0, atol=1e-12)


def test_a_loop_closed_by_connect_moves_as_in_mujoco(tmp_path):
    """MuJoCo's is off by 1e-8 rad where ours holds."""
    rig, said = imported(tmp_path, FOUR_BAR)
    assert said == [] and rig.topology.loops == ("B",)
    turning = jc.Mechanism(rig.bodies, rig.connections, rig.loads, speeds={"O": 20.0})
    run, joints = jc.simulate(turning, 0.1, save=11, verify=False), ("O", "A", "C")
    (model, data), ours = stiff(FOUR_BAR), np.stack([run.coordinate(n) for n in joints], axis=1)
    data.qvel[:] = [float(run.speed(name)[0]) for name in joints]
    for own in ours:
        np.testing.assert_allclose(own, data.qpos, atol=1e-6)
        for _ in range(500):
            mujoco.mj_step(model, data)
    assert ours[-1, 0] > 1.5


def test_what_is_not_built_is_named_one_by_one(tmp_path):
    equalities = """<weld name="idle" body1="arm" body2="load" active="false"/>
      <connect name="within" body1="arm" body2="tip" anchor="0.1 0 0"/>
      <joint name="bent" joint1="turn" polycoef="0.1 0 0 0 0" active="false"/>
      <joint name="curve" joint1="turn" joint2="nod" polycoef="0 1 0.5 0 0"/>
      <tendon name="taut" tendon1="rope"/>"""
    nod = (
        '<body name="head"><joint name="nod"/><geom size="0.1" contype="0" conaffinity="0"/></body>'
    )
    text = PAIR.format(equalities).replace("</worldbody>", f"{nod}</worldbody>")
    text = text.replace(
        "</mujoco>",
        """<tendon><fixed name="rope"><joint joint="turn" coef="1"/></fixed></tendon>
        <actuator><motor name="left" joint="turn"/><motor joint="turn"/></actuator></mujoco>""",
    )
    _, said = imported(tmp_path, text)
    for what in (
        'equality "idle" (weld, not active)',
        'connect "within" (both ends are parts of "arm")',
        'equality "bent" (coordinate of "turn" = 0.1, not active)',
        'equality "curve" (coordinate of "turn" = 1 x + 0.5 x^2, x that of "nod")',
        'equality "taut" (tendon)',
        'tendon "rope"',
        'actuator "left"',
        "actuator 1",
    ):
        assert what in said[0], what


def test_a_disabled_equality_holds_nothing(tmp_path):
    text = PAIR.format('<weld name="w" body1="arm" body2="load"/>').replace(
        "<worldbody>", '<option><flag equality="disable"/></option><worldbody>', 1
    )
    rig, said = imported(tmp_path, text)
    assert "w" not in rig.connections and 'equality "w" (weld, not active)' in said[0]


def wheels(polynomial, joints='joint1="b" joint2="a"'):
    """Three wheels on parallel axes, two of them tied."""
    wheel = """<body name="{0} wheel" pos="{1} 0 0"><joint name="{0}" axis="0 0 1" ref="0.1"/>
      <inertial pos="0.02 0 0" mass="{2}" diaginertia="1e-3 1e-3 {2}e-3"/></body>"""
    bodies = "".join(wheel.format(name, k, k + 1) for k, name in enumerate("ab"))
    return f"""<mujoco><option gravity="0 -9.81 0"/><worldbody>{bodies}</worldbody><equality>
      <joint name="tie" {joints} polycoef="{polynomial}"/></equality></mujoco>"""


def test_a_linear_equality_of_joints_is_a_ratio_and_moves_as_in_mujoco(tmp_path):
    text = wheels("0 -3 0 0 0")
    rig, said = imported(tmp_path, text)
    assert said == [] and type(rig.couplings["tie"]) is jc.coupling.Ratio
    run, (model, data) = jc.simulate(rig, 0.2, save=5, verify=False), stiff(text)
    ours = np.stack([run.coordinate(name) for name in "ab"], axis=1)
    for own in ours:
        np.testing.assert_allclose(own, data.qpos - model.qpos0, atol=1e-6)
        for _ in range(2500):
            mujoco.mj_step(model, data)
    assert abs(ours[-1, 1]) > 0.5


def test_an_equality_off_in_the_reference_configuration_is_told_and_closed(tmp_path):
    rig, said = imported(tmp_path, wheels("0.4 -3 0 0 0"))
    assert 'in which equality "tie" is off by 0.4 rad' in said[0]
    run = jc.simulate(rig, 1e-3, save=2)
    a, b = (float(run.coordinate(name)[0]) for name in "ab")
    np.testing.assert_allclose(b, 0.4 - 3 * a, atol=1e-9)


def test_a_joint_that_an_equality_holds_alone_is_driven(tmp_path):
    rig, said = imported(tmp_path, wheels("0.4 0 0 0 0", 'joint1="b"'))
    assert 'equality "tie" is off by 0.4 rad' in said[0]
    assert type(rig.connections["b"].joint.drive) is jc.drive.ConstantPosition and rig.driven == (
        "b",
    )
    run = jc.simulate(rig, 1e-2, save=2)
    axis = np.asarray(run.body("b wheel").rotation)[-1][:, 0]
    np.testing.assert_allclose(axis, (np.cos(0.4), np.sin(0.4), 0), atol=1e-12)


def test_mimic_of_a_urdf_is_a_ratio(tmp_path):
    link = """<link name="{0}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"
      ixy="0" ixz="0" iyz="0"/></inertial></link>"""
    joint = """<joint name="{0}" type="prismatic"><parent link="base"/><child link="{1}"/>
      <axis xyz="0 {2} 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>{3}</joint>"""
    (tmp_path / "r.urdf").write_text(
        f"""<robot name="r"><link name="base"/>{link.format("left")}{link.format("right")}
        {joint.format("one", "left", 1, "")}
        {joint.format("other", "right", -1, '<mimic joint="one" multiplier="2" offset="0"/>')}
        </robot>"""
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rig = jc.read_urdf(tmp_path / "r.urdf")
    ((name, tie),) = rig.couplings.items()
    assert name == "other by one"
    assert (tie.follower, tie.leader, float(tie.ratio), tie.offset) == ("other", "one", 2.0, None)


@pytest.mark.parametrize(
    "text", [FOUR_BAR, wheels("0.2 -3 0 0 0"), wheels("0.4 0 0 0 0", 'joint1="b"')]
)
def test_what_equalities_become_is_written_to_a_scene_and_read(text, tmp_path):
    rig, _ = imported(tmp_path, text)
    jc.write_scene(rig, tmp_path / "rig.yaml")
    assert str(jc.read_scene(tmp_path / "rig.yaml").mechanism) == str(rig)
