r"""Worn surfaces of cells, and which share of a lost volume each cell gives: its own pressure's.
For machine code a loop goes through the few cells that a contact touches; XLA is left to whole
maps.

A kind of surface (`CylinderMap`, `SphereMap`, `WallMap`) is a metric: where cells lie, how large
they are, and by how much a part overlaps them. All lose by the same `deposit`.

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

import dataclasses
import functools
import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.wear_map import AbstractWearMap
from jaxclear.ground.numerics import (
    arc_sine,
    direction_angle,
    positive_part,
    power,
    safe_divide,
    safe_sqrt,
)
from jaxclear.ground.quantity import Scalar, quantity
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
# Angle [rad] to either side of a contact of the cells that XLA looks at first.
REACH = 0.6

Depth = Float[Array, "around along"]
# Column and row of a cell.
Place = tuple[Int[Array, ""], Int[Array, ""]]


class Contact(NamedTuple):
    """A part that takes a `volume` [m3] off a surface. What its load overlaps on a wall without
    wear: the integrals of that `overlap` [m3] over all of its way, and of its `root` [m2.5] over
    the contact; how deep it would sink into that wall once the volume is lost (`deepest`) [m];
    where it is in the mean, in units of cells (`column`, `row`), and what else the surface's metric
    tells of its `place`."""

    volume: Scalar
    overlap: Scalar
    root: Scalar
    deepest: Scalar
    column: Scalar
    row: Scalar
    place: Any

    @property
    def removed(self) -> Scalar:
        """Volume [m3] after whose loss a pressure shares the whole among cells: V (V/(V+L))^2 with
        L the overlap of the load. A volume that is small beside L leaves the pressure as it is; of
        a large one the wall has the shape of the part when most of it is lost."""
        share = self.volume / (self.volume + self.overlap)
        return self.volume * share * share


class Outline(NamedTuple):
    """How a part at eccentricity e [m] overlaps cells: by e `cosine` - `margin`; `rounding`: half
    the change of that across a cell [m]."""

    cosine: Array | Scalar
    margin: Depth
    rounding: Array | Scalar

    def at(self, level: Scalar) -> tuple[Array, Array]:
        """(mean over each cell of the overlap [m], where there is one; share of the cell where
        there is) at an eccentricity [m]."""
        middle = level * self.cosine - self.margin
        inside = jnp.clip(middle + self.rounding, 0.0, 2.0 * self.rounding)
        share = inside * (0.5 / self.rounding)
        return 0.5 * inside * share + jnp.maximum(middle - self.rounding, 0.0), share


class Patch(NamedTuple):
    """Cells and the part that wears them, which goes through an arc.

    `outline`: of all that it overlaps on its way; `nearest`: when it comes closest to the cells;
    these lie `along` the arc [rad, 0 to pi] from its middle; `half` the arc [rad], with the width
    of a cell; `margin` between the parts [m], centred, on the worn wall; `share` of the pressure
    there that is this contact's; `root`: as of its `Contact`.
    """

    outline: Any
    nearest: Outline
    along: Array
    half: Array
    margin: Depth
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
        fallen = overlap / (overlap + self.margin)
        half_width = 2.0 * arc_sine(safe_sqrt(0.5 * fallen))
        first, last = self.along + self.half, self.along - self.half
        around = first - 2.0 * jnp.pi
        first, last, around = (
            _half_disc_integral(safe_divide(end, half_width)) for end in (first, last, around)
        )
        swept = first - last + around + 0.25 * jnp.pi
        return safe_sqrt(overlap) * half_width * swept / (2.0 * self.half)


@jax.custom_jvp
def _half_disc_integral(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Integral of sqrt(1 - t^2) from 0 to x, which lies within -1 and 1 or is taken so."""
    x = jnp.clip(x, -1.0, 1.0)
    return 0.5 * (x * safe_sqrt(1.0 - x * x) + arc_sine(x))


@_half_disc_integral.defjvp
def _half_disc_integral_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return _half_disc_integral(x), safe_sqrt(1.0 - x * x) * x_dot


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


