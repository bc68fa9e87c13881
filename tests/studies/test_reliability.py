"""Probabilities of failing against closed forms, quadrature, OpenTURNS and published values."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import ndtr

import jaxclear as jc
from jaxclear.studies.reliability.models import RunModel
from jaxclear.studies.reliability.subset import Reach, subset
from tests.rigs.cells import slow_but
from tests.rigs.limit_states import CASES, case

Normal = jc.distribution.Normal
Above, Below = jc.limit_state.Above, jc.limit_state.Below
Series, Parallel = jc.limit_state.Series, jc.limit_state.Parallel
QUICK = ("RP25",)


def standard(function, count=2, **options):
    """A function of standard normal numbers a, b, ..."""
    names = "abcdefgh"[:count]
    variables = {name: jc.Dimension(0.0, Normal(1.0), unit="1") for name in names}
    return jc.FunctionProblem(function, variables, **options)


@pytest.fixture(scope="module")
def fit():
    sizes = {"bore": jc.Dimension(20.1, Normal(0.02)), "shaft": jc.Dimension(20.0, Normal(0.01))}
    return jc.FunctionProblem(
        lambda bore, shaft: {"gap": bore - shaft, "ratio": bore / shaft}, sizes
    )


@pytest.fixture(scope="module")
def linear(fit):
    return jc.reliability(fit, Below("gap", 0.0))


def test_a_plane_in_normal_numbers_is_exact(fit, linear):
    """Gap of two normal diameters: beta = 0.1 / sqrt(0.02^2 + 0.01^2), shares 0.8 and 0.2. The same
    parts fail by gap below 0 and by ratio below 1 (Hasofer and Lind)."""
    beta = 0.1 / np.hypot(0.02, 0.01)
    for method in ("form", "breitung", "tvedt"):
        assert linear.estimates[method].value == pytest.approx(ndtr(-beta), rel=1e-6)
    assert linear.importance() == pytest.approx({"bore": 0.8, "shaft": 0.2}, abs=1e-6)
    assert linear.design_point() == pytest.approx({"bore": 20.02, "shaft": 20.02}, abs=1e-6)
    low, high = linear.interval
    assert low < ndtr(-beta) < high and linear.variation <= 0.1
    assert linear.method == "importance" and "times" not in linear.sentence()
    same = jc.reliability(fit, Below("ratio", 1.0), methods="form")
    assert same.beta == pytest.approx(linear.points[0].beta, abs=1e-5)


def test_correlated_variables_have_their_own_beta():
    """Difference of two normal numbers with correlation 0.6: variance 1 + 0.25 - 2 0.6 0.5."""
    problem = jc.FunctionProblem(
        lambda a, b: a - b,
        {"a": jc.Dimension(3.0, Normal(1.0)), "b": jc.Dimension(0.0, Normal(0.5))},
        correlation={("a", "b"): 0.6},
    )
    found = jc.reliability(problem, Below("response", 0.0), methods="form")
    assert found.beta == pytest.approx(3.0 / np.sqrt(1.25 - 0.6), rel=1e-6)


def test_second_order_bends_with_the_limit():
    """3 - a + 0.15 b^2: the probability is an integral over b."""
    problem = standard(lambda a, b: 3.0 - a + 0.15 * b**2)
    found = jc.reliability(problem, Below("response", 0.0), methods=("form", "sorm")).estimates
    exact = integrate.quad(lambda b: ndtr(-3 - 0.15 * b**2) * stats.norm.pdf(b), -8, 8)[0]
    error = {name: abs(own.value / exact - 1) for name, own in found.items()}
    assert error["form"] > 0.3 > 0.05 > error["breitung"] > error["tvedt"] < 0.005
    # Breitung's formula itself: curvature 0.3 at beta 3.
    assert found["breitung"].value == pytest.approx(ndtr(-3.0) / np.sqrt(1.9), rel=1e-4)


@pytest.mark.slow
def test_a_sphere_is_found_by_subset_simulation():
    """No direction is the likeliest: points on a sphere fail with a chi square's probability."""
    problem = standard(lambda a, b, c: a**2 + b**2 + c**2, 3)
    methods = ("sorm", "subset")
    found = jc.reliability(problem, Above("response", 16.0), methods=methods, most_runs=40_000)
    # Three standard errors: intervals of 95 % leave one seed in twenty out.
    exact = stats.chi2(3).sf(16.0)
    assert abs(found.probability - exact) < 3 * found.variation * found.probability
    assert found.variation <= 0.1
    assert "bends around the middle" in found.sentence() and found.method == "subset"


