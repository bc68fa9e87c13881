"""Where material is lost: worn depth on a cylinder (theta x z), with which of its cells a loss may
overlap; and one depth where parts without a gap wear into each other.

Every cell loses what its own pressure takes, which follows from its own gap on the worn surface
(`contact_patch`): on a cylinder also along the tilted journal. Volume is conserved to rounding, and
depth is a smooth function of where and how much. What is lost between two saving times is spread
over the arc that the contact has gone through. Quadratic B-splines read the depth back when the
worn surface enters the gap.
"""

import functools
import math
from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxclear.components.contact_patch import (
    SHARPEST,
    Elasticity,
    Outline,
    Patch,
    Touched,
    Way,
    angle_touched,
    arc,
    arc_with_cell,
    depth_lost,
    depth_of,
    entry,
    least,
    line_contact,
    line_sunk,
    square_width,
    through,
    way_of,
    ways,
    with_entry,
    worn_in_turn,
)
from jaxclear.ground.numerics import (
    OFF_THE_TIES,
    direction_angle,
    positive_part,
    safe_divide,
    safe_sqrt,
)
from jaxclear.ground.quantity import AbstractQuantified, Scalar, count, quantity
from jaxclear.laws.wear import AbstractWearLaw


class Wall(NamedTuple):
    """A wall of so many `cells` around and along; radius, length, radial clearance [m]."""

    cells: tuple[int, int]
    radius: Scalar
    length: Scalar
    clearance: Scalar

    @property
    def cell(self) -> float:
        """Angle of a cell [rad]."""
        return 2 * math.pi / self.cells[0]

    @property
    def area(self) -> Scalar:
        """Of a cell [m2]."""
        return (2 * math.pi * self.radius / self.cells[0]) * (self.length / self.cells[1])

    def height(self, row: Array) -> Array:
        """z of the centre of cells [m]."""
        return self.length * ((row + 0.5) / self.cells[1] - 0.5)


class Column(NamedTuple):
    """Angle between a column and the middle of an arc [rad, 0 to pi]; cosine and size of the sine
    of that between it and the arc; without a direction all columns are in it."""

    along: Array
    cosine: Array
    sine: Array


