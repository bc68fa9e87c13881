"""Infinite answers, such as lives that outlast what is followed, in every study: they count on
their side of limits and quantiles, against closed forms, and have no mean."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.report import campaign_page
from jaxclear.integrators import Outcome
from jaxclear.studies.design.population import GROUPS
from jaxclear.studies.design.question import Question, checked_limits, freedom_of
from jaxclear.studies.design.runs import Runs
from jaxclear.studies.design.verification import Verifier, _finite
from jaxclear.studies.experiment import Cost, Description, ResponseInfo, SampleResult
from jaxclear.studies.infinite_responses import replace_infinite, successes
from jaxclear.studies.reliability.models import RunModel
from jaxclear.studies.reliability.subset import Reach, subset
from jaxclear.studies.statistics.scrambled import ordinary_quantile
from jaxclear.studies.store.workers import failures

# ln(life / 1e6) is normal about half the hardness; a quarter of the lives are not followed.
SLOPES = {"hardness": 0.5, "load": -0.3}
SPREAD = float(np.hypot(*SLOPES.values()))
FOLLOWED, LIMIT = 1.5e6, 4e5
SCORE = np.log(LIMIT / 1e6) / SPREAD


class Lasting(jc.AbstractExperiment):
    """Lives in closed form, infinite beyond what is followed."""

    followed: float = FOLLOWED
    response_names: tuple[str, ...] = ("life",)

    def evaluate(self, setting, *, discrete_derivatives=False):
        scores = setting(self.subject)
        life = 1e6 * jnp.exp(sum(SLOPES[name] * own for name, own in scores.items()))
        told = {"life": jnp.where(life > self.followed, jnp.inf, life)}
        return SampleResult(told, jnp.asarray(int(Outcome.REACHED)), jnp.zeros(()))

    def cost(self):
        return Cost(1000, 512)

    def describe(self):
        far = "it is not followed further"
        known = {"life": ResponseInfo("cycles", infinite=far, horizon=self.followed)}
        return Description("Lasting", known, derivative=("lives end", ""))


@pytest.fixture(scope="module")
def lasting():
    unit = jc.distribution.Normal(1.0)
    spread = {name: jc.Dimension(0.0, unit, unit="1") for name in SLOPES}
    return jc.Problem.of(Lasting(), spread)


@pytest.fixture(scope="module")
def sample(lasting):
    return jc.monte_carlo(lasting, 512)


def test_shares_and_quantiles_are_those_of_the_closed_form(sample):
    assert not len(sample.failed) and "(it is not followed further)" in sample.sentence()
    below = sample.share_within({"life": (LIMIT, None)})
    assert below.low <= 1 - stats.norm.cdf(SCORE) <= below.high
    for share in (0.01, 0.5):
        found, exact = sample.quantile("life", share), 1e6 * np.exp(SPREAD * stats.norm.ppf(share))
        assert found.low <= exact <= found.high
    assert sample.quantile("life", 0.9).value == np.inf
    lowest = sample.tolerance_interval("life", 0.9, side="lower")
    assert 0 < lowest.low.value < 1e6


def test_an_accuracy_of_a_mean_that_there_is_not_is_not_reached(lasting):
    """More samples would not help, so there are none."""
    found = jc.monte_carlo(lasting, 512, accuracy=0.1)
    assert found.count == 256 and found.unreached in found.sentence()
    assert 'not reached: "life" is infinite' in found.unreached
    assert "ask for a quantile" in found.unreached


def test_a_campaign_tells_what_a_plain_study_tells(lasting, sample, tmp_path):
    """Also opened without its problem, and in its report."""
    kept = jc.campaign(lasting, 512, folder=tmp_path / "kept")
    opened = jc.open_campaign(tmp_path / "kept")
    for found in (kept, opened):
        assert found.sentence() == sample.sentence() and not len(found.failed)
        for share in (0.5, 0.9):
            assert found.quantile("life", share) == sample.quantile("life", share)
        with pytest.raises(ValueError) as refused:
            sample.mean("life")
        with pytest.raises(ValueError, match=re.escape(str(refused.value))):
            found.mean("life")
        with pytest.raises(ValueError, match="it is told up to"):
            found.share_within({"life": (2 * FOLLOWED, None)})
    assert failures(lasting, kept.sample.outcome, kept.sample.responses) == 0
    items = campaign_page(tmp_path / "kept").sections[0].items
    assert any("there is no variance of it" in str(item) for item in items)


def test_a_derivative_beyond_what_is_followed_is_refused(lasting, sample):
    for kind in ("above", "below"):
        with pytest.raises(ValueError, match="it is told up to"):
            jc.sensitivity(lasting, "hardness", sample=sample, of=(kind, 2 * FOLLOWED))


def test_a_histogram_draws_no_mean_of_infinite_answers(sample):
    (axis,) = plot.monte_carlo(sample).axes
    infinite = int(np.isinf(sample.responses["life"]).sum())
    assert axis.get_xlabel().endswith(f"infinite in {infinite} more") and not axis.get_lines()


@pytest.mark.slow
def test_derivatives_of_shares_are_found_and_those_of_means_refused(lasting, sample):
    """Below a limit and of low quantiles; not of quantiles that are themselves infinite."""
    of = {"life": ["mean", "standard deviation", ("below", LIMIT), ("quantile", 0.1)]}
    of["life"].append(("quantile", 0.8))
    found = jc.sensitivity(lasting, "hardness", sample=sample, of=of).derivatives
    answers = {label: own for (label, _), own in found.items()}
    low = 1e6 * np.exp(SPREAD * stats.norm.ppf(0.1))
    exact = -stats.norm.pdf(SCORE) * SLOPES["hardness"] / SPREAD
    for label, wanted in ((f"P(life < {LIMIT:g})", exact), ("10 % quantile of life", 0.5 * low)):
        own = answers[label]
        assert own.trustworthy and abs(own.value - wanted) <= 1.5 * own.error < abs(wanted)
    for label in ("life", "standard deviation of life", "80 % quantile of life"):
        assert np.isnan(answers[label].value) and "are infinite" in answers[label].verdict
    assert "ask for a quantile, or for the share" in answers["life"].verdict


THRESHOLD = 1e6 * np.exp(SPREAD * stats.norm.ppf(1e-3))


@pytest.mark.slow
@pytest.mark.parametrize("methods", [None, "subset"])
def test_reliability_counts_endless_ones_as_safe_and_none_twice(lasting, methods):
    """Also where one in a hundred is followed: nothing tells apart those that are not."""
    below = jc.limit_state.Below("life", THRESHOLD)
    found = jc.reliability(lasting, below, methods=methods)
    assert found.failed == 0 and found.interval[0] <= 1e-3 <= found.interval[1]
    often = jc.reliability(lasting, jc.limit_state.Above("life", 1.2e6), methods="subset")
    assert often.probability == pytest.approx(stats.norm.sf(np.log(1.2) / SPREAD), rel=0.1)
    few = lasting.with_experiment(Lasting(1e6 * np.exp(SPREAD * stats.norm.ppf(0.01))))
    found = jc.reliability(few, below, methods=methods)
    assert found.interval[0] <= 1e-3 <= found.interval[1] or np.isnan(found.probability)
    assert found.estimates["subset"].unknown == 0
    said = found.sentence()
    assert methods or ("There is no surface" in said and '"life" is infinite' in said)


@pytest.mark.slow
@pytest.mark.parametrize("at_least", [LIMIT, FOLLOWED])
def test_a_design_for_life_counts_endless_ones_as_good(lasting, at_least):
    """The least hardness of which 95 in 100 live so long, also as long as they are followed."""
    found = jc.design(
        lasting,
        lambda nominal, tolerance: 3.0 + nominal["hardness"],
        jc.limit.Quantile("life", at_least=at_least, share=0.95),
        nominal={"hardness": (-1.0, 4.0)},
        settings=jc.DesignSettings(check=1024),
    )
    exact = (np.log(at_least / 1e6) - SPREAD * stats.norm.ppf(0.05)) / SLOPES["hardness"]
    assert found.holds and found.nominal["hardness"] == pytest.approx(exact, abs=0.1)
    assert '"life" is infinite in' in found.sentence() and found.failed == 0


class Unfollowed(Lasting):
    """Lives that are told to no end."""

    def describe(self):
        told = super().describe()
        known = {name: own._replace(horizon=np.inf) for name, own in told.responses.items()}
        return told._replace(responses=known)


@pytest.fixture(scope="module")
def finite(lasting):
    """The same lives, followed to their ends."""
    life = lambda **x: {"life": 1e6 * jnp.exp(sum(SLOPES[n] * own for n, own in x.items()))}
    return jc.FunctionProblem(life, lasting.variables)


def question_of(problem, *limits):
    """A design's question with these limits of a problem."""
    freedom = freedom_of(problem, {"hardness": (-1.0, 4.0)}, None, ())
    return Question(freedom, lambda *_: 1.0, limits, problem.inputs, np.ones(len(limits)))


