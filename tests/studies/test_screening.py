"""Morris' elementary effects against SALib and a closed form, and Latin hypercubes against the
variance that theory gives them."""

import importlib.util

import numpy as np
import pytest

import jaxclear as jc

D = jc.distribution


def curved(a, b, c):
    return {"curved": a**2 + a * b, "plane": 3.0 * a - 2.0 * c + 0 * b}


PROBLEM = jc.FunctionProblem(
    curved, {name: jc.Dimension(0.5, D.Uniform(0.5), unit="1") for name in "abc"}
)


@pytest.fixture(scope="module")
def screened():
    return jc.screening(PROBLEM, 24, levels=6)


def test_elementary_effects_are_those_of_salib(screened):
    sampling = pytest.importorskip("SALib.sample.morris")
    analysis = pytest.importorskip("SALib.analyze.morris")
    names = list("abc")
    asked = {"num_vars": 3, "names": names, "bounds": [[0.0, 1.0]] * 3}
    grid = sampling.sample(asked, 24, num_levels=6, seed=0)
    # Our levels are the middles of six equally likely parts: grid points i / 5 are (i + 1/2) / 6.
    values = (5 * grid + 0.5) / 6
    theirs = analysis.analyze(asked, grid, curved(*values.T)["curved"], num_levels=6)
    for i, name in enumerate(names):
        own = screened.mu_star["curved", name], screened.sigma["curved", name]
        np.testing.assert_allclose(own[0].value, theirs["mu_star"][i] * 6 / 5, rtol=1e-9)
        np.testing.assert_allclose(own[1].value, theirs["sigma"][i] * 6 / 5, rtol=1e-9, atol=1e-12)


def test_a_plane_has_its_slopes_and_no_scatter(screened):
    for name, slope in {"a": 3.0, "b": 0.0, "c": 2.0}.items():
        assert screened.mu_star["plane", name].value == pytest.approx(slope, abs=1e-9)
        assert screened.sigma["plane", name].value == pytest.approx(0.0, abs=1e-9)
    assert '"plane" moves most with "a"' in screened.sentence()
    assert "96 runs." in screened.sentence()
    assert screened.to_dataset()["mu*"].sel(response="plane", variable="c") == pytest.approx(2.0)


def test_moves_whose_runs_failed_are_left_out():
    broken = jc.FunctionProblem(
        lambda a, b: np.e * a / (b > -0.5), {n: jc.Dimension(0.0, D.Normal(1.0)) for n in "ab"}
    )
    found = jc.screening(broken, 32)
    assert 0 < found.failed < 96 and "their moves are left out" in found.sentence()
    assert found.mu_star["response", "a"].value > 0


def test_what_cannot_be_asked_gets_a_sentence(monkeypatch):
    with pytest.raises(ValueError, match="levels of screening is 3; it must be even"):
        jc.screening(PROBLEM, levels=3)
    with pytest.raises(ValueError, match="trajectories of screening is 1"):
        jc.screening(PROBLEM, 1)
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "SALib" else find(name)
    )
    with pytest.raises(ImportError, match="jaxclear.screening"):
        jc.screening(PROBLEM)


def test_latin_hypercubes_are_as_exact_on_a_sum_as_theory_says():
    """A sum of n stratified numbers: each repetition of n points has the variance 1 / (12 n^3) of a
    number between 0 and 1 (Stein 1987), random ones 1 / (12 n)."""
    plane = jc.FunctionProblem(
        lambda a, b: a + b, {n: jc.Dimension(0.5, D.Uniform(0.5), unit="1") for n in "ab"}
    )
    found = [
        jc.monte_carlo(plane, 256, sampling="latin", seed=s).mean("response") for s in range(20)
    ]
    means = np.array([one.value for one in found])
    # Eight repetitions of 32 points; the variance of 20 numbers is known to a factor of 2.
    theory = 2 / (12 * 32**3) / 8
    assert theory / 2.5 < np.mean((means - 1.0) ** 2) < 2.5 * theory
    assert sum(one.low <= 1.0 <= one.high for one in found) >= 16
    values = np.asarray(jc.monte_carlo(plane, 256, sampling="latin").values)
    for part in range(8):
        cells = np.floor(32 * values[part::8]).astype(int)
        assert all(len(set(column)) == 32 for column in cells.T)


def test_a_latin_hypercube_does_not_grow():
    with pytest.raises(ValueError, match="a Latin hypercube has a fixed number of samples"):
        jc.monte_carlo(PROBLEM, 256, sampling="latin", accuracy=0.1)
    with pytest.raises(ValueError, match='no sampling "latin"'):
        jc.multi_fidelity(PROBLEM, PROBLEM, sampling="latin")
