"""Surfaces through runs, and statistics that runs correct: against polynomials, refits and closed
forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

import jaxclear as jc
from jaxclear.studies.surface import fitting
from jaxclear.studies.surface.polynomials import powers
from jaxclear.studies.surface.surface import drawn

Normal, Uniform = jc.distribution.Normal, jc.distribution.Uniform


def responses(a, b, c):
    return {
        "polynomial": 1 + 2 * a + 3 * a * b + b**2 - c,
        "rough": jnp.sin(1e4 * a) + 0 * b,
        "smooth": jnp.sin(3 * a) * b + c,
    }


@pytest.fixture(scope="module")
def problem():
    numbers = {"a": jc.Dimension(1.0, Normal(0.1)), "b": jc.Dimension(2.0, Uniform(0.3))}
    return jc.FunctionProblem(responses, numbers | {"c": jc.Dimension(0.0, tolerance=0.1)})


@pytest.fixture(scope="module")
def surface(problem):
    return jc.surface(problem)


def test_a_polynomial_is_met_with_its_derivatives(problem, surface):
    at = jnp.array([1.05, 2.1, 0.02])
    exact = lambda values: responses(*values)["polynomial"]
    found = lambda values: surface(values)["polynomial"]
    both = lambda own: jax.jit(lambda at: (jax.grad(own)(at), jax.hessian(own)(at)))(at)
    for one, other in zip(both(found), both(exact), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-8)
    many = jax.jit(jax.vmap(surface))(jnp.tile(at, (3, 1)))["polynomial"]
    np.testing.assert_allclose(many, exact(at), rtol=1e-11)


def test_what_is_left_out_is_predicted_as_by_a_fit_without_it(problem):
    """Against 20 fits by numpy, each without one run."""
    found = jc.surface(problem, 20)
    assert found.degrees["smooth"] == 2
    x, y = found.values, found.responses["smooth"]
    pairs = [(j, k) for j in range(3) for k in range(j, 3)]
    design = np.column_stack([x[:, j] * x[:, k] for j, k in pairs])
    design = np.column_stack([np.ones(20), x, design])
    for i in range(20):
        rest = np.arange(20) != i
        coefficients = np.linalg.lstsq(design[rest], y[rest], rcond=None)[0]
        assert found.predictions["smooth"][i] == pytest.approx(design[i] @ coefficients, rel=1e-8)
    means = (y.sum() - y) / 19
    quality = 1 - np.sum((y - found.predictions["smooth"]) ** 2) / np.sum((y - means) ** 2)
    assert found.quality["smooth"] == pytest.approx(quality, rel=1e-9)


def test_leave_one_out_tells_the_error_on_fresh_runs(problem, surface):
    fresh = drawn(problem, 256, 1.0, seed=9)
    said = np.asarray(jax.jit(jax.vmap(surface))(jnp.asarray(fresh))["smooth"])
    true = np.asarray(responses(*fresh.T)["smooth"])
    error = np.sqrt(np.mean((said - true) ** 2))
    assert 0.3 < surface.error("smooth") / error < 3


def test_a_rough_response_is_not_trusted_and_says_so(surface):
    assert surface.trusted("smooth") and not surface.trusted("rough")
    assert '"rough": degree 1' in surface.sentence()
    assert "does not stand for runs; sample instead" in surface.sentence()
    assert list(surface.table()["stands for runs"]) == [True, False, True]


def test_ranges_are_filled_whatever_the_distribution(problem):
    found = jc.surface(problem, over={"a": (0.0, 2.0)})
    assert found.values[:, 0].min() < 0.1 and found.values[:, 0].max() > 1.9
    assert abs(found.values[:, 1] - 2.0).max() <= 0.3


def test_failed_runs_are_left_out_and_counted():
    broken = jc.FunctionProblem(
        lambda a: jnp.where(a > 0.5, jnp.nan, a**2), {"a": jc.Dimension(0.0, Normal(1.0))}
    )
    found = jc.surface(broken, 64)
    assert 10 < found.failed < 30 and len(found.values) == 64 - found.failed
    assert f"({found.failed} more failed and are left out)" in found.sentence()
    assert found(jnp.array([-1.0]))["response"] == pytest.approx(1.0)


def test_terms_are_all_products_of_a_total_degree():
    assert len(powers(np.full(4, 3), 3)) == 35  # (4 + 3)! / (4! 3!)
    assert len(powers(np.array([3, 1]), 3)) == 7


REFUSED = {
    "3 of 3 runs reached their end, too few": {"sample": 3},
    'no variable "x" in this problem': {"over": {"x": (0, 1)}},
    "two finite numbers, low and high": {"over": {"a": (1, 0)}},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_cannot_be_asked_gets_a_sentence(problem, sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.surface(problem, **REFUSED[sentence])


@pytest.mark.slow
def test_corrected_intervals_hold_the_closed_form():
    """Lognormal response: mean, deviation and probability are known. 95 % intervals hold in 30 of
    40 repetitions at the least (binomial: fewer than 1 in 1000 times at 91 %); those of deviations,
    whose parts are skewed, in as many as of other numbers."""
    variance = 0.2**2 + (0.5 * 0.3) ** 2
    mean = np.exp(2 + variance / 2)
    probability = 1 - ndtr((np.log(10.0) - 2) / np.sqrt(variance))
    problem = jc.FunctionProblem(
        lambda a, b: {"q": jnp.exp(a + 0.5 * b), "rough": jnp.sin(30 * a)},
        {"a": jc.Dimension(1.0, Normal(0.2)), "b": jc.Dimension(2.0, Normal(0.3))},
    )
    deviation = mean * np.sqrt(np.exp(variance) - 1)
    surface, held = jc.surface(problem), np.zeros(3)
    limit = {"big": jc.limit_state.Above("q", 10.0)}
    for seed in range(40):
        found = jc.corrected_statistics(surface, 16, seed=seed, limits=limit)
        one, rare = found.means["q"], found.probabilities["big"]
        exact = {mean: one, probability: rare, deviation: found.deviations["q"]}
        held += [abs(own.value - value) < own.error for value, own in exact.items()]
    assert np.all(held >= (30, 30, 34))
    assert one.gain > 10, "the surface must carry what it explains"
    assert f'P("big") = {rare}.' in found.sentence(), "what was asked for is told"
    assert found.means["rough"].gain == 1.0 and "its numbers are sampled" in found.sentence()


def test_a_system_fails_by_its_cut_sets():
    above = [jc.limit_state.Above(name, 0.0) for name in "abcd"]
    system = jc.limit_state.Series(
        jc.limit_state.Parallel(above[0], jc.limit_state.Series(above[1], above[2])), above[3]
    )
    assert {tuple(sorted(cut)) for cut in system.cut_sets()} == {(0, 1), (0, 2), (3,)}
    assert system.words() == "(a above 0 and (b above 0 or c above 0)) or d above 0"


def test_many_variables_have_the_terms_that_samples_and_memory_bear(monkeypatch):
    """Sixty variables have 61, 1 891 and 39 711 terms of degree 1, 2 and 3."""
    assert fitting._degrees(60, 5_673) == (1, 2)
    assert fitting._degrees(60, 100_000) == (1, 2)
    assert fitting._degrees(60, 61 * 5_673) == (1,)
    assert fitting._degrees(10, 1_000_000) == (1, 2)
    assert fitting._degrees(3, 40_000) == (1, 2, 3, 4)
    plane = jc.FunctionProblem(
        lambda a, b: a + b**2, {n: jc.Dimension(0.0, tolerance=0.1) for n in "ab"}
    )
    monkeypatch.setattr(fitting, "MOST_NUMBERS", 300)
    assert jc.surface(plane, 64).degrees == {"response": 1}
    with pytest.raises(ValueError, match=r"2 variables has 3 terms, and 128 runs .* 100 runs at"):
        jc.surface(plane, 128)
