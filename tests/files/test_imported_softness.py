"""Limits and dry friction of imported models at rest, against MuJoCo and closed forms."""

import warnings

import numpy as np
import pytest

import jaxclear as jc

mujoco = pytest.importorskip("mujoco")

SLIDE = """<mujoco><option gravity="0 0 -9.81" timestep="1e-3"/><worldbody><body name="rack">
 <joint name="slide" type="slide" axis="0 0 1" range="-2e-3 1e-3" limited="true" damping="20" {}/>
 <inertial pos="0 0 0" mass="{}" diaginertia="1e-2 1e-2 1e-2"/></body></worldbody></mujoco>"""
# MuJoCo's usual softness, others of it, and masses.
SOFT = (
    ("", 2.0),
    ('solimplimit="0.5 0.99 1e-4 0.3 3"', 0.1),
    ('solreflimit="-4e4 -300" margin="1e-4"', 50.0),
    ('solimplimit="0.9 0.9 0 0.5 2" solreflimit="0.01 0.7"', 2.0),
)


def imported(tmp_path, text, **asked):
    """The mechanism, and what is said of it."""
    (tmp_path / "model.xml").write_text(text)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = jc.read_mjcf(tmp_path / "model.xml", **asked)
    return found, [str(one.message) for one in said if one.category is jc.ImportedSoft]


def at_rest_in_mujoco(text, duration):
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    while data.time < duration:
        mujoco.mj_step(model, data)
    return data


@pytest.mark.parametrize(("soft", "mass"), SOFT)
def test_a_limit_gives_way_under_weight_as_far_as_in_mujoco(soft, mass, tmp_path):
    text = SLIDE.format(soft, mass)
    rig, said = imported(tmp_path, text)
    stop = rig.loads["slide limits"]
    there = float(stop.lower) - at_rest_in_mujoco(text, 3.0).qpos[0]
    np.testing.assert_allclose(mass * 9.81 / float(stop.stiffness), there, rtol=1e-5)
    assert bool(said) == (there > 0.01 * 3e-3)
    if said:
        number = f'limits of "slide" by {there:.3g} m'
        assert number in said[0] and "as in MuJoCo" in said[0]


def test_the_rack_rests_on_its_stop_as_in_mujoco(tmp_path):
    """m g / k beyond the limit; what runs into it does not jump back: damped as MuJoCo's, by 1."""
    text = SLIDE.format("", 2.0)
    rig, _ = imported(tmp_path, text)
    place = np.asarray(jc.simulate(rig, 0.6, save=61).coordinate("slide"))
    stiffness = float(rig.loads["slide limits"].stiffness)
    np.testing.assert_allclose(-2e-3 - place[-1], 2 * 9.81 / stiffness, rtol=1e-3)
    np.testing.assert_allclose(place[-1], at_rest_in_mujoco(text, 0.6).qpos[0], atol=1e-6)
    assert place.argmin() == 0 or np.all(np.diff(place[: place.argmin()]) <= 0)


def test_a_limit_for_impacts_says_how_far_it_gives_way_at_rest(tmp_path):
    text = SLIDE.format("", 2.0)
    rig, said = imported(tmp_path, text, stops="impact")
    weight, stiffness = 2 * 9.81, float(rig.loads["slide limits"].stiffness)
    np.testing.assert_allclose(stiffness, 2.0 / 0.02**2)
    told = f"by {weight / stiffness:.3g} m (1.3 of their width) under 19.6 N, in MuJoCo by"
    assert told in said[0]
    with pytest.raises(ValueError, match='no stops "rigid"; there are "steady", "impact"'):
        imported(tmp_path, text, stops="rigid")


def test_springs_press_into_limits_too_and_each_side_is_told(tmp_path):
    """No weight across a horizontal slide: the spring's force in each of the limits."""
    text = SLIDE.replace('gravity="0 0 -9.81"', 'gravity="0 0 0"')
    rig, said = imported(tmp_path, text.format('stiffness="2e4" springref="2e-3"', 2.0))
    stop, data = rig.loads["slide limits"], None
    data = at_rest_in_mujoco(text.format('stiffness="2e4" springref="2e-3"', 2.0), 1.0)
    ours = float(stop.upper) + (2e-3 - float(stop.upper)) / (1 + float(stop.stiffness) / 2e4)
    np.testing.assert_allclose(ours, data.qpos[0], rtol=0.05)
    assert len(said) == 1 and said[0].count("limits of") == 1


HELD = {
    "rigid": (jc.integrator.MoreauJean(1e-3), 1e-12),
    "permanent": (jc.integrator.NonColliding(1e-3), 1e-12),
    # The bristle gives way by its presliding times the share of the friction that is asked for.
    "compliant": (jc.integrator.Adaptive(), 1e-4),
}


@pytest.mark.parametrize("kind", HELD)
def test_imported_friction_holds_and_slides_as_the_file_has_it(kind, tmp_path):
    """A rack on a slide: held by more than its weight, sliding down with g - F/m."""
    integrator, way = HELD[kind]
    text = SLIDE.replace('range="-2e-3 1e-3" limited="true" damping="20"', "")
    held, said = imported(tmp_path, text.format('frictionloss="21"', 2.0))
    run = jc.simulate(held, 10.0, save=3, integrator=integrator, verify=False)
    np.testing.assert_allclose(np.asarray(run.coordinate("slide")), 0.0, atol=way)
    slides, _ = imported(tmp_path, text.format('frictionloss="5"', 2.0))
    run = jc.simulate(slides, 0.1, save=3, integrator=integrator, verify=False)
    # The bristle's way to its bound takes a millisecond of the fall.
    accuracy = 1e-9 if way < 1e-6 else 0.01
    end = np.asarray(run.speed("slide"))[-1]
    np.testing.assert_allclose(end, -(9.81 - 2.5) * 0.1, rtol=accuracy)
    assert said == []


def test_an_arm_of_two_links_rests_on_both_limits_as_in_mujoco(tmp_path):
    """Each limit is as stiff as its own inertia has it there, loads of the other joint included; to
    5 %, because weights are taken where the other joint stands in the reference configuration."""
    text = """<mujoco><compiler angle="radian"/><option timestep="1e-3"/><worldbody><body>
     <joint name="shoulder" axis="0 1 0" range="-1 0.1" limited="true" damping="2"/>
     <inertial pos="0.2 0 0" mass="1" diaginertia="1e-3 1e-2 1e-2"/>
     <body pos="0.4 0 0">
      <joint name="elbow" axis="0 1 0" range="-1 0.2" limited="true" damping="1"/>
      <inertial pos="0.1 0 0" mass="0.5" diaginertia="1e-4 3e-3 3e-3"/></body></body>
     </worldbody></mujoco>"""
    rig, said = imported(tmp_path, text)
    run, data = jc.simulate(rig, 2.0, save=3), at_rest_in_mujoco(text, 2.0)
    ours = [float(run.coordinate(name)[-1]) for name in ("shoulder", "elbow")]
    limits = np.array([0.1, 0.2])
    np.testing.assert_allclose(np.array(ours) - limits, data.qpos - limits, rtol=0.05)
    assert np.all(data.qpos > limits) and said == []
