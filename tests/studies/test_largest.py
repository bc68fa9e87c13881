"""The largest mean of a variable that keeps a limit: closed forms of normal sums, and sentences."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import jaxclear as jc
from tests.rigs.cells import slow

SIGMA, OTHER = 3e-6, 4e-6


def problem(function=lambda play, shift: {"error": play + shift}):
    spread = {"play": SIGMA, "shift": OTHER}
    kind = jc.distribution.Normal
    dimensions = {n: jc.Dimension(40e-6, distribution=kind(s)) for n, s in spread.items()}
    return jc.FunctionProblem(function, dimensions)


QUANTILE = jc.limit.Quantile("error", at_most=140e-6, share=0.95)
MOMENTS = jc.limit.MeanAndDeviation("error", at_most=140e-6, deviations=2)


@pytest.mark.parametrize(("limit", "deviations"), [(QUANTILE, norm.ppf(0.95)), (MOMENTS, 2)])
def test_the_largest_value_is_below_the_closed_form_by_no_more_than_its_error(limit, deviations):
    exact = 100e-6 - deviations * np.hypot(SIGMA, OTHER)
    answer = jc.largest(problem(), "play", limit, (10e-6, 300e-6), accuracy=1e-3, samples=1024)
    best = answer.best
    # The number is the mean plus a constant: its error is that of the value.
    assert exact - 2 * best.error - 1e-3 * exact < answer.value <= exact + 0.5 * best.error
    beyond = min(trial.value for trial in answer.trials if trial.excess > 0)
    assert answer.value < beyond < answer.value * (1 + 2e-3)
    assert "play may be " in answer.sentence() and "at most: there the" in answer.sentence()
    # The bracket is narrower than the error, so the trial above fails by its error alone.
    near = "only the error is beyond it: more samples make it smaller."
    assert answer.sentence().endswith(near)
    coarse = jc.largest(problem(), "play", limit, (10e-6, 300e-6), accuracy=0.99, samples=1024)
    assert near not in coarse.sentence()
    assert answer.table()["holds"].sum() == sum(trial.excess <= 0 for trial in answer.trials)


MOST, SLOW = np.exp(20), pytest.mark.slow
SKEWED = {
    "quantile": (jc.limit.Quantile("error", at_most=MOST, share=0.95), 20 - norm.ppf(0.95)),
    "share": (jc.limit.Probability("error", above=MOST, at_most=0.03), 20 - norm.ppf(0.97)),
    # Of a logarithmic normal number the mean is exp(mean + 1/2).
    "mean": (jc.limit.MeanAndDeviation("error", at_most=MOST, deviations=0), 19.5),
}


@pytest.mark.parametrize("kind", ["quantile", *slow("share", "mean")])
def test_the_largest_value_is_too_large_in_no_more_seeds_than_its_interval_says(kind):
    """An interval of 95 % leaves 2.5 % above: of 30 seeds at most 3, with 99 % (binomial). The
    response is skewed, and its quantile is that of 13 samples or 8."""
    limit, exact = SKEWED[kind]
    law = jc.distribution.Normal
    normal = {name: jc.Dimension(0.0, law(s)) for name, s in (("a", 0.6), ("b", 0.8))}
    skewed = jc.FunctionProblem(lambda a, b: {"error": jnp.exp(a + b)}, normal)
    values = [
        jc.largest(skewed, "a", limit, (10.0, 20.0), accuracy=1e-3, seed=seed).value
        for seed in range(30)
    ]
    assert np.sum(np.array(values) > exact) <= 3
    assert np.median(values) > exact - 0.6


def test_ends_of_the_range_and_runs_that_fail_are_said():
    most = jc.largest(problem(), "play", QUANTILE, (1e-6, 2e-6))
    assert "the largest of its range" in most.sentence()
    none = jc.largest(problem(), "play", QUANTILE, (1e-3, 2e-3))
    assert np.isnan(none.value) and "at neither end of its range" in none.sentence()
    broken = problem(lambda play, shift: {"error": jnp.where(play > 6e-5, jnp.nan, play + shift)})
    answer = jc.largest(broken, "play", QUANTILE, (10e-6, 300e-6))
    # No more than 1 % of the parts lie beyond where none works.
    assert answer.value == pytest.approx(60e-6 - norm.ppf(0.99) * SIGMA, abs=1e-6)
    sentence = jc.largest(broken, "play", QUANTILE, (7e-5, 300e-6)).sentence()
    assert "% of the runs fail" in sentence


def test_a_rare_share_allows_no_more_failures_than_itself():
    """Up to 1 % of the runs might fail, of a share of 0.5 % that may be beyond the bound."""
    rare = jc.limit.Probability("error", above=1.0, at_most=5e-3)
    broken = problem(lambda play, shift: {"error": jnp.where(shift > 50e-6, jnp.nan, play + shift)})
    # A shift beyond 2.5 deviations: 0.62 %.
    answer = jc.largest(broken, "play", rare, (10e-6, 300e-6), samples=2048)
    assert np.isnan(answer.value) and "% of the runs fail" in answer.sentence()


# Of 256 samples none is beyond what 1 of 10 000 exceed: any value seemed to keep it.
RARE = jc.limit.Probability("error", above=1.0, at_most=1e-4)
REFUSED = {
    "no variable": ("plays", QUANTILE, (0.0, 1.0)),
    "limit.Quantile or a": ("play", jc.limit.WorstCase("error", at_most=1.0), (0.0, 1.0)),
    "largest nominal": ("play", QUANTILE, (1.0, 0.0)),
    "too few": ("play", RARE, (0.0, 1.0)),
    "must be members of jaxclear.limit": ("play", 3.0, (0.0, 1.0)),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_cannot_be_asked_is_a_sentence(sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.largest(problem(), *REFUSED[sentence])
