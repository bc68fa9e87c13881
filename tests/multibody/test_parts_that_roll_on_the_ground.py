"""Wheels coupled with the joint of their own carrier: they roll on what that joint starts from."""

import warnings

import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

TURN, SLIDE = jc.joint.Revolute(), jc.joint.Prismatic()
RADIUS, MASS, SLOPE, GRAVITY = 0.1, 3.0, 0.4, 9.81
STEPS = jc.integrator.FixedStep(2e-3)


def last(run, name):
    return float(np.ravel(run.coordinate(name))[-1])


def rolling(below=RADIUS, turned_round=False, **how):
    """A full cylinder that rolls down a slope, along x, on the side `below` its axis."""
    ends = (
        jc.Marker("ground", (0.0, -below), axis="x"),
        jc.Marker("cart", (0.0, -below), axis="x"),
    )
    return jc.Mechanism(
        {"cart": jc.Body(1e-9, 1e-9), "wheel": jc.Body(MASS, 0.5 * MASS * RADIUS**2)},
        {
            "road": jc.Connection(SLIDE, *(ends[::-1] if turned_round else ends)),
            "wheel": jc.Connection(TURN, "cart", "wheel"),
        },
        {"g": jc.load.Gravity((GRAVITY * np.sin(SLOPE), -GRAVITY * np.cos(SLOPE)))},
        couplings={"roll": jc.coupling.Rack("wheel", "road", RADIUS, **how)},
    )


SLOW = pytest.mark.slow


@pytest.mark.parametrize("turned_round", [*slow(False), True])
def test_a_cylinder_rolls_down_a_slope_by_two_thirds_of_what_a_slide_does(turned_round):
    # Several turns: a = 2/3 g sin(slope), and the wheel turns by -x / r on a road below it.
    run = jc.simulate(rolling(turned_round=turned_round), 1.5, save=3, integrator=STEPS)
    way = GRAVITY * np.sin(SLOPE) * 1.5**2 / 3
    sign = -1.0 if turned_round else 1.0
    assert abs(sign * last(run, "road") / way - 1) < 1e-6
    assert abs(last(run, "wheel") / (-way / RADIUS) - 1) < 1e-6
    # What holds the wheel is a third of its weight along the slope.
    force = abs(np.asarray(run.transmitted("roll"))[-1])
    assert abs(force / (MASS * GRAVITY * np.sin(SLOPE) / 3) - 1) < 1e-6


def planet(coupling, base=False, turned_round=False):
    """A wheel on an arm that turns by 3 rad/s; `base`: a body fixed in the ground."""
    ends = ("arm", "ground") if turned_round else ("ground", "arm")
    speed = -3.0 if turned_round else 3.0
    bodies = {"arm": jc.Body(1.0, 1e-2), "wheel": jc.Body(0.3, 4e-4)}
    joints = {
        "C": jc.Connection(jc.joint.Revolute(drive=jc.drive.ConstantSpeed(speed)), *ends),
        "P": jc.Connection(TURN, jc.Marker("arm", (0.1, 0.0)), jc.Marker("wheel")),
    }
    if base:
        bodies["base"] = jc.Body(1.0, 1.0)
        joints["Z"] = jc.Connection(jc.joint.Fixed(), "ground", "base")
    loads = {"load": jc.load.JointTorque("P", 0.05)}
    return jc.Mechanism(bodies, joints, loads, couplings={"mesh": coupling})


# (coupling, turns of the wheel against the arm for one of the arm)
ROUND_A_SUN = {
    "gear": (lambda sun: jc.coupling.Gear("P", sun, 1.5), 1.5),
    "sun first": (lambda sun: jc.coupling.Gear(sun, "P", 1 / 1.5), 1.5),
    "ring": (lambda sun: jc.coupling.Gear("P", sun, 2.5, internal=True), -2.5),
    "belt": (lambda sun: jc.coupling.Belt(sun, "P", 0.04, 0.05), -0.8),
    "crossed": (lambda sun: jc.coupling.Belt("P", sun, 0.05, 0.04, crossed=True), 0.8),
}


FAST = {("gear", True), ("crossed", False)}


@pytest.mark.parametrize(
    ("how", "turned_round"),
    [
        pytest.param(how, turned, marks=() if (how, turned) in FAST else SLOW)
        for how in ROUND_A_SUN
        for turned in (False, True)
    ],
)
def test_a_planet_turns_round_its_fixed_sun_as_willis_has_it(how, turned_round):
    """The carrier joined to the ground, or the ground to it."""
    make, turns = ROUND_A_SUN[how]
    run = jc.simulate(planet(make("C"), turned_round=turned_round), 4.0, save=3, integrator=STEPS)
    assert abs(last(run, "P") / (turns * 12.0) - 1) < 1e-9


@pytest.mark.slow
def test_play_and_losses_round_a_sun_are_those_beside_a_body_in_the_ground():
    def run(sun, base):
        gear = jc.coupling.Gear(
            "P", sun, 1.5, play=2e-3, stiffness=50.0, damping=0.05, efficiency=0.9
        )
        return jc.simulate(
            planet(gear, base), 0.2, save=11, integrator=jc.integrator.FixedStep(1e-4)
        )

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found, beside = run("C", False), run("Z", True)
    for seen in (lambda own: own.coordinate("P"), lambda own: own.transmitted("mesh")):
        np.testing.assert_allclose(seen(found), seen(beside), rtol=1e-7, atol=1e-9)
