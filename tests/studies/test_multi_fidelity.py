"""Means by few accurate runs and many cheap ones: against closed forms of correlated normal numbers
and the work that theory says they take."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.fidelity.levels import chosen
from jaxclear.studies.fidelity.model import models_of
from tests.studies.test_monte_carlo import problem as pendulum_problem

Normal = jc.distribution.Normal
CORRELATION, COST = 0.95, 1 / 64
REST = np.sqrt(1 - CORRELATION**2)
NUMBERS = {name: jc.Dimension(0.0, Normal(1.0)) for name in "ab"}
# Giles 2008: (sum sqrt(V C))^2, with link costs 1 + c and c, variances 1 - rho^2 and rho^2.
GAIN = 1 / (np.sqrt(REST**2 * (1 + COST)) + np.sqrt(CORRELATION**2 * COST)) ** 2
OPTIONS = {"costs": {"rough": COST}, "sampling": "random"}


@pytest.fixture(scope="module")
def accurate():
    return jc.FunctionProblem(lambda a, b: {"y": 3.0 + a + 0 * b}, NUMBERS)


@pytest.fixture(scope="module")
def rough():
    return jc.FunctionProblem(lambda a, b: {"y": CORRELATION * a + REST * b}, NUMBERS)


def moments(seed, *correlations, count=65536):
    """Moments of normal numbers with these correlations to the first, independent otherwise."""
    rng = np.random.default_rng(seed)
    first = rng.normal(size=count)
    rows = [r * first + np.sqrt(1 - r**2) * rng.normal(size=count) for r in correlations]
    return [np.stack([own, own**2], axis=1) for own in (first, *rows)]


def test_the_gain_foreseen_is_that_of_theory():
    found = chosen(moments(0, CORRELATION), np.array([1.0, COST]), np.ones(1), 1024)
    assert found.models == (0, 1)
    # Variances of 1024 means, and weights that follow the correlation.
    assert found.gain == pytest.approx(GAIN, rel=0.1)
    assert found.weights[0, 0] == pytest.approx(CORRELATION, rel=0.02)
    assert found.weights[0, 1] == pytest.approx(CORRELATION**2, rel=0.05)


def test_what_explains_too_little_for_its_cost_is_left_out():
    """At a correlation of 0.5 a model of half the cost loses: (0.87 1.22 + 0.5 0.71)^2 = 2.0."""
    costs = np.array([1.0, 0.5, COST])
    assert chosen(moments(1, 0.5), costs[:2], np.ones(1), 1024).models == (0,)
    # Beside a better one that is no dearer, the worse of two is left out as well.
    assert chosen(moments(2, 0.5, CORRELATION), costs, np.ones(1), 1024).models == (0, 2)


def test_answers_have_the_variance_of_theory_and_intervals_that_hold(accurate, rough):
    """Mean 3, deviation 1. Doubling wastes up to half of the gain; 95 % intervals hold in 15 of 20
    repetitions at the least (binomial: fewer than 1 in 100 times at 92 %)."""
    found = [jc.multi_fidelity(accurate, {"rough": rough}, seed=s, **OPTIONS) for s in range(20)]
    means = np.array([one.means["y"].value for one in found])
    held = [one.means["y"].low <= 3.0 <= one.means["y"].high for one in found]
    spread = [one.standard_deviations["y"] for one in found]
    work = np.mean([one.work for one in found])
    gain = 1 / (np.mean((means - 3.0) ** 2) * work)
    # The variance of 20 numbers is known to a factor of 2 (chi-squared, 99 %).
    assert GAIN / 2 / 2 < gain < 2 * GAIN
    assert sum(held) >= 15 and sum(one.low <= 1.0 <= one.high for one in spread) >= 15
    assert all(one.used == ("the problem", "rough") for one in found)
    assert 'of "rough" (each 1/64 of the work)' in found[0].sentence()
    assert list(found[0].table()["correlation with rough"]) == pytest.approx([0.95], abs=0.06)


def test_no_gain_is_an_answer(accurate):
    strange = jc.FunctionProblem(lambda b: {"y": b}, {"b": jc.Dimension(0.0, Normal(1.0))})
    found = jc.multi_fidelity(accurate, strange, costs={"cheaper": 0.1})
    assert found.used == ("the problem",) and found.gains["y"] == 1.0
    assert '"cheaper" does not pay: correlation' in found.sentence()
    assert "at 1/10 of the work; the problem was sampled plainly." in found.sentence()
    assert found.means["y"].low <= 3.0 <= found.means["y"].high


@pytest.mark.parametrize("samples", [256, 512, 1024])
def test_the_work_allowed_is_not_exceeded_from_the_start(accurate, samples):
    """A model that says nearly all asks for so many of its runs that these alone were more."""
    near = jc.FunctionProblem(lambda a, b: {"y": 1.01 * a + 1e-3 * b}, NUMBERS)
    found = jc.multi_fidelity(accurate, near, samples, costs={"cheaper": 0.1})
    assert len(found.used) == 2 and found.work + found.pilot <= samples


def test_cheap_runs_that_fail_are_told_and_bring_no_bias(accurate):
    """A cheaper model that fails where a > 1 and is 100 too large."""
    failing = lambda bound, own: jc.FunctionProblem(
        lambda a, b: {"y": jnp.where(a > bound, jnp.nan, own(a, b))}, NUMBERS
    )
    broken, costs = failing(1, lambda a, b: 100 + a + 0.1 * b), {"cheaper": COST}
    found = [jc.multi_fidelity(accurate, broken, costs=costs, seed=s) for s in range(10)]
    assert any("cheaper" in one.used for one in found)
    away = [(one.means["y"].value - 3.0) / one.means["y"].error for one in found]
    assert abs(np.mean(away)) < 0.5 and max(map(abs, away)) < 2
    half = {"half": failing(0, lambda a, b: a + b)}
    found = jc.multi_fidelity(accurate, half, costs={"half": 0.5})
    share = found.pilot_failed["half"]
    assert share == pytest.approx(0.5, abs=0.05)
    said = f'{100 * share:.2g} % of the runs of "half" failed in the pilot sample'
    assert said in found.sentence()


def turns(count):
    """A number that takes so many turns of a loop to work out."""
    step = lambda _, y: jnp.sin(y) + 0.1
    first = jnp.arange(200.0)
    return lambda a, b: {"y": a + b * jax.lax.fori_loop(0, count, step, a + first).sum()}


def test_the_cost_of_a_run_is_its_work_without_compilation():
    """A fifth of the turns: a fifth of the work but for a clock's noise, whatever runs together."""
    dear, cheap = (jc.FunctionProblem(turns(count), NUMBERS) for count in (500, 100))
    model, rough = models_of(dear, {"rough": cheap}, 1024)
    model, rough = model._replace(chunk=512), rough._replace(chunk=128)
    values = np.random.default_rng(0).normal(size=(16, 2))
    cost = rough.timed(values)[1] / model.timed(values)[1]
    assert 0.1 < cost < 0.4


