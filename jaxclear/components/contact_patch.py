r"""Which share of a lost volume each cell of a worn surface gives: its own pressure's. For machine
code a loop goes through the few cells that a contact touches; XLA is left to whole maps.

Where the rigid outlines of the parts, worn as they are, would overlap by u, the pressure goes with
:math:`\sqrt u`. On a surface without wear this is Hertz's pressure, of lines as of points; the
depth of the overlap is half the indentation, which gives Hertz's contact area for points, and for
lines to about a quarter of its width. On a worn surface the pressure spreads as the wall conforms.
Source: Hertz 1882, doi:10.1515/crll.1882.92.156; virtual interpenetration for other shapes as in
Piotrowski & Kik 2008, Vehicle Syst. Dyn. 46, 27.

A contact that moves while it wears leaves to each cell the mean of its pressures there over the arc
of its way: arcs that follow upon each other add up to the whole, however many they are. The
pressure is that after the loss, so a loss brings the wall at most to the shape of the part that has
cut it. Where a contact is narrower than two cells, the loss is that of one as wide as these.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.ground.numerics import arc_sine, positive_part, power, safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.native import while_loop

# The level of a part is sought by Newton's method until the overlap is within this share of that
# wanted; so many steps, that one and those after it, then bring it, and its derivatives, to
# rounding. Volumes grow with a power of 1 to 2.5 of how deep a part sinks, so a step loses at least
# 2/5 of what is too much: from anywhere these are enough.
NEAR, LAST_STEPS, MOST_STEPS = 0.03, 3, 60
# Half of the least width [cells] of a contact: narrower ones jump from cell to cell.
LEAST_WIDTH = 1.0
# Width of a kink, relative to the clearance, where nothing else rounds it.
SHARPEST = 1e-9
# Share of its own pressure that is added to the mean over the way, so that some cell has one.
LEAST_SHARE = 1e-6

Depth = Float[Array, "around along"]
# Column and row of a cell.
Place = tuple[Int[Array, ""], Int[Array, ""]]


class Elasticity(NamedTuple):
    """What the load of a contact overlaps on a wall without wear: `depth` [m], and the integrals of
    the overlap [m3] over all of its way and of its root [m2.5] over the contact."""

    depth: Scalar
    overlap: Scalar
    root: Scalar


class Outline(NamedTuple):
    """How a part at eccentricity e [m] overlaps cells: by e `cosine` - `room`; `rounding`: half the
    change of that across a cell [m]."""

    cosine: Array | Scalar
    room: Depth
    rounding: Array | Scalar

    def at(self, level: Scalar) -> tuple[Array, Array]:
        """(mean over each cell of the overlap [m], where there is one; share of the cell where
        there is) at an eccentricity [m]."""
        middle = level * self.cosine - self.room
        inside = jnp.clip(middle + self.rounding, 0.0, 2.0 * self.rounding)
        share = inside * (0.5 / self.rounding)
        return 0.5 * inside * share + jnp.maximum(middle - self.rounding, 0.0), share


class Patch(NamedTuple):
    """Cells and the part that wears them, which goes through an arc.

    `outline`: of all that it overlaps on its way; `nearest`: when it comes closest to the cells;
    these lie `along` the arc [rad, 0 to pi] from its middle; `half` the arc [rad], with the width
    of a cell; `room` between the parts [m], centred, on the worn wall; `share` of the pressure
    there that is this contact's; `root`: as of its `Elasticity`.
    """

    outline: Any
    nearest: Outline
    along: Array
    half: Array
    room: Depth
    share: Array | Scalar
    root: Scalar

    def overlapped(self, level: Scalar) -> tuple[Array, Array]:
        """(mean over each cell of the overlap [m], its slope by the level) at an eccentricity
        [m]."""
        overlap, share = self.outline.at(level)
        return overlap, self.outline.cosine * share

    def pressures(self, volume: Scalar, level: Scalar) -> Array:
        """What each cell loses of a volume [m3], relative to the others, where the part that wears
        them has come to a level [m]."""
        overlap = self.outline.at(level)[0]
        mean = self.share * (self._mean_root(level) + LEAST_SHARE * safe_sqrt(overlap))
        ratio, full = volume * mean, 2.0 * self.root * overlap
        return safe_divide(mean * overlap, ratio + safe_sqrt(ratio * ratio + full * full))

    def _mean_root(self, level: Scalar) -> Array:
        """Mean over the way, and over each cell, of the root of the overlap [m0.5]: as the contact
        passes a cell, the overlap there is a parabola of the angle between both."""
        overlap = self.nearest.at(level)[0]
        # An overlap e - room that falls as e cos does vanishes where 1 - cos is this.
        fallen = overlap / (overlap + self.room)
        half_width = 2.0 * arc_sine(safe_sqrt(0.5 * fallen))
        first, last = self.along + self.half, self.along - self.half
        around = first - 2.0 * jnp.pi
        first, last, around = (
            _segment(safe_divide(end, half_width)) for end in (first, last, around)
        )
        swept = first - last + around + 0.25 * jnp.pi
        return safe_sqrt(overlap) * half_width * swept / (2.0 * self.half)


@jax.custom_jvp
def _segment(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Integral of sqrt(1 - t^2) from 0 to x, which lies within -1 and 1 or is taken so."""
    x = jnp.clip(x, -1.0, 1.0)
    return 0.5 * (x * safe_sqrt(1.0 - x * x) + arc_sine(x))