def test_subset_simulation_keeps_to_its_limit_of_runs():
    """Eight repetitions of 1000 samples a level took 62 000 runs down to 3e-10, whatever the limit.
    A plane at 5 and at 6.2 deviations."""
    plane = standard(lambda a, b, c: (a + b + c) / np.sqrt(3.0), 3)
    ask = lambda limit, most: jc.reliability(
        plane, Above("response", limit), methods="subset", most_runs=most, seed=1
    )
    for limit, most in ((5.0, 10_000), (6.2, 20_000)):
        found = ask(limit, most).estimates["subset"]
        assert 0.5 * most < found.runs <= most
        exact = ndtr(-limit)
        assert abs(found.value - exact) < 3 * found.variation * found.value + 0.5 * exact
    few = ask(5.0, 1000).sentence()
    assert "most_runs=1000 is too small: 1280 runs say about" in few and "at least 5120" in few
    assert "10% takes about" in ask(5.0, 10_000).sentence()


def test_what_a_first_search_sees_is_said_where_the_limit_of_runs_ends_the_levels():
    """It was said that samples that are alike do not tell where the limit lies."""
    plane, limit = standard(lambda a, b: a + b), Above("response", 30.0)
    reach = Reach(RunModel(plane, limit, False), 0, result=(1e-10, 1e-9, 200))
    refusal = subset(reach.model, 0.1, 2000, 0, reach).refusal
    assert refusal.startswith("a first search says about 1e-10, which takes more runs (most_runs)")
    assert "alike" not in refusal


@pytest.mark.parametrize("limit", [2.0, 4.0, 5.0])
def test_a_response_that_says_only_yes_or_no_is_counted(limit):
    """A go/no-go gauge: all samples that pass tie. The sum of two normal numbers in closed form."""
    gauge = standard(lambda a, b: jnp.where(a + b > limit, 1.0, 0.0))
    exact = ndtr(-limit / np.sqrt(2))
    held = 0
    for seed in range(3):
        found = jc.reliability(gauge, Above("response", 0.5), methods="subset", seed=seed)
        low, high = found.interval
        held += low <= exact <= high
        assert 0.4 < found.probability / exact < 2.5
        assert 0.5 < found.variation * np.sqrt(found.runs * exact) < 2.0
    assert held >= 2


def test_a_gauge_with_steps_is_read_down_to_its_rare_ones():
    """Steps of 0.8 of what is normal: levels fall into ties, of which seeds are drawn."""
    steps, above = standard(lambda a, b: jnp.round((a + b) / 0.8) * 0.8), Above("response", 6.1)
    exact = ndtr(-6.0 / np.sqrt(2))
    found = [jc.reliability(steps, above, methods="subset", seed=seed) for seed in range(4)]
    assert sum(own.interval[0] <= exact <= own.interval[1] for own in found) >= 3


def test_nothing_is_ruled_out_below_what_samples_bound():
    """One in 1e9 fails and nothing leads there: none of n samples says less than 3 / n."""
    gauge = standard(lambda a, b: jnp.where(a + b > 8.5, 1.0, 0.0))
    found = jc.reliability(gauge, Above("response", 0.5), methods="subset")
    said = found.sentence()
    assert "samples that are alike do not tell where the limit lies" in said
    assert float(said.split("down to ")[1].split(".")[0]) == pytest.approx(3 / found.runs, rel=0.4)


