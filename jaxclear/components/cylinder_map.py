"""The wall of a bearing, or of its journal: where its cells lie, and how a journal that may be
tilted, and goes through an arc while it wears, overlaps them. Quadratic B-splines read the depth at
both ends.
"""

import math
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.components.surface import (
    SHARPEST,
    AbstractRound,
    Contact,
    Outline,
    Patch,
    Touched,
    arc,
    arc_with_cell,
    block_row,
    edge_depth,
    entry_at,
    half_steps,
    spline,
    visit_cells,
    with_entry,
)
from jaxclear.ground.numerics import (
    OFF_THE_TIES,
    direction_angle,
    positive_part,
    power,
    safe_divide,
    safe_sqrt,
)
from jaxclear.ground.quantity import Scalar, quantity


class Line(NamedTuple):
    """Where a journal touches. It comes closest `towards` a direction, goes through an arc of half
    that angle [rad] about it (with cosine and sine, `rotation`), and overlaps by `fall` [m] less at
    the other `end`; that by which the overlap falls over half a cell at most (`steepest`) [m]."""

    towards: tuple[Scalar, ...]
    half_arc: Scalar
    rotation: tuple[Scalar, Scalar]
    fall: Scalar
    end: Scalar
    steepest: Scalar


class CylinderMap(AbstractRound):
    """Wall of a bearing or journal: theta from x towards y in [0, 2 pi), z from -length/2 to
    length/2.

    Location features: direction (x, y), by how much the overlap falls towards the other end [m],
    one over half the contact's width (`narrowness`) [1/rad] and the end that carries (-1 or 1; 0:
    the whole length).
    """

    axes: ClassVar = 2
    width: ClassVar = (3, -1.0)
    radius: Scalar = quantity(unit="m", meaning="radius of the wall", above=0)
    length: Scalar = quantity(unit="m", meaning="length of the wall", above=0)
    clearance: Scalar = quantity(unit="m", meaning="radial clearance in it", above=0)

    @property
    def extent(self):
        return self.length

    @property
    def pitch(self) -> float:
        """Angle between columns [rad]."""
        return 2 * math.pi / self.cells[0]

    @property
    def cell(self):
        return self.pitch * self.coarseness

    def row_area(self, row):
        return (2 * math.pi * self.radius / self.cells[0]) * (self.length / self.cells[1])

    def cells_per_contact(self, features, depth):
        fall, narrowness, end = features[2:]
        square = self.square_in_scar(narrowness**-2.0, depth)
        fallen, overlap = jnp.abs(fall * end), 0.5 * self.clearance * square
        # Cells widen no contact that goes from end to end.
        along = jnp.where(fallen > overlap, fallen / overlap, 0.0)
        return self.cell / jnp.sqrt(square), along * self.coarse_along / self.cells[1]

    def narrowness(self, indentation: Scalar) -> Scalar:
        """One over half the width [1/rad] of a contact of some indentation [m]. Its mean over a
        loss tells how deep that is in the contact's middle."""
        return 1.0 / jnp.sqrt(self.square_width(indentation))

    def position(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Cell coordinates (around, along) of a point of the wall, in units of cells.

        Args:
            x, y: position across the axis [m]; only its direction counts.
            z: position along the axis from the middle [m].
        """
        return self.column(x, y), self.row(z)

    def footprint(self, features):
        towards, length = self.mean_direction(features)
        depth, _, touching = self._overlapped(features)
        along = self.cells[1] / self.coarse_along
        width = jnp.sqrt(2.0 * depth / self.clearance)
        around = direction_angle(*towards) / self.cell, arc(length) / self.cell, width / self.cell
        return jnp.stack([*around, touching / self.length * along, features[4] * along])

    def _overlapped(self, features: Array) -> tuple[Array, Array, Array]:
        """(overlap [m], by how much that falls towards the other end [m], up to where along a
        tilted journal overlaps [m])."""
        fall, narrowness, end = features[2:]
        depth = self.depth_of(safe_divide(1.0, narrowness * narrowness))
        fallen = jnp.abs(fall) * jnp.abs(end)
        return depth, fallen, safe_divide(depth * self.length, 2.5 * fallen + depth)

    def contact(self, volume, features):
        towards, length = self.mean_direction(features)
        fall, _, end = features[2:]
        ends, clearance = jnp.abs(end), self.clearance
        half_arc = arc(length)
        depth, fallen, touching = self._overlapped(features)
        # The two ends have shares, as the line between them tells, that add up to one.
        half_width, area = safe_sqrt(2.0 * depth / clearance), self.radius * touching
        overlap = 4 / 3 * area * depth * (half_width + 1.5 * half_arc)
        root = 0.5 * jnp.pi * area * safe_sqrt(depth) * half_width
        root = root * (1.0 - 0.5 * ends * touching / self.length)
        # A little less than it sinks in.
        total = 4 / 3 * self.radius * self.length * safe_sqrt(2.0 / clearance)
        parallel = (volume + overlap) / total
        tilted = power(2.5 * fallen * parallel, jnp.asarray(0.4))
        deepest = jnp.maximum(jnp.cbrt(parallel) ** 2, tilted)
        column = direction_angle(*towards) / self.pitch - 0.5
        row = jnp.where(end > 0, self.cells[1] - 1, 0)
        rotation = jnp.cos(half_arc), jnp.sin(half_arc)
        steepest = (0.5 / self.cells[1]) * self.coarse_along * jnp.abs(fall)
        place = Line(towards, half_arc, rotation, fall, end, steepest)
        return Contact(volume, overlap, root, deepest, column, row, place)

    def in_columns(self, contact, column):
        """Angle between a column and the middle of the arc [rad, 0 to pi]; cosine and size of the
        sine of that between it and the arc; without a direction all columns are in it."""
        x, y = block_row(half_steps(self.cells[0]), column, self.coarseness)
        towards, (c, s) = contact.place.towards, contact.place.rotation
        cosine = x * towards[0] + y * towards[1]
        sine = jnp.abs(x * towards[1] - y * towards[0])
        inside = cosine >= c
        return (
            direction_angle(cosine, sine),
            jnp.where(inside, 1.0, cosine * c + sine * s),
            jnp.where(inside, 0.0, sine * c - cosine * s),
        )

    def patch(self, contact, columns, row, depth):
        (along, cosine, sine), line = columns, contact.place
        away = 0.5 * jnp.abs(line.end) - line.end * self.height(row) / self.length
        kink = SHARPEST * self.clearance
        rounding = self.least_overlap(self.cell)[0] * sine + line.steepest * jnp.abs(cosine) + kink
        margin, fallen = self.clearance + depth, line.fall * away
        outline = Outline(cosine, margin + fallen * cosine, rounding)
        nearest = Outline(1.0, margin + fallen, line.steepest + kink)
        half = arc_with_cell(line.half_arc, self.cell)
        return Patch(outline, nearest, along, half, margin, 1.0 - away, contact.root)

    def start(self, contact, depth):
        # At the end that carries, in the first column in the arc, or the nearest to it.
        middle, half_arc = contact.column, contact.place.half_arc / self.pitch
        first = -jnp.floor(half_arc - middle)
        # Between two columns either rounding must choose the same.
        nearest = jnp.floor(middle + (OFF_THE_TIES - 0.5))
        column = jnp.where(first <= middle + half_arc, first, nearest).astype(int)
        edge = entry_at(depth, (column % self.cells[0], contact.row))
        return self.clearance + edge + contact.deepest

    def touched(self, contact, level):
        line, (around, along) = contact.place, self.cells
        wider = self.coarseness - 1.0
        most = level + positive_part(-line.fall) + line.steepest
        reach = (line.half_arc + self.angle_touched(most, self.cell)) / self.pitch + 0.5 * wider
        nowhere = line.towards[0] ** 2 + line.towards[1] ** 2 < 0.5
        everywhere = nowhere | (2.0 * reach + 1.0 >= around)
        # A row is overlapped, if at all, where level cos + rounding sin is as much as is needed.
        rounding, needed = self.least_overlap(self.cell)
        lowest = jnp.sqrt(needed * needed - rounding * rounding)
        share = (level + line.steepest - lowest) / jnp.where(line.fall > 0, line.fall, jnp.inf)
        tilted = (line.fall > 0) & (jnp.abs(line.end) > 0.5)
        fewer = jnp.clip(wider - jnp.floor(0.5 - share * along), 0.0, along)
        rows = jnp.where(tilted, fewer, along)
        lower = jnp.where(line.end > 0.5, along - rows, 0.0)
        return Touched.of(*self.columns_within(contact.column, reach, everywhere), lower, rows)

    def reading(self, depth):
        """Of each row at an end the depth at the edge, column by column, the last two in front and
        the first two behind."""
        rows = []
        for row, inside in self._edge_rows():
            edge = edge_depth(depth[:, row], depth[:, inside])
            rows.append(jnp.concatenate([edge[-2:], edge, edge[:2]]))
        return tuple(rows)

    def _read_anew(self, touched, depth, reading):
        around = self.cells[0]

        def visit(_, place, reading):
            column = place[0]
            ends = []
            for r, (row, inside) in zip(reading, self._edge_rows(), strict=True):
                last, further = (entry_at(depth, (column, each)) for each in (row, inside))
                ends.append(with_entry(r, (column + 2,), edge_depth(last, further)))
            return tuple(ends)

        reading = visit_cells(touched, (around, 1), visit, reading, True)
        # The last two columns once more in front of the first, the first two behind the last.
        for to, of in ((0, around), (1, around + 1), (around + 2, 2), (around + 3, 3)):
            reading = tuple(with_entry(r, (to,), entry_at(r, (of,))) for r in reading)
        return reading

    def _edge_rows(self) -> list[tuple[int, Any]]:
        """(row, the next further inside) at the lower and the upper end; one of a single row."""
        last = self.cells[1] - 1
        inside = jnp.minimum(self.side, last)
        return [(0, inside), (last, last - inside)] if last else [(0, 0)]

    def depth_at_end(self, reading: tuple, x: Scalar, y: Scalar, end: int) -> Scalar:
        """Worn depth [m] at one end of the wall.

        Args:
            reading: rows of depths [m] at the ends (`reading` of this map).
            x, y: unit vector of the direction.
            end: -1 for the lower and 1 for the upper end.
        """
        around, row = self.cells[0], reading[0 if end < 0 else -1]
        position = direction_angle(x, y) * (around / (2 * math.pi) / self.coarseness) - 0.5
        nearest = jnp.round(position)
        # A turn once at most, as a number: a remainder of whole numbers costs more.
        column = nearest * jnp.floor(self.coarseness)
        column = jnp.where(column < 0, column + around, column)
        here, side = column.astype(int) + 2, self.side
        return spline(position - nearest, *(entry_at(row, (here + k * side,)) for k in (-1, 0, 1)))
