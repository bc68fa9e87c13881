"""Derivatives of what a run follows between its saving times, peaks of forces and instants of
touches, are those of the motion: beside closed forms, and beside differences of runs in steps so
short that a peak at their ends is that of the path.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

CLEARANCE = lambda rig: rig.connections["B"].joint.clearance
SPEED = lambda rig: rig.speeds["journal"][1]
CONTACT = lambda rig: rig.connections["B"].joint.contact
STIFFNESS = lambda rig: CONTACT(rig).elastic.stiffness
_HERTZ = lambda rig: CONTACT(rig).stiffness
PEAK = jc.response.PeakContactForce("B")
ANSWERS = {
    "peak": PEAK,
    "touch": lambda run: run.noted.times[0, 0, 0],
    "speed": lambda run: run.noted.rates[0, 0, 0],
    "release": lambda run: run.noted.times[0, 0, 1],
    "speed back": lambda run: run.noted.rates[0, 0, 1],
}
LAWS = {
    "Flores": (jc.contact.Flores(stiffness=1e9, restitution=0.8), STIFFNESS),
    "damped": (jc.contact.CarvalhoMartins(stiffness=1e9, restitution=0.3), STIFFNESS),
    "Hertz": (jc.contact.Hertz(stiffness=1e9), STIFFNESS),
    "KelvinVoigt": (
        jc.contact.KelvinVoigt(stiffness=1e7, damping=2e2),
        lambda rig: CONTACT(rig).damping,
    ),
}


def problem(contact, variables, integrator, gravity=9.81, speed=-0.05, answers=ANSWERS):
    bearing = jc.clearance.PlanarJournalBearing(contact, clearance=1e-3)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -gravity))},
        speeds={"journal": (0.0, speed, 0.0)},
    )
    named = {str(i): jc.Variable(each, tolerance=1e-9) for i, each in enumerate(variables)}
    start, saving = jc.State(concentric=False), jc.Saving(2, 4)
    known = {"integrator": integrator, "save": saving, "state": start}
    return jc.Problem(rig, answers, named, duration=0.013, **known)


def answers(asked, discrete=False):
    """The answers in the order of their names."""

    def of(values):
        found = asked.evaluate(values, discrete_derivatives=discrete).responses
        return jnp.stack([found[name] for name in sorted(found)])

    return of


@pytest.mark.slow(sample=False)
def test_a_lossless_bounce_has_the_derivatives_of_its_closed_form():
    """It touches after c / v and parts pi / omega later; at most the force is omega m v."""
    speed, omega = -0.2, 3e3
    law = jc.contact.Linear(stiffness=omega**2)
    variables = CLEARANCE, SPEED, STIFFNESS
    asked = problem(law, variables, jc.integrator.Adaptive(), gravity=1e-9, speed=speed)
    found = jax.jit(jax.jacfwd(answers(asked)))(asked.nominal())

    def wanted(values):
        clearance, speed, stiffness = values
        touch, omega = -clearance / speed, jnp.sqrt(stiffness)
        return jnp.stack([-omega * speed, touch + jnp.pi / omega, -speed, speed, touch])

    exact = jax.jacfwd(wanted)(asked.nominal())
    scale = abs(wanted(asked.nominal()))[:, None] / abs(asked.nominal())
    # The largest force does not move by the clearance, which steps tell to 1e-4 or not at all.
    assert not np.any(abs(found - exact) > 2e-3 * abs(exact) + 3e-4 * scale)
    assert not np.isnan(np.delete(found.ravel(), 0)).any()


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("law", LAWS)
def test_peaks_and_touches_of_every_kind_of_law_have_the_derivatives_of_the_motion(law):
    contact, own = LAWS[law]
    variables, share = (CLEARANCE, SPEED, own), 1e-3
    asked = problem(contact, variables, jc.integrator.Adaptive())
    best = problem(contact, variables, jc.integrator.Adaptive(rtol=1e-12, atol=1e-14))
    best = eqx.tree_at(
        lambda own: own.integrator.largest_step, best, 3e-7, is_leaf=lambda x: x is None
    )
    values = asked.nominal()
    steps = share * jnp.diag(values)
    ways = jnp.concatenate([steps, -steps, 0.5 * steps, -0.5 * steps])
    around = jax.jit(jax.vmap(answers(best)))(values + ways).reshape(4, len(values), -1)
    whole = (around[0] - around[1]) / (2 * share * values[:, None])
    half = (around[2] - around[3]) / (share * values[:, None])
    found = jax.jit(jax.jacfwd(answers(asked)))(values)
    scale = abs(jax.jit(answers(asked))(values))[:, None] / abs(values)
    wanted = (half + (half - whole) / 3).T
    # What does not move by a number is rounding in differences.
    assert np.all(abs(found - wanted) < 5e-3 * abs(wanted) + 1e-5 * scale)


@pytest.mark.slow(sample=False)
def test_sensitivity_agrees_on_a_peak():
    only = {"peak": PEAK}
    contact = LAWS["Flores"][0]
    asked = problem(contact, (CLEARANCE,), jc.integrator.Adaptive(), answers=only)
    wide = {"c": jc.Variable(CLEARANCE, tolerance=2e-5)}
    asked = jc.Problem(asked.mechanism, only, wide, duration=0.03, save=3)
    asked = eqx.tree_at(lambda own: own.integrator, asked, jc.integrator.Adaptive())
    ways = ("regression", "differences", "pathwise")
    found = jc.sensitivity(asked, sample=64, methods=ways, difference_samples=32)
    found = found.derivatives["peak", "c"]
    assert found.trustworthy
    own = found.estimates["pathwise"]
    assert not own.refusal and abs(own.value - found.value) < 2 * found.error


def test_steps_that_do_not_know_touches_refuse_peaks_and_instants_too():
    for name in ("peak", "touch"):
        steps, only = jc.integrator.FixedStep(2e-5, "munthe_kaas4"), {name: ANSWERS[name]}
        asked = problem(LAWS["Hertz"][0], (CLEARANCE,), steps, answers=only)
        with pytest.raises(ValueError, match="is not to be trusted"):
            jax.eval_shape(jax.jacfwd(answers(asked)), asked.nominal())


@pytest.mark.slow
def test_discrete_derivatives_of_peaks_and_instants_are_those_of_the_discrete_run():
    """In steps in which the law is resolved, by the stiffness, which moves no touch before."""
    asked = problem(LAWS["Hertz"][0], (STIFFNESS,), jc.integrator.FixedStep(2e-6))
    whole = answers(asked, discrete=True)
    values = asked.nominal()
    found = jax.jit(jax.jacfwd(whole))(values)[:, 0]
    step = 1e-6 * values
    around = jax.jit(jax.vmap(whole))(jnp.stack([values + step, values - step]))
    wanted = (around[0] - around[1]) / 2e-6
    np.testing.assert_allclose(found * values, wanted, rtol=1e-4, atol=2e-7)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["Flores", "Hertz"])
@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.Adaptive(),
        jc.integrator.FixedStep(5e-6),
        jc.integrator.FixedStep(5e-6, "heun"),
        jc.integrator.ImplicitStep(1e-5),
    ],
    ids=["Adaptive", "rk4", "heun", "ImplicitStep"],
)
def test_slopes_of_a_peak_do_not_hang_on_where_saving_times_fall(integrator, law):
    """With a saving time at nearly every step a contact turns in the first step of an interval, and
    a run and the motion beside it are pressed hardest in different ones: by `ImplicitStep` slopes
    were 0."""
    bearing = jc.clearance.PlanarJournalBearing(LAWS[law][0], clearance=1e-4)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        speeds={"journal": (0.0, -0.5, 0.0)},
    )
    variables = {
        "clearance": jc.Variable(CLEARANCE, tolerance=1e-9),
        "stiffness": jc.Variable(STIFFNESS if law == "Flores" else _HERTZ, tolerance=1e-3),
        "mass": jc.Variable(lambda rig: rig.bodies["journal"].mass, tolerance=1e-9),
    }

    def slopes(saves):
        asked = jc.Problem(
            rig,
            {"peak": PEAK},
            variables,
            duration=1e-3,
            integrator=integrator,
            save=saves,
            state=jc.State(concentric=False),
        )
        peak = lambda values: asked.evaluate(values).responses["peak"]
        value, slope = jax.jit(lambda v: (peak(v), jax.jacfwd(peak)(v)))(asked.nominal())
        return slope * asked.nominal() / value

    seldom = slopes(2)
    assert np.isfinite(seldom).all() and seldom[1] > 0.1
    for saves in (41, 102):
        np.testing.assert_allclose(slopes(saves), seldom, rtol=5e-3, atol=2e-3)


@pytest.mark.slow(sample=False)
def test_a_peak_with_which_a_run_ends_has_the_derivative_of_the_force_at_that_time():
    """The contact is still pressed harder and harder: later touches press less by then, which at a
    highest point of the path they would not."""
    before = 1.2e-4
    fall = 0.5 * 9.81 * (0.013 - before) ** 2
    contact = LAWS["damped"][0]
    speed = (fall - 1e-3) / (0.013 - before)
    last = {"peak": PEAK, "last": lambda run: run.contact("B").normal_force[-1, 0]}
    asked = problem(contact, (CLEARANCE, SPEED), jc.integrator.Adaptive(), 9.81, speed, last)
    slopes = jax.jit(jax.jacfwd(answers(asked)))(asked.nominal())
    found = jax.jit(asked.evaluate)(asked.nominal()).responses
    assert float(found["peak"]) == pytest.approx(float(found["last"]), rel=1e-9)
    assert float(found["last"]) > 1.0
    np.testing.assert_allclose(slopes[1], slopes[0], rtol=1e-3)
