"""What the losses of single saving intervals tell of where they were put: gone through once, in one
kernel. A loss is spread over the arc that its contact went through within the interval; of one that
is unlike those of the intervals beside it nobody knows where on this arc it was lost, and of one
that went round nearly all of it is even.
"""

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.contact_patch import arc
from jaxclear.components.wear_map import AbstractWearMap
from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, constant
from jaxclear.multibody.state import WearSlot
from jaxclear.multibody.system import wear_maps
from jaxclear.native import scan, while_loop
from jaxclear.simulation.wear import lost_at

# Length of the mean direction of a loss below which it may have been anywhere around: an even sweep
# over two thirds of a turn has one of 0.4, over half a turn 0.64.
AROUND = 0.5


class SingleLosses(NamedTuple):
    """Of each contact that wears: the integral of the square of depths [m4] that losses unlike
    those of the intervals beside them may put `wrong` on their arcs, and the same of arcs that
    reach from one to the next of `some` saving times; losses times mean directions [m3] of
    intervals in which it may have been anywhere `around`; all that it `lost` [m3]."""

    wrong: list[Float[Array, ""]]
    wrong_of_some: list[Float[Array, ""]]
    around: list[Float[Array, " directions"]]
    lost: list[Float[Array, ""]]


def gone_through(model: Model, states: Float[Array, "time n"], some: np.ndarray) -> SingleLosses:
    """The losses of a run that had these states at its saving times, and of `some` of these from
    the first to the last. No derivatives."""
    model, states = constant((model, states))
    slots, maps = model.layout.wear, wear_maps(model.system)
    first, last = slots[0].start, slots[-1].start + 1 + len(slots[-1].averaged)
    table, count = states[:, first:last], len(states) - 1
    slots = tuple(dataclasses.replace(slot, start=slot.start - first) for slot in slots)
    own_map = [maps[slot.bearing][slot.surface][0] for slot in slots]
    # Out here: a sum over all cells would be written out in the kernel.
    areas = [jnp.sum(each.areas()) for each in own_map]

    def interval(carry: tuple) -> tuple:
        k, sudden, found = carry
        before, after = (jnp.where(k > 0, k - 1, 1), jnp.where(k < count - 1, k + 1, count - 2))
        # Without neighbours nothing is unlike them.
        near = (k, k) if count < 2 else (before, after)
        ends = [(table[j], table[j + 1]) for j in (k, *near)]
        new = []
        for i, slot in enumerate(slots):
            (volume, features), *beside = (lost_at(slot, *each) for each in ends)
            # What an interval did not lose is wrong nowhere, however much its neighbours lost.
            unlike = abs(volume - 0.5 * (beside[0][0] + beside[1][0]))
            burst = jnp.minimum(unlike, volume)
            mean = own_map[i].directions_of(features)
            short = jnp.sum(mean**2) < AROUND**2
            wrong, moment, lost = found[i]
            wrong = wrong + wrong_by(own_map[i], areas[i], volume, features, burst)
            moment = moment + jnp.where(short, volume, 0.0) * mean
            new.append((burst, (wrong, moment, lost + volume)))
        bursts, found = zip(*new, strict=True)
        return k + 1, tuple(map(jnp.add, sudden, bursts)), found

    def from_some_to_next(carry: tuple, ends: tuple) -> tuple:
        found, of_some = carry
        begin, end = ends
        none = tuple(jnp.zeros(()) for _ in slots)
        _, sudden, found = while_loop(lambda now: now[0] < end, interval, (begin, none, found))
        # What some intervals lost so is wrong along the arc of all of them.
        each = zip(of_some, own_map, areas, slots, sudden, strict=True)
        of_some = tuple(
            own + wrong_by(wear_map, area, *lost_at(slot, table[begin], table[end]), burst)
            for own, wear_map, area, slot, burst in each
        )
        return (found, of_some), ()

    nothing = tuple(map(_nothing, slots, own_map)), tuple(jnp.zeros(()) for _ in slots)
    found, of_some = scan(from_some_to_next, nothing, (some[:-1], some[1:]))[0]
    wrong, moments, lost = map(list, zip(*found, strict=True))
    return SingleLosses(wrong, list(of_some), moments, lost)


def _nothing(slot: WearSlot, wear_map: AbstractWearMap) -> tuple[Array, Array, Array]:
    """What nothing has put wrong, its losses times directions, and what is lost."""
    moment = wear_map.directions_of(jnp.zeros(slot.feature_count))
    return jnp.zeros(()), jnp.zeros_like(moment), jnp.zeros(())


def wrong_by(
    wear_map: AbstractWearMap, area: Scalar, volume: Scalar, features: Array, burst: Scalar
) -> Float[Array, ""]:
    """Integral of the square of depths [m4] by which an event that lost a volume [m3] on a map of
    this area [m2] is wrong, where so much of it was lost somewhere on its arc."""
    mean = wear_map.directions_of(features)
    swept = arc(safe_sqrt(jnp.sum(mean**2))) ** 2
    width, share = wear_map.covered(features)
    # What is put wrong falls with the square of the arc where that is narrow.
    wrong: Any = burst * safe_divide(swept, swept + width**2)
    return jnp.where(volume > 0, safe_divide(wrong * wrong, share * area), 0.0)
