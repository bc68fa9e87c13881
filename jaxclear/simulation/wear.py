"""Depth maps of worn surfaces: new ones, and what a saving interval takes off."""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.wear_map import AbstractWearMap, Wearing
from jaxclear.ground.arguments import check_name
from jaxclear.ground.quantity import constant, is_traced, with_fields
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import Layout
from jaxclear.multibody.system import System, readings, wear_maps, wearing_in
from jaxclear.native import has_kernels, one_by_one, scan

Worn = dict[str, dict[str, Array]]
# Volumes [m3] and location features of the events of each surface, by joint and surface.
Losses = dict[tuple[str, str], tuple[Array, ...]]


def unworn(system: System) -> Worn:
    """Depth maps of new surfaces, by joint and surface."""
    return {
        name: {surface: jnp.zeros(wear_map.cells) for surface, (wear_map, _) in surfaces.items()}
        for name, surfaces in wear_maps(system).items()
    }


def initial_depths(mechanism: Mechanism, depths: Worn | None) -> Worn | None:
    """Depth maps from which a run sets out: those given [m], by joint and surface, zero where
    nothing is given; None for None. Raises `ValueError` with a sentence for what is no such map."""
    if depths is None:
        return None
    cells = {
        name: {surface: wear_map.cells for surface, (wear_map, _) in maps.maps().items()}
        for name, maps in wearing_in(mechanism).items()
    }
    for joint, surfaces in depths.items():
        check_name("worn joint", joint, cells, " in this mechanism")
        for surface in surfaces:
            check_name("worn surface", surface, cells[joint], f' of joint "{joint}"')
    return {
        joint: {
            surface: _check_depths(f'worn["{joint}"]["{surface}"]', depths[joint][surface], shape)
            if surface in depths.get(joint, {})
            else jnp.zeros(shape)
            for surface, shape in surfaces.items()
        }
        for joint, surfaces in cells.items()
    }


def with_coarser_cells(mechanism: Mechanism, factor: float) -> Mechanism:
    """The mechanism with cells of worn surfaces so many times as wide, in the same program."""
    if factor == 1:
        return mechanism
    is_wearing = lambda node: isinstance(node, Wearing)
    wider = lambda node: (
        with_fields(node, coarseness=factor * node.coarseness) if is_wearing(node) else node
    )
    return jax.tree.map(wider, mechanism, is_leaf=is_wearing)


def _check_depths(name: str, depths: Any, cells: tuple[int, ...]) -> Array:
    """Depths of a map of so many cells [m]."""
    if jnp.shape(depths) != tuple(cells):
        raise ValueError(
            f"{name} has the shape {jnp.shape(depths)}; the map of this surface has the cells "
            f"{tuple(cells)}."
        )
    depths = jnp.asarray(depths, float)
    if not is_traced(depths) and not bool(jnp.all(jnp.isfinite(depths) & (depths >= 0))):
        raise ValueError(f"{name} has depths that are no numbers, or below 0 m.")
    return depths


def losses_between(
    layout: Layout, states: Float[Array, "time n"], every: int = 1
) -> dict[tuple[str, str], tuple[Array, ...]]:
    """What each surface lost between saving times, with a first axis of time.

    Args:
        layout: of the state array.
        states: at the saving times.
        every: stride over saving times; the last one always counts.
    """
    count = len(states)
    some = states[np.unique([*range(0, count, every), count - 1])]
    return jax.vmap(lambda before, after: losses(layout, before, after))(some[:-1], some[1:])


def worn_by(system: System, worn: Worn, losses: Losses) -> Worn:
    """Depth maps [m] after losses one after the other; without derivatives.

    Args:
        system: with the wear maps.
        worn: depth maps [m] before, by joint and surface.
        losses: of each surface, with a first axis of time.
    """
    if not losses:
        return worn
    system, worn, losses = constant((system, worn, losses))
    maps = wear_maps(system)
    if has_kernels():
        # No gap reads these surfaces.
        spare = {
            (joint, surface): tuple(
                jnp.zeros(maps[joint][surface][0].cells) for _ in range(volumes.shape[1])
            )
            for (joint, surface), (volumes, _) in losses.items()
        }

        read = jax.tree.map(lambda _: None, worn)
        turn = lambda now, losses: (_wear_in_turn(system, (now[0], read, now[1]), losses)[::2], ())
        return scan(turn, (worn, spare), losses, long=True)[0][0]
    numbers, rest = eqx.partition(system, eqx.is_array)

    def through(numbers, worn, losses):
        system = eqx.combine(numbers, rest)
        one = lambda worn, events: (deposit_losses(system, worn, events), None)
        return jax.lax.scan(one, worn, losses)[0]

    return one_by_one(through)(numbers, worn, losses)


