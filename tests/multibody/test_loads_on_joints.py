"""Loads on a joint's coordinate mean the same whether the tree carries it, it closes a loop, or it
has clearance.

Stops, dry friction and rotor inertia on the coordinate of a joint: closed forms, energy, and
what they may act on."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

# Elastic: rattling would take energy that the ideal joint keeps.
LAW = jc.contact.Hertz(stiffness=1e10)
CLEARANCE = 1e-6
BEARING = jc.clearance.PlanarJournalBearing(LAW, clearance=CLEARANCE)
GUIDE = jc.clearance.SliderGuide(LAW, length=0.04, width=0.02, clearance=CLEARANCE)
TIME = 0.12


def slider_crank(closes, *loads, **joints):
    """A slider-crank whose loop is closed by one of its joints; some of them of another kind. Its
    crank is pushed to 80 rad/s, so that it turns more than once."""
    kinds = dict.fromkeys("OAB", jc.joint.Revolute()) | {"G": jc.joint.Prismatic()} | joints
    ends = {
        "O": ("ground", "crank", (0.0, 0.0), "z"),
        "A": ("crank", "rod", (0.05, 0.0), "z"),
        "B": ("rod", "slider", (0.12, 0.0), "z"),
        "G": ("ground", "slider", (0.0, 0.0), "x"),
    }
    order = [name for name in ends if name != closes] + [closes]
    return jc.Mechanism(
        {
            "crank": jc.Body(0.5, 1e-3, (0.02, 0.0)),
            "rod": jc.Body(0.3, 4e-4, (0.06, 0.0)),
            "slider": jc.Body(0.2, 1e-4),
        },
        {n: jc.Connection(kinds[n], *ends[n][:2], at=ends[n][2], axis=ends[n][3]) for n in order},
        {f"load {i}": load for i, load in enumerate(loads)},
        start={"O": 0.5},
        guess={"A": -0.7, "G": 0.15},
        speeds={"O": 80.0},
    )


def wound(name):
    """A torsion spring that is wound up by whole turns, and a torque."""
    return jc.load.JointSpring(name, 0.02, 0.3, 2e-4), jc.load.JointTorque(name, lambda t: 3 * t)


def ran(rig, integrator=None):
    integrator = jc.integrator.FixedStep(2e-5) if integrator is None else integrator
    return jc.simulate(rig, TIME, save=13, balance=True, integrator=integrator)


def motion(run):
    """Places of slider and crank, beside their ways."""
    return np.concatenate([run.body("slider").com[:, 0] / 0.1, run.body("crank").rotation[:, 0, 0]])


@pytest.mark.slow
def test_loads_on_a_joint_do_not_depend_on_which_joint_closes_the_loop():
    carried, cut = (ran(slider_crank(closes, *wound("A"))) for closes in "BA")
    assert (carried.mechanism.topology.loops, cut.mechanism.topology.loops) == (("B",), ("A",))
    assert abs(carried.coordinate("A")).max() > 2.5 * np.pi
    np.testing.assert_allclose(motion(cut), motion(carried), atol=1e-8)
    # What the joint hands over, its own loads included.
    for part in ("force", "torque"):
        np.testing.assert_allclose(
            getattr(cut.reaction("A"), part), getattr(carried.reaction("A"), part), atol=1e-5
        )
    for run in (carried, cut):
        assert not run.warnings
        balance = run.energy_balance()
        assert abs(balance.error).max() < 1e-9 * balance.potential.max()


RUNGS = {
    "adaptive": jc.integrator.Adaptive(rtol=1e-8, atol=1e-10),
    "groups": jc.integrator.Adaptive(jc.integrator.MuntheKaas(4), rtol=1e-8, atol=1e-10),
    "implicit": jc.integrator.ImplicitStep(2e-5),
    "semi-implicit": jc.integrator.FixedStep(1e-6, "semi_implicit"),
    "rigid": jc.integrator.MoreauJean(2e-5),
    "permanent": jc.integrator.NonColliding(2e-5),
}


PRESSED = (jc.load.JointSpring("G", 50.0, 0.1, 0.5),)


@functools.cache
def ideal_run(guide):
    return ran(slider_crank("B", *(PRESSED if guide else wound("A"))))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cut", "bearing", "guide"])
@pytest.mark.parametrize("rung", RUNGS)
def test_every_rung_follows_loads_on_joints_outside_the_tree(rung, kind):
    on = "G" if kind == "guide" else "A"
    loads = PRESSED if kind == "guide" else wound("A")
    ideal = ideal_run(kind == "guide")
    joints = {"bearing": {"A": BEARING}, "guide": {"G": GUIDE}}.get(kind, {})
    run = ran(slider_crank(on, *loads, **joints), RUNGS[rung])
    np.testing.assert_allclose(motion(run), motion(ideal), atol=3e-3)


@pytest.mark.slow
def test_a_torsion_spring_in_a_leaning_journal_gives_back_what_it_takes():
    bearing = jc.clearance.JournalBearing(LAW, clearance=3e-4)
    rig = jc.Mechanism(
        {"arm": jc.Body(1.0, (1e-3, 1.2e-3, 1.1e-3), (0.03, 0.0, 0.02))},
        {"pin": jc.Connection(bearing, "ground", "arm")},
        {
            "gravity": jc.load.Gravity((0.0, -9.81, -5.0)),
            "spring": jc.load.JointSpring("pin", 5.0, 0.5),
        },
        speeds={"pin": 200.0},
    )
    tight = jc.integrator.Adaptive(rtol=1e-9, atol=1e-12)
    run = jc.simulate(rig, 0.1, save=21, balance=True, integrator=tight)
    balance = run.energy_balance()
    assert abs(run.contact("pin").axis[:, :2]).max() > 0.02
    assert abs(balance.error).max() < 1e-8 * balance.potential.max()


@pytest.mark.slow
def test_a_run_that_goes_on_keeps_the_turns_of_a_spring():
    rig, step = slider_crank("A", *wound("A")), jc.integrator.FixedStep(2e-5)
    whole = ran(rig)
    one = jc.simulate(rig, TIME / 2, save=7, integrator=step)
    two = jc.simulate(rig, TIME / 2, save=7, integrator=step, state=one.state())
    first = whole.history.layout().angle_start
    assert abs(one.history.states[-1, first]) > np.pi
    np.testing.assert_allclose(
        two.history.states[-1, first], whole.history.states[-1, first], atol=1e-6
    )


MASS, STIFFNESS, SPEED = 2.0, 8e4, 1.5
STEP, FINE = jc.integrator.FixedStep(1e-4), jc.integrator.FixedStep(2e-6)


def slide(*loads, speed=SPEED):
    """A mass on a slide, 0.1 m before its stop if it has one there."""
    return jc.Mechanism(
        {"mass": jc.Body(MASS, 1e-3)},
        {"slide": jc.Connection(jc.joint.Prismatic(), "ground", "mass", axis="x")},
        {type(load).__name__: load for load in loads},
        start={"slide": -0.1},
        speeds={"slide": speed},
    )


def arm(*loads, **joints):
    """Two links on hinges, 1 m each, hanging from gravity."""
    kinds = {"shoulder": jc.joint.Revolute(), "elbow": jc.joint.Revolute()} | joints
    link = jc.Body(1.0, 0.1, (0.5, 0.0))
    return jc.Mechanism(
        {"upper": link, "fore": link},
        {
            "shoulder": jc.Connection(kinds["shoulder"], "ground", "upper"),
            "elbow": jc.Connection(kinds["elbow"], "upper", "fore", at=(1.0, 0.0)),
        },
        {"gravity": jc.load.Gravity((0.0, -9.81))}
        | {f"load {i}": load for i, load in enumerate(loads)},
        guess={"shoulder": -0.5, "elbow": -0.3},
    )


def test_a_mass_comes_back_from_a_stop_after_half_a_period():
    """Without damping: depth v sqrt(m/k), there for pi sqrt(m/k), as fast back as it came; with a
    rotor on the slide m is the sum."""
    stop = jc.load.JointStop("slide", upper=0.0, stiffness=STIFFNESS)
    run = jc.simulate(
        slide(stop, jc.load.RotorInertia("slide", 3.0)), 0.2, save=2001, integrator=STEP
    )
    place = np.asarray(run.coordinate("slide"))
    slowness = np.sqrt((MASS + 3.0) / STIFFNESS)
    np.testing.assert_allclose(place.max(), SPEED * slowness, rtol=1e-4)
    back = 0.1 / SPEED + np.pi * slowness
    np.testing.assert_allclose(place[-1], -SPEED * (0.2 - back), rtol=1e-3)


def test_energy_is_accounted_for_by_stops_friction_and_rotors():
    """An arm swings against a stop of its elbow, which takes energy, as friction does."""
    loads = (
        jc.load.JointStop("elbow", -0.2, 0.3, stiffness=500.0, damping=5.0),
        jc.load.JointFriction("shoulder", 0.7, 0.05),
        jc.load.RotorInertia("elbow", 0.4),
    )
    run = jc.simulate(arm(*loads), 2.0, save=201, balance=True, integrator=STEP)
    angle, balance = np.asarray(run.coordinate("elbow")), run.energy_balance()
    assert angle.min() < -0.2 and angle.max() > 0.3
    assert balance.damping_loss[-1] > 2.0
    assert np.all(np.diff(balance.damping_loss) > -1e-9)
    assert np.abs(balance.error).max() < 1e-4 * np.ptp(balance.potential)


@pytest.mark.parametrize("beyond", [1e-5, 2e-4, 1e-3, 0.01])
def test_a_stop_pushes_and_never_pulls(beyond):
    stop = jc.load.JointStop("a", -1.0, 1.0, stiffness=100.0, damping=30.0)
    for speed in (-10.0, -0.1, 0.0, 0.1, 10.0):
        upper, energy, lost, _ = stop.force(0.0, 1.0 + beyond, speed)
        lower = stop.force(0.0, -1.0 - beyond, -speed)[0]
        assert upper <= 0 and lower == -upper and lost >= -1e-15
        # What it gives and what it takes: power = -d(energy)/dt - loss.
        np.testing.assert_allclose(upper * speed, -100.0 * beyond * speed - lost, atol=1e-12)
        np.testing.assert_allclose(energy, 50.0 * beyond**2)
    assert stop.force(0.0, 1.0 - beyond, 10.0)[0] == 0


@pytest.mark.slow
def test_derivatives_pass_through_a_damped_stop():
    """Of the place after the stop by the speed before: as differences of neighbouring runs."""
    stop = jc.load.JointStop("slide", upper=0.0, stiffness=STIFFNESS, damping=200.0)

    @jax.jit
    def end(speed):
        rig = slide(stop, speed=speed)
        run = jc.simulate(rig, 0.12, save=3, integrator=FINE, throw=False)
        return run.coordinate("slide")[-1]

    near = 1e-3
    by_difference = (end(SPEED + near) - end(SPEED - near)) / (2 * near)
    slope = jax.jvp(end, (jnp.asarray(SPEED),), (jnp.ones(()),))[1]
    np.testing.assert_allclose(slope, by_difference, rtol=2e-3)


def test_a_drive_takes_the_place_of_what_acts_on_the_coordinate():
    before = arm(jc.load.JointSpring("elbow", 3.0), jc.load.JointSpring("shoulder", 2.0))
    driven = before.with_joint("elbow", jc.joint.Revolute(jc.drive.ConstantSpeed(speed=1.0)))
    assert set(driven.loads) == {"gravity", "load 1"}
    assert not driven.guess.keys() & {"elbow"}


@pytest.mark.slow
def test_positions_are_told_whatever_acts_on_a_joint_that_is_held():
    loads = (jc.load.JointSpring("elbow", 3.0), jc.load.RotorInertia("shoulder", 0.1))
    found = jc.positions(arm(*loads), {"shoulder": [0.0, 0.5], "elbow": [0.1, 0.2]})
    tip = np.asarray(found.marker("fore", (1.0, 0.0)).position)
    np.testing.assert_allclose(tip[1, 1], np.sin(0.5) + np.sin(0.7), rtol=1e-12)
