"""From statistics to unknowns: kernel ridge regression on a sample, and intervals from what it
misses where a run is left out.

Unknowns are shares of their priors, so that each is uniform over the sample. For a record the
interval is its estimate and the order statistics of the residuals, each of a run that the
regression did not see and beside the spread of residuals about its estimate: of n exchangeable ones
the k-th smallest is below that of another run with probability k/(n + 1). Runs that belong together
are left out together: where those of one law are, the residuals are those of a law that was not
seen, as a machine's is.

Source: kernel ridge with leave-one-out in closed form, Rasmussen & Williams 2006, Gaussian
Processes for Machine Learning, sec. 5.4, doi:10.7551/mitpress/3206.001.0001; intervals with their
finite-sample correction, Vovk, Gammerman & Shafer 2005, Algorithmic Learning in a Random World,
doi:10.1007/b106715; leave-one-out, Barber, Candès, Ramdas & Tibshirani 2021, Ann. Stat. 49, 486,
doi:10.1214/20-AOS1965; beside their spread, Lei, G'Sell, Rinaldo, Tibshirani & Wasserman 2018, J.
Am. Stat. Assoc. 113, 1094, doi:10.1080/01621459.2017.1307116.
"""

import math
from typing import NamedTuple

import numpy as np

# Lengths of the kernel, in the spread of the whitened statistics, and ridges: the least mean square
# of left-out residuals chooses.
LENGTHS, RIDGES = (0.5, 1.0, 2.0, 4.0), (1e-3, 1e-2, 1e-1, 1.0)
# Length by which single kinds of statistics are compared.
ONE_LENGTH = (2.0,)
# Weight of the straight line beside the bell-shaped part.
LINE = 0.2
# Principal parts of the statistics with less than this share of the largest variance are rounding.
LEAST_VARIANCE = 1e-3
# The spread of residuals about an estimate is that of this share of the runs, at least so many.
NEAREST_SHARE, LEAST_NEAREST = 0.3, 30
TINY = float(np.finfo(float).tiny)
# Runs nearest by statistics, whose mean distance says whether a record is like any run; and parts
# of the sample, each of which is beside the others as a record is beside the sample.
NEIGHBOURS, FOLDS = 5, 4


class Whitened(NamedTuple):
    """Statistics as principal parts of about unit spread: `mean`, `spread` (statistics,), `axes`
    (statistics, parts)."""

    mean: np.ndarray
    spread: np.ndarray
    axes: np.ndarray

    def __call__(self, statistics: np.ndarray) -> np.ndarray:
        """Principal parts (rows, parts)."""
        return (statistics - self.mean) / self.spread @ self.axes


def whitened(statistics: np.ndarray) -> Whitened:
    """How the statistics (runs, statistics) of a sample become principal parts."""
    mean, spread = statistics.mean(0), statistics.std(0)
    spread = np.where(spread > 1e-12 * (np.abs(mean) + 1e-300), spread, np.inf)
    scaled = (statistics - mean) / spread
    variances, axes = np.linalg.eigh(np.atleast_2d(np.cov(scaled.T)))
    mask = variances > LEAST_VARIANCE * max(variances.max(), 1e-300)
    if not mask.any():
        return Whitened(mean, spread, np.zeros((len(mean), 1)))
    variances, axes = variances[mask], axes[:, mask]
    # Parts below the middle are noise for the most: they keep a lesser weight.
    weight = np.minimum(1.0, np.sqrt(variances / np.median(variances)))
    return Whitened(mean, spread, axes / np.sqrt(variances) * weight)


class Surface(NamedTuple):
    """The regression of one unknown: `length` of the kernel, `weights` (runs,), `mean`, the
    `predictions` (runs,) of each run without that run, and their `residuals`
    (runs,)."""

    length: float
    weights: np.ndarray
    mean: float
    predictions: np.ndarray
    residuals: np.ndarray

    def spread(self, estimate: float, but: int | None = None) -> float:
        """Root mean square of the residuals of the runs nearest by estimate, one left out."""
        errors = np.abs(self.predictions - estimate)
        if but is not None:
            errors[but] = np.inf
        count = min(max(LEAST_NEAREST, int(NEAREST_SHARE * len(errors))), len(errors) - 1)
        near = np.argpartition(errors, count - 1)[:count]
        return float(np.sqrt(np.mean(self.residuals[near] ** 2)))

    def spreads(self) -> np.ndarray:
        """That of the others about each run (runs,)."""
        return np.array([self.spread(row, i) for i, row in enumerate(self.predictions)])