class AbstractSurface(AbstractWearMap):
    """A surface of which each cell loses what its own pressure takes: columns around, rows along.

    A kind of surface is its metric: the methods that are abstract here."""

    cells: tuple[int, int] = eqx.field(static=True)
    coarseness: Scalar = quantity(
        1.0, "1", "cells that are one, side by side", at_least=1, kw_only=True
    )

    @property
    @abstractmethod
    def extent(self) -> Scalar:
        """Length along of all rows [m], or of a sphere the angle [rad]."""

    @abstractmethod
    def row_area(self, row: Int[Array, "*rows"]) -> Any:
        """Area of a cell of a row [m2], or of several."""

    @abstractmethod
    def cells_per_contact(self, features: Float[Array, " n"], depth: Scalar) -> tuple[Any, ...]:
        """Size of a cell over half of what the contact overlaps in a scar so deep [m], in each
        direction in which cells widen it [1]."""

    @abstractmethod
    def contact(self, volume: Scalar, features: Float[Array, " n"]) -> Contact:
        """The part that takes a volume [m3] off, by the location features of a loss."""

    @abstractmethod
    def start(self, contact: Contact, depth: Depth) -> Scalar:
        """A level [m] of the part to begin with, near the solution and at or above it, where walls
        are worn so deep [m]."""

    @abstractmethod
    def touched(self, contact: Contact, level: Scalar) -> Touched:
        """Cells that the part may overlap at a level [m]."""

    @abstractmethod
    def in_columns(self, contact: Contact, column: Int[Array, "*columns"]) -> Any:
        """What the cells of a column share, or of several."""

    @abstractmethod
    def patch(self, contact: Contact, columns: Any, row: Int[Array, "*rows"], depth: Array) -> Any:
        """Cells that a contact touches, which have `overlapped` and `pressures` as of a `Patch`.

        Args:
            contact: that wears the surface.
            columns: what cells of a column share.
            row: indices of the cells' rows.
            depth: of these cells [m].
        """

    @property
    def side(self) -> Array:
        """Side of a cell, in cells of the arrays of depths: a whole number."""
        return jnp.asarray(self.coarseness).astype(int)

    @property
    def coarse_along(self) -> Scalar:
        """How many rows are one."""
        return self.coarseness if self.cells[1] > 1 else 1.0

    def areas(self):
        return jnp.ones(self.cells) * self.row_area(jnp.arange(self.cells[1]))

    def heights(self) -> Float[Array, " along"]:
        """Where the centre of each cell lies along, from the middle [m, or rad]."""
        return self.extent * ((jnp.arange(self.cells[1]) + 0.5) / self.cells[1] - 0.5)

    def height(self, row: Array) -> Array:
        """The same of the cells of a row, of which several may be one."""
        centre = block_centre(row, self.coarse_along)
        return self.extent * ((centre + 0.5) / self.cells[1] - 0.5)

    def row(self, height: Any) -> Any:
        """A place along, from the middle [m, or rad], in units of cells."""
        return (height / self.extent + 0.5) * self.cells[1] - 0.5

    def over_three(self, depth):
        if not self.flat:
            depth = (jnp.roll(depth, 1, 0) + depth + jnp.roll(depth, -1, 0)) / 3
        wider = jnp.concatenate([depth[:, :1], depth, depth[:, -1:]], axis=1)
        return (wider[:, :-2] + depth + wider[:, 2:]) / 3

    def deepest(self, depth):
        """A parabola through the means of the deepest cell and those beside it, in each direction;
        at an end a straight line. Scars of flat faces have edges, across which none is right: the
        mean of the deepest cell."""
        if self.flat:
            return jnp.max(depth)
        around, along = self.cells
        place = jnp.argmax(depth) // along, jnp.argmax(depth) % along
        here = result = depth[place]
        for axis, ring in ((0, True), (1, False)):
            if self.cells[axis] < 3:
                continue
            index = place[axis] // self.side * self.side
            at = lambda k, axis=axis: depth[(k, place[1]) if axis == 0 else (place[0], k)]
            before, after = index - self.side, index + self.side
            if ring:
                left, right = at(before % around), at(after % around)
            else:
                left, right = at(jnp.maximum(before, 0)), at(jnp.minimum(after, along - 1))
                left = jnp.where(before < 0, 2.0 * here - right, left)
                right = jnp.where(after >= along, 2.0 * here - left, right)
            slope, bend = 0.5 * (right - left), 2.0 * here - left - right
            top = jnp.clip(safe_divide(slope, bend), -0.5, 0.5)
            top = jnp.where(bend > 0, top, 0.5 * jnp.sign(slope))
            result = result + top * (slope - 0.5 * top * bend) + bend / 24.0
        return result

    def deposit(self, depth, volume, features):
        around = self.cells[0]
        reach = math.ceil(REACH * around / (2 * math.pi))
        width = 2 * reach + 1

        def loss_at(columns, part, contact):
            shared = self.in_columns(contact, columns)
            shared = jax.tree.map(lambda each: each[:, None], shared)
            patch = self.patch(contact, shared, jnp.arange(self.cells[1]), part)
            return self.loss(contact, patch, self.start(contact, depth))

        def wide():
            losses = lambda *event: loss_at(jnp.arange(around), depth, self.contact(*event))[0]
            return depth + jnp.sum(jax.vmap(losses)(volume, features), axis=0)

        if width >= around:
            return wide()

        def near(*event):
            contact = self.contact(*event)
            first = jnp.floor(contact.column).astype(int) - reach
            columns = (first + jnp.arange(width)) % around
            loss, level = loss_at(columns, jnp.roll(depth, -first, axis=0)[:width], contact)
            touched = self.touched(contact, level)
            inside = (touched.first >= first) & (touched.columns <= width + first - touched.first)
            spread = jnp.pad(loss, ((0, around - width), (0, 0)))
            return jnp.roll(spread, first, axis=0), inside | (event[0] == 0)

        losses, inside = jax.vmap(near)(volume, features)
        narrow = lambda: depth + jnp.sum(losses, axis=0)
        # A choice of its own for each sample of a batch would be both branches: the wide one, which
        # costs several times as much, is entered where a sample needs it.
        fits = jnp.all(inside)
        rare = lambda: jnp.where(fits, narrow(), wide())
        return jax.lax.cond(eqxi.unvmap_all(fits), narrow, rare)

    def loss(self, contact: Contact, patch: Any, start: Scalar) -> tuple[Depth, Scalar]:
        r"""(depth [m] that each cell loses, eccentricity [m] of the part).

        Depths are proportional to the mean pressure once a part of the volume is lost
        (`Contact.removed`), :math:`\Delta h = (V/S) w m\sqrt{u - \Delta h}` with V that part, u the
        largest overlap on the way before it, w the contact's share, m the mean of the roots over
        the way relative to the largest and S the integral of w times the root of a contact.

        Args:
            contact: with the volume [m3] that it removes.
            patch: its cells (`patch`).
            start: eccentricity [m] at which the iteration begins.
        """
        area = self.areas()[0]

        def closer(target, patch, level):
            # A product with a vector is several times faster than a sum.
            sums = (jnp.sum(cells @ area) for cells in patch.overlapped(level))
            return _improve_level(level, target, *sums)

        target = contact.removed + contact.overlap
        # Held as they are: a loop that ends by itself has no derivative in reverse mode.
        fixed = jax.lax.stop_gradient((target, patch))

        def turn(now):
            count, _, level = now
            return count + 1, *closer(*fixed, level)

        first = jnp.zeros((), int), jnp.zeros((), bool), jax.lax.stop_gradient(start)
        level = jax.lax.while_loop(lambda now: ~now[1] & (now[0] < MOST_STEPS), turn, first)[2]
        for _ in range(LAST_STEPS - 1):
            _, level = closer(target, patch, level)
        pressure = patch.pressures(contact.removed, level)
        return contact.volume * safe_divide(1.0, jnp.sum(pressure @ area)) * pressure, level

    def deposit_in_turn(self, depth, reading, pressures, volume, features):
        events = zip(volume, features, pressures, strict=True)
        shares, pressures = zip(
            *(self._share_cell_by_cell(depth, *event) for event in events), strict=True
        )
        for (touched, scale), pressure in zip(shares, pressures, strict=True):

            def visit(_, place, depth, scale=scale, pressure=pressure):
                return with_entry(
                    depth, place, entry_at(depth, place) + scale * entry_at(pressure, place)
                )

            depth = visit_cells(touched, self.cells, visit, depth, True)
        for touched, _ in shares if reading is not None else ():
            reading = self._read_anew(touched, depth, reading)
        return depth, reading, pressures

    def _read_anew(self, touched: Touched, depth: Array, reading: Any) -> Any:
        """The reading where these cells have changed."""
        visit = lambda _, place, reading: with_entry(reading, place, entry_at(depth, place))
        return visit_cells(touched, self.cells, visit, reading, True)

    def _share_cell_by_cell(
        self, depth: Depth, volume: Scalar, features: Float[Array, " n"], pressure: Depth
    ) -> tuple[tuple[Touched, Scalar], Depth]:
        """((cells that a volume [m3] is taken off, what their pressures are multiplied by [m]),
        those pressures, which are written over others) on walls worn so deep [m]: as `loss`, cell
        by cell."""

        def turn(now):
            contact = self.contact(volume, features)
            level = self._solve_level_cell_by_cell(contact, depth)
            touched = self.touched(contact, jax.lax.stop_gradient(level))

            def visit(column, place, carry):
                total, pressure = carry
                patch = self.patch(contact, column, place[1], entry_at(depth, place))
                result = patch.pressures(contact.removed, level)
                area = self.row_area(place[1])
                return total + area * result, with_entry(pressure, place, result)

            first, shared = (jnp.zeros(()), now[2]), functools.partial(self.in_columns, contact)
            total, after = visit_cells(touched, self.cells, visit, first, (False, True), shared)
            scale = contact.volume * safe_divide(1.0, total)
            return jnp.zeros((), bool), (touched, scale), after

        nothing = Touched.of(0, 0, 0, 0), jnp.zeros(())
        # A loop of one turn or none: without a loss none of this is gone through.
        first = volume != 0, nothing, pressure
        return while_loop(lambda now: now[0], turn, first, (False, False, True))[1:]

    def _solve_level_cell_by_cell(self, contact: Contact, depth: Depth) -> Scalar:
        """Eccentricity [m] of the part once its volume is removed, as `loss` finds it."""
        target = contact.removed + contact.overlap

        def turn(now):
            count, turns, level = now

            def visit(column, place, sums):
                patch = self.patch(contact, column, place[1], entry_at(depth, place))
                area = self.row_area(place[1])
                return tuple(
                    total + area * part
                    for total, part in zip(sums, patch.overlapped(level), strict=True)
                )

            nothing = jnp.zeros(()), jnp.zeros(())
            touched = self.touched(contact, jax.lax.stop_gradient(level))
            shared = functools.partial(self.in_columns, contact)
            sums = visit_cells(touched, self.cells, visit, nothing, False, shared)
            near, level = _improve_level(level, target, *sums)
            return count + 1, jnp.where(near, turns - 1, turns), level

        first = jnp.zeros((), int), jnp.full((), LAST_STEPS), self.start(contact, depth)
        return while_loop(lambda now: (now[1] > 0) & (now[0] < MOST_STEPS), turn, first)[2]


