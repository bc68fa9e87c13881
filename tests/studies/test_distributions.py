"""Distributions are scipy's, there and back, with their slopes; together they are correlated as
asked and keep their own spread."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxclear as jc
from jaxclear.ground.array_functions import on_host
from jaxclear.studies.inputs import correlation_matrix, joint
from jaxclear.studies.sampling import draw
from tests.rigs.cells import slow_but
from tests.rigs.refusals import refusals

D = jc.distribution
TABLED = {
    "beta": stats.beta(2, 3.5, -1, 3),
    "weibull": stats.weibull_min(1.7, scale=1e-5),
    "gamma": stats.gamma(2.5),
    "student": stats.t(5),
    "kinked": stats.triang(0.3),
    "new interface": stats.Normal(mu=1.0, sigma=2.0),
}
CASES = {
    "normal": (D.Normal(2.0), stats.norm(0, 2)),
    "uniform": (D.Uniform(3.0), stats.uniform(-3, 6)),
    "truncated": (D.TruncatedNormal(1.0, bound=1.5), stats.truncnorm(-1.5, 1.5)),
    "lognormal": (D.Lognormal(1.0, spread=0.4), stats.lognorm(0.4, loc=-1.0)),
    "triangular": (D.Triangular(low=-1.0, high=2.0, mode=0.5), stats.triang(0.5, -1, 3)),
} | {
    name: (D.FromScipy(frozen), stats.norm(1, 2) if name == "new interface" else frozen)
    for name, frozen in TABLED.items()
}
# Shares of 3e-7 to 1 - 3e-7.
SCORES = jnp.linspace(-5.0, 5.0, 101)


def exact(reference):
    low, high = stats.norm.cdf(SCORES), stats.norm.sf(SCORES)
    return np.where(SCORES < 0, reference.ppf(low), reference.isf(high))


@pytest.fixture
def compiled():
    """The programs that JAX compiles, by name."""
    names: list[str] = []
    heard = lambda event, *_, **told: (
        names.append(told["fun_name"]) if "backend_compile" in event else None
    )
    jax.monitoring.register_event_duration_secs_listener(heard)
    yield names
    jax.monitoring.unregister_event_duration_listener(heard)


@pytest.mark.parametrize("name", [*CASES, "empirical", "discrete"])
def test_numbers_that_are_not_traced_compile_nothing(name, compiled):
    """And are those of JAX, but for rounding."""
    more = {"empirical": D.Empirical([0.1, 0.5, 0.2]), "discrete": D.Discrete((0.0, 1.0))}
    distribution = more[name] if name in more else CASES[name][0]
    scores, plain = np.asarray(SCORES), on_host(distribution)
    expected = np.asarray(distribution.of_score(SCORES)), np.asarray(distribution.deviation())
    compiled.clear()
    values = plain.of_score(scores), plain.quantile(np.array([0.2, 0.9])), plain.deviation()
    assert compiled == [] and all(isinstance(own, (np.ndarray, np.number)) for own in values)
    np.testing.assert_allclose(values[0], expected[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(values[2], expected[1], rtol=1e-12)


def test_scores_of_a_cut_off_distribution_end_where_shares_do(compiled):
    law, frozen = on_host(CASES["truncated"][0]), CASES["truncated"][1]
    deviations = np.array([-1.5, -1.4999, 0.0, 1.2, 1.5])
    scores = law.score(deviations)
    assert compiled == []
    np.testing.assert_allclose(scores[1:4], stats.norm.ppf(frozen.cdf(deviations[1:4])), rtol=1e-9)
    assert scores[0] <= -8.2 and scores[-1] >= 8.2
    slopes = jax.vmap(jax.grad(CASES["truncated"][0].score))(jnp.asarray(deviations))
    assert np.all(np.isfinite(slopes))


# Those whose formulas differ most; each compiles its own.
QUICK = ("truncated", "weibull", "triangular")


@pytest.mark.parametrize("name", slow_but(QUICK, CASES))
def test_deviations_slopes_and_scores_are_scipys(name):
    distribution, reference = CASES[name]
    wanted = exact(reference)
    found, slopes = jax.jvp(distribution.of_score, (SCORES,), (jnp.ones(101),))
    # 1e-9 is what the tables promise.
    size = np.maximum(reference.std(), np.abs(wanted))
    assert np.max(np.abs(found - wanted) / size) < 2e-9
    np.testing.assert_allclose(distribution.deviation(), reference.std(), rtol=1e-12)
    density = stats.norm.pdf(SCORES) / reference.pdf(wanted)
    np.testing.assert_allclose(slopes, density, atol=1e-5 * reference.std(), rtol=1e-5)
    # A uniform share near 1 has no digits for its score.
    np.testing.assert_allclose(distribution.score(found), SCORES, atol=1e-9)
    back = jax.vmap(jax.grad(distribution.score))(found)
    np.testing.assert_allclose(back * slopes, 1.0, rtol=1e-6)


def test_a_distribution_about_the_number_itself_gives_deviations():
    clearance = stats.lognorm(0.3, scale=2e-4)
    found = D.FromScipy(clearance, about=2e-4)
    np.testing.assert_allclose(2e-4 + found.quantile(0.9), clearance.ppf(0.9), rtol=1e-9)


@pytest.mark.slow
def test_densities_end_where_parts_are_cut_off():
    ends = {name: CASES[name][0].end_densities() for name in ("student", "uniform", "truncated")}
    assert ends["student"] == (0, 0)
    np.testing.assert_allclose(ends["uniform"], 1 / 6, rtol=1e-9)
    np.testing.assert_allclose(ends["truncated"], stats.truncnorm(-1.5, 1.5).pdf(1.5), rtol=1e-6)


def test_discrete_parts_come_in_their_shares():
    shims = D.Discrete((-1e-4, 0.0, 2e-4), (1, 2, 1))
    found = np.asarray(shims.quantile(jnp.linspace(0.005, 0.995, 100)))
    assert [int(np.sum(found == size)) for size in (-1e-4, 0.0, 2e-4)] == [25, 50, 25]
    np.testing.assert_allclose(shims.deviation(), np.std([-1e-4, 0, 0, 2e-4]))
    np.testing.assert_allclose(shims.score(jnp.asarray(0.0)), 0.0, atol=1e-15)
    assert not shims.is_continuous() and D.Normal(1.0).is_continuous()


@pytest.mark.slow
def test_a_distribution_of_ones_own_needs_a_quantile_and_a_deviation():
    """Density in proportion to cos(x) on +-pi/2."""

    class Cosine(D.AbstractDistribution):
        def quantile(self, share):
            return jnp.arcsin(2.0 * share - 1.0)

        def deviation(self):
            return np.sqrt(np.pi**2 / 4 - 2)

    x = jnp.linspace(-1.4, 1.4, 15)
    np.testing.assert_allclose(Cosine().score(x), stats.norm.ppf((1 + np.sin(x)) / 2), atol=1e-12)


def test_correlated_variables_keep_their_own_spread_and_rank_correlation():
    """Spearman's rank correlation of a Gaussian copula is 6/pi arcsin(r/2)."""
    distributions = (CASES["weibull"][0], D.Uniform(3.0), D.Normal(1.0))
    names = ("a", "b", "c")
    matrix = correlation_matrix({("a", "b"): 0.7, ("c", "b"): -0.4}, names)
    inputs = joint(names, distributions, jnp.array([1e-3, 5.0, -2.0]), matrix)
    normal = jnp.asarray(stats.norm.ppf(stats.qmc.Sobol(3, rng=1).random(4096)))
    values = inputs.values(normal)
    assert np.abs(np.asarray(inputs.normal(values)) - normal).max() < 1e-8
    rank = stats.spearmanr(values).statistic
    np.testing.assert_allclose(rank[0, 1], 6 / np.pi * np.arcsin(0.35), atol=5e-3)
    np.testing.assert_allclose(rank[1, 2], -6 / np.pi * np.arcsin(0.2), atol=5e-3)
    np.testing.assert_allclose(rank[0, 2], 0.0, atol=1e-2)
    np.testing.assert_allclose(values.std(axis=0), inputs.deviations(), rtol=5e-3)