@pytest.mark.parametrize("lives", [(1e4, 2e4, 3e4, np.inf), (np.inf, np.inf)])
def test_a_surface_sees_endless_lives_on_the_good_side_of_limits_that_none_reached(lasting, lives):
    problem = lasting.with_experiment(Unfollowed())
    question = question_of(problem, jc.limit.Quantile("life", at_least=1e6, share=0.9))
    runs = Runs(problem, None, False)
    runs.values, runs.responses = np.zeros((len(lives), 2)), np.array(lives)[:, None]
    everywhere = lambda values: np.ones(len(values), bool)
    assert runs.good(everywhere).sum() == len(lives)
    _, told = runs.within(everywhere, question.levels)
    finite = np.isfinite(lives)
    np.testing.assert_array_equal(told[finite, 0], np.array(lives)[finite])
    assert np.all(np.isfinite(told)) and np.all(told[~finite] > 1e6)


def test_a_share_is_told_beside_lives_that_are_smaller_and_no_infinite_error_is_lost(lasting):
    lives = np.array([-7.0, -6.0, np.inf])
    share = jc.limit.Probability("life", below=-6.5, at_most=0.1)
    assert _finite(share, lives)[1] == np.inf
    lowest = jc.limit.Quantile("life", at_least=-6.5, share=0.9)
    assert _finite(lowest, lives)[1] == -6.0
    found = np.ones((2, 1 + GROUPS, 2))
    found[0, 3, 0] = np.inf
    verifier = Verifier(question_of(lasting, share, share), None, 0)
    nothing = [np.zeros(64)] * 2, np.zeros((64, 1)), np.ones(64, bool)
    assert verifier._make_check(found, *nothing).errors.tolist() == [np.inf, 0.0]


