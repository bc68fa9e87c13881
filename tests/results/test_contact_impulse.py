"""The impulse of contact forces is carried through a run's steps, so their mean does not hang on
the saving times: against balances of momentum, in closed form."""

import jax
import numpy as np
import pytest

import jaxclear as jc
from tests.formulations.test_permanent_joints import rubbing
from tests.rigs.bouncing_journal import CLEARANCE, GRAVITY, LEFT_THERE, MASS, falling

DURATION = 0.2
MEAN = jc.response.MeanContactForce("B")


def long(*parameters):
    return pytest.param(*parameters, marks=pytest.mark.slow)


SOFT, HARD = jc.contact.Flores(stiffness=1e8, restitution=0.6), jc.contact.Rigid(restitution=0.6)
USUAL = {
    "fixed": (jc.integrator.FixedStep(1e-5), SOFT),
    "implicit": (jc.integrator.ImplicitStep(), SOFT),
    "rigid": (jc.integrator.MoreauJean(1e-4), HARD),
}
OTHERS = {
    "adaptive": (jc.integrator.Adaptive(), SOFT),
    "semi-implicit": (jc.integrator.FixedStep(1e-5, method="semi_implicit"), SOFT),
    "groups": (jc.integrator.FixedStep(1e-5, method="munthe_kaas4"), SOFT),
    "short steps in contact": (jc.integrator.FixedStep(1e-4, contact_steps=10), SOFT),
}
# As many saving times, elsewhere.
OTHER_TIMES = np.linspace(0.0, 1.0, 11) ** 2 * DURATION


def fallen(rung, save=11):
    integrator, law = (USUAL | OTHERS)[rung]
    return jc.simulate(falling(law), DURATION, integrator=integrator, save=save, state=LEFT_THERE)


@pytest.mark.parametrize("rung", [*USUAL, *(long(rung) for rung in OTHERS)])
def test_contacts_give_the_impulse_that_weight_and_speed_ask_for(rung):
    """m v = I - m g t at every saving time; implicit steps end on a contact with the impulse of a
    speed b h g / 2, which is none."""
    run = fallen(rung)
    impulse = np.asarray(run.contact_impulse("B"))
    speed = np.asarray(run.body("journal").velocity[:, 1])
    balance = MASS * (speed + GRAVITY * np.asarray(run.time))
    assert impulse[-1] > 0.9 * MASS * GRAVITY * DURATION
    held = 1e-9 * impulse[-1]
    if rung == "implicit":
        integrator = USUAL[rung][0]
        bias = (1 - integrator.rebound) / (1 + integrator.rebound)
        held += 0.5 * bias * integrator.step * MASS * GRAVITY
    np.testing.assert_allclose(impulse, balance, atol=float(held))
    assert float(MEAN(run)) == pytest.approx(impulse[-1] / DURATION, rel=1e-12)


@pytest.mark.parametrize("rung", ["fixed", long("adaptive")])
def test_a_mean_force_does_not_hang_on_the_saving_times(rung):
    """As a mean over the saving times it was off by its like, by chance."""
    found = [float(MEAN(fallen(rung, save))) for save in (11, OTHER_TIMES)]
    assert found[0] == pytest.approx(found[1], rel=1e-5)


@pytest.mark.slow
def test_derivatives_of_a_mean_are_those_of_the_momentum():
    """The impulse is m (v + g t): its derivative by the clearance is that of m v."""
    last = lambda run: run.body("journal").velocity[-1, 1]
    how = {"integrator": jc.integrator.FixedStep(1e-5), "save": 11, "state": LEFT_THERE}
    varied = {"clearance": jc.Variable(CLEARANCE, tolerance=1e-5)}
    asked = {"mean": MEAN, "speed": last}
    problem = jc.Problem(falling(SOFT), asked, varied, duration=DURATION, **how)
    evaluate = lambda values: problem.evaluate(values, discrete_derivatives=True).responses
    _, slopes = jax.jvp(evaluate, (problem.nominal(),), (np.ones(1),))
    mean, speed = float(slopes["mean"]), float(slopes["speed"])
    assert abs(speed) > 0 and mean == pytest.approx(MASS / DURATION * speed, rel=1e-9)


SPIN, ARM = 2 * np.pi, 0.03


def spun(joint):
    """A rotor out of balance that turns evenly, without gravity."""
    return jc.Mechanism(
        {"rotor": jc.Body(MASS, 1e-3, com=(ARM, 0.0))},
        {"B": jc.Connection(joint, "ground", "rotor")},
        speeds={"B": SPIN},
    )


PLAIN = jc.joint.PlainBearing(radius=8e-3)
GAP = jc.clearance.PlanarJournalBearing(jc.contact.Rigid(restitution=0.0), clearance=1e-5)


TURNING = {
    "clearance": (GAP, jc.integrator.NonColliding(1e-3)),
    "plain": (PLAIN, jc.integrator.FixedStep(1e-3)),
    "plain that always touches": (PLAIN, jc.integrator.NonColliding(1e-3)),
    "plain and adaptive": (PLAIN, jc.integrator.Adaptive()),
    "plain and implicit": (PLAIN, jc.integrator.ImplicitStep(1e-3)),
}


@pytest.mark.parametrize("kind", [*list(TURNING)[:2], *map(long, list(TURNING)[2:])])
def test_a_force_that_turns_counts_by_its_size(kind):
    """m r omega^2, however often it is saved; the mean over a whole turn is nought."""
    joint, integrator = TURNING[kind]
    run = jc.simulate(spun(joint), 1.0, integrator=integrator, save=2)
    assert float(MEAN(run)) == pytest.approx(MASS * ARM * SPIN**2, rel=1e-6)


@pytest.mark.slow
def test_friction_at_the_side_of_a_guide_counts_in_how_hard_it_presses():
    """Step by step what `contact` finds by many turns, where the steps extrapolate from three."""
    run = jc.simulate(
        rubbing("OABG", 0.3), 0.02, integrator=jc.integrator.NonColliding(1e-4), save=201
    )
    for name in "ABG":
        forces = np.asarray(run.contact(name).normal_force).sum(axis=1)[1:]
        gained = np.diff(run.contact_impulse(name)) / np.diff(run.time)
        np.testing.assert_allclose(gained, forces, rtol=2e-5)
