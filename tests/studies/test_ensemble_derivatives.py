"""Derivatives of statistics, by nominal values and by widths of tolerances, against closed forms;
their intervals hold, and what jumps or has no density is told."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxclear as jc
from jaxclear.studies.sampling import draw, groups
from jaxclear.studies.sensitivity.derivative import Estimate, confirmed, from_parts
from jaxclear.studies.sensitivity.differences import differences, moved
from jaxclear.studies.sensitivity.estimand import Functional, Size, directions
from tests.rigs.cells import slow_but

D = jc.distribution
SLOPES, SPREADS = np.array([1.0, -0.8, 0.5]), np.array([0.1, 0.2, 0.15])
SPREAD = float(np.sqrt(np.sum((SLOPES * SPREADS) ** 2)))
LIMIT = 0.7 + 1.5 * SPREAD
LINEAR = jc.FunctionProblem(
    lambda x, y, z: x - 0.8 * y + 0.5 * z,
    {n: jc.Dimension(1.0, D.Normal(float(s))) for n, s in zip("xyz", SPREADS, strict=True)},
)
OF = ("mean", "standard deviation", ("quantile", 0.95), ("above", LIMIT))
LABELS = (
    "response",
    "standard deviation of response",
    "95 % quantile of response",
    f"P(response > {LIMIT:g})",
)
DENSITY = stats.norm.pdf(1.5)
# Of the spread, by the width of x: a^2 s / spread.
BY_WIDTH = float(SLOPES[0] ** 2 * SPREADS[0] / SPREAD)
BY_NOMINAL = (1.0, 0.0, 1.0, DENSITY / SPREAD)
BY_SPREAD = (0.0, 1.0, stats.norm.ppf(0.95), 1.5 * DENSITY / SPREAD)
TRUTH = {(label, "x"): exact for label, exact in zip(LABELS, BY_NOMINAL, strict=True)} | {
    (label, "standard deviation of x"): exact * BY_WIDTH
    for label, exact in zip(LABELS, BY_SPREAD, strict=True)
}
REPEATED = 12


@pytest.fixture(scope="module")
def answers():
    by, how = ["x", "standard deviation of x"], {"of": OF, "methods": ("regression",)}
    return [jc.sensitivity(LINEAR, by, seed=10 * seed, **how) for seed in range(REPEATED)]


@pytest.mark.parametrize("key", TRUTH, ids=str)
def test_intervals_hold_the_closed_form(answers, key):
    """95 %: of 12 fewer than 9 by chance once in 500 (the eight are of one sample)."""
    found = [study.derivatives[key].estimates["regression"] for study in answers]
    inside = [abs(e.value - TRUTH[key]) <= e.error + 1e-12 for e in found]
    assert sum(inside) >= 9
    # Intervals promise something: a tenth of the derivative of a share, at 256 runs.
    assert np.median([e.error for e in found]) < 0.5 * abs(TRUTH[key]) + 0.03


@pytest.mark.slow
def test_derivatives_go_by_the_names_of_statistics_and_widths(answers):
    study = answers[0]
    assert set(study.derivatives) == set(TRUTH)
    assert study.unit(LABELS[3], "standard deviation of x") == "1/m"
    assert study.unit(LABELS[2], "x") == "m/m"
    tolerance = jc.FunctionProblem(lambda x: x**2, {"x": jc.Dimension(1.0, tolerance=0.3)})
    found = jc.sensitivity(tolerance, "tolerance of x", sample=64, difference_samples=64)
    derivative = found.derivatives["response", "tolerance of x"]
    # E x^2 = 1 + variance, which grows with the square of the tolerance.
    exact = 2 * float(tolerance.inputs.deviations()[0]) ** 2 / 0.3
    assert derivative.trustworthy and derivative.value == pytest.approx(exact, rel=2e-2)


def kinked(x, y):
    return {"kink": jnp.abs(x - 1.02) + jnp.sin(5 * y) * x, "steps": jnp.floor(8 * (x + y)) + x}


KINKED = jc.FunctionProblem(
    kinked, {"x": jc.Dimension(1.0, D.Uniform(0.3)), "y": jc.Dimension(0.3, tolerance=0.4)}
)


def means(x, y, half_width, points=1 << 16):
    share = stats.qmc.Sobol(2, scramble=True, rng=1).random(points)
    cut = np.asarray(KINKED.variables["y"].distribution.quantile(jnp.asarray(share[:, 1])))
    found = kinked(x + half_width * (2 * share[:, 0] - 1), y + cut)
    return {name: float(np.mean(r)) for name, r in found.items()}


@pytest.mark.slow
def test_what_jumps_is_differentiated_through_the_ends_of_its_distribution():
    """All that a uniform distribution knows of a derivative is at its ends."""
    step = 0.02
    up, down = means(1.0 + step, 0.3, 0.3), means(1.0 - step, 0.3, 0.3)
    wide, narrow = means(1.0, 0.3, 0.3 + step), means(1.0, 0.3, 0.3 - step)
    # Of 1024 runs regression is too wide to confirm the differences: "The methods disagree."
    methods = ("regression", "differences", "pathwise")
    found = jc.sensitivity(KINKED, ["x", "half width of x"], methods=methods, sample=4096)
    for name in ("kink", "steps"):
        for label, high, low in (("x", up, down), ("half width of x", wide, narrow)):
            exact = (high[name] - low[name]) / (2 * step)
            derivative = found.derivatives[name, label]
            for method in ("regression", "differences"):
                estimate = derivative.estimates[method]
                assert abs(estimate.value - exact) < 1.5 * estimate.error + 0.02
    # No run's tangent sees a jump: 1 where the mean moves by 9.
    jumping = found.derivatives["steps", "x"]
    assert jumping.estimates["pathwise"].value == pytest.approx(1.0)
    assert "Not confirmed by pathwise" in jumping.verdict and jumping.value > 8


@pytest.mark.slow
def test_single_sizes_have_differences_only():
    laws = {"shim": (1.0, D.Discrete((-0.1, 0.1))), "gap": (2.0, D.Normal(0.1))}
    sizes = {name: jc.Dimension(*own) for name, own in laws.items()}
    shims = jc.FunctionProblem(lambda shim, gap: gap - shim, sizes)
    found = jc.sensitivity(shims, sample=64, difference_samples=32)
    shim, gap = (found.derivatives["response", n] for n in ("shim", "gap"))
    assert "single sizes" in shim.estimates["regression"].refusal
    assert shim.value == pytest.approx(-1.0) and "Unconfirmed" in shim.verdict
    assert gap.trustworthy and gap.value == pytest.approx(1.0)


def test_samples_that_fail_where_they_are_moved_are_told():
    """The mean of a root over 0 to 1 moves by 1; of parts that bear a step to both sides by 0.65,
    which is no answer by itself. Where they are few they are told beside it."""
    root = lambda spread: jc.FunctionProblem(
        lambda x: jnp.sqrt(x), {"x": jc.Dimension(0.5, spread)}
    )
    told = jc.sensitivity(root(D.Uniform(0.5)), methods=("differences",))
    answer = told.derivatives["response", "x"]
    assert np.isnan(answer.value) and not answer.trustworthy
    assert "34 of 128 samples, which fail where they are moved, are left out" in answer.verdict
    both = jc.sensitivity(root(D.Uniform(0.5))).derivatives["response", "x"]
    assert both.value == pytest.approx(1.0, rel=1e-4) and "Unconfirmed" in both.verdict
    few = jc.sensitivity(root(D.Normal(0.18)), methods=("differences",))
    told = few.derivatives["response", "x"]
    assert np.isfinite(told.value) and " of 128 samples, which fail" in told.verdict


def test_correlated_variables_move_one_by_one():
    """The derivative by one nominal value, all spreads and their correlation as they are."""

    def product(law):
        sizes = {"x": jc.Dimension(1.0, law), "y": jc.Dimension(3.0, D.Normal(0.2))}
        return jc.FunctionProblem(lambda x, y: x * y, sizes, correlation={("x", "y"): 0.9})

    of = ("mean", "standard deviation")
    found = jc.sensitivity(product(D.Normal(0.1)), of=of, difference_samples=64)
    mean = found.derivatives["response", "x"]
    assert mean.trustworthy and mean.value == pytest.approx(3.0, abs=1e-3)
    cut = jc.sensitivity(product(D.Uniform(0.1)), "x", sample=64, difference_samples=32)
    assert "correlated" in cut.derivatives["response", "x"].estimates["regression"].refusal


def test_a_verdict_is_right():
    """Methods that are both right are said to disagree hardly ever; one that is off by three times
    the error of their difference is found out."""
    rng = np.random.default_rng(1)
    right = wrong = 0
    for _ in range(200):
        one, other = (from_parts(1.0 + rng.normal(size=16)) for _ in range(2))
        right += confirmed("r", "v", {"a": one, "b": other}).trustworthy
        off = 3 * np.hypot(one.error, other.error)
        biased = other._replace(value=other.value + off)
        wrong += not confirmed("r", "v", {"a": one, "b": biased}).trustworthy
    assert right >= 194 and wrong >= 190


MISTAKES = {
    'no statistic of sensitivity "magic"': "magic",
    "'quantile'; it must be": "quantile",
    "of of sensitivity is empty": [],
    '"quantile" of sensitivity is 1.5': [("quantile", 1.5)],
    '"above", limit': [("beyond", 1.0)],
    'no response "force"': {"force": "mean"},
}


@pytest.mark.parametrize("sentence", MISTAKES)
def test_mistakes_get_a_sentence(sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.sensitivity(LINEAR, of=MISTAKES[sentence])


PAIR = {name: jc.Dimension(0.0, D.Normal(1.0)) for name in "ab"}


def coverage(problem, by, share, seeds, exact):
    """Share of the intervals of a quantile's differences, each of 128 samples, that hold it."""
    direction, one = directions(problem, [by])[0], Functional("response", "quantile", share)
    inside = []
    for seed in seeds:
        values = draw(problem, 128, seed, scramblings=16)
        runs = moved(problem, (values, groups(128, 16)), direction)
        found = differences(problem, runs, direction, [one])[one.label]
        inside.append(abs(found.value - exact) <= found.error)
    return np.mean(inside)


