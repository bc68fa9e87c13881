"""What every distribution answers: deviations from shares, from standard normal scores, and back.

Scores are what studies draw, correlate and search in: `of_score` is the deviation whose share is
that of a standard normal variable, and keeps its accuracy in both tails.
"""

from abc import abstractmethod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground import array_functions as xp
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import AbstractQuantified, Scalar
from jaxclear.native.compiled import compiled_quickly

# What a distribution describes tells its unit.
UNIT = "(in the varied number's unit)"
# Shares of double precision lie within these scores: ndtr(-8.3) = 5e-17.
LARGEST_SCORE = 8.3
# Halvings of the range of scores before one step of Newton: 17 / 2^52 is rounding.
HALVINGS = 52
# Where a distribution is asked whether it ends: one part in 1e9 lies beyond.
END_SCORE = 6.0
# A density [1/standard deviation] below this at its end moves no mean that a sample could see.
LEAST_END_DENSITY = 1e-4


@compiled_quickly
def score_slopes(distribution: Any, scores: Float[Array, " scores"]) -> Float[Array, " scores"]:
    """How fast the deviations of a distribution move with these scores [its unit]."""
    return jax.jvp(distribution.of_score, (scores,), (jnp.ones_like(scores),))[1]


class AbstractDistribution(AbstractQuantified):
    """Deviation of a number from its nominal value, in the number's own unit.

    A subclass defines `quantile` and `deviation`.
    """

    @abstractmethod
    def quantile(self, share: Float[Array | np.ndarray | float, "..."]) -> Float[Array, "..."]:
        """Deviation below which a share of the parts lies.

        Args:
            share: share of the parts [1], between 0 and 1, any shape.

        Returns:
            The deviation in the number's unit, of the same shape.
        """

    @abstractmethod
    def deviation(self) -> Scalar:
        """Standard deviation."""

    def of_score(self, score: Float[Array | np.ndarray | float, "..."]) -> Float[Array, "..."]:
        """Deviation of a standard normal score; it has derivatives.

        Args:
            score: standard normal score [1], any shape.

        Returns:
            The deviation in the number's unit, of the same shape.
        """
        return self.quantile(xp.ndtr(score))

    def score(self, deviation: Float[Array | np.ndarray | float, "..."]) -> Float[Array, "..."]:
        """Standard normal score of a deviation, the inverse of `of_score`, differentiable once.

        Args:
            deviation: value of the deviation, in the number's unit, any shape.

        Returns:
            The score [1], within +-8.3.
        """
        target = jax.lax.stop_gradient(deviation)

        def halved(_, span):
            low, high = span
            middle = 0.5 * (low + high)
            above = self.of_score(middle) > target
            return jnp.where(above, low, middle), jnp.where(above, middle, high)

        edge = jnp.full(jnp.shape(deviation), LARGEST_SCORE)
        low, high = jax.lax.fori_loop(0, HALVINGS, halved, (-edge, edge))
        score = jax.lax.stop_gradient(0.5 * (low + high))
        value, slope = jax.jvp(self.of_score, (score,), (jnp.ones_like(score),))
        return score + safe_divide(deviation - value, slope)

    def width(self) -> tuple[str, Scalar]:
        """Name and value of the number that describes the width of the distribution.

        It doubles where all deviations double.
        """
        return "standard deviation", self.deviation()

    def is_continuous(self) -> bool:
        """Whether the distribution has a density."""
        return True

    def end_densities(self) -> tuple[float, float]:
        """Density at the lower and the upper end [1/unit]; 0 without an end."""
        slopes = score_slopes(self, np.array([-END_SCORE, END_SCORE]))
        with np.errstate(divide="ignore"):
            density = np.exp(-0.5 * END_SCORE**2) / np.sqrt(2 * np.pi) / np.asarray(slopes)
        density = np.where(density * float(self.deviation()) > LEAST_END_DENSITY, density, 0.0)
        return float(density[0]), float(density[1])
