"""Morris' elementary effects against closed forms."""

import jax.numpy as jnp
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
    return jc.screening(PROBLEM, 24)


def _mean_move(response, moved):
    """mu* and sigma of a response of one share: moves by s, or by s - 1 where they leave the unit
    interval, of which s is a third to two thirds. By the midpoint rule."""
    step = np.linspace(1 / 3, 2 / 3, 402)
    step, start = 0.5 * (step[1:] + step[:-1])[:, None], (np.arange(2000) + 0.5)[None] / 2000
    end = (start + step) % 1.0
    effect = (response(end) - response(start)) / (end - start)
    return {"mu*": np.abs(effect).mean(), "sigma": effect.std()}[moved]


@pytest.mark.parametrize("periods", [0.5, 1.0, 2.0, 3.0])
def test_a_response_that_repeats_itself_is_seen(periods):
    """As an oval bore over a phase: steps of one length miss some number of periods."""
    wave = lambda share: np.sin(np.pi * periods * (share - 0.1)) ** 2
    problem = jc.FunctionProblem(
        lambda phase, other: jnp.sin(jnp.pi * periods * (phase + 0.4)) ** 2 + 0.01 * other,
        {n: jc.Dimension(0.0, D.Uniform(0.5), unit="1") for n in ("phase", "other")},
    )
    found = jc.screening(problem, 64)
    own = found.mu_star["response", "phase"]
    assert own.low <= _mean_move(wave, "mu*") <= own.high
    assert own.low > found.mu_star["response", "other"].high


def test_effects_are_those_of_the_population():
    """Of a square the mean move is known: (2 a + s) for each start a and step s."""
    found = [jc.screening(PROBLEM, 32, seed=seed) for seed in range(20)]
    square = lambda share: 0 * share + share**2 + 0.5 * share
    for kind in ("mu*", "sigma"):
        own = [getattr(f, {"mu*": "mu_star"}.get(kind, kind))["curved", "b"] for f in found]
        # b moves by a, which is uniform: mean 1/2, deviation 1/sqrt(12).
        exact = {"mu*": 0.5, "sigma": 12**-0.5}[kind]
        assert sum(one.low <= exact <= one.high for one in own) >= 16
    assert np.mean([f.mu_star["curved", "a"].value for f in found]) == pytest.approx(
        _mean_move(square, "mu*"), rel=0.05
    )


def test_a_plane_has_its_slopes_and_no_scatter(screened):
    for name, slope in {"a": 3.0, "b": 0.0, "c": 2.0}.items():
        assert screened.mu_star["plane", name].value == pytest.approx(slope, abs=1e-9)
        assert screened.sigma["plane", name].value == pytest.approx(0.0, abs=1e-9)
    assert '"plane" moves most with "a"' in screened.sentence()
    assert "96 runs." in screened.sentence()
    assert screened.to_dataset()["mu*"].sel(response="plane", variable="c") == pytest.approx(2.0)


def test_moves_whose_runs_failed_are_left_out():
    numbers = {n: jc.Dimension(0.0, D.Normal(1.0)) for n in "ab"}
    found = jc.screening(jc.FunctionProblem(lambda a, b: np.e * a / (b > -0.5), numbers), 32)
    assert 0 < found.failed < 96 and "their moves are left out" in found.sentence()
    assert found.mu_star["response", "a"].value > 0
    with pytest.raises(ValueError, match="trajectories of screening is 1"):
        jc.screening(PROBLEM, 1)
