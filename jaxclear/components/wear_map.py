"""Where material is lost: worn depth on a cylinder (theta x z), with which of its cells a loss may
overlap; and one depth where parts without a gap wear into each other.

Every cell loses what its own pressure takes, which follows from its own gap on the worn surface
(`contact_patch`): on a cylinder also along the tilted journal. Volume is conserved to rounding, and
depth is a smooth function of where and how much. What is lost between two updates is spread over
the arc that the contact has gone through. Quadratic B-splines read the depth back when the worn
surface enters the gap.
"""

import functools
import math
from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.contact_patch import (
    SHARPEST,
    Elasticity,
    Outline,
    Patch,
    Touched,
    angle_touched,
    arc,
    arc_with_cell,
    block_centre,
    contact_square,
    depth_loss,
    depth_of,
    entry,
    find_share,
    least_overlap,
    line_contact,
    line_depth,
    square_width,
    table_rows,
    through,
    with_entry,
)
from jaxclear.ground.numerics import (
    OFF_THE_TIES,
    direction_angle,
    positive_part,
    safe_divide,
    safe_sqrt,
)
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete, count, quantity
from jaxclear.laws.wear import AbstractWearLaw

# Angle [rad] to either side of a contact of the cells that XLA looks at first.
REACH = 0.6


class Wearing(AbstractQuantified):
    """A surface that wears.

    The surface is updated whenever a contact has moved by half a cell, and at the saving times;
    companion runs halve that path, and another one has cells twice as wide, so that errors of both
    are part of the estimate. A scar narrower than
    a few cells has too small a depth, and the run says so; the tilted journal of a `JournalBearing`
    takes some hundred along. A run whose steps are counted (`steps_per_save`) updates the surface
    at each saving time.

    Args:
        law: wear law of this surface alone, one of `jaxclear.wear`.
        cells: number of cells around and along, 2 counts, at least 4 and 1: azimuth and elevation
            on a sphere; of a guide and its slider only the number along is used.
        acceleration: factor of the worn volume [1], >= 0: one simulated cycle stands for so many
            (linear extrapolation, as in cycle-jump schemes).
        worn_radius: whether what the contact law takes from the geometry, such as its stiffness,
            follows the radius as worn at the contact, not as made.
        updates: largest number of updates of the surface in a run, a count, >= 1; None: no bound.
            With a bound a depth may be wrong by more than the estimate.
        coarseness: number of cells side by side that are one [1], >= 1, <= 2: either 1 or 2, which
            companion runs take.

    Raises:
        ValueError: for fewer than 4 cells around or 1 along, or another coarseness.
    """

    law: AbstractWearLaw
    cells: tuple[int, int] = eqx.field(
        static=True,
        default=(288, 20),
        converter=lambda value: tuple(value) if isinstance(value, list) else value,
        metadata={"wanted": "2 whole numbers: cells around and along"},
    )
    acceleration: Scalar = quantity(1.0, "1", at_least=0)
    worn_radius: bool = eqx.field(static=True, default=False, kw_only=True)
    updates: int | None = count(None, kw_only=True)
    coarseness: Scalar = quantity(1.0, "1", at_least=1, at_most=2, kw_only=True)

    def __check_init__(self):
        if self.cells[0] < 4 or self.cells[1] < 1:
            raise ValueError(
                f"a wear map must have at least 4 cells around and 1 along, not {self.cells}."
            )
        if concrete(self.coarseness) not in (None, 1.0, 2.0):
            raise ValueError(f"coarseness of a Wearing must be 1 or 2, not {self.coarseness:g}.")


def mean_along(depth: Float[Array, "around along"]) -> Float[Array, "around along"]:
    """Mean depth over each cell and those before and after it, along."""
    wider = jnp.concatenate([depth[:, :1], depth, depth[:, -1:]], axis=1)
    return (wider[:, :-2] + depth + wider[:, 2:]) / 3


