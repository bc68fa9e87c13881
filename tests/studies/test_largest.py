"""The largest mean of a variable that keeps a limit: closed forms of normal sums, and sentences."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import jaxclear as jc

SIGMA, OTHER = 3e-6, 4e-6


def problem(function=lambda play, shift: {"error": play + shift}):
    spread = {"play": SIGMA, "shift": OTHER}
    kind = jc.distribution.Normal
    dimensions = {n: jc.Dimension(40e-6, distribution=kind(s)) for n, s in spread.items()}
    return jc.FunctionProblem(function, dimensions)


@pytest.mark.parametrize(
    ("limit", "exact"),
    [
        (
            jc.limit.Quantile("error", at_most=140e-6, share=0.95),
            100e-6 - norm.ppf(0.95) * np.hypot(SIGMA, OTHER),
        ),
        (
            jc.limit.MeanAndDeviation("error", at_most=140e-6, deviations=2),
            100e-6 - 2 * np.hypot(SIGMA, OTHER),
        ),
    ],
)
def test_the_largest_value_is_below_the_closed_form_by_no_more_than_its_error(limit, exact):
    answer = jc.largest(problem(), "play", limit, (10e-6, 300e-6), accuracy=1e-3, samples=1024)
    best = answer.best
    # The number is the mean plus a constant: its error is that of the value.
    assert exact - 2 * best.error - 1e-3 * exact < answer.value <= exact + 0.5 * best.error
    beyond = min(trial.value for trial in answer.trials if trial.excess > 0)
    assert answer.value < beyond < answer.value * (1 + 2e-3)
    assert "play may be " in answer.sentence() and "at most: there the" in answer.sentence()
    assert answer.table()["holds"].sum() == sum(trial.excess <= 0 for trial in answer.trials)


@pytest.mark.parametrize(
    ("limit", "exact"),
    [
        (jc.limit.Quantile("error", at_most=np.exp(20), share=0.95), 20 - norm.ppf(0.95)),
        pytest.param(
            jc.limit.Probability("error", above=np.exp(20), at_most=0.03),
            20 - norm.ppf(0.97),
            marks=pytest.mark.slow,
        ),
        # Of a logarithmic normal number the mean is exp(mean + 1/2).
        pytest.param(
            jc.limit.MeanAndDeviation("error", at_most=np.exp(20), deviations=0),
            19.5,
            marks=pytest.mark.slow,
        ),
    ],
    ids=["quantile", "probability", "mean"],
)
def test_the_largest_value_is_too_large_in_no_more_seeds_than_its_interval_says(limit, exact):
    """An interval of 95 % leaves 2.5 % above: of 60 seeds at most 4, with 98 % (binomial). The
    response is skewed, and its quantile is that of 13 samples or 8."""
    normal = {
        name: jc.Dimension(0.0, jc.distribution.Normal(s)) for name, s in (("a", 0.6), ("b", 0.8))
    }
    skewed = jc.FunctionProblem(lambda a, b: {"error": jnp.exp(a + b)}, normal)
    values = [
        jc.largest(skewed, "a", limit, (10.0, 20.0), accuracy=1e-3, seed=seed).value
        for seed in range(60)
    ]
    assert np.sum(np.array(values) > exact) <= 4
    assert np.median(values) > exact - 0.6


def test_ends_of_the_range_and_runs_that_fail_are_said():
    limit = jc.limit.Quantile("error", at_most=140e-6, share=0.95)
    assert (
        "the largest of its range" in jc.largest(problem(), "play", limit, (1e-6, 2e-6)).sentence()
    )
    none = jc.largest(problem(), "play", limit, (1e-3, 2e-3))
    assert np.isnan(none.value) and "at neither end of its range" in none.sentence()
    broken = problem(lambda play, shift: {"error": jnp.where(play > 6e-5, jnp.nan, play + shift)})
    answer = jc.largest(broken, "play", limit, (10e-6, 300e-6))
    sentence = jc.largest(broken, "play", limit, (7e-5, 300e-6)).sentence()
    assert "% of the runs fail" in sentence
    # No more than 1 % of the parts lie beyond where none works.
    assert answer.value == pytest.approx(60e-6 - norm.ppf(0.99) * SIGMA, abs=1e-6)


def test_a_rare_share_allows_no_more_failures_than_itself():
    """Up to 1 % of the runs might fail, of a share of 0.5 % that may be beyond the bound."""
    rare = jc.limit.Probability("error", above=1.0, at_most=5e-3)
    broken = problem(lambda play, shift: {"error": jnp.where(shift > 50e-6, jnp.nan, play + shift)})
    # A shift beyond 2.5 deviations: 0.62 %.
    answer = jc.largest(broken, "play", rare, (10e-6, 300e-6), samples=2048)
    assert np.isnan(answer.value) and "% of the runs fail" in answer.sentence()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("plays", jc.limit.Quantile("error", at_most=1.0, share=0.9), (0.0, 1.0)), "no variable"),
        (("play", jc.limit.WorstCase("error", at_most=1.0), (0.0, 1.0)), "limit.Quantile or a"),
        (
            ("play", jc.limit.Quantile("error", at_most=1.0, share=0.9), (1.0, 0.0)),
            "largest nominal",
        ),
        # Of 256 samples none is beyond what 1 of 10 000 exceed: any value seemed to keep it.
        (("play", jc.limit.Probability("error", above=1.0, at_most=1e-4), (0.0, 1.0)), "too few"),
        (("play", 3.0, (0.0, 1.0)), "must be members of jaxclear.limit"),
    ],
)
def test_what_cannot_be_asked_is_a_sentence(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.largest(problem(), *arguments)