@_segment.defjvp
def _segment_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return _segment(x), safe_sqrt(1.0 - x * x) * x_dot


class Touched(NamedTuple):
    """Cells that a part may overlap: from a `first` column (of any turn) so many `columns`, each at
    most once, and in each from a `lower` row so many `rows`."""

    first: Int[Array, ""]
    columns: Int[Array, ""]
    lower: Int[Array, ""]
    rows: Int[Array, ""]

    @classmethod
    def of(cls, *counts: Any) -> "Touched":
        """From whole numbers of any type."""
        return cls(*(jnp.asarray(n).astype(int) for n in counts))


class Contact(Protocol):
    """A part that takes a `volume` [m3] off a `surface` under a `load`."""

    @property
    def surface(self) -> Any: ...

    @property
    def volume(self) -> Scalar: ...

    @property
    def load(self) -> Elasticity: ...

    def start(self, depth: Depth) -> Scalar:
        """A level [m] of the part to begin with, near the solution and at or above it, where walls
        are worn so deep [m]."""

    def touched(self, level: Scalar) -> Touched:
        """Cells that the part may overlap at a level [m]."""

    def in_columns(self, column: Int[Array, "*columns"]) -> Any:
        """What the cells of a column share, or of several."""

    def patch(self, columns: Any, row: Int[Array, "*rows"], depth: Array) -> Any:
        """Cells worn so deep [m], which have `overlapped` and `pressures` as of a `Patch`."""


def depth_loss(contact: Contact, patch: Any, start: Scalar) -> tuple[Depth, Scalar]:
    r"""(depth [m] that each cell loses, eccentricity [m] of the part, sought from a `start` [m]).
    Depths are in proportion to the mean
    pressure once a part of the volume is lost (`volume_before_pressure`),
    :math:`\Delta h = (V/S) w m\sqrt{u - \Delta h}` with V that part, u the largest overlap on the
    way before it, w the contact's share, m the mean of the roots over the way beside the largest
    and S the integral of w times the root of a contact.
    """
    removed = volume_before_pressure(contact.volume, contact.load)
    area = contact.surface.areas()[0]

    def closer(target, patch, level):
        # A product with a vector is several times faster than a sum.
        sums = (jnp.sum(cells @ area) for cells in patch.overlapped(level))
        return next_level(level, target, *sums)

    target = removed + contact.load.overlap
    # Held as they are: a loop that ends by itself has no derivative in reverse mode.
    fixed = jax.lax.stop_gradient((target, patch))

    def turn(now):
        count, _, level = now
        return count + 1, *closer(*fixed, level)

    first = jnp.zeros((), int), jnp.zeros((), bool), jax.lax.stop_gradient(start)
    level = jax.lax.while_loop(lambda now: ~now[1] & (now[0] < MOST_STEPS), turn, first)[2]
    for _ in range(LAST_STEPS - 1):
        _, level = closer(target, patch, level)
    pressure = patch.pressures(removed, level)
    return contact.volume * safe_divide(1.0, jnp.sum(pressure @ area)) * pressure, level


def volume_before_pressure(volume: Scalar, load: Elasticity) -> Scalar:
    """Volume [m3] after whose loss a pressure shares the whole `volume` among cells: V (V/(V+L))^2
    with L the overlap of the load. A volume that is small beside L leaves the pressure as it is; of
    a large one the wall has the shape of the part when most of it is lost."""
    share = volume / (volume + load.overlap)
    return volume * share * share


def next_level(
    level: Scalar, target: Scalar, overlap: Scalar, slope: Scalar
) -> tuple[Array, Scalar]:
    """(whether an overlap [m3] at a level is near that wanted, the next level [m]); `slope` of the
    overlap [m2]. The overlap of all cells is convex in the level, so that there is one solution,
    and from above it every step stays above."""
    missing = target - overlap
    return jnp.abs(missing) <= NEAR * target, level + safe_divide(missing, slope)


