"""Statistics of a Monte Carlo study and their errors, against closed forms of a stack of parts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxclear as jc
from jaxclear.studies.statistics.limits import fewest, normal_factor
from jaxclear.studies.statistics.scrambled import (
    deviation_of_moments,
    half_widths,
    smooth_quantile,
    student,
)
from tests.rigs.cells import slow

D = jc.distribution
# A stack of four parts: gap = d - a - b - c, normal with mean 0.5 mm.
SPREADS = (0.05, 0.03, 0.02, 0.04)
SPREAD = float(np.sqrt(np.sum(np.square(SPREADS))))


def gap(a, b, c, d):
    return {"gap": d - a - b - c, "worn": jnp.exp(10 * (a + b + c - 6.0))}


NOMINAL = (1.0, 2.0, 3.0, 6.5)
STACK = jc.FunctionProblem(
    gap,
    {
        name: jc.Dimension(nominal, D.Normal(spread), unit="mm")
        for name, nominal, spread in zip("abcd", NOMINAL, SPREADS, strict=True)
    },
    units={"gap": "mm", "worn": "1"},
)
EXACT = stats.norm(0.5, SPREAD)
TRUTH = {
    "mean": (lambda s: s.mean("gap"), 0.5),
    "standard deviation": (lambda s: s.standard_deviation("gap"), SPREAD),
    "5 %": (lambda s: s.quantile("gap", 0.05), EXACT.ppf(0.05)),
    "median": (lambda s: s.quantile("gap", 0.5), 0.5),
    "95 %": (lambda s: s.quantile("gap", 0.95), EXACT.ppf(0.95)),
    "yield": (lambda s: s.share_within({"gap": (0.4, None)}), EXACT.sf(0.4)),
    "rare": (lambda s: s.share_within({"gap": (0.3, 0.7)}), 1 - 2 * EXACT.sf(0.7)),
    "Cpk": (lambda s: s.process_capability("gap", (0.3, 0.75)), 0.2 / (3 * SPREAD)),
    "skewness": (lambda s: s.statistic(stats.skew, "gap"), 0.0),
    "mean of a curved one": (
        lambda s: s.mean("worn"),
        np.exp(50 * np.sum(np.square(SPREADS[:3]))),
    ),
}
REPEATED = 60


@pytest.fixture(scope="module")
def studies():
    return [jc.monte_carlo(STACK, 256, seed=seed) for seed in range(REPEATED)]


@pytest.mark.parametrize("name", TRUTH)
def test_intervals_hold_what_they_promise(studies, name):
    """95 %, of 60: 50 or fewer by chance once in 1e4."""
    ask, exact = TRUTH[name]
    told = [ask(study) for study in studies]
    covered = sum(one.low <= exact <= one.high for one in told)
    assert covered > 50
    # Not by being wide: half widths within 2.5 times what the scatter asks for (rare: of few).
    needed = 1.96 * np.std([one.value for one in told])
    widths = np.median([0.5 * (one.high - one.low) for one in told])
    assert widths < (4.0 if name == "rare" else 2.5) * needed


def test_standard_errors_are_the_scatter_of_means(studies):
    """Random samples would promise 0.0046: 4 times the truth."""
    told = np.sqrt(np.mean([s.summary()["standard error"][0] ** 2 for s in studies]))
    scatter = np.std([s.mean("gap").value for s in studies])
    assert 0.8 < told / scatter < 1.3
    assert 3 * scatter < SPREAD / 16


def test_a_sample_consists_of_scramblings_of_equal_length(studies):
    assert np.bincount(studies[0].scrambling).tolist() == [32] * 8
    assert np.bincount(jc.monte_carlo(STACK, 100).scrambling).tolist() == [13] * 4 + [12] * 4
    assert len(np.unique(jc.monte_carlo(STACK, 64, scramblings=4).scrambling)) == 4


def test_the_summary_gives_every_statistic_its_error(studies):
    table = studies[0].summary({"gap": (0.3, 0.7)}).set_index("response")
    row = table.loc["gap"]
    for name in ("mean", "standard deviation", "5 %", "median", "95 %", "yield", "Cpk"):
        assert row[f"{name} error"] > 0
    assert row["mean"] == studies[0].mean("gap").value
    assert np.isnan(table.loc["worn", "yield"])


def test_samples_are_doubled_until_the_accuracy_is_reached():
    study = jc.monte_carlo(STACK, 65536, accuracy={"worn": 0.005})
    assert 256 < study.count < 65536 and study.mean("worn").error <= 0.005
    assert study.count & (study.count - 1) == 0 and not study.unreached
    # What was drawn first is still there.
    first = jc.monte_carlo(STACK, 256)
    np.testing.assert_array_equal(study.values[:256], first.values)
    short = jc.monte_carlo(STACK, 512, accuracy=1e-6)
    assert short.count == 512
    assert "accuracy asked is not reached (mean of gap to" in short.sentence()


def test_failed_samples_are_unknown_in_the_yield():
    broken = jc.FunctionProblem(
        lambda a: jnp.where(a > 0, jnp.sqrt(a), jnp.nan), {"a": jc.Dimension(0.0, D.Uniform(1.0))}
    )
    told = jc.monte_carlo(broken, 64).share_within({"response": (None, 2.0)})
    assert told.value == 1.0 and told.low < 0.55 and told.high == 1.0


def test_factors_and_numbers_of_samples_are_the_published_ones():
    """Factors of ISO 16269-6:2014, tables for a confidence of 95 %; numbers of Wilks; quantiles of
    Harrell and Davis by scipy."""
    for samples, content, both, factor in (
        (10, 0.95, False, 2.911),
        (30, 0.99, False, 3.064),
        (10, 0.95, True, 3.393),
    ):
        assert normal_factor(samples, content, 0.95, both) == pytest.approx(factor, abs=1.1e-3)
    assert fewest(0.95, 0.95, "upper") == 59 and fewest(0.95, 0.95, "both") == 93
    values = np.random.default_rng(1).gumbel(size=77)
    for share in (0.05, 0.5, 0.95):
        expected = float(stats.mstats.hdquantiles(values, [share])[0])
        assert smooth_quantile(values, share) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("normal", [True, False])
def test_tolerance_intervals_hold_their_content(studies, normal):
    """With a confidence of 95 %: of 60 intervals 8 too short by chance once in 100."""
    content = 0.95
    short = 0
    for study in studies:
        found = study.tolerance_interval("gap", content, normal=normal)
        assert found.low.value < found.high.value and found.low.error > 0
        short += EXACT.cdf(found.high.value) - EXACT.cdf(found.low.value) < content
    assert short < 8
    upper = studies[0].tolerance_interval("gap", content, side="upper", normal=normal)
    assert upper.low.value == -np.inf and EXACT.cdf(upper.high.value) > content


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda s: s.quantile("gap", 1.0), "share of quantile is 1.0"),
        (lambda s: s.mean("force"), 'no response "force"'),
        (lambda s: s.share_within({"gap": (1.0, 0.0)}), "low is not below high"),
        (lambda s: s.share_within({"gap": 0.3}), r"two numbers, \(low, high\)"),
        (lambda s: s.tolerance_interval("gap", 0.99), "samples are too few .* it needs 473[.]"),
        (lambda s: s.tolerance_interval("gap", side="left"), 'no side .* "left"'),
        (lambda s: jc.monte_carlo(STACK, 8, scramblings=9), "8 samples cannot be 9 scramblings"),
        (lambda s: jc.sobol_indices(STACK, 8, scramblings=9), "8 samples cannot be 9 scramblings"),
        (lambda s: jc.monte_carlo(STACK, 8, accuracy={"force": 1.0}), 'no response "force"'),
    ],
)
def test_mistakes_get_a_sentence(studies, call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call(studies[0])


@pytest.mark.parametrize(
    ("law", "mean", "fewest_held"), [("chisquare", 1.0, 0.91), ("normal", 0.0, 0.94)]
)
def test_intervals_of_skewed_contributions_hold_and_others_hardly_widen(law, mean, fewest_held):
    """16 squares of normal numbers: Student's interval holds their mean in 88 % of cases only; of
    numbers without skewness the interval is at most 10 % wider than Student's."""
    rng = np.random.default_rng(0)
    rows = rng.chisquare(1, (2000, 16)) if law == "chisquare" else rng.normal(size=(2000, 16))
    away = abs(rows.mean(axis=1) - mean)
    half = np.array([max(half_widths(row)) for row in rows])
    students = student(16) * rows.std(axis=1, ddof=1) / 4
    assert np.mean(away <= half) > fewest_held
    assert np.mean(half / students) < (1.5 if law == "chisquare" else 1.1)
    assert np.mean(away <= students) < 0.9 or law == "normal"


