"""A derivative through contacts that open and close is refused, or stands beside one that is right.

A journal dropped in its bearing bounces once. Where its law is linear and lossless its height is
known in closed form: free fall, half of a harmonic oscillation, free flight."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.sensitivity.derivative import Estimate, confirmed
from tests.rigs.cells import slow_but

CLEARANCE, GRAVITY, OMEGA, TIME = 1e-3, 9.81, 3e3, 0.02
INTEGRATORS = {
    "explicit": jc.integrator.FixedStep(2e-5, "munthe_kaas4"),
    "explicit, reverse mode": jc.integrator.FixedStep(steps_per_save=50),
    "contact steps": jc.integrator.FixedStep(1e-4, "heun", contact_steps=10),
    "implicit, reverse mode": jc.integrator.ImplicitStep(steps_per_save=50),
    "adaptive, implicit": jc.integrator.Adaptive(diffrax.Kvaerno5()),
}


def dropped(law):
    bearing = jc.clearance.PlanarJournalBearing(law, clearance=CLEARANCE)
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
    )


def height(run):
    return run.body("journal").com[-1, 1]


def problem(integrator, law=None, duration=TIME):
    law = jc.contact.CarvalhoMartins(stiffness=1e9, restitution=0.8) if law is None else law
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=2e-5)
    return jc.Problem(
        dropped(law), {"height": height}, {"c": clearance}, duration=duration, integrator=integrator
    )


def fall_and_bounce(clearance):
    """Height [m] after one lossless bounce on a linear wall, by the clearance [m]."""
    touch, speed = jnp.sqrt(2 * clearance / GRAVITY), jnp.sqrt(2 * GRAVITY * clearance)
    # In contact y = rest + amplitude cos(omega t - phase), entered and left at the same height.
    contact = 2 * (jnp.pi - jnp.arctan(speed * OMEGA / GRAVITY)) / OMEGA
    flight = TIME - touch - contact
    return -clearance + speed * flight - GRAVITY * flight**2 / 2


@pytest.mark.parametrize(
    "name", slow_but(("explicit, reverse mode", "adaptive, implicit"), INTEGRATORS)
)
def test_a_raw_derivative_through_contacts_is_refused_while_traced(name):
    asked = problem(INTEGRATORS[name])
    answer = jax.jit(lambda values: asked.evaluate(values).responses["height"])
    backward = name == "adaptive, implicit" or "reverse" in name
    derivative = jax.grad(answer) if backward else jax.jacfwd(answer)
    with pytest.raises(
        ValueError, match=r'is not to be trusted: .*joint "B".*jaxclear.sensitivity'
    ):
        derivative(asked.nominal())


def test_a_derivative_of_simulate_through_contacts_is_refused():
    rig = dropped(jc.contact.CarvalhoMartins(stiffness=1e9))

    def end(clearance):
        moved = eqx.tree_at(lambda rig: rig.connections["B"].joint.clearance, rig, clearance)
        run = jc.simulate(moved, 1e-3, save=3, integrator=INTEGRATORS["explicit"], throw=False)
        return height(run)

    with pytest.raises(
        ValueError, match="take jaxclear.integrator.Adaptive.*, or jaxclear.sensitivity"
    ):
        jax.jvp(end, (CLEARANCE,), (1.0,))


def test_the_derivative_of_the_discrete_run_is_had_by_asking_for_it():
    """While nothing touches it is that of the motion: the height of a fall does not depend on the
    clearance, its share of the clearance does. Integrators that have none refuse."""
    asked = problem(INTEGRATORS["explicit"], duration=0.5 * np.sqrt(2 * CLEARANCE / GRAVITY))
    share = lambda run: height(run) / run.mechanism.connections["B"].joint.clearance
    asked = eqx.tree_at(lambda p: p.response["height"], asked, share)
    slope = lambda asked: jax.jit(
        jax.jacfwd(lambda v: asked.evaluate(v, discrete_derivatives=True).responses["height"])
    )(asked.nominal())
    np.testing.assert_allclose(slope(asked), 0.25 / CLEARANCE, rtol=1e-9)
    with pytest.raises(ValueError, match="is not to be trusted"):
        slope(problem(INTEGRATORS["adaptive, implicit"]))


@pytest.mark.parametrize(
    "integrator",
    [jc.integrator.Adaptive(), jc.integrator.NonColliding(1e-3), jc.integrator.MoreauJean(1e-3)],
    ids=lambda i: type(i).__name__,
)
def test_where_nothing_opens_derivatives_pass(integrator):
    """The swing A cos(sqrt(g / l) t) of a pendulum by its length."""
    rod = jc.Mechanism(
        {"rod": jc.Body(1.0, 1e-9, (1.0, 0.0))},
        {"pivot": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        start={"pivot": -np.pi / 2 + 1e-3},
    )
    length = {"length": jc.Variable(lambda r: r.bodies["rod"].com[0], tolerance=0.01)}
    asked = jc.Problem(
        rod,
        jc.response.FinalCoordinate("pivot"),
        length,
        duration=1.0,
        integrator=integrator,
        save=5,
    )
    slope = jax.jit(jax.jacfwd(lambda v: asked.evaluate(v).responses["response"]))(asked.nominal())
    omega = np.sqrt(GRAVITY)
    # Steps of 1 ms: (omega h)^2 = 1e-5 of the swing, more of its slope, which is nearly zero.
    np.testing.assert_allclose(slope, 1e-3 * np.sin(omega) * omega / 2, rtol=1e-3)


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("name", ["explicit", "implicit", "under error control"])
def test_pathwise_knows_that_a_longer_fall_strikes_faster(name):
    """-1.212 by differences of tight runs. Impact speeds are taken at the touch, so the tangent of
    the discrete run follows them; alone it is refused, because nothing confirms it."""
    others = {"under error control": jc.integrator.Adaptive()}
    others["implicit"] = jc.integrator.ImplicitStep(2e-5)
    asked = problem((INTEGRATORS | others)[name])
    sample = jc.monte_carlo(asked, 32)
    answers = jc.sensitivity(
        asked, sample=sample, methods=("regression", "pathwise"), difference_samples=16
    ).derivatives["height", "c"]
    assert answers.trustworthy and abs(answers.value + 1.212) < 0.01
    assert abs(answers.estimates["pathwise"].value + 1.212) < 0.02
    alone = jc.sensitivity(asked, sample=sample, methods=("pathwise",), difference_samples=16)
    alone = alone.derivatives["height", "c"]
    assert np.isnan(alone.value) and not alone.trustworthy
    assert "no other method has an answer" in alone.estimates["pathwise"].refusal


@pytest.mark.slow
def test_the_answer_through_a_bounce_is_that_of_the_closed_form():
    asked = problem(jc.integrator.FixedStep(1e-5), jc.contact.Linear(stiffness=OMEGA**2))
    found = eqx.filter_jit(asked.evaluate)(asked.nominal()).responses["height"]
    np.testing.assert_allclose(found, fall_and_bounce(CLEARANCE), rtol=1e-4)
    exact = float(jax.grad(fall_and_bounce)(CLEARANCE))
    answers = jc.sensitivity(asked, sample=64, difference_samples=32).derivatives["height", "c"]
    assert answers.trustworthy and abs(answers.value - exact) < answers.error + 0.005 * abs(exact)


def test_an_estimate_in_doubt_confirms_and_is_never_the_answer():
    doubtful = Estimate(1.05, 1e-3, doubt="impacts")
    found = confirmed("r", "v", {"regression": Estimate(1.0, 0.1), "pathwise": doubtful})
    assert (found.value, found.error, found.method) == (1.0, 0.1, "regression")
    assert found.trustworthy and found.verdict == "From regression, confirmed by pathwise (±0.001)."
    others = {"regression": Estimate(1.0, 0.01), "differences": Estimate(2.0, 0.01)}
    apart = confirmed("r", "v", others | {"pathwise": doubtful})
    assert apart.verdict == "The methods disagree." and not apart.trustworthy
    assert "other methods disagree, and impacts" in apart.estimates["pathwise"].refusal
