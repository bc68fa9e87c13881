"""All figures of a run as two rows of numbers. A short run would pay for every array that it works
out and hands over by itself.
"""

from itertools import chain
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.integrators.checks import Check
from jaxclear.integrators.figures import Checks
from jaxclear.simulation.tally import Figures


class Found(NamedTuple):
    """Figures at all of their places behind each other, when [s] each was met, and the checks with
    the names of their places."""

    worst: list[Float[Array, " places"]]
    when: list[Float[Array, " places"]]
    named: list[tuple[Check, tuple[str, ...]]]


def met_by(worst: Figures, when: Figures, places: dict[str, tuple[str, ...]]) -> Found:
    """The worst figures that were met, and when; `places`: names of the places by what they are
    of."""
    kept = [check for check in worst if places[check.of]]
    named = [_named(check, worst[check], places) for check in kept]
    return Found([worst[check] for check in kept], [when[check] for check in kept], named)


def seen_by(
    looks: Figures, ends: Float[Array, " looks"], places: dict[str, tuple[str, ...]]
) -> Found:
    """The worst of figures found by looks, at such times [s]; `places` as for `met_by`. All of them
    are gone through together: XLA would start every operation anew for each."""
    if not looks:
        return Found([], [], [])
    named = [_named(check, each, places) for check, each in looks.items()]
    figures = _infinite_where_nan(jnp.concatenate(list(looks.values()), axis=1))
    return Found([jnp.max(figures, axis=0)], [ends[jnp.argmax(figures, axis=0)]], named)


def _named(
    check: Check, figures: Array, places: dict[str, tuple[str, ...]]
) -> tuple[Check, tuple[str, ...]]:
    """A check with the names of the places of its figures. One name more or less would give every
    figure behind it the limit and the joint of another: a `ValueError` as the run is traced."""
    own, count = places[check.of], figures.shape[-1]
    if len(own) != count:
        raise ValueError(
            f"the check {check.name} has {count} figures for {len(own)} places ({', '.join(own)}) "
            f"of what it is told for ({check.of}): a run must have one for each."
        )
    return check, own


def together(*found: Found) -> Checks:
    """All figures; what is not a number counts as infinite."""
    worst, when, named = (list(chain(*parts)) for parts in zip(*found, strict=True))
    if not named:
        return Checks()
    return Checks(_infinite_where_nan(jnp.concatenate(worst)), jnp.concatenate(when), tuple(named))


def _infinite_where_nan(figures: Array) -> Array:
    return jnp.where(jnp.isnan(figures), jnp.inf, figures)