LAWS = {
    "normal": (lambda u: u, 0.0, 1.0),
    "exponential": (lambda u: -jax.scipy.stats.norm.logsf(u), 1.0, 1.0),
    "chi square": (lambda u: u**2, 1.0, np.sqrt(2)),
    "lognormal": (jnp.exp, np.exp(0.5), np.exp(0.5) * np.sqrt(np.e - 1)),
}


@pytest.mark.parametrize(("samples", "seeds"), slow((256, 100), (1024, 400)))
def test_intervals_of_skewed_statistics_hold_their_closed_forms(samples, seeds):
    """Of three numbers. The skewness of eight scramblings alone left 16 % of deviations of a
    lognormal above the interval, and 6 % of an exponential; 2.5 % are expected, 3 to 6 measured.
    Of a lognormal the samples hardly know how skewed they are."""
    three = {name: jc.Dimension(0.0, D.Normal(1.0)) for name in "abc"}
    asked = jc.FunctionProblem(
        lambda a, b, c: {name: of((a + b + c) / np.sqrt(3)) for name, (of, *_) in LAWS.items()},
        three,
    )
    missed = dict.fromkeys(LAWS, 0) | {f"{name}, mean + 3": 0 for name in LAWS}
    width = []
    for seed in range(seeds):
        study = jc.monte_carlo(asked, samples, seed=seed)
        for name, (_, mean, spread) in LAWS.items():
            deviation = study.standard_deviation(name)
            missed[name] += deviation.high < spread or study.mean(name).high < mean
            limit = jc.limit.MeanAndDeviation(name, at_most=1.0)
            missed[f"{name}, mean + 3"] += (
                limit.estimate(*study.good(name)).high < mean + 3 * spread
            )
        normal = study.standard_deviation("normal")
        width.append(0.5 * (normal.high - normal.low))
    shares = {name: count / seeds for name, count in missed.items()}
    assert all(share <= (0.15 if "log" in name else 0.09) for name, share in shares.items()), shares
    # That of independent normal numbers, by Student's factor of eight scramblings.
    assert np.median(width) < 1.5 * student(8) / np.sqrt(2 * samples)


