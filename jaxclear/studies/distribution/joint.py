"""Several numbers that vary together, as the two of a shift within a round zone.

They follow from as many standard normal scores, smoothly and without a special direction: what
studies draw, search and differentiate in stays independent and normal. Each number by itself has a
distribution, its marginal.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground import array_functions as xp
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.ground.wording import described
from jaxclear.studies.distribution.base import (
    HALVINGS,
    LARGEST_SCORE,
    UNIT,
    AbstractDistribution,
)

# Of a point at the very edge the scores are as long as any.
LARGEST_SHARE = 1.0 - 1e-15
AXES = ("x", "y", "z")
# Of scores this short (squared) the radius is in proportion to them, by what factor in a disc and
# in a ball: a root of the scores' density in the middle.
SMALL_SQUARE = 1e-12
IN_THE_MIDDLE = {2: 0.5**0.5, 3: (2.0 / (9.0 * np.pi)) ** (1.0 / 6.0)}


class AbstractJointDistribution(AbstractQuantified):
    """Deviations of several numbers from their nominal values, in the numbers' own unit."""

    @property
    @abstractmethod
    def parts(self) -> tuple[str, ...]:
        """Names of the numbers."""

    @abstractmethod
    def of_scores(self, scores: Float[Array, "... parts"]) -> Float[Array, "... parts"]:
        """Deviations of independent standard normal scores; differentiable.

        Args:
            scores: standard normal scores [1], the numbers last.

        Returns:
            The deviations in the numbers' unit, of the same shape.
        """

    @abstractmethod
    def scores(self, deviations: Float[Array, "... parts"]) -> Float[Array, "... parts"]:
        """Standard normal scores of deviations, the inverse of `of_scores`.

        Args:
            deviations: deviations in the numbers' unit, the numbers last.

        Returns:
            The scores [1], of the same shape.
        """

    @abstractmethod
    def marginals(self) -> tuple[AbstractDistribution, ...]:
        """Distribution of each number by itself."""

    @abstractmethod
    def nearest(self, deviations: Float[Array, "... parts"]) -> Float[Array, "... parts"]:
        """The nearest deviations that numbers which depend on each other can have together.

        Args:
            deviations: deviations in the numbers' unit, the numbers last.

        Returns:
            The deviations, of the same shape.
        """


class BallMarginal(AbstractDistribution):
    """One coordinate of a point that is anywhere in a disc or a ball, each part as likely.

    Args:
        radius: radius of the disc or the ball, in the varied number's unit, > 0.
        dimension: number of coordinates, 2 or 3; 2 by default.
    """

    radius: Scalar = quantity(unit=UNIT, above=0)
    dimension: int = eqx.field(static=True, default=2)

    def quantile(self, share):
        power = 0.5 * (self.dimension + 1)

        def halved(_, span):
            low, high = span
            middle = 0.5 * (low + high)
            above = xp.betainc(power, power, 0.5 * (1.0 + middle)) > share
            return xp.where(above, low, middle), xp.where(above, middle, high)

        edge = xp.ones(xp.shape(share))
        low, high = jax.lax.fori_loop(0, HALVINGS, halved, (-edge, edge))
        return self.radius * 0.5 * (low + high)

    def deviation(self):
        return self.radius / (self.dimension + 2) ** 0.5

    def width(self):
        # Of one coordinate alone: the radius is the width of all of them together.
        return "half width", self.radius


