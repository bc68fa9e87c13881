"""What is said before a run: float64 switched off, steps that cannot be as long as asked."""

import functools
import warnings

import jax
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow_but

RIG = jc.scenes.slider_crank(wear=False)
STEPS = jc.integrator.FixedStep(1e-5)
CLEARANCE = {"c": jc.Variable(lambda r: r.connections["B"].joint.clearance, tolerance=1e-5)}


def problem(**options):
    options = {"duration": 2e-3, "save": 3, "integrator": STEPS} | options
    return jc.Problem(RIG, jc.response.MeanContactForce("B"), CLEARANCE, **options)


@functools.cache
def existing_problem():
    return problem()


@functools.cache
def existing_run():
    return jc.simulate(RIG, 2e-3, save=3, integrator=STEPS)


LCP = jc.complementarity.LCP(np.eye(2), -np.ones(2))


@pytest.mark.parametrize(
    "entry",
    [
        lambda: jc.simulate(RIG, 2e-3, save=3, integrator=STEPS),
        lambda: jc.assemble(RIG),
        problem,
        lambda: existing_problem().evaluate(existing_problem().nominal()),
        lambda: jc.monte_carlo(existing_problem(), 4),
        lambda: jc.sensitivity(existing_problem(), sample=4),
        lambda: jc.advise(existing_problem(), 0.1),
        lambda: existing_run().contact("B"),
        lambda: existing_run().body("slider"),
        lambda: jc.complementarity.InteriorPoint().solve(LCP),
    ],
)
def test_single_precision_is_refused_at_every_entry_that_computes(entry):
    # What was computed before.
    existing_problem(), existing_run()
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(RuntimeError, match="float64, and jax_enable_x64 has been switched off"):
            entry()
    finally:
        jax.config.update("jax_enable_x64", True)


INTEGRATORS = {
    "FixedStep": jc.integrator.FixedStep(1e-4),
    "contact steps": jc.integrator.FixedStep(1e-4, contact_steps=5),
    "ImplicitStep": jc.integrator.ImplicitStep(1e-4),
    "NonColliding": jc.integrator.NonColliding(1e-4),
    "MoreauJean": jc.integrator.MoreauJean(1e-4),
}


@pytest.mark.parametrize("name", slow_but(("FixedStep", "ImplicitStep"), INTEGRATORS))
def test_steps_longer_than_the_saving_interval_are_said(name):
    how = {"save": 21, "integrator": INTEGRATORS[name]}
    with pytest.warns(UserWarning, match=r"step=0.0001\) asks .* 5e-05 s: .* 2 times as many"):
        often = jc.simulate(RIG, 1e-3, **how)
    assert often.accepted_steps >= 20
    with pytest.warns(UserWarning, match="longer steps than the shortest saving interval"):
        problem(duration=1e-3, **how)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        for save in (11, 4):
            problem(duration=1e-3, save=save, integrator=INTEGRATORS[name])


@pytest.mark.slow
def test_steps_that_nobody_asked_for_are_not_said():
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        jc.simulate(RIG, 1e-4, save=101)
        for integrator in (None, jc.integrator.FixedStep(steps_per_save=1)):
            problem(duration=1e-4, save=101, integrator=integrator)
