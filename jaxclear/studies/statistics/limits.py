"""Limits of responses: the share of parts that keep given ones, and those within which a share of
all parts lies, with a confidence that counts the size of the sample (tolerance intervals).

Source: ISO 16269-6:2014; without a distribution: Wilks 1941, Ann. Math. Stat. 12, 91,
doi:10.1214/aoms/1177731788.
"""

import bisect
import functools
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy

from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.ground.printing import with_text_repr
from jaxclear.ground.wording import described
from jaxclear.studies.statistics.scrambled import (
    Statistic,
    contributions_to_moments,
    deviation,
    jackknifed,
    quantile,
    share,
)

# (low, high) of a response in its unit, None for no limit.
Limits = tuple[float | None, float | None]
SIDES = ("both", "lower", "upper")


def check_limits(limits: Any, responses: Iterable[str]) -> None:
    """Raises `ValueError` with a sentence for limits that are none."""
    expect(limits, Mapping, "limits", "a dictionary from responses to (low, high)")
    for name, pair in limits.items():
        check_name("response", name, responses, " in this study")
        if not isinstance(pair, (tuple, list)) or len(pair) != 2 or tuple(pair) == (None, None):
            raise ValueError(
                f'the limits of "{name}" are {described(pair)}; they must be two numbers, (low, '
                "high), with None in place of one of them where there is no limit."
            )
        for value in pair:
            if value is not None:
                check_number(f'a limit of "{name}"', value)
        if None not in pair and not pair[0] < pair[1]:
            raise ValueError(
                f'the limits of "{name}" are {described(pair)}; low is not below high.'
            )


def within(values: np.ndarray, limits: Limits) -> np.ndarray:
    """Whether each of the values (samples,) keeps its limits."""
    low, high = limits
    inside = np.ones(len(values), bool)
    if low is not None:
        inside &= values >= low
    if high is not None:
        inside &= values <= high
    return inside


def yield_of(
    responses: Mapping[str, np.ndarray],
    limits: Mapping[str, Limits],
    failed: np.ndarray,
    group: np.ndarray,
) -> Statistic:
    """Share of samples that keep all limits.

    Failed samples count as outside at the lower end of the interval, as inside at its upper.

    Args:
        responses: by name, shape (samples,).
        limits: lower and upper one of each response.
        failed: indices of samples that failed.
        group: scrambling of each sample.
    """
    inside = np.all([within(responses[name], pair) for name, pair in limits.items()], axis=0)
    good = np.setdiff1d(np.arange(len(group)), failed)
    ratio = share(inside[good], group[good])
    if not len(failed):
        return ratio
    reached = len(good) / len(group)
    return Statistic(ratio.value, ratio.low * reached, ratio.high * reached + 1.0 - reached)


@with_text_repr
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
    """Factor of the standard deviation in a tolerance interval of a normal variable [1].

    Args:
        samples: their number.
        content: share of all parts within the limits [1].
        confidence: probability of that [1].
        both: whether the interval has two limits.
    """
    free = samples - 1
    if not both:
        shift = scipy.special.ndtri(content) * np.sqrt(samples)
        return float(scipy.stats.nct.ppf(confidence, free, shift) / np.sqrt(samples))

    def short(factor):
        # Of all means that a sample may have, the chance that its spread reaches far enough.
        def at(z):
            needed = scipy.stats.ncx2.ppf(content, 1, z * z / samples)
            return scipy.stats.chi2.sf(free * needed / factor**2, free) * scipy.stats.norm.pdf(z)

        return 2.0 * scipy.integrate.quad(at, 0.0, 8.0, epsabs=1e-9)[0] - confidence

    guess = scipy.special.ndtri(0.5 + 0.5 * content) * np.sqrt(
        free * (1 + 1 / samples) / scipy.stats.chi2.ppf(1 - confidence, free)
    )
    return float(scipy.optimize.brentq(short, 0.5 * guess, 2.0 * guess, xtol=1e-9))


def normal_interval(
    values: np.ndarray, group: np.ndarray, content: float, confidence: float, side: str
) -> ToleranceInterval:
    """Tolerance interval of a normal response.

    Args:
        values: of the response, shape (samples,).
        group: scrambling of each sample.
        content, confidence, side: as of `MonteCarlo.tolerance_interval`.
    """
    factor = normal_factor(len(values), content, confidence, side == "both")

    def limit(sign: float) -> Statistic:
        at = lambda numbers, parts: numbers.mean() + sign * factor * deviation(numbers, parts)
        contributions = contributions_to_moments(values, sign * factor)
        return jackknifed(at, values, group, contributions, grouped=True)

    return _sided(limit(-1.0), limit(1.0), content, confidence, side)


def free_interval(
    values: np.ndarray, group: np.ndarray, content: float, confidence: float, side: str
) -> ToleranceInterval:
    """Tolerance interval of a response of any distribution, between two of the samples.

    Args:
        values: of the response, shape (samples,).
        group: scrambling of each sample.
        content, confidence, side: as of `MonteCarlo.tolerance_interval`.

    Raises:
        ValueError: the samples are too few, with how many are needed.
    """
    count = len(values)
    omitted = np.arange(1, count // 2 + 1)
    # The content between ordered samples follows a beta distribution.
    outside = omitted * (2 if side == "both" else 1)
    sure = scipy.special.betaincc(count + 1 - outside, outside, content) >= confidence
    if not sure.any():
        raise ValueError(
            f"{count} samples are too few for a tolerance interval of {content:g} with a "
            f"confidence of {confidence:g} that presumes no distribution; it needs "
            f"{fewest(content, confidence, side)}."
        )
    rank = int(omitted[sure][-1])
    ordered = np.sort(values)
    ends = []
    for place, at in ((rank - 1, rank / count), (count - rank, 1 - rank / count)):
        statistic = quantile(values, group, at)
        ends.append(Statistic(float(ordered[place]), statistic.low, statistic.high))
    return _sided(ends[0], ends[1], content, confidence, side)


def fewest(content: float, confidence: float, side: str) -> int:
    """The fewest samples that give a tolerance interval without a distribution.

    Args:
        content, confidence, side: as of `MonteCarlo.tolerance_interval`.
    """
    outside = 2 if side == "both" else 1
    sure = lambda count: scipy.special.betaincc(count + 1 - outside, outside, content) >= confidence
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