class Loss(NamedTuple):
    """A volume [m3] that a `wall` loses to a part that comes closest `towards` a direction, which
    `middle` says in units of columns, goes through an arc of half that angle [rad] about it (with
    cosine and sine, `turned`), and overlaps by `fall` [m] less at the other `end`; that by which
    the overlap falls over half a cell at most (`steepest`) [m]; its `load` before anything is lost,
    and how deep it would sink into an unworn wall (`sunk`) [m]."""

    wall: Wall
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

    @property
    def cells(self) -> tuple[int, int]:
        """How many cells the wall has, around and along."""
        return self.wall.cells

    def columns(self, ways: Float[Array, "*columns 2"]) -> Column:
        """Columns in these directions (x, y)."""
        x, y = ways[..., 0], ways[..., 1]
        towards, (c, s) = self.towards, self.turned
        cosine = x * towards[0] + y * towards[1]
        sine = jnp.abs(x * towards[1] - y * towards[0])
        inside = cosine >= c
        return Column(
            direction_angle(cosine, sine),
            jnp.where(inside, 1.0, cosine * c + sine * s),
            jnp.where(inside, 0.0, sine * c - cosine * s),
        )

    def in_column(self, column: Int[Array, ""]) -> Column:
        """That column alone."""
        return self.columns(way_of(column, self.cells[0]))

    def cell(self, column: Column, row: Array, depth: Array, start: Scalar = 0.0) -> Patch:
        """Cells of columns in rows, worn so deep [m]; where their level is sought, from `start`
        [m]."""
        wall, clearance = self.wall, self.wall.clearance
        away = 0.5 * jnp.abs(self.end) - self.end * wall.height(row) / wall.length
        rounding = (
            (jnp.pi / wall.cells[0]) * clearance * column.sine
            + self.steepest * jnp.abs(column.cosine)
            + SHARPEST * clearance
        )
        room, fallen = clearance + depth, self.fall * away
        outline = Outline(column.cosine, room + fallen * column.cosine, rounding)
        nearest = Outline(1.0, room + fallen, self.steepest + SHARPEST * clearance)
        half = arc_with_cell(self.half_arc, wall.cell)
        way = Way(column.along, nearest, half, room)
        return Patch(outline, way, wall.area, 1.0 - away, start, self.load)

    def start(self, depth: Float[Array, "around along"]) -> Scalar:
        """A level [m] near that of the part and above it, on walls worn so deep [m]: at the end
        that carries."""
        around, along = self.wall.cells
        row = jnp.where(self.end > 0, along - 1, 0)
        edge = entry(depth, (self.nearest.astype(int) % around, row))
        return self.wall.clearance + edge + self.sunk

    def reach(self, level: Scalar) -> Scalar:
        """Angle [rad] to either side beyond which the part overlaps no cell at a level [m]."""
        most = level + positive_part(-self.fall) + self.steepest
        return self.half_arc + angle_touched(most, self.wall.cell, self.wall.clearance)

    @property
    def nearest(self) -> Scalar:
        """The first column in the arc, or the nearest to it."""
        half_arc = self.half_arc / self.wall.cell
        first = -jnp.floor(half_arc - self.middle)
        # Between two columns either rounding must choose the same.
        nearest = jnp.floor(self.middle + (OFF_THE_TIES - 0.5))
        return jnp.where(first <= self.middle + half_arc, first, nearest)

    def touched(self, level: Scalar) -> Touched:
        """Cells that the part may overlap at a level."""
        around, along = self.wall.cells
        reach, middle = self.reach(level) / self.wall.cell, self.middle
        first = -jnp.floor(reach - middle)
        nowhere = self.towards[0] ** 2 + self.towards[1] ** 2 < 0.5
        whole = nowhere | (2.0 * reach + 1.0 >= around)
        columns = jnp.where(whole, around, jnp.floor(middle + reach) - first + 1.0)
        # A row is overlapped, if at all, where level cos + rounding sin is as much as is needed.
        rounding, needed = least(self.wall.cell, self.wall.clearance)
        lowest = jnp.sqrt(needed * needed - rounding * rounding)
        share = (level + self.steepest - lowest) / jnp.where(self.fall > 0, self.fall, jnp.inf)
        tilted = (self.fall > 0) & (jnp.abs(self.end) > 0.5)
        rows = jnp.where(tilted, jnp.clip(-jnp.floor(0.5 - share * along), 0.0, along), along)
        lower = jnp.where(self.end > 0.5, along - rows, 0.0)
        return Touched(*(jnp.asarray(n).astype(int) for n in (first, columns, lower, rows)))


def loss_of(wall: Wall, volume: Scalar, features: Float[Array, "5"]) -> Loss:
    """What an event with these location features takes off a wall (see `CylinderMap`)."""
    x, y, fall, narrowness, end = features
    ends, clearance = jnp.abs(end), wall.clearance
    length = safe_sqrt(x * x + y * y)
    half_arc = arc(length)
    square = safe_divide(1.0, narrowness * narrowness)
    overlap = depth_of(square, wall.cell, clearance)
    # Up to where a tilted journal overlaps. Its two ends have shares, as the line between them
    # tells, that add up to one.
    touching = safe_divide(overlap * wall.length, 2.5 * jnp.abs(fall) * ends + overlap)
    load = line_contact(overlap, wall.radius, clearance, touching, half_arc)
    load = load._replace(root=load.root * (1.0 - 0.5 * ends * touching / wall.length))
    wanted = volume + load.overlap
    towards = safe_divide(x, length), safe_divide(y, length)
    return Loss(
        wall,
        volume,
        towards,
        direction_angle(*towards) / wall.cell - 0.5,
        half_arc,
        (jnp.cos(half_arc), jnp.sin(half_arc)),
        fall,
        end,
        (0.5 / wall.cells[1]) * jnp.abs(fall),
        load,
        line_sunk(wanted, wall.radius, clearance, wall.length, jnp.abs(fall) * ends),
    )