class Share(NamedTuple):
    """Which cells a loss is taken off, and what a cell's pressure is multiplied by [m]."""

    touched: Touched
    scale: Scalar


def find_share(
    contact_of: Callable[[], Contact], volume: Scalar, depth: Depth, pressure: Depth
) -> tuple[Share, Depth]:
    """(the `Share` of a loss of a volume [m3] on walls worn so deep [m], the pressures of its
    cells, which are written over others): cell by cell, for a kernel."""

    def turn(now):
        contact = contact_of()
        removed = volume_before_pressure(contact.volume, contact.load)
        level = _find_level(contact, removed, depth)
        touched = contact.touched(jax.lax.stop_gradient(level))

        def visit(column, place, carry):
            total, pressure = carry
            patch = contact.patch(column, place[1], entry(depth, place))
            result = patch.pressures(removed, level)
            area = contact.surface.row_area(place[1])
            return total + area * result, with_entry(pressure, place, result)

        first = jnp.zeros(()), now[2]
        total, after = through(touched, depth.shape, visit, first, (False, True), contact)
        scale = contact.volume * safe_divide(1.0, total)
        return jnp.zeros((), bool), Share(touched, scale), after

    nothing = Share(Touched.of(0, 0, 0, 0), jnp.zeros(()))
    # A loop of one turn or none: without a loss none of this is gone through.
    first = volume != 0, nothing, pressure
    return while_loop(lambda now: now[0], turn, first, (False, False, True))[1:]


def _find_level(contact: Contact, removed: Scalar, depth: Depth) -> Scalar:
    """Eccentricity [m] of the part once a volume [m3] is removed, as `depth_loss` finds it."""

    def turn(now):
        count, turns_left, level = now

        def visit(column, place, sums):
            patch = contact.patch(column, place[1], entry(depth, place))
            overlap, slope = patch.overlapped(level)
            area = contact.surface.row_area(place[1])
            return sums[0] + area * overlap, sums[1] + area * slope

        nothing = jnp.zeros(()), jnp.zeros(())
        touched = contact.touched(jax.lax.stop_gradient(level))
        sums = through(touched, depth.shape, visit, nothing, False, contact)
        near, level = next_level(level, removed + contact.load.overlap, *sums)
        return count + 1, jnp.where(near, turns_left - 1, turns_left), level

    first = jnp.zeros((), int), jnp.full((), LAST_STEPS), contact.start(depth)
    return while_loop(lambda now: (now[1] > 0) & (now[0] < MOST_STEPS), turn, first)[2]


def through(
    touched: Touched,
    cells: tuple[int, ...],
    visit: Callable[[Any, Place, Any], Any],
    first: Any,
    long: Any = False,
    contact: Any = None,
) -> Any:
    """What `visit` (of what a column's cells share by a `contact`, the place of a cell, and what
    the visit before has left) leaves in the end, once it has been at all cells of a map of so many
    `cells` that are touched. `long` as of `while_loop`."""
    around, along = cells
    # A turn once for all: a remainder of whole numbers costs as much as a cell.
    first_column = touched.first % around

    def visit_column(now):
        count, carry = now
        column = first_column + count
        column = jnp.where(column < around, column, column - around)
        shared = None if contact is None else contact.in_columns(column)
        if along == 1:
            return count + 1, visit(shared, (column, jnp.zeros_like(column)), carry)
        cell = lambda now: (now[0] + 1, visit(shared, (column, touched.lower + now[0]), now[1]))
        begin, inside = (jnp.zeros((), int), carry), lambda now: now[0] < touched.rows
        return count + 1, while_loop(inside, cell, begin, (False, long))[1]

    begin, inside = (jnp.zeros((), int), first), lambda now: now[0] < touched.columns
    return while_loop(inside, visit_column, begin, (False, long))[1]


def entry(array: Array, place: tuple) -> Scalar:
    """That at one place."""
    return jax.lax.dynamic_slice(array, place, (1,) * array.ndim)[(0,) * array.ndim]


def with_entry(array: Array, place: tuple, value: Scalar) -> Array:
    """The array with another value at one place."""
    return jax.lax.dynamic_update_slice(array, jnp.reshape(value, (1,) * array.ndim), place)


def block_centre(index: Array, side: Scalar) -> Array:
    """Where the centre of the block of an index lies, in units of cells, if so many cells side by
    side are one."""
    return jnp.floor(index * (1.0 / side)) * side + 0.5 * (side - 1.0)


def table_rows(table: Float[np.ndarray, "n m"], index: Int[Array, "*rows"]) -> Array:
    """Rows of a table, one or several."""
    if index.ndim:
        return jnp.asarray(table)[index]
    return jax.lax.dynamic_slice(table, (index, 0), (1, table.shape[1]))[0]


