"""Loads on a joint's coordinate mean the same whether the tree carries it, it closes a loop, or it
has clearance."""

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


@pytest.mark.slow
def test_loads_on_a_tight_bearing_do_as_those_on_the_ideal_joint():
    ideal = ran(slider_crank("B", *wound("A")))
    tight = ran(slider_crank("B", *wound("A"), A=BEARING), jc.integrator.FixedStep(2e-6))
    np.testing.assert_allclose(motion(tight), motion(ideal), atol=1e-3)
    balance = tight.energy_balance()
    assert abs(balance.error).max() < 1e-6 * balance.potential.max()


RUNGS = {
    "adaptive": jc.integrator.Adaptive(rtol=1e-8, atol=1e-10),
    "groups": jc.integrator.Adaptive(jc.integrator.MuntheKaas(4), rtol=1e-8, atol=1e-10),
    "implicit": jc.integrator.ImplicitStep(2e-5),
    "semi-implicit": jc.integrator.FixedStep(1e-6, "semi_implicit"),
    "rigid": jc.integrator.MoreauJean(2e-5),
    "permanent": jc.integrator.NonColliding(2e-5),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cut", "bearing", "guide"])
@pytest.mark.parametrize("rung", RUNGS)
def test_every_rung_follows_loads_on_joints_outside_the_tree(rung, kind):
    on = "G" if kind == "guide" else "A"
    loads = (jc.load.JointSpring("G", 50.0, 0.1, 0.5),) if kind == "guide" else wound("A")
    ideal = ran(slider_crank("B", *loads))
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