class Fold(NamedTuple):
    """A part of a sample beside the rest of it: how the rest is whitened, the rest's principal
    `parts` (runs, parts), and the distances (runs,) [1] of this part's runs from it."""

    whiten: Whitened
    parts: np.ndarray
    distances: np.ndarray


class Regression(NamedTuple):
    """Surfaces of all unknowns over the statistics of a sample: `whiten`, `parts` (runs, parts),
    `unknowns` (runs, unknowns) as shares of their priors, `surfaces`, `relative` (runs, unknowns),
    the residuals beside their spread [1], and the `folds` of the sample."""

    whiten: Whitened
    parts: np.ndarray
    unknowns: np.ndarray
    surfaces: tuple[Surface, ...]
    relative: np.ndarray
    folds: tuple[Fold, ...]

    @property
    def residuals(self) -> np.ndarray:
        """What is missed of each run that is left out (runs, unknowns)."""
        return np.stack([surface.residuals for surface in self.surfaces], axis=1)

    @property
    def scatter(self) -> np.ndarray:
        """Root mean square (unknowns,) of the residuals beside the prior's deviation [1]."""
        return np.sqrt(np.mean(self.residuals**2, axis=0) * 12)

    def estimates(self, statistics: np.ndarray) -> np.ndarray:
        """Estimates (records, unknowns) for statistics (records, statistics)."""
        parts = self.whiten(np.atleast_2d(statistics))
        estimates = [
            s.mean + _kernel(parts, self.parts, s.length) @ s.weights for s in self.surfaces
        ]
        return np.stack(estimates, axis=1)

    def missed(self, estimates: np.ndarray) -> np.ndarray:
        """What estimates (unknowns,) may miss: the residuals (runs, unknowns) of all runs, as wide
        as they are about there."""
        pairs = zip(self.surfaces, estimates, strict=True)
        return self.relative * np.array([surface.spread(at) for surface, at in pairs])

    def distance(self, statistics: np.ndarray) -> float:
        """The share [1] of the sample's runs that lie further from the others than these statistics
        (statistics,): near 0 where no run is like them."""
        # Of more statistics than runs principal parts know the runs that they are made of.
        further = sum(
            int(np.sum(fold.distances >= _nearness(fold.whiten(statistics[None]), fold.parts)[0]))
            for fold in self.folds
        )
        return float((1 + further) / (len(self.parts) + 1))


def regression(
    statistics: np.ndarray, unknowns: np.ndarray, groups: np.ndarray | None = None
) -> Regression:
    """Kernel ridge regression of unknowns on statistics of a sample.

    Args:
        statistics: shape (runs, statistics).
        unknowns: shares of their priors [1], shape (runs, unknowns).
        groups: number of the group of each run; a group is left out as a whole. None: each run
            alone.
    """
    whiten = whitened(statistics)
    parts = whiten(statistics)
    surfaces = _fit_surfaces(parts, unknowns, LENGTHS, groups)
    relative = np.stack([s.residuals / np.maximum(s.spreads(), TINY) for s in surfaces], 1)
    return Regression(whiten, parts, unknowns, surfaces, relative, _split_folds(statistics))


def _split_folds(statistics: np.ndarray) -> tuple[Fold, ...]:
    folds = []
    for number in range(FOLDS):
        mask = np.arange(len(statistics)) % FOLDS == number
        whiten = whitened(statistics[~mask])
        parts = whiten(statistics[~mask])
        folds.append(Fold(whiten, parts, _nearness(whiten(statistics[mask]), parts)))
    return tuple(folds)


