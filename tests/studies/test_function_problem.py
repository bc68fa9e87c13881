"""Studies of functions of dimensions: a stack of parts with a closed form."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Outcome
from jaxclear.studies.store.batch import evaluate_all

PARTS = {
    "housing": jc.Dimension(40e-3, jc.distribution.Normal(20e-6)),
    "bearing": jc.Dimension(12e-3, jc.distribution.Uniform(15e-6)),
    "ring": jc.Dimension(2e-3, tolerance=30e-6),
}


def gap(housing, bearing, ring):
    """Play left of three bearings and a ring in a housing [m]."""
    return housing - 3 * bearing - ring


@pytest.fixture(scope="module")
def stack():
    return jc.FunctionProblem(gap, PARTS)


def test_spread_of_a_stack_is_the_root_of_the_sum_of_squares(stack):
    study = jc.monte_carlo(stack, 4096)
    spreads = [v.distribution.deviation() for v in PARTS.values()]
    closed = math.sqrt(sum((w * s) ** 2 for w, s in zip((1, 3, 1), spreads, strict=True)))
    row = study.summary().iloc[0]
    assert row["unit"] == "m" and row["failed"] == 0
    assert row["mean"] == pytest.approx(2e-3, abs=1e-8)
    assert row["standard deviation"] == pytest.approx(closed, rel=2e-3)


def test_slopes_of_a_stack_are_its_counts_by_every_method(stack):
    methods = ("regression", "differences", "pathwise")
    found = jc.sensitivity(stack, sample=64, difference_samples=16, methods=methods)
    for name, slope in (("housing", 1.0), ("bearing", -3.0), ("ring", -1.0)):
        answer = found.derivatives["response", name]
        assert answer.trustworthy and answer.value == pytest.approx(slope, rel=1e-9)


def test_a_sample_without_a_number_has_failed_and_is_named(stack):
    def root(**dimensions):
        play = gap(**dimensions) - 2e-3
        return {"root": jnp.sqrt(play), "play": play}

    study = jc.monte_carlo(jc.FunctionProblem(root, PARTS), 64)
    plays = gap(*study.values.T) - 2e-3
    np.testing.assert_array_equal(study.failed, np.flatnonzero(plays < 0))
    worst = int(study.failed[0])
    assert "a number that the function gives is not finite" in study.failures()[worst]
    assert study.table()["result"][int(np.argmax(plays))] == "The function gave its numbers."
    assert np.isnan(study.rerun(worst)["root"]) and float(study.rerun(worst)["play"]) < 0


def test_responses_keep_the_order_in_which_the_function_returns_them():
    asked = jc.FunctionProblem(
        lambda z: {"late": z, "early": 2 * z}, {"z": jc.Dimension(1, tolerance=0.1)}
    )
    assert asked.response_names == ("late", "early")
    found = evaluate_all(asked, jnp.asarray([[1.0], [3.0]]))
    np.testing.assert_array_equal(found.responses["early"], [2.0, 6.0])
    np.testing.assert_array_equal(found.outcome, Outcome.REACHED)


def test_other_nominal_values_and_tolerances_compile_nothing_anew():
    traced = []

    def length(a):
        traced.append(1)
        return 2 * a

    def traces_of(nominal, tolerance):
        before, size = len(traced), {"a": jc.Dimension(nominal, tolerance=tolerance)}
        study = jc.monte_carlo(jc.FunctionProblem(length, size), 8)
        assert study.responses["response"].mean() == pytest.approx(2 * nominal, rel=0.1)
        return len(traced) - before

    assert traces_of(1.0, 0.1) > traces_of(2.0, 0.2)


def test_units_are_those_of_the_dimensions_where_they_share_one():
    angle = {"angle": jc.Dimension(0.1, tolerance=0.01, unit="rad")}
    both = {"a": jc.Dimension(1.0, tolerance=0.1)} | angle
    f = lambda a, angle: a * jnp.sin(angle)
    assert jc.FunctionProblem(f, both).units() == {"response": "1"}
    assert jc.FunctionProblem(f, both, units="m").units() == {"response": "m"}
    assert jc.FunctionProblem(lambda angle: angle, angle).units() == {"response": "rad"}


REFUSED = {
    'leaves JAX in ".*sqrt': lambda a: math.sqrt(a),
    'leaves JAX in ".* if a': lambda a: a if a > 0 else -a,
    'leaves JAX in ".*interp': lambda a: np.interp(a, [0.0, 1.0], [0.0, 1.0]),
    "is a `return` missing": lambda a: None,
    "an array of shape": lambda a: jnp.stack([[a, a]]),
    "returns no number": lambda a: {},
    "names a variable and a response": lambda a: {"a": a},
    'takes "b", and the variables are "a"': lambda b: b,
    "must be a function": 3.0,
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_cannot_be_asked_is_refused_with_a_sentence(sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.FunctionProblem(REFUSED[sentence], {"a": jc.Dimension(1.0, tolerance=0.1)})


def test_a_function_without_a_derivative_is_sampled_and_its_tangent_refused():
    def outside(a):
        shape = jax.ShapeDtypeStruct((), float)
        return jax.pure_callback(lambda x: 2 * np.asarray(x), shape, a, vmap_method="sequential")

    asked = jc.FunctionProblem(outside, {"a": jc.Dimension(1.0, tolerance=0.1)})
    assert jc.monte_carlo(asked, 8).responses["response"].mean() == pytest.approx(2.0, rel=0.1)
    assert asked.description.derivative[0].startswith("JAX has no derivative")


@pytest.mark.parametrize("values", [[1.0], np.zeros(3), "a", 1.0, {"a": 1.0}])
def test_evaluate_says_how_many_values_it_takes(values):
    """It said that the second argument of zip is shorter."""
    problem = jc.FunctionProblem(
        lambda a, b: a + b, {n: jc.Dimension(1.0, tolerance=0.1) for n in "ab"}
    )
    told = 'evaluate takes an array of 2 values, one for each variable in order, "a", "b"; it is'
    with pytest.raises(ValueError, match=told):
        problem.evaluate(values)


def test_series_are_beside_numbers_and_alone_no_question_of_a_sample():
    both = lambda a: {"largest": 2 * a, "force": a * jnp.arange(3.0)}
    problem = jc.FunctionProblem(both, {"a": PARTS["ring"]}, units={"force": "N"})
    assert problem.response_names == ("largest",) and problem.units()["force"] == "N"
    np.testing.assert_allclose(problem.detail(jnp.array([2.0]))["force"], [0.0, 2.0, 4.0])
    assert list(jc.monte_carlo(problem, 16).responses) == ["largest"]
    alone = jc.FunctionProblem(lambda a: a * jnp.arange(3.0), {"a": PARTS["ring"]})
    with pytest.raises(ValueError, match="answers no number, only series"):
        jc.monte_carlo(alone, 16)
