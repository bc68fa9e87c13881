"""Numbers that come in a few sizes: gauges, shims, classes of a selective fit."""

from typing import Any

import numpy as np

from jaxclear.ground import array_functions as xp
from jaxclear.ground.quantity import vector
from jaxclear.ground.wording import described
from jaxclear.studies.distribution.base import UNIT, AbstractDistribution


class Discrete(AbstractDistribution):
    """A few deviations, each with its share of the parts.

    The score of a deviation is that of the middle of its share. There is no density and no slope:
    derivatives by scores are refused.

    Args:
        deviations: deviations that occur, two numbers at least, increasing, in the varied number's
            unit.
        shares: share of the parts of each [1], >= 0, scaled to a sum of 1; None (default) for equal
            ones.

    Raises:
        ValueError: if deviations do not increase or shares do not fit them.
    """

    deviations: Any = vector(unit=UNIT, meaning="deviations that occur, rising")
    shares: Any = vector(None, meaning="how often each occurs, as shares of all parts")

    def __check_init__(self):
        sizes = np.asarray(self.deviations, float)
        if len(sizes) < 2 or np.any(np.diff(sizes) <= 0):
            raise ValueError(
                f"distribution.Discrete has deviations = {described(sizes.tolist())}; it must be "
                "two or more numbers that rise."
            )
        if self.shares is not None:
            shares = np.asarray(self.shares, float)
            if len(shares) != len(sizes) or np.any(shares < 0) or shares.sum() <= 0:
                raise ValueError(
                    f"distribution.Discrete has {len(shares)} shares for {len(sizes)} deviations; "
                    "it needs one for each, none negative and not all zero."
                )

    def _table(self):
        sizes = xp.stack(self.deviations)
        shares = xp.ones(len(sizes)) if self.shares is None else xp.stack(self.shares)
        return sizes, xp.cumsum(shares / shares.sum())

    def quantile(self, share):
        sizes, upper = self._table()
        return xp.take(sizes, xp.searchsorted(upper[:-1], share, side="right"))

    def score(self, deviation):
        sizes, upper = self._table()
        lower = xp.concatenate([xp.zeros(1), upper[:-1]])
        place = xp.argmin(abs(sizes - xp.expand_dims(deviation, -1)), axis=-1)
        return xp.take(xp.ndtri(0.5 * (lower + upper)), place)

    def deviation(self):
        sizes, upper = self._table()
        shares = xp.diff(upper, prepend=0.0)
        mean = xp.sum(shares * sizes)
        return xp.sqrt(xp.sum(shares * (sizes - mean) ** 2))

    def is_continuous(self):
        return False

    def end_densities(self):
        return 0.0, 0.0
