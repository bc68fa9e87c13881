"""Distributions whose quantile is no formula: any continuous one of scipy, and what a sample says.

Their deviation is tabulated over standard normal scores, with its slope, and read off by cubic
Hermite polynomials: what is drawn is differentiated and compiled as any other number, without a
call back to scipy. Knots are set until the polynomials keep within `ACCURACY` of scipy's quantile;
beyond one part in 1e9, where some of scipy's quantiles are themselves rough, they stand evenly.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from jaxclear.ground import array_functions as xp
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.ground.wording import described
from jaxclear.studies.distribution.base import END_SCORE, LARGEST_SCORE, UNIT, AbstractDistribution

# Largest error between knots, as a share of the standard deviation, or of the deviation in tails.
ACCURACY = 1e-9
# Intervals at first, how often they are halved where needed, and where their errors are measured.
FIRST_INTERVALS, MOST_HALVINGS, MOST_KNOTS = 256, 24, 8192
PROBES = (0.21, 0.5, 0.79)


class Table(eqx.Module):
    """Deviations over standard normal scores: `scores` [1], `deviations` [the number's unit] and
    `slopes` [the same], (knots,) each."""

    scores: Float[Array, " knots"]
    deviations: Float[Array, " knots"]
    slopes: Float[Array, " knots"]

    def of_score(self, score: Float[Array, "..."]) -> Float[Array, "..."]:
        """Deviation at a score [1]; beyond the last knots along the line through the last two."""
        i = xp.clip(xp.searchsorted(self.scores, score) - 1, 0, len(self.scores) - 2)
        (start, end), (left, right), slopes = (
            (xp.take(column, i), xp.take(column, i + 1))
            for column in (self.scores, self.deviations, self.slopes)
        )
        step = end - start
        s = (score - start) / step
        deviation = _hermite(s, left, right, step * slopes[0], step * slopes[1])
        return xp.where((s < 0) | (s > 1), left + s * (right - left), deviation)


def _hermite(s, left, right, left_slope, right_slope):
    """Cubic by values and slopes at s = 0 and 1."""
    rise = right - left
    square = s * s * (3.0 - 2.0 * s)
    return left + rise * square + (1 - s) * s * ((1 - s) * left_slope - s * right_slope)


def tabulated(frozen: Any, name: str) -> Table:
    """The table of a frozen distribution of scipy. Raises `ValueError` with a sentence where its
    quantile jumps, so that no polynomials follow it."""
    spread = float(_call(frozen, "std", "standard_deviation")())
    scores = np.linspace(-LARGEST_SCORE, LARGEST_SCORE, FIRST_INTERVALS + 1)
    for _ in range(MOST_HALVINGS):
        knots, slopes = _sample_quantiles(frozen, scores)
        step = np.diff(scores)
        error = np.zeros(len(step))
        for s in PROBES:
            exact, _ = _sample_quantiles(frozen, scores[:-1] + s * step)
            ends = (step * slopes[:-1], step * slopes[1:])
            missed = np.abs(_hermite(s, knots[:-1], knots[1:], *ends) - exact)
            error = np.maximum(error, missed / np.maximum(spread, np.abs(exact)))
        middles = 0.5 * (scores[:-1] + scores[1:])
        coarse = ~(error <= ACCURACY) & (np.abs(middles) < END_SCORE)
        if not coarse.any():
            knots = np.maximum.accumulate(knots)
            return Table(jnp.asarray(scores), jnp.asarray(knots), jnp.asarray(slopes))
        where = float(knots[:-1][coarse][0])
        scores = np.sort(np.concatenate([scores, middles[coarse]]))
        if len(scores) > MOST_KNOTS:
            break
    raise ValueError(
        f"{name}: its quantile cannot be followed near {where:g}; it must be continuous, without "
        "gaps (for single sizes take distribution.Discrete)."
    )


def _sample_quantiles(frozen: Any, scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quantiles at scores, and their slopes by the score."""
    lower = scores <= 0
    with np.errstate(all="ignore"):
        below = _call(frozen, "ppf", "icdf")(scipy.special.ndtr(np.where(lower, scores, 0.0)))
        above = _call(frozen, "isf", "iccdf")(scipy.special.ndtr(-np.where(lower, 0.0, scores)))
        deviations = np.where(lower, below, above)
        slopes = scipy.stats.norm.pdf(scores) / np.asarray(frozen.pdf(deviations))
    return deviations, np.where(np.isfinite(slopes), slopes, 0.0)


def _call(frozen: Any, old: str, new: str) -> Any:
    """A method of a frozen distribution, by its name in scipy's old or new interface."""
    return getattr(frozen, old, None) or getattr(frozen, new)


def _is_continuous(frozen: Any) -> bool:
    """Whether scipy knows density, quantile and standard deviation of it."""
    pairs = (("ppf", "icdf"), ("isf", "iccdf"), ("std", "standard_deviation"))
    has_all = all(any(callable(getattr(frozen, name, None)) for name in pair) for pair in pairs)
    generic = isinstance(frozen, (scipy.stats.rv_continuous, scipy.stats.rv_discrete))
    return has_all and callable(getattr(frozen, "pdf", None)) and not generic


class FromScipy(AbstractDistribution):
    """A continuous distribution of scipy.stats, frozen.

    For example `FromScipy(scipy.stats.weibull_min(2, scale=1e-5))`. Its quantile is within 1e-9
    standard deviations of scipy's (in the tails, of the deviation) for shares of 1e-9 and more at
    either end. Distributions of scipy's new interface (`stats.Normal()`, `stats.make_distribution`)
    are accepted too.

    Args:
        frozen: distribution of the deviation, of scipy.stats with its numbers.
        about: nominal value, in the varied number's unit, where the distribution is that of the
            number itself; 0 by default.

    Raises:
        ValueError: if the distribution is not continuous or its standard deviation is not finite.
    """

    table: Table
    spread: Scalar = quantity(unit=UNIT, meaning="standard deviation", above=0)

    def __init__(self, frozen: Any, *, about: float = 0.0):
        if not _is_continuous(frozen):
            raise ValueError(
                f"distribution.FromScipy is given {described(frozen)}; it must be a continuous "
                "distribution of scipy.stats with its numbers, such as scipy.stats.norm(0, 1e-5)."
            )
        spread = float(_call(frozen, "std", "standard_deviation")())
        if not np.isfinite(spread) or spread <= 0 or not np.isfinite(about):
            raise ValueError(
                "distribution.FromScipy needs a distribution with a finite standard deviation, and "
                "a finite about."
            )
        table = tabulated(frozen, "distribution.FromScipy")
        moved = table.deviations - about
        self.table = Table(table.scores, moved, table.slopes)
        self.spread = spread

    def quantile(self, share):
        return self.of_score(xp.ndtri(share))

    def of_score(self, score):
        return self.table.of_score(score)

    def deviation(self):
        return self.spread


class Empirical(AbstractDistribution):
    """The distribution of a sample of deviations.

    Between its values it is linear in their normal scores, and beyond the outermost ones up to
    `low` and `high`.

    Args:
        deviations: the sample in the varied number's unit, an array (samples,) with two different
            values at least, in any order.
        low: smallest deviation, a number in the varied number's unit; None (default) for that of
            the sample.
        high: largest deviation, a number in the varied number's unit, > low; None (default) for
            that of the sample.

    Raises:
        ValueError: if the sample has no two different finite numbers, or low is not below high.
    """

    deviations: Float[Array, " samples"]
    low: Scalar | None = quantity(None, UNIT, "smallest deviation (None: of the sample)")
    high: Scalar | None = quantity(None, UNIT, "largest deviation (None: of the sample)")

    def __init__(self, deviations: Any, *, low: float | None = None, high: float | None = None):
        try:
            ordered = np.sort(np.asarray(deviations, float).ravel())
        except (TypeError, ValueError):
            ordered = np.zeros(0)
        if len(ordered) < 2 or not np.all(np.isfinite(ordered)) or ordered[0] == ordered[-1]:
            raise ValueError(
                f"distribution.Empirical is given {described(deviations)}; it must be two "
                "different finite numbers at least."
            )
        if low is not None and high is not None and not low < high:
            raise ValueError(
                f"distribution.Empirical has low = {low:g}, high = {high:g}; low must be below "
                "high."
            )
        self.deviations, self.low, self.high = jnp.asarray(ordered), low, high

    def _values_within_ends(self) -> Array:
        """Its values, none beyond its ends."""
        low = -np.inf if self.low is None else self.low
        return xp.clip(self.deviations, low, np.inf if self.high is None else self.high)

    def quantile(self, share):
        return self.of_score(xp.ndtri(share))

    def of_score(self, score):
        inside, count = self._values_within_ends(), len(self.deviations)
        ends = (
            inside[0] if self.low is None else self.low,
            inside[-1] if self.high is None else self.high,
        )
        scores = xp.ndtri((np.arange(count) + 0.5) / count)
        outer = np.array([LARGEST_SCORE])
        scores = xp.concatenate([-outer, scores, outer])
        return xp.interp(score, scores, xp.concatenate([ends[0][None], inside, ends[1][None]]))

    def deviation(self):
        return xp.std(self._values_within_ends())
