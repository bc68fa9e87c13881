"""Absurd amounts of work are refused before a run, which would hang or end without a step."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Outcome

RIG = jc.scenes.slider_crank(wear=False)
STEP = jc.integrator
# In contact from its first steps on.
PRESSED = jc.scenes.slider_crank(wear=False, clearance=1e-9)


def problem(integrator):
    wanted = {"end": lambda run: run.states[-1, 0]}
    varied = {"c": jc.Variable(lambda r: r.connections["B"].joint.clearance, tolerance=1e-6)}
    return jc.Problem(RIG, wanted, varied, duration=1.0, integrator=integrator)


ABSURD = {
    r"FixedStep(step=1e-30) takes 1e+30 steps to 1 s": STEP.FixedStep(1e-30),
    "at least 1e-12 s": STEP.FixedStep(1e-13, "munthe_kaas4"),
    r"ImplicitStep(step=1e-20) takes 1e+20 steps": STEP.ImplicitStep(1e-20),
    r"MoreauJean(step=1e-20) takes 1e+20 steps": STEP.MoreauJean(1e-20),
    r"NonColliding(step=1e-20) takes 1e+20 steps": STEP.NonColliding(1e-20),
    "give fewer contact_steps": STEP.FixedStep(1e-5, contact_steps=1e12),
    "steps_per_save = 1000000000000000": STEP.FixedStep(steps_per_save=10**15),
    "give a step and let": STEP.ImplicitStep(steps_per_save=10**9),
}


@pytest.mark.parametrize("sentence", ABSURD)
def test_more_steps_than_any_machine_takes_are_refused(sentence):
    """In a run and in a study."""
    run = lambda integrator: jc.simulate(RIG, 1.0, integrator=integrator)
    for ask in (run, problem):
        with pytest.raises(ValueError, match=re.escape(sentence)):
            ask(ABSURD[sentence])
    for number in (jnp.inf, -jnp.inf, jnp.nan):
        with pytest.raises(ValueError, match="contact_steps = .*; it must be at least 1 and fin"):
            STEP.FixedStep(contact_steps=number)


@pytest.mark.parametrize(
    ("integrator", "place", "number"),
    [
        (STEP.FixedStep(contact_steps=10), lambda own: own.contact_steps, jnp.inf),
        (STEP.FixedStep(contact_steps=10), lambda own: own.contact_steps, 1e300),
        (STEP.FixedStep(1e-5), lambda own: own.step, 0.0),
        (STEP.ImplicitStep(1e-5), lambda own: own.step, 0.0),
    ],
)
def test_numbers_put_into_a_built_integrator_are_refused_before_the_run(integrator, place, number):
    """They ended in a ZeroDivisionError."""
    absurd = eqx.tree_at(place, integrator, jnp.asarray(number))
    with pytest.raises(ValueError, match="no machine goes through|give fewer contact_steps"):
        jc.simulate(RIG, 1e-3, integrator=absurd, save=2)


@pytest.mark.parametrize(
    ("of", "number"),
    [
        (lambda n: STEP.FixedStep(contact_steps=n), jnp.inf),
        (STEP.ImplicitStep, 1e-20),
        *(
            pytest.param(of, number, marks=pytest.mark.slow)
            for of, number in (
                (lambda n: STEP.FixedStep(contact_steps=n), 1e300),
                (STEP.ImplicitStep, 0.0),
                (STEP.FixedStep, 1e-300),
                (STEP.MoreauJean, 1e-300),
                (STEP.NonColliding, 1e-300),
            )
        ),
    ],
)
def test_of_numbers_known_only_in_the_program_a_run_neither_hangs_nor_lies(of, number):
    """A step of 1e-20 s went on for ever, and the number of steps of 1e-300 s is beyond all whole
    numbers, of which none were taken: the state at the start stood at the end."""

    def end(n):
        run = jc.simulate(PRESSED, 1e-3, integrator=of(n), save=2, throw=False)
        return run.outcome, run.states[-1]

    outcome, _ = jax.jit(end)(number)
    assert Outcome(int(outcome)) == Outcome.NOT_FINITE


@pytest.mark.slow
def test_many_steps_that_a_machine_does_take_are_not_refused():
    jc.simulate(RIG, 1e-7, integrator=STEP.FixedStep(1e-12), save=3)
    jc.simulate(RIG, 1e-6, integrator=STEP.FixedStep(1e-6, contact_steps=1e3), save=2)