@pytest.mark.slow
def test_a_mechanism_by_longer_steps_has_the_mean_of_short_ones():
    """A pendulum's swing: against 4096 plain runs; work follows the measured cost."""
    fine = pendulum_problem()
    coarse = fine.with_integrator(jc.integrator.FixedStep(0.05))
    assert coarse.integrator.step == 0.05 and coarse.names == fine.names
    found = jc.multi_fidelity(fine, {"coarse": coarse}, costs={"coarse": 0.2})
    plain = jc.monte_carlo(fine, 4096).mean("swing")
    assert abs(found.means["swing"].value - plain.value) < found.means["swing"].error + plain.error
    assert found.correlations["coarse", "swing"] > 0.999
    assert found.used == ("the problem", "coarse") and found.gains["swing"] > 1


ONE = {"c": jc.Dimension(0.0, Normal(1.0))}
REFUSED = {
    "cheaper is empty": {"cheaper": {}},
    'cheaper "cheaper" is 3; it must be a problem': {"cheaper": 3},
    "samples of multi_fidelity is 100": {"samples": 100},
    'costs names "x", which is not in cheaper: cheaper': {"costs": {"x": 0.1}},
    'cost of "cheaper" is -1.0': {"costs": {"cheaper": -1.0}},
    'varies "c"; its variables must be among those': {
        "cheaper": jc.FunctionProblem(lambda c: {"y": c}, ONE)
    },
    'answers "z"; it must have a response of the problem: "y"': {
        "cheaper": jc.FunctionProblem(lambda a: {"z": a}, {"a": NUMBERS["a"]})
    },
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_cannot_be_asked_gets_a_sentence(accurate, rough, sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.multi_fidelity(accurate, **{"cheaper": rough} | REFUSED[sentence])


@pytest.mark.slow(sample=False)
def test_intervals_hold_in_200_repetitions(accurate, rough):
    """95 % and three standard deviations of 200 trials."""
    found = [jc.multi_fidelity(accurate, {"rough": rough}, seed=s, **OPTIONS) for s in range(200)]
    assert np.mean([one.means["y"].low <= 3.0 <= one.means["y"].high for one in found]) > 0.905
