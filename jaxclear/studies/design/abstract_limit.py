"""What a limit is: a bound on a number that says how a response spreads.

A limit sees a `Sample` of a response (or of a variable) and gives its own number. What is limited
from below is limited from above with the sign turned, so a positive excess always breaks it.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.quantity import AbstractQuantified, Scalar

__all__ = ["AbstractLimit", "Sample"]


class Sample(NamedTuple):
    """A response over a population. `values` (samples,), `weights` (samples,) add up to 1 and may
    be negative; `ends` (2,): its smallest and largest value as the dimensions go through their
    tolerances, by first order (0 where the limit is of another kind)."""

    values: Float[Array, " samples"]
    weights: Float[Array, " samples"]
    ends: Float[Array, " 2"]


class AbstractLimit(AbstractQuantified):
    """A limit on how a response, or a variable, spreads."""

    response: eqx.AbstractVar[str]

    @abstractmethod
    def number(self, sample: Sample) -> Scalar:
        """The limited number."""

    @abstractmethod
    def excess(self, sample: Sample) -> Scalar:
        """By how much the limit is broken, smooth in the sample; below 0 where it is kept, in the
        response's unit."""

    @abstractmethod
    def bound(self) -> Scalar:
        """What the limited number is held against."""

    @abstractmethod
    def with_bound(self, bound: Any) -> "AbstractLimit":
        """The same limit with another bound."""

    @abstractmethod
    def rarest(self) -> float:
        """The smallest share of a population that decides [1]."""

    @abstractmethod
    def sides(self, values: Array) -> list[Array]:
        """Of each side that is limited, a number that is the larger the nearer a value is to
        breaking the limit there."""

    def give(self, sample: Sample) -> Scalar:
        """By how much less a unit more of the bound lets the excess be; 1 where both have one
        unit."""
        return jnp.ones(())

    @abstractmethod
    def size(self, sample: Sample) -> Scalar:
        """What an excess is measured by, in the response's unit, above 0."""

    @abstractmethod
    def words(self) -> str:
        """The limited number, in words."""

    @abstractmethod
    def unit(self, of_response: str) -> str:
        """Unit of the limited number."""

    def upper(self) -> bool:
        """Whether the number is limited from above."""
        return getattr(self, "at_most", None) is not None

    def levels(self) -> tuple[Any, ...]:
        """Values of the response that decide, in its unit: all that the limit asks of a part is on
        which side of them it lies. None where it asks more."""
        return ()

    def by_moments(self) -> bool:
        """Whether mean and deviation decide, which infinite responses have none of."""
        return False

    def extreme(self) -> bool:
        """Whether the ends of tolerances decide, not how often they are reached."""
        return False