def test_the_end_of_an_interval_of_few_skewed_parts_is_johnsons():
    """Of the unbiased skewness by SciPy that part which is beyond the spread of it in samples of
    normal numbers, drawn here. Johnson 1978, J. Am. Stat. Assoc. 73, 536."""
    parts, count = np.array([0.0, 0.1, 0.2, 0.3, 0.5, 0.9, 2.0, 9.0]), 8
    normal = np.random.default_rng(0).normal(size=(400_000, count))
    chance = stats.skew(normal, axis=1, bias=False).var()
    skewness = np.sqrt(stats.skew(parts, bias=False) ** 2 - chance)
    times, spread = stats.t.ppf(0.975, count - 1), parts.std(ddof=1)
    near = times * spread / np.sqrt(count)
    far = near + skewness * spread * (2 * times**2 + 1) / (6 * count)
    # The spread of skewness, of 400 000 samples: 0.2 %, of which a sixteenth is left.
    np.testing.assert_allclose(half_widths(parts), (near, far), rtol=5e-4)
    np.testing.assert_allclose(half_widths(-parts), (far, near), rtol=5e-4)


def test_a_deviation_is_of_products_of_different_scramblings():
    """11 of the second moment, less a third of 1 times 2, 1 times 3 and 2 times 3."""
    value, _ = deviation_of_moments(np.array([1.0, 2.0, 3.0]), np.array([14.0, 8.0, 11.0]))
    assert value == pytest.approx(np.sqrt(11 - 11 / 3), rel=1e-12)


