"""How a dimension varies about its nominal value, as the inverse of its cumulative distribution.

`quantile(u)` maps u in (0, 1) to the deviation from nominal, so any sampling of the unit cube
serves every distribution.
"""

from abc import abstractmethod

import jax.numpy as jnp
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Float

from jaxclear.ground.answering import nothing_else
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity

__all__ = [
    "AbstractDistribution",
    "Normal",
    "TruncatedNormal",
    "Uniform",
]
__getattr__ = nothing_else("jaxclear.distribution", __all__)

# What a distribution describes tells its unit.
UNIT = "(in the varied number's unit)"


class AbstractDistribution(AbstractQuantified):
    """Deviation of a number from its nominal value, in the number's own unit."""

    @abstractmethod
    def quantile(self, share: Float[Array, "..."]) -> Float[Array, "..."]:
        """Deviation below which the given share of parts lies."""

    @abstractmethod
    def deviation(self) -> Scalar:
        """Standard deviation."""


class Normal(AbstractDistribution):
    """Normal distribution about nominal."""

    standard_deviation: Scalar = quantity(unit=UNIT, meaning="standard deviation", above=0)

    def quantile(self, share):
        return self.standard_deviation * ndtri(share)

    def deviation(self):
        return self.standard_deviation


class Uniform(AbstractDistribution):
    """Equally likely within +- half_width of nominal."""

    half_width: Scalar = quantity(unit=UNIT, meaning="largest deviation", above=0)

    def quantile(self, share):
        return self.half_width * (2.0 * share - 1.0)

    def deviation(self):
        return self.half_width / 3.0**0.5


class TruncatedNormal(AbstractDistribution):
    """Normal distribution of which only what lies within +- bound of nominal is accepted (inspected
    parts).
    """

    standard_deviation: Scalar = quantity(
        unit=UNIT, meaning="standard deviation before inspection", above=0
    )
    bound: Scalar = quantity(unit=UNIT, meaning="largest accepted deviation", above=0, kw_only=True)

    def quantile(self, share):
        low = ndtr(-self.bound / self.standard_deviation)
        return self.standard_deviation * ndtri(low + share * (1.0 - 2.0 * low))

    def deviation(self):
        ratio = self.bound / self.standard_deviation
        density = jnp.exp(-0.5 * ratio * ratio) / jnp.sqrt(2.0 * jnp.pi)
        inside = 1.0 - 2.0 * ndtr(-ratio)
        return self.standard_deviation * jnp.sqrt(1.0 - 2.0 * ratio * density / inside)