class AbstractWearMap(AbstractQuantified):
    """Geometry of a wear map; the depth itself is an array (cells) [m] kept by the simulation."""

    cells: eqx.AbstractVar[tuple[int, int]]

    @property
    def flat(self) -> bool:
        """Whether it is that of flat walls, which a part can leave: locations are then no numbers,
        and the run ends. It is not unless overridden."""
        return False

    @property
    def thickness(self) -> Any:
        """Depth [m] at which nothing is left of what wears, as of a journal worn to its middle;
        infinite where that is not known."""
        return math.inf

    @abstractmethod
    def areas(self) -> Float[Array, "around along"]:
        """Area of each cell [m2]."""

    def path(self, features: Float[Array, " n"]) -> Any:
        """How far a contact has moved in an event.

        Args:
            features: location features of the event, an array (n,).

        Returns:
            the path [cells].
        """
        return 0.0

    def over_three(self, depth: Float[Array, "around along"]) -> Float[Array, "around along"]:
        """Mean depth over each cell and its neighbours, three to a side; beyond the last row the
        depth is that of the row.

        Args:
            depth: worn depth of each cell [m], an array (around, along).

        Returns:
            the means [m], an array (around, along).
        """
        around = (jnp.roll(depth, 1, 0) + depth + jnp.roll(depth, -1, 0)) / 3
        return mean_along(around)

    def deepest(self, depth: Float[Array, "around along"]) -> Array:
        """Depth of the deepest place, from the mean depths of the cells.

        Args:
            depth: mean worn depth of each cell [m], an array (around, along).

        Returns:
            the depth [m].
        """
        return jnp.max(depth)

    @abstractmethod
    def reading(self, depth):
        """The depth in the form in which the gap reads it, made once for as long as the depth does
        not change.

        Args:
            depth: worn depth of each cell [m], an array (around, along).

        Returns:
            an array, for the methods that read the depth.
        """

    @abstractmethod
    def deposit(self, depth, volume, features):
        """Depth after a loss.

        Args:
            depth: worn depth of each cell before [m], an array (around, along).
            volume: volume lost in each event [m^3], an array (events,).
            features: location features of each event, an array (events, n): means weighted by what
                was lost there.

        Returns:
            worn depth of each cell [m], an array (around, along).
        """

    def deposit_in_turn(self, depth, reading, pressures, volume, features):
        """The same within a kernel: cell by cell where there are many, and only those that are
        touched.

        Args:
            depth: worn depth of each cell before [m], an array (around, along).
            reading: the form in which the gap reads the depth, an array; None where no gap reads
                it.
            pressures: workspace, an array like the depth for each event, which is overwritten.
            volume: volume lost in each event [m^3], an array (events,).
            features: location features of each event, an array (events, n).

        Returns:
            the depth, its reading, and the workspace, a tuple.
        """
        depth = self.deposit(depth, volume, features)
        return depth, None if reading is None else self.reading(depth), pressures


class AbstractSurface(AbstractWearMap):
    """A surface of which each cell loses what its own pressure takes. A kind of surface gives the
    area of its cells, how gaps read it and the `contact` that takes a loss off."""

    @abstractmethod
    def contact(self, volume: Scalar, features: Float[Array, " n"]) -> Any:
        """The part that takes a volume [m3] off, by the location features of a loss: a `Contact`,
        the surface of which is this."""

    coarseness: eqx.AbstractVar[Scalar]

    @abstractmethod
    def cells_per_contact(self, features: Float[Array, " n"], depth: Scalar) -> tuple[Any, ...]:
        """Size of a cell over half of what the contact overlaps in a scar so deep [m], in each
        direction in which cells widen it [1]."""

    @property
    def side(self) -> Array:
        """Side of a cell, in cells of the arrays of depths: a whole number."""
        return jnp.asarray(self.coarseness).astype(int)

    @property
    def coarse_along(self) -> Scalar:
        """How many rows are one."""
        return self.coarseness if self.cells[1] > 1 else 1.0

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

    @abstractmethod
    def row_area(self, row: Int[Array, "*rows"]) -> Any:
        """Area of a cell of a row [m2], or of several."""

    def areas(self):
        return jnp.ones(self.cells) * self.row_area(jnp.arange(self.cells[1]))

    def reading(self, depth):
        return depth

    def deposit(self, depth, volume, features):
        around = self.cells[0]
        reach = math.ceil(REACH * around / (2 * math.pi))
        width = 2 * reach + 1

        def wide():
            columns = jnp.arange(around)
            losses = jax.vmap(lambda *event: self._lost(columns, depth, depth, *event)[0])
            return depth + jnp.sum(losses(volume, features), axis=0)

        if width >= around:
            return wide()

        def near(*event):
            first = jnp.floor(self.contact(*event).middle).astype(int) - reach
            columns = (first + jnp.arange(width)) % around
            rolled = jnp.roll(depth, -first, axis=0)[:width]
            loss, touched = self._lost(columns, rolled, depth, *event)
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

    def _lost(self, columns, depth, all_depth, volume, features):
        """(what each cell of some columns, worn so deep [m], loses in an event [m], which cells of
        all the contact may overlap)."""
        contact = self.contact(volume, features)
        shared = jax.tree.map(lambda each: each[:, None], contact.in_columns(columns))
        patch = contact.patch(shared, jnp.arange(self.cells[1]), depth)
        loss, level = depth_loss(contact, patch, contact.start(all_depth))
        return loss, contact.touched(level)

    def deposit_in_turn(self, depth, reading, pressures, volume, features):
        results = [
            find_share(functools.partial(self.contact, *event), event[0], depth, pressure)
            for pressure, *event in zip(pressures, volume, features, strict=True)
        ]
        shares, pressures = zip(*results, strict=True)
        for (touched, scale), pressure in zip(shares, pressures, strict=True):

            def visit(_, place, depth, scale=scale, pressure=pressure):
                return with_entry(
                    depth, place, entry(depth, place) + scale * entry(pressure, place)
                )

            depth = through(touched, self.cells, visit, depth, True)
        for touched, _ in shares if reading is not None else ():
            reading = self._read_anew(touched, depth, reading)
        return depth, reading, pressures

    def _read_anew(self, touched: Touched, depth: Array, reading: Any) -> Any:
        """The reading where these cells have changed."""
        visit = lambda _, place, reading: with_entry(reading, place, entry(depth, place))
        return through(touched, self.cells, visit, reading, True)