@pytest.mark.parametrize("rare", [1, 2, 3])
def test_the_end_of_a_skewed_interval_is_that_of_gamma_parts(rare):
    """Student's statistic of eight parts with a gamma distribution lies below it in 2.5 % of cases:
    of 100 000 draws 5.2 (skewness 2.3), 3.3 and 2.7 standard errors, for 2.36 of normal ones."""
    samples = np.repeat([0.0, 1.0], [8 - rare, rare])
    shape, rng = 4 / stats.skew(samples) ** 2, np.random.default_rng(0)
    rows = rng.gamma(shape, size=(100_000, 8)) - shape
    exact = -np.quantile(rows.mean(axis=1) / rows.std(axis=1, ddof=1) * np.sqrt(8), 0.025)
    # Parts that show no skewness themselves.
    parts = np.array([-3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0])
    for sign in (1, -1):
        below, above = half_widths(parts, sign * samples) / parts.std(ddof=1) * np.sqrt(8)
        near, far = (below, above) if sign > 0 else (above, below)
        assert near == pytest.approx(student(8), rel=1e-12)
        assert far == pytest.approx(exact, rel=0.1)
    near = half_widths(parts)
    assert half_widths(parts, np.ones(60)) == half_widths(parts, np.ones(2)) == near


def test_the_deviation_of_random_samples_is_the_usual_one_and_few_can_be_printed():
    study = jc.monte_carlo(STACK, 256, sampling="random", scramblings=256)
    told = study.standard_deviation("gap").value
    assert told == pytest.approx(study.responses["gap"].std(ddof=1), rel=1e-12)
    # No number of samples of one scrambling bounds a quantile.
    for samples in (1, 2, 3, 4):
        assert f"{samples} samples, 0 failed" in str(jc.monte_carlo(STACK, samples))


def test_the_deviation_of_quasi_random_samples_has_no_bias():
    """A bore 20 H7 and a shaft g6 (ISO 286: 21 um and 13 um wide), both uniform, in closed form.
    Moments about the mean of such a sample lack next to nothing; n - 1 adds 1 / (2 n), 6e-5."""
    sizes = {"bore": (20.0105e-3, 10.5e-6), "shaft": (19.9865e-3, 6.5e-6)}
    fit = jc.FunctionProblem(
        lambda bore, shaft: bore - shaft,
        {name: jc.Dimension(middle, D.Uniform(half)) for name, (middle, half) in sizes.items()},
    )
    exact = np.sqrt((21e-6**2 + 13e-6**2) / 12)
    studies = [jc.monte_carlo(fit, 8192, seed=seed, verify=False) for seed in range(20)]
    told = [study.standard_deviation("response") for study in studies]
    assert sum(one.low <= exact <= one.high for one in told) >= 18
    assert np.median([abs(one.value / exact - 1) for one in told]) < 1e-5
    capable = [study.process_capability("response", (0.0, 40e-6)) for study in studies]
    assert np.median([abs(one.value * 3 * exact / 16e-6 - 1) for one in capable]) < 1e-5
    budget = sum(part.value for part in studies[0].error_budget("response").values())
    assert budget == pytest.approx(told[0].value ** 2, rel=1e-12)