def test_differences_of_a_quantile_tell_their_error():
    """The median of a symmetric response does not move with the width of a variable. Medians of
    single samples jump, and their jackknife held in 72 % of repetitions."""
    problem = jc.FunctionProblem(lambda a, b: a + 0.6 * b, PAIR)
    assert coverage(problem, "standard deviation of a", 0.5, range(100, 160), 0.0) > 0.85


ROUGH = jc.FunctionProblem(
    lambda x: x + 0.3 * jnp.sin(3000.0 * x), {"x": jc.Dimension(1.0, D.Normal(0.1))}
)


def test_a_confirmation_costs_a_quarter_of_what_it_confirms():
    """Single differences of a rough response say little, and the regression is much more certain;
    the first 16 of them are enough to show that nothing is wrong with it."""
    answers = (jc.sensitivity(ROUGH, seed=10 * seed) for seed in range(8))
    rough = [answer.derivatives["response", "x"] for answer in answers]
    assert sum(answer.trustworthy for answer in rough) >= 7
    found = [answer.estimates for answer in rough]
    assert [own["differences"].runs for own in found].count(64) >= 7
    assert all(own["regression"].runs == 320 for own in found)
    assert all(answer.value == answer.estimates["regression"].value for answer in rough)
    # Of a cubic through so many samples the part that is known is exact.
    assert sum(abs(answer.value - 1.0) <= answer.error for answer in rough) >= 7