def line_contact(
    depth: Scalar, radius: Scalar, clearance: Scalar, length: Scalar, half_arc: Scalar
) -> Elasticity:
    """A journal that overlaps its bearing so deep along so long a line [m], while the line goes
    through an arc."""
    half_width = safe_sqrt(2.0 * depth / clearance)
    area = radius * length
    overlap = 4 / 3 * area * depth * (half_width + 1.5 * half_arc)
    root = 0.5 * jnp.pi * area * safe_sqrt(depth) * half_width
    return Elasticity(depth, overlap, root)


def point_contact(depth: Scalar, radius: Scalar, clearance: Scalar, half_arc: Scalar) -> Elasticity:
    """A ball that overlaps its socket so deep [m], while the point goes through an arc."""
    half_width = safe_sqrt(2.0 * depth / clearance)
    area = radius * radius * half_width
    overlap = area * depth * (0.5 * jnp.pi * half_width + 8 / 3 * half_arc)
    root = 2 / 3 * jnp.pi * area * safe_sqrt(depth) * half_width
    return Elasticity(depth, overlap, root)


def line_depth(
    volume: Scalar, radius: Scalar, clearance: Scalar, length: Scalar, fall: Scalar
) -> Scalar:
    """How deep [m] a journal sinks into an unworn bearing that overlaps it by a volume [m3], or a
    little less; `fall` of the overlap over the length [m]."""
    parallel = volume / (4 / 3 * radius * length * safe_sqrt(2.0 / clearance))
    return jnp.maximum(jnp.cbrt(parallel) ** 2, power(2.5 * fall * parallel, jnp.asarray(0.4)))


def point_depth(volume: Scalar, radius: Scalar, clearance: Scalar) -> Scalar:
    """How deep [m] a ball sinks into an unworn socket that overlaps it by a volume [m3]."""
    return safe_sqrt(volume * clearance / jnp.pi) / radius


def square_width(indentation: Scalar, cell: Scalar, clearance: Scalar) -> Scalar:
    """Square of half the width [rad2] of a contact of some indentation [m], which is two cells wide
    at least (`cell`: angle of one [rad]); the outlines overlap by half the indentation there.
    Fourth powers add up, so that cells hardly widen what they resolve."""
    square, least = positive_part(indentation) / clearance, (LEAST_WIDTH * cell) ** 2
    return jnp.sqrt(square * square + least * least)


def contact_square(widened: Scalar, cell: Scalar, depth: Scalar, clearance: Scalar) -> Scalar:
    """Square of half the width [rad2] of a contact in a scar so deep [m], from that of one that is
    `widened` to cells (`square_width`): an elastic contact, and the outline that sinks in."""
    least = (LEAST_WIDTH * cell) ** 2
    elastic = safe_sqrt(positive_part(widened * widened - least * least))
    return elastic + 2.0 * depth / clearance


def depth_of(square: Scalar, cell: Scalar, clearance: Scalar) -> Scalar:
    """Overlap [m] of a contact whose half width [rad] has this square; 0 stands for none."""
    return 0.5 * clearance * jnp.maximum(square, (LEAST_WIDTH * cell) ** 2)


def arc_with_cell(half_arc: Scalar, cell: Array | Scalar) -> Array:
    """Half of an arc [rad] over which, and over cells of this angle [rad], a mean is taken: as two
    spreads add up."""
    return jnp.sqrt(half_arc * half_arc + 0.25 * cell * cell)


def arc(length: Scalar) -> Scalar:
    """Half the arc a [rad] over which unit vectors are spread evenly whose mean has this length,
    sin(a)/a; within 1 %."""
    missing = 1.0 - length
    square = missing * (6.0 + missing * (1.8 + missing * (jnp.pi**2 - 7.8)))
    return safe_sqrt(square)


def least_overlap(cell: Scalar, clearance: Scalar) -> tuple[Scalar, Scalar]:
    """(a cell's own rounding [m], what a part's overlap cos + rounding sin is at the least where it
    overlaps one [m]) of cells of such an angle [rad]."""
    return 0.5 * cell * clearance, (1.0 - SHARPEST) * clearance


def angle_touched(level: Scalar, cell: Scalar, clearance: Scalar) -> Scalar:
    """An angle [rad] from a way of a part at a level [m] beyond which it overlaps no cell."""
    rounding, needed = least_overlap(cell, clearance)
    size = jnp.sqrt(level * level + rounding * rounding)
    # That of the largest sum is no more than its tangent, that of the cosine needed / size no more
    # than this.
    sine = safe_sqrt(0.5 * (1.0 - needed / size))
    return rounding / level + 2.0 * sine * (1.0 + (0.5 * jnp.pi - 1.0) * sine * sine)