def residuals_alone(statistics: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """Root mean square (unknowns,) of what some statistics alone miss of runs that are left out,
    beside the prior's deviation [1]."""
    surfaces = _fit_surfaces(whitened(statistics)(statistics), unknowns, ONE_LENGTH)
    return np.array([np.sqrt(12 * np.mean(surface.residuals**2)) for surface in surfaces])


def _fit_surfaces(
    parts: np.ndarray,
    unknowns: np.ndarray,
    lengths: tuple[float, ...],
    groups: np.ndarray | None = None,
) -> tuple[Surface, ...]:
    """Of each unknown the surface that misses least of runs that are left out."""
    means = unknowns.mean(0)
    best: list[tuple[float, Surface] | None] = [None] * unknowns.shape[1]
    for length in lengths:
        values, vectors = np.linalg.eigh(_kernel(parts, parts, length))
        rotated = vectors.T @ (unknowns - means)
        for ridge in RIDGES:
            inverse = 1 / (np.maximum(values, 0) + ridge)
            weights = vectors @ (inverse[:, None] * rotated)
            residuals = _leave_out_residuals(vectors, inverse, weights, groups)
            for k, missed in enumerate(np.mean(residuals**2, axis=0)):
                best_surface = best[k]
                if best_surface is None or missed < best_surface[0]:
                    residual = residuals[:, k]
                    predicted = unknowns[:, k] - residual
                    surface = Surface(length, weights[:, k], float(means[k]), predicted, residual)
                    best[k] = float(missed), surface
    return tuple(entry[1] for entry in best if entry is not None)


def _leave_out_residuals(
    vectors: np.ndarray, inverse: np.ndarray, weights: np.ndarray, groups: np.ndarray | None
) -> np.ndarray:
    """Residuals (runs, unknowns) of runs that a ridge regression does not see, from that of all:
    its inverse is `vectors` times the diagonal `inverse` times these."""
    if groups is None:
        return weights / (vectors**2 @ inverse)[:, None]
    result = np.empty_like(weights)
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        block = (vectors[members] * inverse) @ vectors[members].T
        result[members] = np.linalg.solve(block, weights[members])
    return result


def _kernel(one: np.ndarray, other: np.ndarray, length: float) -> np.ndarray:
    count = one.shape[1]
    inner = one @ other.T
    squares = np.sum(one**2, axis=1)[:, None] + np.sum(other**2, axis=1) - 2 * inner
    return np.exp(-squares / (2 * count * length**2)) + LINE * inner / count


def _nearness(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Mean distance of rows from their nearest neighbours."""
    squares = np.sum(one**2, axis=1)[:, None] + np.sum(other**2, axis=1) - 2 * one @ other.T
    nearest = np.sort(np.sqrt(np.maximum(squares, 0)), axis=1)
    return nearest[:, :NEIGHBOURS].mean(1)


def conformal(residuals: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """The ends between which a further residual lies with probability `level` at least, half of the
    rest on either side; the extremes where there are too few."""
    count = len(residuals)
    ranked = np.sort(residuals)
    above = min(math.ceil((count + 1) * (0.5 + 0.5 * level)), count)
    return float(ranked[count - above]), float(ranked[above - 1])


class Prediction(NamedTuple):
    """An unknown of one record, as shares of its prior [1]: `estimate`, `low` and `high` ends of
    its interval, and the `sample` of what it may be."""

    estimate: float
    low: float
    high: float
    sample: np.ndarray


def predict(fitted: Regression, statistics: np.ndarray, level: float = 0.95) -> list[Prediction]:
    """Estimate and interval of each unknown from the statistics of a record.

    Args:
        fitted: regression on a sample.
        statistics: of the record, shape (statistics,).
        level: confidence of the intervals [1].
    """
    # One beyond an end of the prior stands at the end, with an interval of its usual width.
    estimates = np.clip(fitted.estimates(statistics)[0], 0.0, 1.0)
    intervals = []
    for estimate, missed in zip(estimates, fitted.missed(estimates).T, strict=True):
        low, high = conformal(missed, level)
        within = lambda share: float(np.clip(share, 0.0, 1.0))
        ends = within(estimate), within(estimate + low), within(estimate + high)
        intervals.append(Prediction(*ends, np.clip(estimate + missed, 0.0, 1.0)))
    return intervals


def calibration(fitted: Regression, level: float = 0.95) -> np.ndarray:
    """Whether the interval of each run, left out, holds its unknowns (runs, unknowns)."""
    is_covered = np.zeros(fitted.relative.shape, bool)
    for k, column in enumerate(fitted.relative.T):
        for i, missed in enumerate(column):
            low, high = conformal(np.delete(column, i), level)
            is_covered[i, k] = low <= missed <= high
    return is_covered