class AbstractRound(AbstractSurface):
    """A surface about an axis or a point, on which cells are apart by angles."""

    # How many of the features are the mean direction.
    axes: ClassVar[int]
    # Which one is a power of the contact's half width, and which [1].
    width: ClassVar[tuple[int, float]]
    radius: eqx.AbstractVar[Scalar]
    clearance: eqx.AbstractVar[Scalar]

    def facing(self, loss, features):
        # Thinner all round, as what turns against its load becomes.
        clearance, (index, exponent) = self.clearance + loss, self.width
        # The square of a half width is inversely as the clearance.
        factors = [1.0] * features.shape[-1]
        factors[index] = power(clearance / self.clearance, jnp.asarray(-0.5 * exponent))
        return dataclasses.replace(self, clearance=clearance), features * jnp.stack(factors)

    @property
    @abstractmethod
    def cell(self) -> Scalar:
        """Angle of a cell [rad], the shorter where it has two."""

    @property
    def thickness(self):
        return self.radius

    def angles(self) -> Float[Array, " around"]:
        """Direction of the centre of each cell around [rad]."""
        return (jnp.arange(self.cells[0]) + 0.5) * (2 * jnp.pi / self.cells[0])

    def column(self, x: Array, y: Array) -> Array:
        """A direction around, in units of cells."""
        return direction_angle(x, y) * (self.cells[0] / (2 * jnp.pi)) - 0.5

    def mean_direction(self, features: Float[Array, " n"]) -> tuple[tuple[Scalar, ...], Scalar]:
        """(that of a loss, its length: 1 where it has stood still)."""
        mean = features[: self.axes]
        length = safe_sqrt(jnp.sum(mean * mean))
        return tuple(safe_divide(each, length) for each in mean), length

    def path(self, features):
        return 2.0 * arc(self.mean_direction(features)[1]) / self.cell

    def square_width(self, indentation: Scalar) -> Scalar:
        """Square of half the width [rad2] of a contact of some indentation [m], which is two cells
        wide at least; the outlines overlap by half the indentation there. Fourth powers add up, so
        that cells hardly widen what they resolve."""
        square, least = positive_part(indentation) / self.clearance, (LEAST_WIDTH * self.cell) ** 2
        return jnp.sqrt(square * square + least * least)

    def square_in_scar(self, widened: Scalar, depth: Scalar) -> Scalar:
        """The same in a scar so deep [m], from that of a contact that is `widened` to cells: an
        elastic contact, and the outline that sinks in."""
        least = (LEAST_WIDTH * self.cell) ** 2
        elastic = safe_sqrt(positive_part(widened * widened - least * least))
        return elastic + 2.0 * depth / self.clearance

    def depth_of(self, square: Scalar) -> Scalar:
        """Overlap [m] of a contact whose half width [rad] has this square; 0 stands for none."""
        return 0.5 * self.clearance * jnp.maximum(square, (LEAST_WIDTH * self.cell) ** 2)

    def least_overlap(self, cell: Scalar) -> tuple[Scalar, Scalar]:
        """(own rounding [m] of a cell of such an angle [rad], what a part's overlap cos + rounding
        sin is at the least where it overlaps one [m])."""
        return 0.5 * cell * self.clearance, (1.0 - SHARPEST) * self.clearance

    def angle_touched(self, level: Scalar, cell: Scalar) -> Scalar:
        """An angle [rad] from the way of a part at a level [m] beyond which it overlaps no cell of
        such an angle [rad]."""
        rounding, needed = self.least_overlap(cell)
        size = jnp.sqrt(level * level + rounding * rounding)
        # That of the largest sum is no more than its tangent, that of the cosine needed / size no
        # more than this.
        sine = safe_sqrt(0.5 * (1.0 - needed / size))
        return rounding / level + 2.0 * sine * (1.0 + (0.5 * jnp.pi - 1.0) * sine * sine)

    def columns_within(self, middle: Scalar, reach: Scalar, all_around: Any) -> tuple[Any, Any]:
        """(index of the first column, number of columns) within a distance of a place, or all.

        Args:
            middle: place around, in units of cells.
            reach: distance to either side, in units of cells.
            all_around: whether all columns count.
        """
        first = -jnp.floor(reach - middle)
        columns = jnp.floor(middle + reach) - first + 1.0
        around = self.cells[0]
        return first, jnp.where(all_around, around, jnp.minimum(columns, around))


