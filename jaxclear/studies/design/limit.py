"""The limits that a design may have to keep, `jaxclear.limit`: on mean and deviation, a quantile, a
probability, the worst case."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.ground.answering import nothing_else
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.ground.shown import as_written
from jaxclear.studies.design.abstract_limit import AbstractLimit, Sample
from jaxclear.studies.design.weighted import deviation, mean, quantile, share_above

__all__ = [
    "AbstractLimit",
    "AbstractOneSidedLimit",
    "MeanAndDeviation",
    "Probability",
    "Quantile",
    "WorstCase",
]
__getattr__, __dir__ = nothing_else("jaxclear.limit", __all__)

# What a share more is worth is told from shares larger and smaller by this factor.
NEAR = 1.5
OWN = "(in the response's unit)"


class AbstractOneSidedLimit(AbstractLimit):
    """A number in the response's unit, at most or at least."""

    at_most: eqx.AbstractVar[Scalar | None]
    at_least: eqx.AbstractVar[Scalar | None]

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


def _check_one_side(limit: Any, kind: str) -> None:
    if (limit.at_most is None) == (limit.at_least is None):
        raise ValueError(
            f'limit.{kind} of "{limit.response}" takes at_most or at_least; give one of the two.'
        )


class MeanAndDeviation(AbstractOneSidedLimit):
    """Mean plus `deviations` standard deviations at most, or mean less as many at least."""

    response: str = eqx.field(static=True)
    at_most: Scalar | None = quantity(None, OWN, "largest mean plus deviations", kw_only=True)
    at_least: Scalar | None = quantity(None, OWN, "smallest mean less deviations", kw_only=True)
    deviations: Scalar = quantity(
        3.0, "1", "standard deviations beyond the mean", at_least=0, kw_only=True
    )

    def __check_init__(self):
        _check_one_side(self, "MeanAndDeviation")

    def number(self, sample):
        side = 1.0 if self.upper() else -1.0
        beyond = side * self.deviations * deviation(sample.values, sample.weights)
        return mean(sample.values, sample.weights) + beyond

    def rarest(self):
        return 0.5

    def by_moments(self):
        return True

    def words(self):
        side = "+" if self.upper() else "-"
        return f"mean {side} {float(self.deviations):g} standard deviations of {self.response}"


class Quantile(AbstractOneSidedLimit):
    """The value below which `share` of the population lies, at most; or that above which it lies,
    at least."""

    response: str = eqx.field(static=True)
    at_most: Scalar | None = quantity(None, OWN, "largest quantile", kw_only=True)
    at_least: Scalar | None = quantity(None, OWN, "smallest quantile", kw_only=True)
    share: Scalar = quantity(
        unit="1", meaning="share on the good side", above=0.5, below=1, kw_only=True
    )

    def __check_init__(self):
        _check_one_side(self, "Quantile")

    def number(self, sample):
        if self.upper():
            return quantile(sample.values, sample.weights, 1.0 - self.share)
        return -quantile(-sample.values, sample.weights, 1.0 - self.share)

    def rarest(self):
        return 1.0 - float(self.share)

    def words(self):
        side = "below" if self.upper() else "above"
        return f"value {side} which {100 * float(self.share):.6g} % of {self.response} lie"


class Probability(AbstractLimit):
    """Share of the population outside `above` or `below` (or both: yield is one less this), at
    most."""

    response: str = eqx.field(static=True)
    above: Scalar | None = quantity(None, OWN, "too large from here on", kw_only=True)
    below: Scalar | None = quantity(None, OWN, "too small up to here", kw_only=True)
    at_most: Scalar = quantity(
        unit="1", meaning="largest share outside", above=0, below=0.5, kw_only=True
    )

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
        """How far values lie outside; below 0 inside."""
        sides = self.sides(values)
        return sides[0] if len(sides) == 1 else jnp.maximum(*sides)

    def number(self, sample):
        return share_above(self.beyond(sample.values), sample.weights, 0.0)

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
    """The value where every dimension lies at the bad end of its tolerance, by first order."""

    response: str = eqx.field(static=True)
    at_most: Scalar | None = quantity(None, OWN, "largest value", kw_only=True)
    at_least: Scalar | None = quantity(None, OWN, "smallest value", kw_only=True)

    def __check_init__(self):
        _check_one_side(self, "WorstCase")

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
