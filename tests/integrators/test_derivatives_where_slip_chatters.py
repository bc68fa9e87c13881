"""Friction that stops slip within a step carries it to and fro, and a derivative with it: one that
steps do not determine is no number."""

import jax
import numpy as np
import pytest

import jaxclear as jc
from benchmarks.attacks.structures import structures

SLIDER_CRANK, DRAW = 14, 40


def slopes(integrator):
    """Of the mean force and the worn volume of the attack's slider-crank, which sticks in its
    bearing in the middle of a hit, by its clearance and the stiffness of its contact, as shares."""
    case = structures()[SLIDER_CRANK].case(DRAW)
    joint = lambda rig: rig.connections["B"].joint
    places = {
        "clearance": lambda rig: joint(rig).clearance,
        "stiffness": lambda rig: joint(rig).contact.elastic.stiffness,
    }
    asked = jc.Problem(
        case.mechanism,
        {
            "mean force": jc.response.MeanContactForce("B"),
            "worn volume": lambda run: run.worn_volume("B", "bearing")[-1],
        },
        {name: jc.Variable(of, tolerance=1e-3 * of(case.mechanism)) for name, of in places.items()},
        duration=case.duration,
        integrator=integrator,
        save=51,
        state=jc.State(concentric=case.concentric),
    )
    evaluate = lambda values: asked.evaluate(values).responses
    at = asked.nominal()
    found, values = jax.jit(lambda at: (jax.jacfwd(evaluate)(at), evaluate(at)))(at)
    return {name: np.asarray(each * at) / values[name] for name, each in found.items()}


@pytest.mark.slow
def test_of_slip_that_chatters_there_is_none():
    """At 20 us, a study's default, they were 10 % (mean force) and 23 % (wear) off."""
    told = slopes(jc.integrator.FixedStep())
    assert np.isnan(told["mean force"]).all() and np.isnan(told["worn volume"]).all()


@pytest.mark.slow
def test_steps_that_resolve_it_have_one():
    told = slopes(jc.integrator.FixedStep(5e-6))
    known = slopes(jc.integrator.Adaptive(rtol=1e-9, atol=1e-11))
    for name in ("mean force", "worn volume"):
        np.testing.assert_allclose(told[name], known[name], rtol=6e-3)