def _improve_level(
    level: Scalar, target: Scalar, overlap: Scalar, slope: Scalar
) -> tuple[Array, Scalar]:
    """(whether an overlap [m3] at a level is near that wanted, the next level [m]); `slope` of the
    overlap [m2]. The overlap of all cells is convex in the level, so that there is one solution,
    and from above it every step stays above."""
    missing = target - overlap
    return jnp.abs(missing) <= NEAR * target, level + safe_divide(missing, slope)


def visit_cells(
    touched: Touched,
    cells: tuple[int, ...],
    visit: Callable[[Any, Place, Any], Any],
    first: Any,
    long: Any = False,
    shared_by: Callable[[Array], Any] = lambda column: None,
) -> Any:
    """Visits all touched cells of a map, one after the other; returns what the last visit returns.

    Args:
        touched: range of columns and rows.
        cells: numbers of cells of the map, around and along.
        visit: function of what a column's cells share, the cell's (column, row), and the last
            result.
        first: in the place of a result, for the first visit.
        long: as of `while_loop`, for `first`.
        shared_by: function of a column that computes what its cells share; default: None.
    """
    around, along = cells
    # A turn once for all: a remainder of whole numbers costs as much as a cell.
    first_column = touched.first % around

    def visit_column(now):
        count, carry = now
        column = first_column + count
        column = jnp.where(column < around, column, column - around)
        shared = shared_by(column)
        if along == 1:
            return count + 1, visit(shared, (column, jnp.zeros_like(column)), carry)
        cell = lambda now: (now[0] + 1, visit(shared, (column, touched.lower + now[0]), now[1]))
        begin, inside = (jnp.zeros((), int), carry), lambda now: now[0] < touched.rows
        return count + 1, while_loop(inside, cell, begin, (False, long))[1]

    begin, inside = (jnp.zeros((), int), first), lambda now: now[0] < touched.columns
    return while_loop(inside, visit_column, begin, (False, long))[1]


