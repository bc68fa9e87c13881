"""What a part takes off the cells that it touches, gone through one by one.

The same numbers as by `contact_patch.depth_lost`, for machine code: of a map of a thousand cells a
contact touches a few, and a loop that ends behind these costs as many times less. XLA, which starts
each operation of such a loop by itself, is left to whole maps.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.contact_patch import (
    LAST_STEPS,
    MOST_STEPS,
    SHARPEST,
    Cells,
    Elasticity,
    next_level,
)
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.native import while_loop

Depth = Float[Array, "around along"]
# Column and row of a cell.
Place = tuple[Int[Array, ""], Int[Array, ""]]


class Touched(NamedTuple):
    """Cells that a part may overlap: from a `first` column (of any turn) so many `columns`, each at
    most once, and in each from a `lower` row so many `rows`."""

    first: Int[Array, ""]
    columns: Int[Array, ""]
    lower: Int[Array, ""]
    rows: Int[Array, ""]


def ways(columns: int) -> Float[np.ndarray, "columns 2"]:
    """Direction (x, y) of the centre of each of so many columns around."""
    angles = (np.arange(columns) + 0.5) * (2 * np.pi / columns)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def way_of(column: Int[Array, ""], columns: int) -> Float[Array, "2"]:
    """Direction (x, y) of one of so many columns."""
    return jax.lax.dynamic_slice(ways(columns), (column, 0), (1, 2))[0]


def least(cell: float, clearance: Scalar) -> tuple[Scalar, Scalar]:
    """(a cell's own rounding [m], what a part's overlap cos + rounding sin is at the least where it
    overlaps one [m]) of cells of such an angle [rad]."""
    return 0.5 * cell * clearance, (1.0 - SHARPEST) * clearance


def angle_touched(level: Scalar, cell: float, clearance: Scalar) -> Scalar:
    """An angle [rad] from a way of a part at a level [m] beyond which it overlaps no cell."""
    rounding, needed = least(cell, clearance)
    size = jnp.sqrt(level * level + rounding * rounding)
    # That of the largest sum is no more than its tangent, that of the cosine needed / size no more
    # than this.
    sine = safe_sqrt(0.5 * (1.0 - needed / size))
    return rounding / level + 2.0 * sine * (1.0 + (0.5 * jnp.pi - 1.0) * sine * sine)


class Loss(Protocol):
    """What a map of so many `cells` loses to a part: a `volume` [m3] under a `load`."""

    @property
    def cells(self) -> tuple[int, int]: ...

    @property
    def volume(self) -> Scalar: ...

    @property
    def load(self) -> Elasticity: ...

    def start(self, depth: Depth) -> Scalar:
        """A level [m] of the part to begin with, where walls are worn so deep [m]."""

    def touched(self, level: Scalar) -> Touched:
        """Cells that the part may overlap at a level [m]."""

    def in_column(self, column: Int[Array, ""]) -> Any:
        """What the cells of a column share."""

    def cell(self, column: Any, row: Int[Array, ""], depth: Scalar) -> Cells:
        """One of them, worn so deep [m]."""


class Share(NamedTuple):
    """Which cells a loss is taken off, and what a cell's pressure is multiplied by [m]."""

    touched: Touched
    scale: Scalar


def worn_in_turn(
    loss_of: Callable[..., Loss],
    read_anew: Callable[[Touched, Depth, Any], Any],
    depth: Depth,
    reading: Any,
    pressures: Sequence[Depth],
    volume: Float[Array, " events"],
    features: Float[Array, "events n"],
) -> tuple[Depth, Any, Sequence[Depth]]:
    """(depth, its reading, pressures) after the loss of each event; the reading (None: nobody asks
    for it) is made anew where cells have been touched."""
    shares, pressures = all_shared(loss_of, depth, pressures, volume, features)
    depth = taken_off(shares, pressures, depth)
    for touched, _ in shares if reading is not None else ():
        reading = read_anew(touched, depth, reading)
    return depth, reading, pressures


def all_shared(
    loss_of: Callable[..., Loss],
    depth: Depth,
    pressures: Sequence[Depth],
    volume: Float[Array, " events"],
    features: Float[Array, "events n"],
) -> tuple[tuple[Share, ...], tuple[Depth, ...]]:
    """(the `Share`, the pressures) of the loss of each event (volume [m3], location features)."""
    found = []
    for own, *event in zip(pressures, volume, features, strict=True):
        loss = lambda event=event: loss_of(*event)
        found.append(_shared(loss, event[0], depth, own))
    shares, pressures = zip(*found, strict=True)
    return shares, pressures


