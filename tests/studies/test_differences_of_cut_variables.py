"""Differences of what is beyond a limit near the end of a distribution, and of what rattles."""

import jax.numpy as jnp
import scipy

import jaxclear as jc


def test_a_share_near_the_end_of_a_distribution_is_not_confirmed_by_a_step_beyond_it():
    """Half of how far the end moves, but for what y holds back. A step of a deviation passes the
    end; the error holds the density that ends there."""
    spread = {"x": jc.distribution.Uniform(1.0), "y": jc.distribution.Normal(0.3)}
    numbers = {name: jc.Dimension(0.0, own) for name, own in spread.items()}
    problem = jc.FunctionProblem(lambda x, y: x + 0.1 * y, numbers)
    wanted = 0.5 * scipy.stats.norm.cdf(0.1 / 0.03)
    for seed in (2, 3, 7):
        (found,) = jc.sensitivity(problem, "x", of=[("above", 0.9)], seed=seed).derivatives.values()
        own = found.estimates["differences"]
        assert abs(found.value - wanted) <= found.error and found.method == "regression"
        assert own.refusal or abs(own.value - wanted) <= own.error


def test_a_sample_of_differences_doubles_until_it_confirms():
    """Waves far shorter than any step, whose mean does not matter: the larger they are the more
    samples it takes, and what no sample confirms is not called agreed."""
    numbers = {name: jc.Dimension(0.0, jc.distribution.Normal(1.0)) for name in "xy"}
    mean = []
    for size in (0.3, 20.0):
        function = lambda x, y, size=size: 0.5 * x + size * jnp.sin(3000.0 * x) * (1.0 + 0.1 * y)
        runs = []
        for seed in range(6):
            problem = jc.FunctionProblem(function, numbers)
            found = jc.sensitivity(problem, "x", seed=seed).derivatives["response", "x"]
            runs.append(found.estimates["differences"].runs)
            assert found.trustworthy or runs[-1] == 512
        assert set(runs) <= {64, 128, 256, 512}
        mean.append(sum(runs) / len(runs))
    assert mean[0] < 100 and mean[0] < mean[1]