def entry_at(array: Array, place: tuple) -> Scalar:
    """That at one place."""
    return jax.lax.dynamic_slice(array, place, (1,) * array.ndim)[(0,) * array.ndim]


def with_entry(array: Array, place: tuple, value: Scalar) -> Array:
    """The array with one entry replaced.

    Args:
        array: of any rank.
        place: index along each axis; may be traced.
        value: new entry.
    """
    return jax.lax.dynamic_update_slice(array, jnp.reshape(value, (1,) * array.ndim), place)


def block_centre(index: Array, side: Scalar) -> Array:
    """Where the centre of the block of an index lies, in units of cells, if so many cells side by
    side are one."""
    return jnp.floor(index * (1.0 / side)) * side + 0.5 * (side - 1.0)


def half_steps(columns: int) -> Float[np.ndarray, "steps 2"]:
    """Direction (x, y) of the centre of each of so many columns around, and of the edge behind."""
    angles = (0.5 * np.arange(2 * columns) + 0.5) * (2 * np.pi / columns)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def block_row(table: Float[np.ndarray, "n m"], index: Int[Array, "*rows"], side: Scalar) -> Any:
    """Columns of a table at the centre of a block of cells.

    Args:
        table: tabulated by half cells, shape (2 cells, m).
        index: of the block, or of several.
        side: cells along one side of a block.
    """
    centre = (2.0 * block_centre(index, side)).astype(int)
    rows = table_rows(table, centre)
    return tuple(rows[..., k] for k in range(table.shape[1]))


def table_rows(table: Float[np.ndarray, "n m"], index: Int[Array, "*rows"]) -> Array:
    """Rows of a table, one or several."""
    if index.ndim:
        return jnp.asarray(table)[index]
    return jax.lax.dynamic_slice(table, (index, 0), (1, table.shape[1]))[0]


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


def edge_depth(last: Array, inside: Array) -> Array:
    """Depth [m] at the edge of a last cell, beside that of the one further inside."""
    return last + 0.5 * positive_part(last - inside)


def spline(place: Scalar, left: Scalar, here: Scalar, right: Scalar) -> Scalar:
    """Value of a quadratic B-spline.

    Args:
        place: distance from the nearest of three knots, in cells, -0.5 to 0.5.
        left, here, right: coefficients at the knots; `here` is the nearest.
    """
    curvature = 0.5 * (left + right) - here
    return 0.125 * (left + 6.0 * here + right) + place * (0.5 * (right - left) + place * curvature)
