"""Whether where a run wears hangs on its saving times: what it lost is put on its surfaces once
more, as if it had been saved less often, and what both end with is compared.

Surfaces are updated at saving times; what is lost in between is spread over the arc that the
contact went through. Where force or place change fast, that is not how it was lost.

Intervals in which a contact goes round more than once look alike, however many there are. Their
mean direction tells: it is short, and zero only of a loss that is even around, as of a shaft that
makes whole turns under a steady load (or lies on opposite places alike, which is not told).
"""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.integrators.checks import Check
from jaxclear.multibody.system import wear_maps
from jaxclear.simulation.wear import Worn, lost_at, worn_by_some

# One of at least so many saving times counts in the comparison, and so many do at most: a run of
# many saving times pays little for it.
LEAST, MOST = 4, 64
# A surface that wears less than this share of the one that wears most is judged beside that.
NEGLIGIBLE = 0.01
# Length of the mean direction of a loss below which it may have been anywhere around: an even sweep
# over two thirds of a turn has one of 0.4, over half a turn 0.64.
AROUND = 0.5


def figures(
    model: Model, begun: Worn, ended: Worn, states: Float[Array, "time n"]
) -> dict[Check, Float[Array, " places"]]:
    """By how much depths may be off, beside their size, where a run began with some worn surfaces
    and `ended` with others; one figure for each contact that wears. Of one saving interval only
    `_around` can be told.

    Root mean square over the cells, or of the deepest one if that is more. With every g-th saving
    time as much changes as g - 1 times what is left to change, for an error that falls with their
    distance; that of smooth motion falls faster and is smaller, that of impacts by chance.
    """
    intervals = len(states) - 1
    every = min(max(LEAST, math.ceil(intervals / MOST)), intervals)
    if not ended or not model.layout.wear:
        return {}
    begun, ended, states = jax.lax.stop_gradient((begun, ended, states))
    around = _around(model, states)
    if every < 2:
        return {Check.WEAR_BY_SAVES: around}
    fewer = worn_by_some(model.system, model.layout, begun, states, every)
    apart, sizes = {}, {}
    for joint, surfaces in wear_maps(model.system).items():
        for surface, (wear_map, _) in surfaces.items():
            own, other = (each[joint][surface] for each in (ended, fewer))
            areas = wear_map.areas()
            lost = own - begun[joint][surface]
            sizes[joint, surface] = _mean(lost, areas), jnp.max(lost)
            deepest = abs(jnp.max(own) - jnp.max(other))
            apart[joint, surface] = _mean(own - other, areas), deepest
    largest = [NEGLIGIBLE * jnp.max(jnp.stack(each)) for each in zip(*sizes.values(), strict=True)]
    shares = {
        place: [
            safe_divide(off, jnp.maximum(size, least))
            for off, size, least in zip(apart[place], sizes[place], largest, strict=True)
        ]
        for place in sizes
    }
    worst: list[Any] = [jnp.maximum(*shares[s.bearing, s.surface]) for s in model.layout.wear]
    return {Check.WEAR_BY_SAVES: jnp.maximum(jnp.stack(worst) / (every - 1), around)}


def _around(model: Model, states: Float[Array, "time n"]) -> Float[Array, " places"]:
    """Of each contact that wears, by how much depths are off that its losses in intervals of short
    mean direction leave even around, beside their mean: twice the length of those losses' mean
    direction, as of a depth that goes with the cosine, the smoothest that has it."""
    maps, slots = wear_maps(model.system), model.layout.wear
    uneven, lost = [], []
    for slot in slots:
        volumes, features = jax.vmap(functools.partial(lost_at, slot))(states[:-1], states[1:])
        lost.append(jnp.sum(volumes))
        means = maps[slot.bearing][slot.surface][0].directions_of(features)
        short = jnp.sum(means**2, axis=-1) < AROUND**2
        moment = jnp.sum(jnp.where(short, volumes, 0.0)[:, None] * means, axis=0)
        uneven.append(2 * safe_sqrt(jnp.sum(moment**2)))
    by_surface = [
        sum(
            own
            for own, other in zip(lost, slots, strict=True)
            if (slot.bearing, slot.surface) == (other.bearing, other.surface)
        )
        for slot in slots
    ]
    wholes = jnp.stack(by_surface)
    return safe_divide(
        jnp.stack(uneven), jnp.maximum(wholes, NEGLIGIBLE * jnp.max(wholes, initial=0.0))
    )


def _mean(depths: Array, areas: Array) -> Float[Array, ""]:
    """Root mean square over a surface [m]."""
    return safe_sqrt(jnp.sum(areas * depths * depths) / jnp.sum(areas))
