"""What a run says of steps that are too long (loads, contacts, wear), and of right ones nothing."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Check, Outcome
from jaxclear.simulation import spot_checks

LINKS = 4


def chain(damping):
    """A pendulum of links with dampers in all joints but the first."""
    link = jc.Body(0.1, 1e-5, (0.05, 0.0))
    bodies = {f"link{i}": link for i in range(LINKS)}
    connections = {"J0": jc.Connection(jc.joint.Revolute(), "ground", "link0")}
    loads = {"gravity": jc.load.Gravity((0.0, -9.81))}
    for i in range(1, LINKS):
        ends = (f"link{i - 1}", f"link{i}")
        connections[f"J{i}"] = jc.Connection(jc.joint.Revolute(), *ends, at=(0.1, 0.0))
        loads[f"damper{i}"] = jc.load.JointSpring(f"J{i}", damping=damping)
    return jc.Mechanism(bodies, connections, loads)


def beyond(run):
    return {check for check, worst, *_ in run.checks.rows() if worst > check.limit}


@pytest.mark.slow
def test_a_mechanism_that_gains_energy_from_nowhere_ends():
    """Steps just beyond what a damper allows: speeds of hundreds of rad/s, bounded by nothing but
    the geometry."""
    integrator = jc.integrator.FixedStep(2e-5, "semi_implicit")
    with pytest.raises(jc.SimulationError, match="gained energy that nothing gave"):
        jc.simulate(chain(2.0), 0.02, save=21, integrator=integrator)
    right = jc.simulate(chain(2.0), 0.02, save=21, integrator=jc.integrator.Adaptive())
    assert right.warnings == () and Check.ENERGY_GAIN in right.checks.figures


def test_forces_that_are_wrong_in_a_right_motion_are_said():
    """Error control holds explicit steps at the edge of stability: the motion is right to rounding,
    what stiff dampers exert is not."""
    loose, tight = (
        jc.integrator.Adaptive(rtol=r, atol=a) for r, a in ((1e-3, 1e-4), (1e-9, 1e-12))
    )
    found, exact = (
        jc.simulate(chain(20.0), 0.02, save=21, integrator=each) for each in (loose, tight)
    )
    places = [np.asarray(run.body("link3").com) for run in (found, exact)]
    np.testing.assert_allclose(*places, atol=1e-12)
    forces, true = (np.asarray(run.reaction("J1").force) for run in (found, exact))
    assert np.abs(forces - true).max() > 0.5 * np.abs(true).max()
    assert Check.HALVED_FORCES in beyond(found) and "forces at an instant" in found.result
    assert beyond(exact) == set()


def test_phases_that_drift_over_many_turns_are_said():
    """Eighty turns of a mass on a spring, beside the cosine: every step is nearly right, and so are
    forces over a window; what is off adds up."""
    omega, length = 1000.0, 0.1
    rig = jc.Mechanism(
        {"mass": jc.Body(1.0, 1e-3)},
        {"guide": jc.Connection(jc.joint.Prismatic(), "ground", "mass")},
        {"spring": jc.load.JointSpring("guide", omega**2)},
        start={"guide": length},
    )

    def off(step):
        integrator = jc.integrator.ImplicitStep(step)
        run = jc.simulate(rig, 0.5, save=201, integrator=integrator)
        exact = length * np.cos(omega * np.asarray(run.time))
        return np.abs(run.coordinate("guide").ravel() - exact).max() / length, beyond(run)

    worst, said = off(1e-4)
    assert worst > 0.1 and said == {Check.HALVED_MOTION}
    worst, said = off(1e-5)
    assert worst < 0.01 and said == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    "integrator", [jc.integrator.MoreauJean(1e-3), jc.integrator.NonColliding()]
)
def test_rounding_of_what_stands_still_is_no_motion_and_no_wear(integrator):
    """An arm that friction holds: slip, wear and losses are of the order of 1e-30."""
    sticks = jc.friction.Coulomb(mu_kinetic=0.1)
    hinge = jc.joint.PlainBearing(
        sticks, radius=8e-3, length=20e-3, wear=jc.Wearing(jc.wear.Archard())
    )
    held = jc.Mechanism(
        {"arm": jc.Body(1.0, 1e-3, com=(1e-4, 0.0))},
        {"B": jc.Connection(hinge, "ground", "arm")},
        {"gravity": jc.load.Gravity()},
    )
    run = jc.simulate(held, 0.2, save=51, integrator=integrator, balance=True)
    assert 0 < run.worn_volume("B", "bearing")[-1] < 1e-30
    assert run.warnings == ()


def test_windows_of_long_adaptive_steps_have_a_finer_pass():
    """Neither tolerance asks for shorter steps than the window: the second pass was the first one,
    and the run saw nothing."""
    turning = jc.scenes.slider_crank("ideal", crank_speed=600.0)
    loose = jc.integrator.Adaptive(rtol=0.9, atol=1e6)
    found, tight = (
        jc.simulate(turning, 0.05, save=101, integrator=each)
        for each in (loose, jc.integrator.Adaptive())
    )
    assert found.accepted_steps <= 2 * 100 + 1
    speeds = slice(found.states.shape[1] // 2, None)
    off = np.abs(found.states - tight.states)[:, speeds].max() / np.abs(tight.states).max()
    assert found.checks.figures[Check.HALVED_MEAN_FORCES].worst.max() > 0.1 * off


@pytest.mark.slow
def test_contacts_crossed_in_one_step_are_said():
    """Peak forces are then those of the steps."""
    rig = jc.scenes.slider_crank()
    long = jc.simulate(rig, 0.02, save=11, integrator=jc.integrator.ImplicitStep(2e-4))
    short = jc.simulate(rig, 0.02, save=11, integrator=jc.integrator.ImplicitStep(5e-6))
    assert Check.CONTACT_STEP in beyond(long) and "peak forces" in long.result
    assert beyond(short) == set()


def test_impacts_that_explicit_steps_do_not_resolve_are_said():
    """Within 0.02 s a journal is then elsewhere in its gap by a tenth of it, and more."""
    rig = jc.scenes.slider_crank()
    long, short = (
        jc.simulate(rig, 0.02, save=41, integrator=jc.integrator.FixedStep(step))
        for step in (2e-5, 5e-6)
    )
    joint = next(iter(rig.topology.clearances))
    places = [np.asarray(run.contact(joint).offset) for run in (long, short)]
    assert np.abs(places[0] - places[1]).max() > 0.1 * np.abs(places[1]).max()
    assert Check.IMPACT_STEP in beyond(long) and "back from impacts" in long.result
    assert Check.IMPACT_STEP not in beyond(short)


def pushed_through(stiffness, integrator):
    soft = jc.scenes.slider_crank(contact=jc.contact.CarvalhoMartins(stiffness=stiffness))
    return jc.simulate(soft, 0.02, save=11, integrator=integrator, throw=False)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [jc.integrator.FixedStep(), jc.integrator.Adaptive()])
def test_a_journal_that_sinks_in_is_said_and_ends_the_run_beyond_its_radius(integrator):
    """No contact law was made for it."""
    said, ended = (pushed_through(stiffness, integrator) for stiffness in (1e6, 1e2))
    assert said.succeeded and Check.INDENTATION in beyond(said)
    assert ended.outcome == Outcome.SUNK_IN and ended.ended < 0.02


@pytest.mark.slow
def test_shadows_do_not_touch_the_run():
    """The same saved states, bit for bit, as where no window lies before them."""
    rig = jc.scenes.slider_crank()
    integrator = jc.integrator.FixedStep()
    times = np.linspace(0.0, 0.004, 11)
    few = jc.simulate(rig, 0.004, save=times, integrator=integrator)
    fewer = jc.simulate(rig, times[6], save=times[:7], integrator=integrator)
    assert Outcome(int(few.outcome)) == Outcome.REACHED
    np.testing.assert_array_equal(few.states[:7], fewer.states)
    assert few.accepted_steps == 200


@pytest.mark.parametrize(("saves", "extra"), [(501, 3), (51, 4)])
def test_a_window_that_fills_its_saving_interval_is_gone_through_once_more(saves, extra):
    """With half the steps; the run's own turn, in its place, stands for the other pass."""
    plan = spot_checks.plan(np.linspace(0.0, 0.1, saves), 2e-5)
    parts = plan.parts
    assert np.sum(~parts.own) == extra * len(plan.windows) and plan.intervals == saves - 1
    own = [
        np.arange(*each) for each in zip(parts.first[parts.own], parts.stop[parts.own], strict=True)
    ]
    np.testing.assert_array_equal(np.concatenate(own), np.arange(saves - 1))
    fine, on = plan.shadows(spot_checks.FINE), plan.shadows(spot_checks.COARSE_ON)
    start, stop = (np.asarray(each) for each in plan.turns[:2])
    begun = np.linspace(0.0, 0.1, saves)[plan.windows]
    np.testing.assert_array_equal(start[parts.first[fine]], begun)
    np.testing.assert_array_equal(stop[parts.first[fine]], start[parts.first[on]])
    assert np.all(parts.goes_on[on]) and not np.any(parts.goes_on[fine])
    if extra == 3:
        np.testing.assert_array_equal(stop[plan.windows], start[parts.first[on]])
        np.testing.assert_array_equal(parts.first[on - 1], plan.windows)