def test_a_region_that_no_design_point_sees_is_sampled():
    """A plane, and a small disc off its slope that is a hundred times as likely: no search along
    slopes leads there. Closed form: noncentral chi square."""
    x, y, radius = -3.0, -2.5, np.sqrt(np.log(2) / 8)
    disc = lambda a, b: jnp.exp(-8 * ((a - x) ** 2 + (b - y) ** 2)) - 0.5
    hat = standard(lambda a, b: jnp.maximum(a - 5.0, disc(a, b)))
    exact = ndtr(-5.0) + stats.ncx2(2, x**2 + y**2).cdf(radius**2)
    found = [jc.reliability(hat, Above("response", 0.0), seed=seed) for seed in range(4)]
    assert sum(own.interval[0] <= exact <= own.interval[1] for own in found) >= 3
    assert all(own.variation < 0.11 for own in found)
    alone = [own for own in found if len(own.points) == 1]
    assert alone and all(" beside the 1 design point" in o.sentence() for o in alone)


@pytest.mark.slow
def test_directions_without_a_design_point_have_samples():
    """A sphere in six variables: eight design points see a fiftieth of it. Chi square."""
    ball, above = (
        standard(lambda **x: sum(own**2 for own in x.values()), 6),
        Above("response", 28.0),
    )
    exact, methods = stats.chi2(6).sf(28.0), ("form", "importance")
    found = [jc.reliability(ball, above, methods=methods, seed=seed) for seed in range(3)]
    assert all(own.variation <= 0.1 and own.runs < 15_000 for own in found)
    assert sum(own.interval[0] <= exact <= own.interval[1] for own in found) >= 2


def test_systems_of_planes_have_the_multinormal_probability():
    """Of two planes under an angle, by scipy's bivariate distribution."""
    problem = standard(lambda a, b: {"first": a, "second": 0.6 * a + 0.8 * b})
    limits = Above("first", 1.5), Above("second", 2.0)
    both = stats.multivariate_normal([0, 0], [[1, 0.6], [0.6, 1]]).cdf([-1.5, -2.0])
    either = ndtr(-1.5) + ndtr(-2.0) - both
    for system, exact in ((Parallel(*limits), both), (Series(*limits), either)):
        found = jc.reliability(problem, system, methods=("form", "importance"))
        assert found.estimates["form"].value == pytest.approx(exact, rel=0.01)
        assert found.interval[0] < exact < found.interval[1]
    assert len(found.points) == 2


def test_every_branch_of_a_limit_is_found():
    """|a b| above 12.5 in four corners that a search from the middle sees none of."""
    problem, limit, _ = case("RP111")
    found = jc.reliability(problem, limit, methods="form")
    assert len(found.points) == 4
    np.testing.assert_allclose([p.beta for p in found.points], 5.0, atol=1e-3)


def test_the_sentence_says_where_planes_mislead():
    problem, limit, reference = case("RP31")
    found = jc.reliability(problem, limit, seed=1)
    assert found.estimates["form"].value / reference["published"] > 5
    assert "FORM says 0.0228" in found.sentence()
    assert "the limit is not a plane where parts fail" in found.sentence()
    table = found.table()
    assert list(table.index) == ["form", "breitung", "tvedt", "importance"]
    assert table.loc["importance", "95 % high"] < table.loc["form", "probability"]


def test_runs_that_end_early_count_as_failing_and_are_told():
    """A number that does not exist beyond a = 2: nobody knows, so it fails, on the safe side."""
    problem = standard(lambda a, b: jnp.where(a > 2, jnp.nan, a + b))
    methods, tail = ("form", "importance", "subset"), ndtr(-2.0)
    found = jc.reliability(problem, Above("response", 3.0), methods=methods)
    rest = integrate.quad(lambda a: ndtr(a - 3.0) * stats.norm.pdf(a), -8, 2)[0]
    for method in methods[1:]:
        own = found.estimates[method]
        assert own.interval[0] < tail + rest < own.interval[1]
        assert own.failed > 0 and own.unknown == pytest.approx(tail / (tail + rest), rel=0.3)
    assert "they count as failing" in found.sentence()