# Angle [rad] to either side of a contact that is looked at first.
REACH = 0.6


class Wearing(AbstractQuantified):
    """A surface that wears.

    The surface is updated whenever a contact has moved by half a cell, and at the saving times;
    companion runs halve that path, so that its error is part of the estimate. A scar narrower than
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

    Raises:
        ValueError: for fewer than 4 cells around or 1 along.
    """

    law: AbstractWearLaw
    cells: tuple[int, int] = eqx.field(
        static=True,
        default=(288, 20),
        converter=lambda given: tuple(given) if isinstance(given, list) else given,
        metadata={"wanted": "2 whole numbers: cells around and along"},
    )
    acceleration: Scalar = quantity(1.0, "1", "worn volume per simulated volume", at_least=0)
    worn_radius: bool = eqx.field(static=True, default=False, kw_only=True)
    updates: int | None = count(None, "most updates of the worn surface in a run", kw_only=True)

    def __check_init__(self):
        if self.cells[0] < 4 or self.cells[1] < 1:
            raise ValueError(
                f"a wear map must have at least 4 cells around and 1 along, not {self.cells}."
            )


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


class CylinderMap(AbstractWearMap):
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

    @property
    def thickness(self):
        return self.radius

    def areas(self) -> Float[Array, "around along"]:
        around, along = self.cells
        return (
            jnp.full(self.cells, 1.0) * (2 * jnp.pi * self.radius / around) * (self.length / along)
        )

    def path(self, features):
        return 2.0 * arc(safe_sqrt(features[0] ** 2 + features[1] ** 2)) / self._cell

    def angles(self) -> Float[Array, " around"]:
        """Direction of the centre of each cell [rad]."""
        return (jnp.arange(self.cells[0]) + 0.5) * (2 * jnp.pi / self.cells[0])

    def heights(self) -> Float[Array, " along"]:
        """z of the centre of each cell [m]."""
        return self.length * ((jnp.arange(self.cells[1]) + 0.5) / self.cells[1] - 0.5)

    def narrowness(self, indentation: Scalar) -> Scalar:
        """One over half the width [1/rad] of a contact of some indentation [m]. Its mean over a
        loss tells how deep that is in the contact's middle."""
        return 1.0 / jnp.sqrt(square_width(indentation, self._cell, self.clearance))

    @property
    def _cell(self) -> float:
        return 2 * math.pi / self.cells[0]

    def position(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Where a place of the wall [m] lies, in units of cells: around, along."""
        return self._column(x, y), (z / self.length + 0.5) * self.cells[1] - 0.5

    def _column(self, x, y):
        return direction_angle(x, y) * (self.cells[0] / (2 * jnp.pi)) - 0.5

    @property
    def wall(self) -> Wall:
        """Its geometry alone."""
        return Wall(self.cells, self.radius, self.length, self.clearance)

    def deposit(self, depth, volume, features):
        around = self.cells[0]
        reach = math.ceil(REACH * around / (2 * math.pi))

        # A table: XLA would work them out anew for every cell of a column.
        table = ways(around)

        def wide():
            whole = jax.vmap(lambda *event: self._lost(table, depth, depth, *event))
            return depth + jnp.sum(whole(volume, features)[0], axis=0)

        if 2 * reach + 1 >= around:
            return wide()
        towards = direction_angle(features[:, 0], features[:, 1]) * (around / (2 * jnp.pi))
        first = (jnp.floor(towards).astype(int) - reach) % around
        width = 2 * reach + 1
        twice = jnp.concatenate([depth, depth[:width]])
        near = lambda these, start: jax.lax.dynamic_slice_in_dim(these, start, width)
        table_twice = jnp.concatenate([table, table[:width]])
        lost, fits = jax.vmap(
            lambda start, *event: self._lost(
                near(table_twice, start), near(twice, start), depth, *event
            )
        )(first, volume, features)

        def narrow():
            # Slices: to scatter costs XLA several times as much as the losses themselves.
            gained = jnp.zeros_like(twice)
            for start, own in zip(first, lost, strict=True):
                there = jax.lax.dynamic_slice_in_dim(gained, start, width)
                gained = jax.lax.dynamic_update_slice_in_dim(gained, there + own, start, 0)
            return depth + gained[:around].at[:width].add(gained[around:])

        # A choice of its own for each sample of a batch would be both branches: the wide one, which
        # costs several times as much, is entered where a sample needs it.
        fit = jnp.all(fits)
        rare = lambda: jnp.where(fit, narrow(), wide())
        return jax.lax.cond(eqxi.unvmap_all(fit), narrow, rare)

    def _lost(self, table, depth, of_all, volume, features):
        """(what each cell of columns in these directions, worn so deep [m], loses in an event [m],
        whether no other column is reached)."""
        loss = loss_of(self.wall, volume, features)
        columns = jax.tree.map(lambda each: each[:, None], loss.columns(table))
        patch = loss.cell(columns, jnp.arange(self.cells[1]), depth, loss.start(of_all))
        lost, level = depth_lost(volume, patch._replace(area=self.areas()[0]))
        return lost, (loss.reach(level) < REACH) | (volume == 0)

    def deposit_in_turn(self, depth, reading, pressures, volume, features):
        loss = functools.partial(loss_of, self.wall)
        worn = depth, reading, pressures
        return worn_in_turn(loss, self._read_anew, *worn, volume, features)

    def _read_anew(self, touched, depth, reading):
        """The reading where cells of these columns have changed."""
        around = self.cells[0]

        def one(_, place, reading):
            column = place[0]
            ends = []
            for own, (row, inside) in zip(reading, self._edges(), strict=True):
                last, further = (entry(depth, (column, each)) for each in (row, inside))
                ends.append(with_entry(own, (column + 1,), _to_the_edge(last, further)))
            return tuple(ends)

        reading = through(touched, (around, 1), one, reading, True)
        # The last column once more in front of the first, the first behind the last.
        for to, of in ((0, around), (around + 1, 1)):
            reading = tuple(with_entry(own, (to,), entry(own, (of,))) for own in reading)
        return reading

    def reading(self, depth):
        """Of each row at an end the depth at the edge, column by column, the last one in front and
        the first one behind: what a place reads of it is one small slice."""
        rows = []
        for row, inside in self._edges():
            edge = _to_the_edge(depth[:, row], depth[:, inside])
            rows.append(jnp.concatenate([edge[-1:], edge, edge[:1]]))
        return tuple(rows)

    def _edges(self) -> list[tuple[int, int]]:
        """(row, the next further inside) at the lower and the upper end; one of a single row."""
        last = self.cells[1] - 1
        return [(0, 1), (last, last - 1)] if last else [(0, 0)]

    def depth_at_end(self, reading: tuple, x: Scalar, y: Scalar, end: int) -> Scalar:
        """Worn depth at the direction (x, y) of the row at the lower (-1) or upper (1) end, in
        metres.
        """
        position = self._column(x, y)
        nearest = jnp.round(position)
        f = position - nearest
        first = nearest.astype(int) % self.cells[0]
        own = reading[0 if end < 0 else -1]
        left, here, right = jax.lax.dynamic_slice_in_dim(own, first, 3)
        # A quadratic B-spline.
        curvature = 0.5 * (left + right) - here
        return 0.125 * (left + 6.0 * here + right) + f * (0.5 * (right - left) + f * curvature)


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
