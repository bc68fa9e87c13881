"""The limits that a design may have to keep, `jaxclear.limit`: on mean and deviation, a quantile, a
probability, the worst case.

A limit sees a `Sample` of a response (or of a variable) and gives its own number. What is limited
from below is limited from above with the sign turned, so a positive excess always breaks it.
Weights of a sample add up to 1.

An infinite response, such as a life that outlasts what is followed, is a finite one beyond all
others and beyond the `levels` that decide. Limits that ask for more than on which side of their
levels parts lie are refused before anything is run.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.printing import as_written
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.studies.infinite_responses import check_within_horizon
from jaxclear.studies.statistics import scrambled
from jaxclear.studies.statistics.scrambled import Statistic

# A quantile is a mean over values whose shares lie within so much of the one asked for, as a part
# of it: without it, it would jump from one sample to the next as a design changes. For a normal
# response the bias is below 5e-5 of the quantile at 3 standard deviations.
SMOOTHING = 0.03
# What a share more is worth is told from shares larger and smaller by this factor.
NEAR = 1.5
RESPONSE_UNIT = "(in the response's unit)"
# A unit by which to see whether a limit's number has that of its response.
SAME = "the response's unit"


class Sample(NamedTuple):
    """A response over a population.

    Args:
        values: values of the response, shape (samples,).
        weights: weights [1], shape (samples,), with a sum of 1.
        ends: smallest and largest value over the tolerances, at the corners that slopes choose,
            shape (2,); 0 where the limit is of another kind.
    """

    values: Float[Array, " samples"]
    weights: Float[Array, " samples"]
    ends: Float[Array, " 2"]


class AbstractLimit(AbstractQuantified):
    """A limit on the spread of a response or of a variable."""

    response: eqx.AbstractVar[str]

    @abstractmethod
    def number(self, sample: Sample) -> Scalar:
        """The limited number.

        Args:
            sample: the response over a population, a `Sample`.

        Returns:
            The number, shape ().
        """

    @abstractmethod
    def excess(self, sample: Sample) -> Scalar:
        """Excess over the limit, smooth in the sample; negative where the limit holds.

        Args:
            sample: the response over a population, a `Sample`.

        Returns:
            The excess in the response's unit, shape ().
        """

    def estimate(self, values: np.ndarray, group: np.ndarray) -> Statistic:
        """The limited number with its 95 % interval, of parts that count alike.

        Args:
            values: values of the response, shape (samples,), in its unit.
            group: number of the independent scrambling of each, shape (samples,).

        Returns:
            A `jaxclear.Statistic`; of nan where samples do not tell it (a worst case).
        """
        return scrambled.UNKNOWN

    @abstractmethod
    def bound(self) -> Scalar:
        """The bound of the limited number."""

    @abstractmethod
    def with_bound(self, bound: Any) -> "AbstractLimit":
        """The same limit with another bound.

        Args:
            bound: value of the new bound.

        Returns:
            The limit.
        """

    @abstractmethod
    def rarest(self) -> float:
        """The smallest share of a population that decides [1]."""

    @abstractmethod
    def sides(self, values: Array) -> list[Array]:
        """For each side that is limited a number that grows towards its limit.

        Args:
            values: values of the response, an array in its unit.

        Returns:
            A list of arrays.
        """

    def give(self, sample: Sample) -> Scalar:
        """Change of the excess for a unit of the bound.

        Args:
            sample: the response over a population, a `Sample`.

        Returns:
            The decrease; 1 where both have one unit.
        """
        return jnp.ones(())

    @abstractmethod
    def size(self, sample: Sample) -> Scalar:
        """Scale of an excess, in the response's unit, > 0.

        Args:
            sample: the response over a population, a `Sample`.

        Returns:
            The scale, shape ().
        """

    @abstractmethod
    def words(self) -> str:
        """The limited number in words."""

    @abstractmethod
    def unit(self, of_response: str) -> str:
        """Unit of the limited number.

        Args:
            of_response: unit of the response.

        Returns:
            The unit as text.
        """

    def upper(self) -> bool:
        """Whether the number is limited from above."""
        return getattr(self, "at_most", None) is not None

    def levels(self) -> tuple[Any, ...]:
        """Values of the response that decide, in its unit.

        There are none where more matters than the side of them on which a part lies: an infinite
        response, such as a life, then stands somewhere beyond them.
        """
        return ()

    def by_moments(self) -> bool:
        """Whether mean and deviation decide, which infinite responses do not have."""
        return False

    def extreme(self) -> bool:
        """Whether the ends of tolerances decide, not their probability."""
        return False


Values = Float[Array, " samples"]


def mean(values: Values, weights: Values) -> Scalar:
    """Weighted mean."""
    return jnp.sum(weights * values)


def deviation(values: Values, weights: Values) -> Scalar:
    """Weighted standard deviation."""
    away = values - mean(values, weights)
    return safe_sqrt(jnp.sum(weights * away**2))


def quantile(values: Values, weights: Values, share: Scalar) -> Scalar:
    """Smoothed value that a share of the population exceeds, differentiable.

    Args:
        values: of a response, shape (samples,).
        weights: of the samples [1], with a sum of 1.
        share: of the population above the result [1], > 0 and < 1.
    """
    order = jnp.argsort(-values)
    above = jnp.concatenate([jnp.zeros(1), jnp.cumsum(weights[order])])
    width = SMOOTHING * jnp.minimum(share, 1.0 - share)
    kernel = jnp.diff(ndtr((above - share) / width))
    return jnp.sum(kernel * values[order]) / jnp.sum(kernel)


__all__ = [
    "AbstractLimit",
    "AbstractOneSidedLimit",
    "MeanAndDeviation",
    "Probability",
    "Quantile",
    "WorstCase",
]
__getattr__, __dir__ = nothing_else("jaxclear.limit", __all__)


class AbstractOneSidedLimit(AbstractLimit):
    """A limit from above or from below on a number in the response's unit.

    Args:
        response: name of the response.
        at_most: largest value, a number in the response's unit; None (default) with `at_least`.
        at_least: smallest value, a number in the response's unit; None (default) with `at_most`.

    Raises:
        ValueError: for none or both of `at_most` and `at_least`.
    """

    response: str = eqx.field(static=True)
    at_most: Scalar | None = quantity(None, RESPONSE_UNIT, kw_only=True)
    at_least: Scalar | None = quantity(None, RESPONSE_UNIT, kw_only=True)

    def __check_init__(self):
        if (self.at_most is None) == (self.at_least is None):
            raise ValueError(
                f'limit.{type(self).__name__} of "{self.response}" takes at_most or at_least; give '
                "one of the two."
            )

    def bound(self):
        return self.at_most if self.upper() else self.at_least

    def excess(self, sample):
        beyond = self.number(sample) - self.bound()
        return beyond if self.upper() else -beyond

    def with_bound(self, bound):
        where = (lambda one: one.at_most) if self.upper() else (lambda one: one.at_least)
        return eqx.tree_at(where, self, jnp.asarray(bound, float))

    def sides(self, values):
        return [values if self.upper() else -values]

    def levels(self):
        return (self.bound(),)

    def size(self, sample):
        return _size(self.bound(), sample)

    def unit(self, of_response):
        return of_response


class MeanAndDeviation(AbstractOneSidedLimit):
    """Mean plus a number of standard deviations at most, or mean minus as many at least.

    Args:
        response: name of the response or variable.
        at_most: largest value, a number in the response's unit; None (default) with `at_least`.
        at_least: smallest value, a number in the response's unit; None (default) with `at_most`.
        deviations: number of standard deviations [1], >= 0; 3 by default.

    Raises:
        ValueError: unless one of at_most and at_least is given.
    """

    deviations: Scalar = quantity(3.0, "1", at_least=0, kw_only=True)

    def number(self, sample):
        side = 1.0 if self.upper() else -1.0
        beyond = side * self.deviations * deviation(sample.values, sample.weights)
        return mean(sample.values, sample.weights) + beyond

    def estimate(self, values, group):
        factor = float(self.deviations) * (1.0 if self.upper() else -1.0)
        number = lambda values, group: values.mean() + factor * scrambled.deviation(values, group)
        contributions = scrambled.contributions_to_moments(values, factor)
        return scrambled.jackknifed(number, values, group, contributions, grouped=True)

    def rarest(self):
        return 0.5

    def by_moments(self):
        return True

    def words(self):
        side = "+" if self.upper() else "-"
        return f"mean {side} {float(self.deviations):g} standard deviations of {self.response}"


class Quantile(AbstractOneSidedLimit):
    """A quantile of the response, at most or at least.

    It is the value below which `share` of the population lies (at most), or above which it lies (at
    least).

    Args:
        response: name of the response or variable.
        at_most: largest value, a number in the response's unit; None (default) with `at_least`.
        at_least: smallest value, a number in the response's unit; None (default) with `at_most`.
        share: share of the population on the good side [1], > 0.5 and < 1.

    Raises:
        ValueError: unless one of at_most and at_least is given.
    """

    share: Scalar = quantity(unit="1", above=0.5, below=1, kw_only=True)

    def number(self, sample):
        if self.upper():
            return quantile(sample.values, sample.weights, 1.0 - self.share)
        return -quantile(-sample.values, sample.weights, 1.0 - self.share)

    def estimate(self, values, group):
        share = 1.0 - self.rarest() if self.upper() else self.rarest()
        return scrambled.quantile(values, group, share)

    def rarest(self):
        return 1.0 - float(self.share)

    def words(self):
        side = "below" if self.upper() else "above"
        return f"value {side} which {100 * float(self.share):.6g} % of {self.response} lie"


class Probability(AbstractLimit):
    """Share of the population above or below a value, or outside two values, at most.

    The yield is 1 minus this share.

    Args:
        response: name of the response or variable.
        above: value from which on the response is too large, a number in its unit; None (default)
            for none.
        below: value up to which the response is too small, a number in its unit; None (default) for
            none.
        at_most: largest share outside [1], > 0 and < 0.5.

    Raises:
        ValueError: if neither above nor below is given, or above is not the larger.
    """

    response: str = eqx.field(static=True)
    above: Scalar | None = quantity(None, RESPONSE_UNIT, kw_only=True)
    below: Scalar | None = quantity(None, RESPONSE_UNIT, kw_only=True)
    at_most: Scalar = quantity(unit="1", above=0, below=0.5, kw_only=True)

    def __check_init__(self):
        if self.above is None and self.below is None:
            raise ValueError(
                f'limit.Probability of "{self.response}" takes above, below or both; give one.'
            )
        if self.above is not None and self.below is not None and self.above <= self.below:
            raise ValueError(
                f'limit.Probability of "{self.response}" has above = {float(self.above):g} and '
                f"below = {float(self.below):g}; above must be the larger."
            )

    def beyond(self, values: Array) -> Array:
        """Distance of values outside the limits; negative inside.

        Args:
            values: values of the response, an array in its unit.

        Returns:
            An array of the same shape.
        """
        sides = self.sides(values)
        return sides[0] if len(sides) == 1 else jnp.maximum(*sides)

    def number(self, sample):
        return jnp.sum(jnp.where(self.beyond(sample.values) > 0.0, sample.weights, 0.0))

    def estimate(self, values, group):
        return scrambled.share(np.asarray(self.beyond(values)) > 0, group)

    def excess(self, sample):
        # At most p lie beyond 0 where the value that p exceed is at most 0, which is smooth.
        return quantile(self.beyond(sample.values), sample.weights, self.at_most)

    def bound(self):
        return self.at_most

    def with_bound(self, bound):
        return eqx.tree_at(lambda one: one.at_most, self, jnp.asarray(bound, float))

    def rarest(self):
        return float(self.at_most)

    def sides(self, values):
        above = [] if self.above is None else [values - self.above]
        return above if self.below is None else [*above, self.below - values]

    def give(self, sample):
        # The quantile is nearly straight in the logarithm of the share.
        beyond, factor = self.beyond(sample.values), NEAR
        ends = [
            quantile(beyond, sample.weights, self.at_most * by) for by in (factor, 1.0 / factor)
        ]
        return (ends[1] - ends[0]) / (2.0 * jnp.log(factor) * self.at_most)

    def size(self, sample):
        ends = [jnp.abs(end) for end in self.levels()]
        return _size(jnp.max(jnp.stack(ends)), sample)

    def levels(self):
        return tuple(end for end in (self.above, self.below) if end is not None)

    def words(self):
        sides = [] if self.above is None else [f"above {as_written(self.above)}"]
        sides += [] if self.below is None else [f"below {as_written(self.below)}"]
        return f"share of {self.response} {' or '.join(sides)}"

    def unit(self, of_response):
        return "1"


class WorstCase(AbstractOneSidedLimit):
    """The value where every dimension is at the bad end of its tolerance, by slopes at the nominal.

    Args:
        response: name of the response or variable.
        at_most: largest value, a number in the response's unit; None (default) with `at_least`.
        at_least: smallest value, a number in the response's unit; None (default) with `at_most`.

    Raises:
        ValueError: unless one of at_most and at_least is given.
    """

    def number(self, sample):
        return sample.ends[1 if self.upper() else 0]

    def rarest(self):
        return 0.5

    def words(self):
        return f"{'largest' if self.upper() else 'smallest'} {self.response} in the worst case"

    def extreme(self):
        return True


def _size(bound: Scalar, sample: Sample) -> Scalar:
    """The smaller of a bound's own size and three standard deviations: what is let pass of a gap of
    20 mm +- 20 um is a share of the 20 um."""
    spread = 3.0 * jnp.std(sample.values)
    size = jnp.abs(bound)
    either = jnp.where(spread > 0, spread, jnp.where(size > 0, size, 1.0))
    return jnp.where(size > 0, jnp.minimum(size, either), either)


def check_levels(problem: Any, limit: AbstractLimit) -> None:
    """Raises `ValueError` for a limit that cannot take what its response may answer."""
    name, levels = limit.response, [float(level) for level in limit.levels()]
    why = problem.description.responses[name].infinite
    if why and not levels and not limit.by_moments():
        raise ValueError(
            f'"{name}" may be infinite ({why}), and limit.{type(limit).__name__} names no values '
            "of it that decide, beyond which an infinite one could stand: give it `levels`, or "
            "take limit.Quantile or limit.Probability."
        )
    check_within_horizon(problem, name, *levels)