def is_off_surface(system: System, layout: Layout, state: Array) -> Any:
    """Whether a state is not finite only because a part has left the surface that it wears.

    Args:
        system: with the wear maps; only flat ones can be left.
        layout: of the state array.
        state: shape (n,).
    """
    maps = wear_maps(system)
    places: list[int] = []
    for slot in layout.wear:
        if slot.averaged and maps[slot.bearing][slot.surface][0].flat:
            places += range(slot.start + 1, slot.start + 1 + len(slot.averaged))
    if not places:
        return False
    finite = jnp.isfinite(state)
    return jnp.all(finite.at[np.array(places)].set(True)) & ~jnp.all(finite)


def losses(layout: Layout, before: Array, after: Array) -> Losses:
    """What each surface lost between two states, by (joint, surface).

    Args:
        layout: of the state array.
        before, after: states, shape (n,).
    """
    events: dict[tuple[str, str], list] = {}
    for slot in layout.wear:
        events.setdefault((slot.bearing, slot.surface), []).append(slot.loss(before, after))
    return {
        surface: tuple(jnp.stack(parts) for parts in zip(*events, strict=True))
        for surface, events in events.items()
    }


def deposit_losses(system: System, worn: Worn, losses: Losses) -> Worn:
    """Depth maps [m] after losses, all of which see the surfaces as they were.

    Args:
        system: with the wear maps.
        worn: depth maps [m] before, by joint and surface.
        losses: volume and place of each event, by (joint, surface).
    """
    worn = {name: dict(surfaces) for name, surfaces in worn.items()}
    for (joint, surface), (volumes, places) in losses.items():
        wear_map, places = _map_with_other_wear(system, worn, joint, surface, places)
        # All events of a surface see it as it was: none comes before the others.
        worn[joint][surface] = wear_map.deposit(worn[joint][surface], volumes, places)
    return worn


def _map_with_other_wear(
    system: System, worn: Worn, joint: str, surface: str, places: Array
) -> tuple[AbstractWearMap, Array]:
    """(map of a surface, location features of its events) beside what the other surfaces of its
    joint have lost in the mean."""
    maps = wear_maps(system)[joint]
    loss: Any = 0.0
    for other, (other_map, _) in maps.items():
        if other != surface:
            areas = other_map.areas()
            loss = loss + jnp.sum(worn[joint][other] * areas) / jnp.sum(areas)
    wear_map = maps[surface][0]
    return (wear_map, places) if len(maps) == 1 else wear_map.facing(loss, places)


def longest_path(system: System, losses: Losses) -> Array:
    """The longest path [cells] of a contact on the surface that it wears, in these losses."""
    maps, paths = wear_maps(system), [jnp.zeros(())]
    for (joint, surface), (volumes, places) in losses.items():
        path = maps[joint][surface][0].path
        # Where nothing is lost, locations are zeros.
        paths += [
            jnp.where(volume > 0, path(place), 0.0)
            for volume, place in zip(volumes, places, strict=True)
        ]
    return jax.lax.stop_gradient(functools.reduce(jnp.maximum, paths))


class Pending(NamedTuple):
    """What surfaces of a run in one kernel are still to lose: the entries of the state that tell
    what contacts have lost, as they were when surfaces were worn (`since`), and for each event of a
    surface an array in which the pressures of cells are put down."""

    since: Array
    pressures: dict[tuple[str, str], tuple[Array, ...]]


