"""Whether where a run wears hangs on its saving times: what it lost is put on its surfaces once
more, as if it had been saved less often, and what both end with is compared.

Surfaces are updated at saving times; what is lost in between is spread over the arc that the
contact went through. Where force or place change fast, that is not how it was lost.

Where fewer saving times change little, single impacts may still be put wrong: of a loss that is
unlike those of the intervals beside it, over an arc that is wide beside its contact, nobody knows
where on this arc it was lost.

Intervals in which a contact goes round more than once look alike, however many there are. Their
mean direction tells: it is short, and zero only of a loss that is even around, as of a shaft that
makes whole turns under a steady load (or lies on opposite places alike, which is not told).
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.touched_cells import entry
from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.integrators.checks import Check
from jaxclear.multibody.system import wear_maps
from jaxclear.native import has_kernels, while_loop
from jaxclear.simulation.single_losses import SingleLosses, gone_through
from jaxclear.simulation.wear import Worn, worn_by_some

# One of at least so many saving times counts in the comparison. Each that counts is put on its
# surface once more, which is most of what this check costs: where `ENOUGH` count without, one of
# more does, up to `FEWER`; where more than `MOST` would even then, one of as many as leave these.
LEAST, FEWER, ENOUGH, MOST = 4, 8, 25, 64
# A surface that wears less than this share of the one that wears most is judged beside that.
NEGLIGIBLE = 0.01
# Share of the depths that single losses may put wrong by which they were wrong: of slider-cranks,
# four-bars and the 3RSR a quarter to one and a half, beside runs with up to 64 times the saving
# times, the median a half.
EXPECTED = 0.5
# (joint, surface) of what wears.
Place = tuple[str, str]


def figures(
    model: Model, begun: Worn, ended: Worn, states: Float[Array, "time n"]
) -> dict[Check, Float[Array, " places"]]:
    """By how much depths may be off, beside their size, where a run began with some worn surfaces
    and `ended` with others; one figure for each contact that wears. Of one saving interval only
    `_around` can be told.

    Root mean square over the cells, or of the deepest one if that is more. With every g-th saving
    time as much changes as g - 1 times what is left to change, for an error that falls with their
    distance; that of smooth motion falls faster and is smaller. That of single losses falls by
    chance: what every g-th saving time may put wrong of these is left out, they are judged as they
    are.
    """
    intervals = len(states) - 1
    every = one_of(intervals)
    if not ended or not model.layout.wear:
        return {}
    begun, ended, states = jax.lax.stop_gradient((begun, ended, states))
    some = np.unique([*range(0, intervals, every), intervals])
    single = gone_through(model, states, some)
    around = _around(model, single)
    if every < 2:
        return {Check.WEAR_BY_SAVES: around}
    fewer = worn_by_some(model.system, model.layout, begun, states, every)
    bursts, of_fewer = (_bursts(model, each) for each in (single.wrong, single.wrong_of_some))
    by_saves, in_bursts = {}, {}
    for joint, surfaces in wear_maps(model.system).items():
        for surface, (wear_map, _) in surfaces.items():
            place, areas = (joint, surface), wear_map.areas()
            end, other, start = (each[joint][surface] for each in (ended, fewer, begun))
            (apart, size), (own, others, most) = _compared(end, other, start, areas)
            deepest = abs(own - others)
            sudden, by_chance = (
                safe_divide(each[place], safe_sqrt(jnp.sum(areas))) for each in (bursts, of_fewer)
            )
            steady = safe_divide(safe_sqrt(positive_part(apart**2 - by_chance**2)), apart)
            by_saves[place] = (steady * apart, steady * deepest), (size, most)
            in_bursts[place] = (EXPECTED * sudden,), (size,)
    shares = _shares(by_saves), _shares(in_bursts)
    places = [(slot.bearing, slot.surface) for slot in model.layout.wear]
    steadily, suddenly = (jnp.stack([each[place] for place in places]) for each in shares)
    told = jnp.maximum(steadily / (every - 1), suddenly)
    return {Check.WEAR_BY_SAVES: jnp.maximum(told, around)}


def one_of(intervals: int) -> int:
    """One of how many saving times counts in the comparison, of so many saving intervals."""
    few = max(LEAST, min(FEWER, math.ceil(intervals / ENOUGH)))
    return min(max(few, math.ceil(intervals / MOST)), intervals)


def _shares(found: dict[Place, tuple]) -> dict[Place, Array]:
    """How far each surface's numbers are apart beside their sizes, the worst of them, from both; of
    one that wears little beside the sizes of the one that wears most."""
    sizes = [jnp.stack(size) for _, size in found.values()]
    least = NEGLIGIBLE * jnp.max(jnp.stack(sizes), axis=0)
    return {
        place: jnp.max(safe_divide(jnp.stack(apart), jnp.maximum(jnp.stack(size), least)))
        for place, (apart, size) in found.items()
    }


def _bursts(model: Model, wrong: list[Float[Array, ""]]) -> dict[Place, Array]:
    """By surface the root of the integral of the square of depths [m2] that single losses may put
    wrong, by contact [m4]: independent of each other."""
    squares: dict[Place, Any] = {}
    for slot, own in zip(model.layout.wear, wrong, strict=True):
        place = slot.bearing, slot.surface
        squares[place] = squares.get(place, 0.0) + own
    return {place: safe_sqrt(each) for place, each in squares.items()}


def _around(model: Model, single: SingleLosses) -> Float[Array, " places"]:
    """Of each contact that wears, by how much depths are off that its losses in intervals of short
    mean direction leave even around, beside their mean: twice the length of those losses' mean
    direction, as of a depth that goes with the cosine, the smoothest that has it."""
    slots = model.layout.wear
    uneven = [2 * safe_sqrt(jnp.sum(moment**2)) for moment in single.around]
    by_surface = [
        sum(
            own
            for own, other in zip(single.lost, slots, strict=True)
            if (slot.bearing, slot.surface) == (other.bearing, other.surface)
        )
        for slot in slots
    ]
    wholes = jnp.stack(by_surface)
    return safe_divide(
        jnp.stack(uneven), jnp.maximum(wholes, NEGLIGIBLE * jnp.max(wholes, initial=0.0))
    )


def _compared(ended: Array, fewer: Array, begun: Array, areas: Array) -> tuple[Any, Any]:
    """((root mean squares of the difference of two surfaces, and of what the first has lost), (the
    deepest cell of each, the most that one of the first has lost)) [m]."""

    def told(own, other, before, area):
        apart, lost = own - other, own - before
        return (area * apart * apart, area * lost * lost), (own, other, lost)

    cells = [each.ravel() for each in (ended, fewer, begun, areas)]
    if has_kernels():
        # XLA goes through the cells of all samples once for each number, and writes most of these.
        def visit(now):
            k, sums, most = now
            of_cell = told(*(entry(each, (k,)) for each in cells))
            return k + 1, *map(_each_by, (jnp.add, jnp.maximum), (sums, most), of_cell)

        zero, least = jnp.zeros(()), jnp.full((), -jnp.inf)
        begin = jnp.zeros((), int), (zero, zero), (least, least, least)
        _, sums, most = while_loop(lambda now: now[0] < ended.size, visit, begin)
    else:
        sums, most = told(*cells)
        sums, most = tuple(map(jnp.sum, sums)), tuple(map(jnp.max, most))
    return tuple(safe_sqrt(each / jnp.sum(areas)) for each in sums), most


def _each_by(join: Callable, known: tuple, more: tuple) -> tuple:
    return tuple(map(join, known, more))
