"""A surrogate with its correction, of which all studies that use one are made.

The mean of a response is that of a share of what stands in for its runs, known from as many
evaluations as wanted, and the mean of the difference, $E[y] = w E[s] + E[y - w s]$: without bias
whatever stands in. Each is told by independent scramblings of its own, so that their variances add
up. With a cheaper model in the place of the surface, level by level, that is a telescoping sum; as
one sample whose weights may be negative it serves quantiles too.

Source: Nelson 1990, Oper. Res. 38, 974, doi:10.1287/opre.38.6.974 (control variates); Giles 2008,
Oper. Res. 56, 607, doi:10.1287/opre.1070.0496 (levels).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxclear.studies.scrambling import scrambled_normal


class Mean(NamedTuple):
    """Mean of what stands in for runs, and the variance of that."""

    value: float
    variance: float

    @classmethod
    def of(cls, numbers: np.ndarray, scramblings: int) -> "Mean":
        """By numbers (samples,) of scramblings of one length, one after the other."""
        means = numbers.reshape(scramblings, -1).mean(axis=1)
        return cls(float(means.mean()), float(means.var(ddof=1) / scramblings))

    def times(self, weight: float) -> "Mean":
        """The same of a multiple of it."""
        return Mean(weight * self.value, weight**2 * self.variance)


def normal_blocks(
    scramblings: int, samples: int, dimensions: int, seed: tuple[int, ...], first: int = 0
) -> np.ndarray:
    """Standard normal numbers (scramblings samples, dimensions) of independent scramblings, one
    after the other, of which the first has the number `first`."""
    rngs = [np.random.default_rng([*seed, first + k]) for k in range(scramblings)]
    return np.concatenate([scrambled_normal(samples, dimensions, rng) for rng in rngs])


def regressed(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Weights (moments,) of moments (samples, moments) that stand in, in those of the upper."""
    one, other = upper - upper.mean(axis=0), lower - lower.mean(axis=0)
    spread = np.sum(other**2, axis=0)
    return np.where(spread > 0, np.sum(one * other, axis=0) / np.where(spread > 0, spread, 1.0), 0)


def with_difference(sample: Any, runs: Any, there: Any, shares: Any) -> Any:
    """A large sample of what stands in, and runs (samples,) with `shares` [1] beside what stood
    `there` for them: one sample whose weights add up to 1 and may be negative. `sample` has
    `values` and `weights`."""
    values = jnp.concatenate([sample.values, runs, there])
    weights = jnp.concatenate([sample.weights, shares, -shares])
    return sample._replace(values=values, weights=weights)