class Median(jc.limit.Quantile):
    """A limit as a stranger may write it, who knows of no endless lives."""

    def levels(self):
        return ()


def test_a_limit_that_names_no_level_is_refused_for_endless_lives(lasting, finite):
    own = Median("life", at_least=LIMIT, share=0.6)
    with pytest.raises(ValueError, match=r"may be infinite .*limit.Median names no values"):
        checked_limits(own, lasting)
    assert checked_limits(own, finite) == (own,)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.501, 0.75, 0.935, 0.9375, 0.94, 0.999999])
def test_limits_of_this_package_take_endless_lives(lasting, share):
    """Also where a quantile lies between those that end and those that do not."""
    limit = jc.limit
    for side in ("at_least", "at_most"):
        for level in (LIMIT, FOLLOWED):
            limits = [
                limit.Quantile("life", share=share, **{side: level}),
                limit.WorstCase("life", **{side: level}),
                limit.MeanAndDeviation("life", **{side: level}),
                limit.Probability("life", below=level, at_most=1.0 - share),
                limit.Probability("life", above=level, below=0.5 * level, at_most=0.1),
            ]
            assert checked_limits(limits, lasting)


@pytest.mark.slow
def test_what_takes_no_infinite_answer_says_what_does(lasting, sample):
    costs = {"hardness": jc.cost.Reciprocal(1.0)}
    moments = jc.limit.MeanAndDeviation("life", at_least=LIMIT)
    free = {"tolerance": {"hardness": (0.1, 2.0)}}
    studies = (
        lambda: sample.process_capability("life", (LIMIT, None)),
        lambda: sample.tolerance_interval("life", normal=True),
        lambda: jc.sobol_indices(lasting, 64),
        lambda: jc.shapley_effects(lasting, 64),
        lambda: jc.surface(lasting),
        lambda: jc.design(lasting, costs, moments, **free),
    )
    for study in studies:
        with pytest.raises(ValueError, match=r'"life" is infinite in \d+ of \d+ samples.*: there'):
            study()
    row = sample.summary().iloc[0]
    assert row["infinite"] == np.isinf(sample.responses["life"]).sum() > 0
    assert np.isnan(row["mean"]) and np.isfinite(row["median"]) and row["failed"] == 0