def test_values_are_differentiated_by_nominal_values_and_widths():
    inputs = joint(("a", "b"), (D.Normal(0.1), D.Uniform(3.0)), jnp.array([1.0, 2.0]))
    normal = jnp.array([0.5, -1.0])
    leaves = lambda i: (i.nominal, i.widths)
    moved = lambda *new: eqx.tree_at(leaves, inputs, new).values(normal)
    by_nominal, by_width = jax.jacfwd(moved, argnums=(0, 1))(*leaves(inputs))
    np.testing.assert_allclose(by_nominal, np.eye(2))
    uniform = 3 * (2 * stats.norm.cdf(-1) - 1)
    np.testing.assert_allclose(by_width, np.diag([0.05, uniform]), rtol=1e-12)


test_mistakes_get_a_sentence = refusals(
    {
        "must be a continuous distribution of scipy.stats": lambda: D.FromScipy(stats.norm),
        "must be a continuous distribution": lambda: D.FromScipy(stats.poisson(3)),
        "finite standard deviation": lambda: D.FromScipy(stats.cauchy()),
        "in this order": lambda: D.Triangular(low=1.0, high=0.0),
        "two or more numbers that rise": lambda: D.Discrete((1.0, 1.0)),
        "1 shares for 2 deviations": lambda: D.Discrete((1.0, 2.0), (1.0,)),
        'no variable "z" in this problem': lambda: correlation_matrix({("a", "z"): 0.1}, "ab"),
        "above -1 and below 1": lambda: correlation_matrix({("a", "b"): 1.0}, "ab"),
        "must be a pair": lambda: correlation_matrix({"a": 1.0}, "ab"),
        "must be a symmetric matrix": lambda: correlation_matrix([[1.0]], "ab"),
        "one that no numbers can have": lambda: correlation_matrix(
            {("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9}, "abc"
        ),
    }
)


def rod(length=0.1, mass=2.0):
    """A rod about its end: its inertia is not that of the length unless it is told to follow."""
    return jc.Mechanism(
        {"rod": jc.Body(mass, mass * length**2 / 12, (length / 2, 0.0))},
        {"pivot": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
    )


def of_length(factor):
    inertia = lambda rig: rig.bodies["rod"].inertia
    return [(inertia, lambda rig: factor * rig.bodies["rod"].mass * rig.bodies["rod"].com[0] ** 2)]


def test_numbers_follow_from_the_variables_that_they_are_derived_from():
    where = lambda rig: rig.bodies["rod"].com[0]
    varied = {
        "centre": jc.Variable(where, tolerance=1e-3, derived=of_length(1 / 3)),
        "mass": jc.Variable(lambda rig: rig.bodies["rod"].mass, tolerance=0.1),
    }
    alike = {("centre", "mass"): 0.8}
    end = lambda run: run.states[-1, 0]
    problem = jc.Problem(rod(), end, varied, duration=0.1, save=2, correlation=alike)
    moved = problem.with_values(jnp.array([0.06, 3.0]))
    np.testing.assert_allclose(moved.bodies["rod"].inertia, 3.0 * 0.06**2 / 3, rtol=1e-12)
    np.testing.assert_allclose(problem.inputs.correlation[0, 1], 0.8)
    drawn = draw(problem, 256, 0)
    np.testing.assert_allclose(np.corrcoef(drawn.T)[0, 1], 0.8, atol=0.02)
    with pytest.raises(ValueError, match='"centre" derives a number that is .* at nominal, where'):
        wrong = {"centre": jc.Variable(where, tolerance=1e-3, derived=of_length(1 / 12))}
        jc.Problem(rod(), end, wrong, duration=0.1)
    with pytest.raises(ValueError, match="derived of a Variable holds .* pair of functions"):
        jc.Variable(where, tolerance=1e-3, derived=[where])