class Ball(AbstractJointDistribution):
    r"""A point anywhere in a disc, or in a ball, each part of it as likely.

    With scores of length $s$ the point lies in their direction, at $r = R \sqrt{1 - e^{-s^2/2}}$ in
    a disc, and in a ball at the radius within which the same share of points lies.

    Args:
        radius: radius R of the disc or the ball, in the varied numbers' unit, > 0.
        dimension: number of coordinates, 2 (a disc) or 3 (a ball); 2 by default.

    Raises:
        ValueError: if `dimension` is neither 2 nor 3.
    """

    radius: Scalar = quantity(unit=UNIT, above=0)
    dimension: int = eqx.field(static=True, default=2)

    def __check_init__(self):
        if self.dimension not in (2, 3):
            raise ValueError(
                f"dimension of distribution.Ball is {described(self.dimension)}; it must be 2 (a "
                "disc) or 3 (a ball)."
            )

    @property
    def parts(self):
        return AXES[: self.dimension]

    def of_scores(self, scores):
        square = xp.sum(scores**2, axis=-1, keepdims=True)
        inside = square > SMALL_SQUARE
        length = xp.sqrt(xp.where(inside, square, 1.0))
        factor = xp.where(inside, self._share(length) / length, IN_THE_MIDDLE[self.dimension])
        return self.radius * scores * factor

    def scores(self, deviations):
        square = xp.sum((deviations / self.radius) ** 2, axis=-1, keepdims=True)
        inside = square > SMALL_SQUARE
        share = xp.sqrt(xp.clip(xp.where(inside, square, 1.0), 0.0, 1.0))
        if self.dimension == 2:
            length = xp.sqrt(-2.0 * xp.log1p(-(xp.minimum(share, LARGEST_SHARE) ** 2)))
        else:

            def halved(_, span):
                low, high = span
                middle = 0.5 * (low + high)
                above = self._share(middle) > share
                return xp.where(above, low, middle), xp.where(above, middle, high)

            ends = xp.zeros_like(share), xp.full_like(share, LARGEST_SCORE)
            length = 0.5 * sum(jax.lax.fori_loop(0, HALVINGS, halved, ends))
        factor = xp.where(inside, length / share, 1.0 / IN_THE_MIDDLE[self.dimension])
        return deviations / self.radius * factor

    def _share(self, length):
        """The radius [1] of the unit ball within which as many points lie as scores within
        `length`."""
        if self.dimension == 2:
            return xp.sqrt(-xp.expm1(-0.5 * length**2))
        return xp.gammainc(1.5, 0.5 * length**2) ** (1.0 / 3.0)

    def marginals(self):
        return (BallMarginal(self.radius, self.dimension),) * self.dimension

    def nearest(self, deviations):
        length = xp.sqrt(xp.sum(deviations**2, axis=-1, keepdims=True))
        beyond = length > self.radius
        return deviations * xp.where(beyond, self.radius / xp.where(beyond, length, 1.0), 1.0)


class Independent(AbstractJointDistribution):
    """Several numbers of one thing that vary independently, as those of a rectangular zone.

    Args:
        names: names of the numbers, such as ("x", "y").
        members: distribution of each number, or of several together, a sequence.

    Raises:
        ValueError: if there are not as many numbers as names.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    members: tuple[AbstractDistribution | AbstractJointDistribution, ...]

    def __init__(self, names: Sequence[str], members: Sequence[Any]):
        self.names, self.members = tuple(names), tuple(members)
        count = sum(len(marginals) for marginals in map(marginals_of, self.members))
        if count != len(self.names):
            raise ValueError(
                f"distribution.Independent has {len(self.names)} names of parts and distributions "
                f"of {count} numbers; give each number a name."
            )

    @property
    def parts(self):
        return self.names

    def of_scores(self, scores):
        return self._each(scores, "of_scores", "of_score")

    def scores(self, deviations):
        return self._each(deviations, "scores", "score")

    def marginals(self):
        return tuple(one for member in self.members for one in marginals_of(member))

    def nearest(self, deviations):
        return self._each(deviations, "nearest", "")

    def _each(self, numbers, together, alone):
        """What a method of the members, of that name, makes of their numbers; "": nothing."""
        parts, first = [], 0
        for member in self.members:
            some = numbers[..., first : first + len(marginals_of(member))]
            name = together if isinstance(member, AbstractJointDistribution) else alone
            parts.append(getattr(member, name)(some) if name else some)
            first += some.shape[-1]
        return xp.concatenate(parts, axis=-1)


def marginals_of(distribution: Any) -> tuple[AbstractDistribution, ...]:
    """Distribution of each of the numbers of a distribution, of which most have one."""
    joint = isinstance(distribution, AbstractJointDistribution)
    return distribution.marginals() if joint else (distribution,)