def _shared(loss: Callable[[], Loss], volume: Scalar, depth: Depth, pressure: Depth) -> tuple:
    """(the `Share` of a loss of a volume [m3] on walls worn so deep [m], the pressures of its
    cells, which are written over others)."""
    none = jnp.zeros((), int)

    def turn(now):
        own = loss()
        level = _level(own, depth)
        touched = own.touched(jax.lax.stop_gradient(level))

        def visit(column, place, carry):
            total, pressure = carry
            cell = own.cell(column, place[1], entry(depth, place))
            found = cell.pressures(own.volume, level)
            return total + cell.area * found, with_entry(pressure, place, found)

        first = jnp.zeros(()), now[2]
        total, after = through(touched, own.cells, visit, first, (False, True), own.in_column)
        scale = own.volume * safe_divide(1.0, total)
        return jnp.zeros((), bool), Share(touched, scale), after

    nothing = Share(Touched(none, none, none, none), jnp.zeros(()))
    # A loop of one turn or none: without a loss none of this is gone through.
    first = volume != 0, nothing, pressure
    return while_loop(lambda now: now[0], turn, first, (False, False, True))[1:]


def _level(loss: Loss, depth: Depth) -> Scalar:
    """Eccentricity [m] of the part after the loss, as `depth_lost` finds it."""

    def turn(now):
        count, left, level = now

        def visit(column, place, sums):
            cell = loss.cell(column, place[1], entry(depth, place))
            overlap, slope = cell.overlapped(level)
            return sums[0] + cell.area * overlap, sums[1] + cell.area * slope

        nothing = jnp.zeros(()), jnp.zeros(())
        touched = loss.touched(jax.lax.stop_gradient(level))
        overlap, slope = through(touched, loss.cells, visit, nothing, False, loss.in_column)
        wanted = loss.volume + loss.load.overlap
        near, level = next_level(level, wanted, overlap, slope)
        return count + 1, jnp.where(near, left - 1, left), level

    first = jnp.zeros((), int), jnp.full((), LAST_STEPS), loss.start(depth)
    return while_loop(lambda now: (now[1] > 0) & (now[0] < MOST_STEPS), turn, first)[2]


def taken_off(shares: Sequence[Share], pressures: Sequence[Depth], depth: Depth) -> Depth:
    """Depth [m] once cells have lost their shares, by their pressures in each."""
    for (touched, scale), pressure in zip(shares, pressures, strict=True):

        def visit(_, place, depth, scale=scale, pressure=pressure):
            return with_entry(depth, place, entry(depth, place) + scale * entry(pressure, place))

        depth = through(touched, depth.shape, visit, depth, True)
    return depth


def through(
    touched: Touched,
    cells: tuple[int, ...],
    visit: Callable[[Any, Place, Any], Any],
    first: Any,
    long: Any = False,
    in_column: Callable[[Array], Any] | None = None,
) -> Any:
    """What `visit` (of what a column's cells share, the place of a cell, and what the visit before
    has left) leaves in the end, once it has been at all cells of a map of so many `cells` that are
    touched. `long` as of `while_loop`."""
    around, along = cells
    # A turn once for all: a remainder of whole numbers costs as much as a cell.
    first_column = touched.first % around

    def one(now):
        count, carry = now
        column = first_column + count
        column = jnp.where(column < around, column, column - around)
        shared = None if in_column is None else in_column(column)
        if along == 1:
            return count + 1, visit(shared, (column, jnp.zeros_like(column)), carry)
        cell = lambda own: (own[0] + 1, visit(shared, (column, touched.lower + own[0]), own[1]))
        begin = jnp.zeros((), int), carry
        return count + 1, while_loop(lambda own: own[0] < touched.rows, cell, begin, (False, long))[
            1
        ]

    begin = jnp.zeros((), int), first
    return while_loop(lambda now: now[0] < touched.columns, one, begin, (False, long))[1]


def entry(array: Array, place: tuple) -> Scalar:
    """That at one place."""
    return jax.lax.dynamic_slice(array, place, (1,) * array.ndim)[(0,) * array.ndim]


def with_entry(array: Array, place: tuple, value: Scalar) -> Array:
    """The array with another value at one place."""
    return jax.lax.dynamic_update_slice(array, jnp.reshape(value, (1,) * array.ndim), place)