def test_differences_go_on_where_they_are_the_more_certain():
    """Half of the variance is of a variable whose waves no polynomial takes up; what x does is
    straight, and every single difference shows it. The regression is still the answer: it alone has
    seen so many parts."""
    waves = jc.FunctionProblem(
        lambda x, y: x + 0.2 * jnp.sin(50 * y),
        {n: jc.Dimension(1.0, D.Normal(0.1)) for n in "xy"},
    )
    found = jc.sensitivity(waves, "x").derivatives["response", "x"]
    assert found.estimates["differences"].runs == 512 and found.method == "regression"
    assert found.estimates["differences"].value == pytest.approx(1.0, abs=1e-9)
    assert found.trustworthy and abs(found.value - 1.0) <= found.error


def test_differences_confirm_a_regression_and_do_not_replace_it():
    """What states the smaller error may lack a branch; agreement that says little is told."""
    wide, narrow = from_parts(np.linspace(0.9, 1.1, 16)), from_parts(np.linspace(0.98, 1.02, 16))
    found = confirmed("r", "v", {"regression": wide, "differences": narrow})
    assert found.method == "regression" and found.error == wide.error > narrow.error
    assert found.trustworthy
    wide, vague = from_parts(np.linspace(0.5, 1.5, 16)), from_parts(np.linspace(-3.0, 5.0, 16))
    found = confirmed("r", "v", {"regression": wide, "differences": vague})
    assert found.trustworthy and found.value == pytest.approx(1.0)
    told = f"That by differences (±{vague.error:.2g}) is consistent but too"
    assert told in found.verdict and vague.error > 1.0