def without_slopes(form):
    """As a run with contacts: right values, no slopes."""

    def evaluate(*values):
        shape = jax.ShapeDtypeStruct((), float)
        return jax.pure_callback(form, shape, *values, vmap_method="broadcast_all")

    return evaluate


def not_differentiable(a, b, c):
    """A plane that is bent a little, without its slopes."""
    bent = lambda a, b, c: np.asarray(a + 0.5 * b + 0.05 * c**2 + 0.02 * a * b)
    return without_slopes(bent)(a, b, c)


@pytest.mark.slow
def test_a_limit_beyond_all_bounds_is_told_after_few_runs():
    """It took 94 400 runs to say nothing of where the limit lies."""
    names = [f"part {i}" for i in range(4)]
    stack = jc.FunctionProblem(
        lambda **parts: {"height": sum(parts.values())},
        {name: jc.Dimension(10e-3, tolerance=20e-6) for name in names},
    )
    found = jc.reliability(stack, Above("height", 40.1e-3))
    assert found.runs < 3000 and found.method == "none"
    said = found.sentence()
    assert "the limit (height above 0.0401) lies beyond everything seen" in said
    nearest = float(said.split("height = ")[1].split(" m")[0])
    # The worst case is the sum of all tolerances.
    assert 0.9 * 80e-6 < nearest - 40e-3 <= 80e-6
    assert "part 0 = 0.01001" in said or "part 0 = 0.01002" in said


def bent(z):
    return 4.5 - z[:, 1] - 0.3 * (z[:, 0] - 0.1) ** 2


def branched(z):
    along, across = (z[:, 0] + z[:, 1]) / np.sqrt(2), z[:, 0] - z[:, 1]
    ends = 7 / np.sqrt(2) - abs(across)
    return np.minimum(3 + 0.1 * across**2 - abs(along), ends)


def corner(z):
    """Three variables within bounds of 3 deviations, all near them: 8 of 9."""
    return 8.0 - stats.truncnorm(-3, 3).ppf(ndtr(z)).sum(axis=1)


REACHABLE = {
    "plane of 20, 1e-7": (20, lambda z: 5.2 - z.sum(axis=1) / np.sqrt(20)),
    "bent": (2, bent),
    "four branches": (2, branched),
    "two modes": (5, lambda z: np.minimum(8 - z[:, 0], 4 + z[:, 1])),
    "both at once": (2, lambda z: np.maximum(3.2 - z[:, 0], 3.2 - z[:, 1])),
    "sphere": (10, lambda z: 60 - (z**2).sum(axis=1)),
    "corner of bounds": (3, corner),
    "nearly flat before": (
        2,
        lambda z: 1 - 0.9 * np.tanh(z[:, 0]) - 0.5 * np.maximum(z[:, 0] - 4, 0),
    ),
    "an island": (2, lambda z: np.where(np.all(abs(z - 1.5) < 0.1, axis=1), -1.0, 1.0)),
}


class ByNumpy:
    """A model whose margins are a function of standard normal numbers."""

    def __init__(self, variables, margin):
        self.problem = types.SimpleNamespace(names=tuple(range(variables)))
        self.limit, self.runs, self.margin = Below("response", 0.0), 0, margin

    def margins(self, normal):
        return self.margin(normal)[:, None]


@pytest.mark.parametrize("name", REACHABLE)
def test_what_fails_seldom_is_not_called_beyond_reach(name):
    """Probabilities of 1e-2 to 1e-7, in each of 10 searches."""
    for seed in range(10):
        assert Reach(ByNumpy(*REACHABLE[name]), seed).beyond() == ""


