"""Statistical tolerance intervals: limits within which a share of all parts lies, with a confidence
that counts the size of the sample.

Source: ISO 16269-6:2014; without a distribution: Wilks 1941, Ann. Math. Stat. 12, 91,
doi:10.1214/aoms/1177731788.
"""

import bisect
import functools
from typing import NamedTuple

import numpy as np
import scipy

from jaxclear.ground.shown import shown_in_words
from jaxclear.studies.statistics.scrambled import Statistic, deviation, jackknifed, quantile

SIDES = ("both", "lower", "upper")


@shown_in_words
class ToleranceInterval(NamedTuple):
    """At least a share `content` [1] of all parts lies from `low` to `high` (infinite where that
    side is open), with a `confidence` [1]. Limits carry the interval that the scramblings tell."""

    low: Statistic
    high: Statistic
    content: float
    confidence: float

    def in_unit(self, unit: str) -> "ToleranceInterval":
        """The same with the unit of its limits told."""
        return self._replace(low=self.low.in_unit(unit), high=self.high.in_unit(unit))

    def __str__(self) -> str:
        ends = {"above": self.low, "below": self.high}
        sides = [f"{side} {end}" for side, end in ends.items() if np.isfinite(end.value)]
        share, sure = f"{100 * self.content:g} %", f"{100 * self.confidence:g} %"
        return f"{share} of all parts are {' and '.join(sides)}, with a confidence of {sure}"


@functools.lru_cache(maxsize=256)
def normal_factor(samples: int, content: float, confidence: float, both: bool) -> float:
    """Factor [1] of the standard deviation of so many samples of a normal variable."""
    free = samples - 1
    if not both:
        shift = scipy.stats.norm.ppf(content) * np.sqrt(samples)
        return float(scipy.stats.nct.ppf(confidence, free, shift) / np.sqrt(samples))

    def short(factor):
        # Of all means that a sample may have, the chance that its spread reaches far enough.
        def at(z):
            needed = scipy.stats.ncx2.ppf(content, 1, z * z / samples)
            return scipy.stats.chi2.sf(free * needed / factor**2, free) * scipy.stats.norm.pdf(z)

        return 2.0 * scipy.integrate.quad(at, 0.0, 8.0, epsabs=1e-9)[0] - confidence

    guess = scipy.stats.norm.ppf(0.5 + 0.5 * content) * np.sqrt(
        free * (1 + 1 / samples) / scipy.stats.chi2.ppf(1 - confidence, free)
    )
    return float(scipy.optimize.brentq(short, 0.5 * guess, 2.0 * guess, xtol=1e-9))


def normal_interval(
    values: np.ndarray, group: np.ndarray, content: float, confidence: float, side: str
) -> ToleranceInterval:
    """Of a normal response."""
    factor = normal_factor(len(values), content, confidence, side == "both")
    limit = lambda sign: jackknifed(
        lambda own: own.mean() + sign * factor * deviation(own), values, group, skewed=True
    )
    return _sided(limit(-1.0), limit(1.0), content, confidence, side)


def free_interval(
    values: np.ndarray, group: np.ndarray, content: float, confidence: float, side: str
) -> ToleranceInterval:
    """Of a response of any distribution, between two of the samples. Raises `ValueError` where the
    samples are too few, with how many are needed."""
    count = len(values)
    left_out = np.arange(1, count // 2 + 1)
    # The content between ordered samples follows a beta distribution.
    outside = left_out * (2 if side == "both" else 1)
    sure = scipy.stats.beta.sf(content, count + 1 - outside, outside) >= confidence
    if not sure.any():
        raise ValueError(
            f"{count} samples are too few for a tolerance interval of {content:g} with a "
            f"confidence of {confidence:g} that presumes no distribution; it needs "
            f"{fewest(content, confidence, side)}."
        )
    rank = int(left_out[sure][-1])
    ordered = np.sort(values)
    ends = []
    for place, at in ((rank - 1, rank / count), (count - rank, 1 - rank / count)):
        told = quantile(values, group, at)
        ends.append(Statistic(float(ordered[place]), told.low, told.high))
    return _sided(ends[0], ends[1], content, confidence, side)


def fewest(content: float, confidence: float, side: str) -> int:
    """The fewest samples that give an interval without a distribution."""
    outside = 2 if side == "both" else 1
    sure = lambda count: scipy.stats.beta.sf(content, count + 1 - outside, outside) >= confidence
    high = 2 * outside
    while not sure(high):
        high *= 2
    return bisect.bisect_left(range(high), True, lo=outside, key=sure)


def _sided(low, high, content, confidence, side):
    open_low, open_high = (Statistic(sign * np.inf, *[sign * np.inf] * 2) for sign in (-1, 1))
    return ToleranceInterval(
        open_low if side == "upper" else low,
        open_high if side == "lower" else high,
        content,
        confidence,
    )
