"""Absurd amounts of work are refused before a run, which would hang or end without a step."""

import re

import pytest

import jaxclear as jc

RIG = jc.scenes.slider_crank(wear=False)
STEP = jc.integrator


def problem(integrator):
    wanted = {"end": lambda run: run.states[-1, 0]}
    varied = {"c": jc.Variable(lambda r: r.connections["B"].joint.clearance, tolerance=1e-6)}
    return jc.Problem(RIG, wanted, varied, duration=1.0, integrator=integrator)


@pytest.mark.parametrize(
    "ask",
    [lambda integrator: jc.simulate(RIG, 1.0, integrator=integrator), problem],
    ids=["run", "study"],
)
@pytest.mark.parametrize(
    ("integrator", "sentence"),
    [
        (STEP.FixedStep(1e-30), r"FixedStep(step=1e-30) takes 1e+30 steps to 1 s"),
        (STEP.FixedStep(1e-13, "munthe_kaas2"), "at least 1e-12 s"),
        (STEP.ImplicitStep(1e-20), r"ImplicitStep(step=1e-20) takes 1e+20 steps"),
        (STEP.MoreauJean(1e-20), r"MoreauJean(step=1e-20) takes 1e+20 steps"),
        (STEP.NonColliding(1e-20), r"NonColliding(step=1e-20) takes 1e+20 steps"),
        (STEP.FixedStep(1e-5, contact_steps=1e12), "give fewer contact_steps"),
        (STEP.FixedStep(steps_per_save=10**15), "steps_per_save = 1000000000000000"),
        (STEP.ImplicitStep(steps_per_save=10**9), "give a step and let"),
    ],
)
def test_more_steps_than_any_machine_takes_are_refused(ask, integrator, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        ask(integrator)


def test_many_steps_that_a_machine_does_take_are_not_refused():
    jc.simulate(RIG, 1e-7, integrator=STEP.FixedStep(1e-12), save=3)
    jc.simulate(RIG, 1e-6, integrator=STEP.FixedStep(1e-6, contact_steps=1e3), save=2)