class Column(NamedTuple):
    """Angle between a column and the middle of an arc [rad, 0 to pi]; cosine and size of the sine
    of that between it and the arc; without a direction all columns are in it."""

    along: Array
    cosine: Array
    sine: Array


class LineContact(NamedTuple):
    """A journal that takes a volume [m3] off the wall of a `surface`. It comes closest `towards` a
    direction, which `middle` says in units of columns, goes through an arc of half that angle [rad]
    about it (with cosine and sine, `turned`), and overlaps by `fall` [m] less at the other `end`;
    that by which the overlap falls over half a cell at most (`steepest`) [m]; its `load` before
    anything is lost, and how deep it would sink into an unworn wall (`sunk`) [m]."""

    surface: "CylinderMap"
    volume: Scalar
    towards: tuple[Scalar, Scalar]
    middle: Scalar
    half_arc: Scalar
    turned: tuple[Scalar, Scalar]
    fall: Scalar
    end: Scalar
    steepest: Scalar
    load: Elasticity
    sunk: Scalar

    def in_columns(self, column: Int[Array, "*columns"]) -> Column:
        direction = table_rows(half_steps(self.surface.cells[0]), self.surface.centre(column))
        x, y = direction[..., 0], direction[..., 1]
        towards, (c, s) = self.towards, self.turned
        cosine = x * towards[0] + y * towards[1]
        sine = jnp.abs(x * towards[1] - y * towards[0])
        inside = cosine >= c
        return Column(
            direction_angle(cosine, sine),
            jnp.where(inside, 1.0, cosine * c + sine * s),
            jnp.where(inside, 0.0, sine * c - cosine * s),
        )

    def patch(self, columns: Column, row: Array, depth: Array) -> Patch:
        surface, clearance = self.surface, self.surface.clearance
        away = 0.5 * jnp.abs(self.end) - self.end * surface.height(row) / surface.length
        rounding = (
            0.5 * surface.cell * clearance * columns.sine
            + self.steepest * jnp.abs(columns.cosine)
            + SHARPEST * clearance
        )
        space, fallen = clearance + depth, self.fall * away
        outline = Outline(columns.cosine, space + fallen * columns.cosine, rounding)
        nearest = Outline(1.0, space + fallen, self.steepest + SHARPEST * clearance)
        half = arc_with_cell(self.half_arc, surface.cell)
        return Patch(outline, nearest, columns.along, half, space, 1.0 - away, self.load.root)

    def start(self, depth: Float[Array, "around along"]) -> Scalar:
        # At the end that carries.
        around, along = self.surface.cells
        row = jnp.where(self.end > 0, along - 1, 0)
        edge = entry(depth, (self.nearest.astype(int) % around, row))
        return self.surface.clearance + edge + self.sunk

    def reach(self, level: Scalar) -> Scalar:
        """Angle [rad] to either side beyond which the part overlaps no cell at a level [m]."""
        most = level + positive_part(-self.fall) + self.steepest
        return self.half_arc + angle_touched(most, self.surface.cell, self.surface.clearance)

    @property
    def nearest(self) -> Scalar:
        """The first column in the arc, or the nearest to it."""
        half_arc = self.half_arc / self.surface.pitch
        first = -jnp.floor(half_arc - self.middle)
        # Between two columns either rounding must choose the same.
        nearest = jnp.floor(self.middle + (OFF_THE_TIES - 0.5))
        return jnp.where(first <= self.middle + half_arc, first, nearest)

    def touched(self, level: Scalar) -> Touched:
        surface, (around, along) = self.surface, self.surface.cells
        wider = surface.coarseness - 1.0
        reach, middle = self.reach(level) / surface.pitch + 0.5 * wider, self.middle
        first = -jnp.floor(reach - middle)
        nowhere = self.towards[0] ** 2 + self.towards[1] ** 2 < 0.5
        everywhere = nowhere | (2.0 * reach + 1.0 >= around)
        columns = jnp.where(everywhere, around, jnp.floor(middle + reach) - first + 1.0)
        # A row is overlapped, if at all, where level cos + rounding sin is as much as is needed.
        rounding, needed = least_overlap(surface.cell, surface.clearance)
        lowest = jnp.sqrt(needed * needed - rounding * rounding)
        share = (level + self.steepest - lowest) / jnp.where(self.fall > 0, self.fall, jnp.inf)
        tilted = (self.fall > 0) & (jnp.abs(self.end) > 0.5)
        fewer = jnp.clip(wider - jnp.floor(0.5 - share * along), 0.0, along)
        rows = jnp.where(tilted, fewer, along)
        lower = jnp.where(self.end > 0.5, along - rows, 0.0)
        return Touched.of(first, columns, lower, rows)