@pytest.mark.slow
def test_without_slopes_a_surface_searches_and_runs_correct_it():
    problem = standard(not_differentiable, 3)
    assert any(problem.description.derivative)
    found = jc.reliability(problem, Above("response", 5.0))
    smooth = standard(lambda a, b, c: a + 0.5 * b + 0.05 * c**2 + 0.02 * a * b, 3)
    exact = jc.reliability(smooth, Above("response", 5.0), variation=0.02)
    assert found.surface is not None and exact.surface is None
    assert found.points[0].beta == pytest.approx(exact.points[0].beta, abs=1e-3)
    gap = abs(found.probability - exact.probability)
    assert gap < 3 * np.hypot(found.variation, exact.variation) * exact.probability
    assert found.runs < 320 and found.variation < 0.05, "the surface takes up what it explains"


@pytest.mark.slow
def test_a_rough_surface_is_not_searched():
    rough = without_slopes(lambda a, b: np.asarray(np.sin(40 * a) + np.sin(40 * b)))
    problem = standard(lambda a, b: rough(a, b))
    found = jc.reliability(problem, Above("response", 1.9))
    assert found.method == "subset" and "the surface is too rough to search" in found.sentence()


@pytest.mark.slow
def test_stated_errors_are_the_true_ones():
    """40 repetitions: root mean square of stated over true error, and how often 95 % hold."""
    problem, limit, reference = case("RP22")
    runs = [jc.reliability(problem, limit, seed=s, methods="importance") for s in range(40)]
    true = np.array([run.probability for run in runs]) / reference["published"] - 1
    stated = np.array([run.variation for run in runs])
    assert 0.7 < np.sqrt(np.mean(stated**2) / np.mean(true**2)) < 1.6
    inside = [run.interval[0] < reference["published"] < run.interval[1] for run in runs]
    assert sum(inside) >= 34


@pytest.mark.parametrize("name", slow_but(QUICK, CASES))
def test_published_limit_states_are_within_their_intervals(name):
    """Three standard errors, for 26 cases are asked at once."""
    problem, limit, reference = case(name)
    found = jc.reliability(problem, limit, most_runs=1_000_000, seed=2)
    width = 3 * found.variation * found.probability
    assert found.variation <= 0.1
    assert reference["low"] - width < found.probability < reference["high"] + width


@pytest.mark.parametrize("name", ["RP8", "RP28", "RP38", "R-S", "Axial stressed beam"])
@pytest.mark.slow
def test_design_points_are_those_of_openturns(name):
    openturns = pytest.importorskip("openturns")
    problem, limit, _ = case(name)
    found = jc.reliability(problem, limit, methods="form")
    count, own = len(problem.names), limit.limits()[0]

    @jax.jit
    def margin(z):
        return own.margin(problem.evaluate(problem.inputs.values(z)).responses)

    function = openturns.PythonFunction(count, 1, lambda z: [float(margin(jnp.asarray(list(z))))])
    inputs = openturns.RandomVector(openturns.Normal(count))
    event = openturns.ThresholdEvent(
        openturns.CompositeRandomVector(openturns.Function(function), inputs), openturns.Less(), 0.0
    )
    solver = openturns.AbdoRackwitz()
    try:
        search = openturns.FORM(solver, event, openturns.Point(count))
    except TypeError:
        solver.setStartingPoint(openturns.Point(count))
        search = openturns.FORM(solver, event)
    search.run()
    answer = search.getResult()
    theirs = np.asarray(answer.getStandardSpaceDesignPoint())
    nearest = min(found.points, key=lambda point: np.linalg.norm(theirs - point.normal))
    assert np.linalg.norm(theirs - nearest.normal) < 0.05
    assert nearest.beta == pytest.approx(answer.getHasoferReliabilityIndex(), abs=2e-3)
    # It may stop at a saddle where several points are nearer (RP28).
    assert found.points[0].beta < nearest.beta + 1e-6


REFUSED = {
    "it must be a limit state, such as": {"limit": 3.0},
    'no response "gup" in this problem.*gap': {"limit": Above("gup", 0.1)},
    "methods of reliability is empty": {"methods": ()},
    'no method "fosm" of reliability': {"methods": ("fosm",)},
    "variation of reliability is 0": {"variation": 0.0},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_cannot_be_asked_gets_a_sentence(fit, sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.reliability(fit, **{"limit": Below("gap", 0.0)} | REFUSED[sentence])
