"""A surrogate with its correction, of which all studies that use one are made.

The mean of a response is that of a share of what stands in for its runs, known from as many
evaluations as wanted, and the mean of the difference, $E[y] = w E[s] + E[y - w s]$: without bias
whatever stands in. Each is told by independent scramblings of its own, so that their variances add
up. With a cheaper model in the place of the surface, level by level, that is a telescoping sum. As
one sample, each part of which takes the difference of the run of its rank, it serves quantiles too.

Source: Nelson 1990, Oper. Res. 38, 974, doi:10.1287/opre.38.6.974 (control variates); Giles 2008,
Oper. Res. 56, 607, doi:10.1287/opre.1070.0496 (levels).
"""

from typing import NamedTuple

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
    """Standard normal numbers (scramblings samples, dimensions), one scrambling after the other.

    Args:
        scramblings: their number.
        samples: of each.
        dimensions: numbers of a sample.
        seed: first parts of the generators' seeds.
        first: number of the first scrambling.
    """
    rngs = [np.random.default_rng([*seed, first + k]) for k in range(scramblings)]
    return np.concatenate([scrambled_normal(samples, dimensions, rng) for rng in rngs])


def regressed(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Weights (moments,) of moments (samples, moments) that stand in, in those of the upper."""
    one, other = upper - upper.mean(axis=0), lower - lower.mean(axis=0)
    spread = np.sum(other**2, axis=0)
    return np.where(spread > 0, np.sum(one * other, axis=0) / np.where(spread > 0, spread, 1.0), 0)


def corrected_values(
    values: np.ndarray, weights: np.ndarray, runs: np.ndarray, there: np.ndarray, shares: np.ndarray
) -> np.ndarray:
    """A large sample of a surface, corrected by runs of the same rank.

    Each run moves as much as its share, so that the mean is that of a control variate.

    Args:
        values: of the surface, shape (points,).
        weights: of the points [1].
        runs: responses of runs, shape (runs,).
        there: values of the surface at these runs.
        shares: weights of the runs [1].
    """
    by_rank, order = np.argsort(there, kind="stable"), np.argsort(values, kind="stable")
    middles = np.cumsum(weights[order]) - 0.5 * weights[order]
    rank = np.searchsorted(np.cumsum(shares[by_rank])[:-1], middles)
    corrected = values.copy()
    corrected[order] += (runs - there)[by_rank][rank]
    return corrected