@pytest.mark.slow
def test_differences_of_a_quantile_that_few_samples_decide_say_so():
    """4.5 of 128 samples lie beyond: 93 to 96 % of intervals held."""
    problem = jc.FunctionProblem(lambda a, b: jnp.exp(0.5 * a) + 0.6 * b, PAIR)
    a, b = stats.norm.ppf(stats.qmc.Sobol(2, rng=0).random(1 << 18)).T
    low, high = (np.quantile(np.exp(0.5 * (a + h)) + 0.6 * b, 0.965) for h in (-0.1, 0.1))
    assert coverage(problem, "a", 0.965, range(300, 380), (high - low) / 0.2) >= 75 / 80


# Of a response that does not change with y in the mean: exactly, by symmetry, beside jumps or what
# rattles, and where arithmetic alone leaves something.
ZERO = {
    "not asked": lambda x, y: jnp.exp(3 * x),
    "one number": lambda x, y: 3.0 + 0.0 * x,
    "nought": lambda x, y: 0.0 * x,
    "rounding": lambda x, y: jnp.sin(y) ** 2 + jnp.cos(y) ** 2,
    "symmetric": lambda x, y: (y - 1.0) ** 2 + 0.1 * x,
    "beside what rattles": lambda x, y: jnp.sin(300 * x) + 1e-9 * y,
    "beside a jump": lambda x, y: jnp.where(jnp.sin(5 * x) > 0.3, 1.0, 0.0),
}


@pytest.mark.parametrize("name", slow_but(("one number", "rounding", "beside what rattles"), ZERO))
def test_methods_agree_on_a_derivative_of_zero(name):
    """What is small is small beside the response's scatter, or beside rounding."""
    both = {name: jc.Dimension(1.0, D.Normal(0.1)) for name in "xy"}
    flat = jc.FunctionProblem(ZERO[name], both)
    of = ("mean", "standard deviation", ("quantile", 0.9))
    for found in jc.sensitivity(flat, "y", of=of, seed=100).derivatives.values():
        assert found.trustworthy and "confirmed by" in found.verdict, found
        assert abs(found.value) <= 2 * found.error, found


def test_a_zero_beside_a_slope_is_a_disagreement():
    """A scale of the response excuses nothing that is told to be more certain than this."""
    flat, steep = Estimate(0.0, 1e-3), Estimate(0.1, 1e-2)
    found = confirmed("r", "v", {"regression": flat, "differences": steep}, Size(1.0, 1e-12))
    assert found.verdict == "The methods disagree." and not found.trustworthy
    # An error of half of what the variable could do says nothing.
    vague = confirmed("r", "v", {"regression": flat, "differences": Estimate(0.1, 0.5)}, Size(1.0))
    assert "too large to tell" in vague.verdict and not vague.trustworthy