def half_steps(columns: int) -> Float[np.ndarray, "steps 2"]:
    """Direction (x, y) of the centre of each of so many columns around, and of the edge behind."""
    angles = (0.5 * np.arange(2 * columns) + 0.5) * (2 * np.pi / columns)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


class CylinderMap(AbstractSurface):
    """Wall of a bearing or journal: theta from x towards y in [0, 2 pi), z from -length/2 to
    length/2.

    Location features: direction (x, y), by how much the overlap falls towards the other end [m],
    one over half the contact's width (`narrowness`) [1/rad] and the end that carries (-1 or 1; 0:
    the whole length).
    """

    cells: tuple[int, int] = eqx.field(static=True)
    radius: Scalar = quantity(unit="m", meaning="radius of the wall", above=0)
    length: Scalar = quantity(unit="m", meaning="length of the wall", above=0)
    clearance: Scalar = quantity(unit="m", meaning="radial clearance in it", above=0)
    coarseness: Scalar = quantity(1.0, "1", "cells that are one, side by side", at_least=1)

    @property
    def thickness(self):
        return self.radius

    @property
    def pitch(self) -> float:
        """Angle between columns [rad]."""
        return 2 * math.pi / self.cells[0]

    @property
    def cell(self) -> Scalar:
        """Angle of a cell [rad]."""
        return self.pitch * self.coarseness

    def row_area(self, row):
        return (2 * math.pi * self.radius / self.cells[0]) * (self.length / self.cells[1])

    def path(self, features):
        return 2.0 * arc(safe_sqrt(features[0] ** 2 + features[1] ** 2)) / self.cell

    def cells_per_contact(self, features, depth):
        fall, narrowness, end = features[2:]
        square = contact_square(narrowness**-2.0, self.cell, depth, self.clearance)
        fallen = jnp.abs(fall * end) * self.coarse_along / self.cells[1]
        overlap = 0.5 * self.clearance * square
        return self.cell / jnp.sqrt(square), fallen / overlap

    def centre(self, column: Int[Array, "*columns"]) -> Array:
        """Centres of columns, in half steps."""
        return (2.0 * block_centre(column, self.coarseness)).astype(int)

    def angles(self) -> Float[Array, " around"]:
        """Direction of the centre of each cell [rad]."""
        return (jnp.arange(self.cells[0]) + 0.5) * (2 * jnp.pi / self.cells[0])

    def heights(self) -> Float[Array, " along"]:
        """z of the centre of each cell [m]."""
        return self.length * ((jnp.arange(self.cells[1]) + 0.5) / self.cells[1] - 0.5)

    def height(self, row: Array) -> Array:
        """z of the centre of cells of a row [m]."""
        centre = block_centre(row, self.coarse_along)
        return self.length * ((centre + 0.5) / self.cells[1] - 0.5)

    def narrowness(self, indentation: Scalar) -> Scalar:
        """One over half the width [1/rad] of a contact of some indentation [m]. Its mean over a
        loss tells how deep that is in the contact's middle."""
        return 1.0 / jnp.sqrt(square_width(indentation, self.cell, self.clearance))

    def position(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Where a place of the wall [m] lies, in units of cells: around, along."""
        column = direction_angle(x, y) * (self.cells[0] / (2 * jnp.pi)) - 0.5
        return column, (z / self.length + 0.5) * self.cells[1] - 0.5

    def contact(self, volume, features):
        x, y, fall, narrowness, end = features
        ends, clearance = jnp.abs(end), self.clearance
        length = safe_sqrt(x * x + y * y)
        half_arc = arc(length)
        square = safe_divide(1.0, narrowness * narrowness)
        overlap = depth_of(square, self.cell, clearance)
        # Up to where a tilted journal overlaps. Its two ends have shares, as the line between them
        # tells, that add up to one.
        touching = safe_divide(overlap * self.length, 2.5 * jnp.abs(fall) * ends + overlap)
        load = line_contact(overlap, self.radius, clearance, touching, half_arc)
        load = load._replace(root=load.root * (1.0 - 0.5 * ends * touching / self.length))
        towards = safe_divide(x, length), safe_divide(y, length)
        target, fallen = volume + load.overlap, jnp.abs(fall) * ends
        return LineContact(
            self,
            volume,
            towards,
            direction_angle(*towards) / self.pitch - 0.5,
            half_arc,
            (jnp.cos(half_arc), jnp.sin(half_arc)),
            fall,
            end,
            (0.5 / self.cells[1]) * self.coarse_along * jnp.abs(fall),
            load,
            line_depth(target, self.radius, clearance, self.length, fallen),
        )

    def _read_anew(self, touched, depth, reading):
        around = self.cells[0]

        def visit(_, place, reading):
            column = place[0]
            ends = []
            for r, (row, inside) in zip(reading, self._edges(), strict=True):
                last, further = (entry(depth, (column, each)) for each in (row, inside))
                ends.append(with_entry(r, (column + 2,), _to_the_edge(last, further)))
            return tuple(ends)

        reading = through(touched, (around, 1), visit, reading, True)
        # The last two columns once more in front of the first, the first two behind the last.
        for to, of in ((0, around), (1, around + 1), (around + 2, 2), (around + 3, 3)):
            reading = tuple(with_entry(r, (to,), entry(r, (of,))) for r in reading)
        return reading

    def reading(self, depth):
        """Of each row at an end the depth at the edge, column by column, the last two in front and
        the first two behind."""
        rows = []
        for row, inside in self._edges():
            edge = _to_the_edge(depth[:, row], depth[:, inside])
            rows.append(jnp.concatenate([edge[-2:], edge, edge[:2]]))
        return tuple(rows)

    def _edges(self) -> list[tuple[int, Any]]:
        """(row, the next further inside) at the lower and the upper end; one of a single row."""
        last = self.cells[1] - 1
        inside = jnp.minimum(self.side, last)
        return [(0, inside), (last, last - inside)] if last else [(0, 0)]

    def depth_at_end(self, reading: tuple, x: Scalar, y: Scalar, end: int) -> Scalar:
        """Worn depth at the direction (x, y) of the row at the lower (-1) or upper (1) end, in
        metres.
        """
        around, row = self.cells[0], reading[0 if end < 0 else -1]
        position = direction_angle(x, y) * (around / (2 * math.pi) / self.coarseness) - 0.5
        nearest = jnp.round(position)
        # A turn once at most, as a number: a remainder of whole numbers costs more.
        column = nearest * jnp.floor(self.coarseness)
        column = jnp.where(column < 0, column + around, column)
        here, side = column.astype(int) + 2, self.side
        return spline(position - nearest, *(entry(row, (here + k * side,)) for k in (-1, 0, 1)))


def spline(place: Scalar, left: Scalar, here: Scalar, right: Scalar) -> Scalar:
    """A quadratic B-spline at a place, in cells from the nearest of three."""
    curvature = 0.5 * (left + right) - here
    return 0.125 * (left + 6.0 * here + right) + place * (0.5 * (right - left) + place * curvature)


def _to_the_edge(last: Array, inside: Array) -> Array:
    """Depth [m] at the edge of a last cell, beside that of the one further inside."""
    return last + 0.5 * positive_part(last - inside)


class AreaMap(AbstractWearMap):
    """A single cell: worn volume over the bearing area, which for a pin is its diameter times the
    bearing's length, so that the depth [m] is how far the pin has sunk into the bearing.
    """

    area: Scalar = quantity(
        unit="m^2", meaning="bearing area, at right angles to the load", above=0
    )
    cells: tuple[int, int] = eqx.field(static=True, default=(1, 1))

    def areas(self):
        return jnp.full(self.cells, 1.0) * self.area

    def over_three(self, depth):
        return depth

    def reading(self, depth):
        return depth

    def deposit(self, depth, volume, features):
        return depth + jnp.sum(volume) / self.area
