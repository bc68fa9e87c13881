"""Distributions whose quantile is a formula."""

import math

from jaxclear.ground import array_functions as xp
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.studies.distribution.base import LARGEST_SCORE, UNIT, AbstractDistribution


class Normal(AbstractDistribution):
    """Normal distribution about the nominal value.

    Args:
        standard_deviation: standard deviation, a number in the varied number's unit, > 0.
    """

    standard_deviation: Scalar = quantity(unit=UNIT, above=0)

    def quantile(self, share):
        return self.standard_deviation * xp.ndtri(share)

    def of_score(self, score):
        return self.standard_deviation * score

    def score(self, deviation):
        return deviation / self.standard_deviation

    def deviation(self):
        return self.standard_deviation


class Uniform(AbstractDistribution):
    """Uniform distribution within +- half_width of the nominal value.

    Args:
        half_width: largest deviation, a number in the varied number's unit, > 0.
    """

    half_width: Scalar = quantity(unit=UNIT, above=0)

    def quantile(self, share):
        return self.half_width * (2.0 * share - 1.0)

    def score(self, deviation):
        # From the nearer end, where the share has digits left.
        upper, ratio = deviation > 0, deviation / self.half_width
        score = xp.ndtri(0.5 * (1.0 + xp.where(upper, -ratio, ratio)))
        return xp.where(upper, -score, score)

    def deviation(self):
        return self.half_width / 3.0**0.5

    def width(self):
        return "half width", self.half_width


class TruncatedNormal(AbstractDistribution):
    """Normal distribution cut off at +- bound of the nominal value (inspected parts).

    Args:
        standard_deviation: standard deviation before inspection, a number in the varied number's
            unit, > 0.
        bound: largest accepted deviation, a number in the varied number's unit, > 0.
    """

    standard_deviation: Scalar = quantity(unit=UNIT, above=0)
    bound: Scalar = quantity(unit=UNIT, above=0, kw_only=True)

    def quantile(self, share):
        low = xp.ndtr(-self.bound / self.standard_deviation)
        return self.standard_deviation * xp.ndtri(low + share * (1.0 - 2.0 * low))

    def of_score(self, score):
        # Of the lower half and mirrored: a share near 1 has no digits left for what lies beyond.
        low = xp.ndtr(-self.bound / self.standard_deviation)
        upper = score > 0
        share = low + xp.ndtr(xp.where(upper, -score, score)) * (1.0 - 2.0 * low)
        deviation = self.standard_deviation * xp.ndtri(share)
        return xp.where(upper, -deviation, deviation)

    def score(self, deviation):
        low = xp.ndtr(-self.bound / self.standard_deviation)
        upper, ratio = deviation > 0, deviation / self.standard_deviation
        share = (xp.ndtr(xp.where(upper, -ratio, ratio)) - low) / (1.0 - 2.0 * low)
        score = xp.maximum(xp.ndtri(xp.maximum(share, 0.0)), -LARGEST_SCORE)
        return xp.where(upper, -score, score)

    def deviation(self):
        ratio = self.bound / self.standard_deviation
        density = xp.exp(-0.5 * ratio * ratio) / xp.sqrt(2.0 * math.pi)
        inside = 1.0 - 2.0 * xp.ndtr(-ratio)
        return self.standard_deviation * xp.sqrt(1.0 - 2.0 * ratio * density / inside)

    def width(self):
        return "tolerance", self.bound


class Lognormal(AbstractDistribution):
    """A positive number whose logarithm is normal, such as roughness or a wear coefficient.

    The deviation is median (exp(s z) - 1) with z standard normal. With the nominal value for
    `median` the number itself is nominal times exp(s z).

    Args:
        median: median of the number whose logarithm is normal, in the varied number's unit, > 0.
        spread: standard deviation s of the logarithm [1], > 0.
    """

    median: Scalar = quantity(unit=UNIT, above=0)
    spread: Scalar = quantity(unit="1", above=0, kw_only=True)

    def quantile(self, share):
        return self.of_score(xp.ndtri(share))

    def of_score(self, score):
        return self.median * xp.expm1(self.spread * score)

    def score(self, deviation):
        return xp.log1p(deviation / self.median) / self.spread

    def deviation(self):
        square = self.spread * self.spread
        return self.median * xp.exp(0.5 * square) * xp.sqrt(xp.expm1(square))


class Triangular(AbstractDistribution):
    """Density that rises linearly from `low` to `mode` and falls linearly to `high`.

    Args:
        low: smallest deviation, a number in the varied number's unit.
        high: largest deviation, a number in the varied number's unit, > low.
        mode: most likely deviation, a number in the varied number's unit, from low to high; 0 by
            default.

    Raises:
        ValueError: if they are not in this order.
    """

    low: Scalar = quantity(unit=UNIT, kw_only=True)
    high: Scalar = quantity(unit=UNIT, kw_only=True)
    mode: Scalar = quantity(0.0, UNIT, kw_only=True)

    def __check_init__(self):
        if not self.low < self.high or not self.low <= self.mode <= self.high:
            raise ValueError(
                f"distribution.Triangular has low = {self.low:g}, mode = {self.mode:g}, high = "
                f"{self.high:g}; they must be in this order, low below high."
            )

    def quantile(self, share):
        return self._of_shares(share, 1.0 - share)

    def of_score(self, score):
        return self._of_shares(xp.ndtr(score), xp.ndtr(-score))

    def _of_shares(self, below, above):
        span = self.high - self.low
        rising = below * span < self.mode - self.low
        up = self.low + safe_sqrt(below * span * (self.mode - self.low))
        return xp.where(rising, up, self.high - safe_sqrt(above * span * (self.high - self.mode)))

    def deviation(self):
        a, b, c = self.low, self.high, self.mode
        return xp.sqrt((a * a + b * b + c * c - a * b - a * c - b * c) / 18.0)