def pending_wear(system: System, layout: Layout, state: Array) -> Pending:
    """Record of wear that is not yet put into the maps, when all until a state has been.

    Args:
        system: with the wear maps.
        layout: of the state array.
        state: shape (n,).
    """
    maps, pressures = wear_maps(system), {}
    for surface, (volumes, _) in losses(layout, state, state).items():
        cells = maps[surface[0]][surface[1]][0].cells
        pressures[surface] = tuple(jnp.zeros(cells) for _ in volumes)
    return Pending(state[_wear_entries(layout)], pressures)


def worn_so_far(
    system: System, layout: Layout, now: tuple[Worn, Any, Pending], state: Array, wears: Any = None
) -> tuple[Worn, Any, Pending]:
    """(depth maps, as gaps read them, pending wear) with all losses up to a state in the maps.

    It goes cell by cell, for a kernel.

    Args:
        system: with the wear maps.
        layout: of the state array.
        now: the same three before; the second is None where no gap reads the maps.
        state: shape (n,).
        wears: whether to update; None: always.
    """
    worn, read, before = now
    events, reached = pending_losses(layout, before.since, state, wears)
    worn, read, pressures = _wear_in_turn(system, (worn, read, before.pressures), events)
    return worn, read, Pending(reached, pressures)


def _wear_in_turn(system: System, now: tuple[Worn, Any, Any], losses: Losses) -> tuple:
    """(depth maps, as gaps read them, pressures) after these losses, cell by cell."""
    worn, read = ({name: dict(m) for name, m in part.items()} for part in now[:2])
    pressures = dict(now[2])
    for (joint, surface), (volumes, places) in losses.items():
        wear_map, places = _map_with_other_wear(system, worn, joint, surface, places)
        inputs = worn[joint][surface], read[joint][surface], pressures[joint, surface]
        result = wear_map.deposit_in_turn(*inputs, volumes, places)
        worn[joint][surface], read[joint][surface], pressures[joint, surface] = result
    return worn, read, pressures


def pending_losses(
    layout: Layout, since: Array, state: Array, wears: Any = None
) -> tuple[Losses, Array]:
    """Losses that are not yet in the maps, and the entries of the state up to which they then are.

    Args:
        layout: of the state array.
        since: wear entries of the state at the last update.
        state: shape (n,).
        wears: whether to update; None: always.
    """
    entries = _wear_entries(layout)
    reached = state[entries] if wears is None else jnp.where(wears, state[entries], since)
    return losses(layout, *(state.at[entries].set(each) for each in (since, reached))), reached


def _wear_entries(layout: Layout) -> slice:
    """The entries of a state that tell what contacts have lost; none where nothing wears."""
    if not layout.wear:
        return slice(0, 0)
    last = layout.wear[-1]
    return slice(layout.wear[0].start, last.start + 1 + len(last.averaged))


def wear_all(system: System, worn: Worn, _: Worn, losses: Losses) -> tuple[Worn, Worn]:
    """Depth maps [m] after losses, and as gaps read them.

    Args:
        system: with the wear maps.
        worn: depth maps [m] before, by joint and surface.
        _: the maps as gaps read them before, which are not needed.
        losses: volume and place of each event, by (joint, surface).
    """
    worn = deposit_losses(system, worn, losses)
    return worn, readings(system, worn)


def wear_changed(system: System, worn: Worn, read: Worn, losses: Losses) -> tuple[Worn, Worn]:
    """As `wear_all`, but surfaces that lost nothing are not computed; not for reverse mode.

    Samples of a batch go one after the other, so that each costs only its own losses.

    Args:
        system: with the wear maps.
        worn, read: depth maps [m] before, and as gaps read them.
        losses: volume and place of each event, by (joint, surface).
    """
    if not losses:
        return worn, read
    numbers, rest = eqx.partition(system, eqx.is_array)

    def one(numbers, worn, read, losses):
        # A loop of one turn or none: XLA makes one function of a loop that stands by itself. In a
        # turn of a longer loop it starts operation by operation, some in another thread.
        some = [jnp.any(volumes != 0) for volumes, _ in losses.values()]
        system = eqx.combine(numbers, rest)
        turn = lambda now: (jnp.zeros((), bool), *wear_all(system, now[1], now[2], losses))
        begin = jnp.any(jnp.stack(some)), worn, read
        return jax.lax.while_loop(lambda now: now[0], turn, begin)[1:]

    return one_by_one(one)(numbers, worn, read, losses)
