"""What wears a cylinder's wall in one loss: where the part comes closest, how wide and deep it is
there, and which cells it may overlap."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxclear.components.contact_patch import (
    SHARPEST,
    Elasticity,
    Outline,
    Patch,
    Way,
    arc,
    arc_with_cell,
    depth_of,
    line_contact,
    line_sunk,
)
from jaxclear.components.touched_cells import Touched, angle_touched, entry, least, way_of
from jaxclear.ground.numerics import (
    OFF_THE_TIES,
    direction_angle,
    positive_part,
    safe_divide,
    safe_sqrt,
)
from jaxclear.ground.quantity import Scalar


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