@pytest.mark.slow
def test_the_worst_life_is_finite_and_the_best_endless(lasting):
    found = jc.worst_case(lasting, samples=64)
    assert found.least["life"].value == pytest.approx(1e6 * np.exp(-3 * 0.8), rel=1e-3)
    assert found.largest["life"].value == np.inf


class Followed(RunModel):
    """Margins of a normal number, of which a share is followed; infinite ones are safe or fail."""

    share, sense = 1.0, 1.0

    def margins(self, normal):
        self.runs += len(normal)
        margins = self.sense * (normal - stats.norm.ppf(1e-3 if self.sense > 0 else 0.7))
        return np.where(normal > stats.norm.ppf(self.share), self.sense * np.inf, margins)


@pytest.mark.parametrize(("share", "sense"), [(0.01, 1.0), (0.0, 1.0), (0.8, 1.0), (0.8, -1.0)])
def test_subset_simulation_takes_no_endless_answer_for_a_lost_run(lasting, share, sense):
    model = Followed(lasting, jc.limit_state.Below("life", LIMIT))
    model.share, model.sense = share, sense
    found = subset(model, 0.2, 20_000, 0, Reach(model, 0))
    assert found.unknown == 0.0
    if share > 0.0:
        assert found.interval[0] <= (1e-3 if sense > 0 else 0.3) <= found.interval[1]
    else:
        assert np.isnan(found.value) and "infinite responses say nothing" in found.refusal


def test_quantiles_and_stand_ins_of_infinite_values():
    values = np.array([3.0, 1.0, np.inf, 2.0, np.inf])
    assert [ordinary_quantile(values, q) for q in (0.0, 0.25, 0.5)] == [1.0, 2.0, 3.0]
    assert ordinary_quantile(values, 0.4) == pytest.approx(2.6)
    assert ordinary_quantile(values, 0.51) == ordinary_quantile(values, 1.0) == np.inf
    np.testing.assert_array_equal(replace_infinite(values, 10.0), [3.0, 1.0, 19.0, 2.0, 19.0])
    assert np.isnan(replace_infinite(np.array([np.nan, -np.inf]))[0])
    # Where no infinite answer is declared an infinite number is none.
    single = jc.FunctionProblem(lambda x: 1.0 / x, {"x": jc.Dimension(0.0, tolerance=1.0)})
    assert single.evaluate(jnp.zeros(1)).outcome == Outcome.NOT_FINITE


def test_what_failed_has_no_number_in_any_response(lasting):
    """An infinite life is an answer; one that is not a number, or of a run that ended, is none."""
    lives = {"life": np.array([1.0, np.nan, 3.0, np.inf])}
    outcome = np.array([0, 0, int(Outcome.TOO_MANY_STEPS), 0])
    good, told = successes(lasting, outcome, lives)
    assert good.tolist() == [True, False, False, True]
    np.testing.assert_array_equal(told["life"], [1.0, np.nan, np.nan, np.inf])
