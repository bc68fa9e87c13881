"""Where a slider wears its guide, and a guide its slider: depth along the two flat walls of either,
by the face of a slider that one of its corners presses against the wall.

The face is a straight line between its two corners, so on an unworn wall their overlaps tell that
of every place between them. Pressure goes with the overlap, as of flat faces (Winkler's
foundation), and each corner takes its share of it, as the line from 1 there to 0 at the other
corner tells: both together press as the face does. Source: Johnson 1985, Contact Mechanics, section
4.3, doi:10.1017/CBO9781139171731.

A corner that moves while it wears leaves to each cell the mean of its pressures there over its way.
The pressure is that after the loss, as in `contact_patch`.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxclear.components.contact_patch import (
    LEAST_SHARE,
    SHARPEST,
    Elasticity,
    Outline,
    Touched,
    block_centre,
    entry,
)
from jaxclear.components.wear_map import AbstractSurface, mean_along, spline
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity

# A tilted face overlaps a wall along so many cells at least, and any face by this share of the
# clearance: 0.1 um at 0.1 mm, as rough as ground faces are. Of rigid parts nothing else is known.
LEAST_CELLS, LEAST_OVERLAP = 2.0, 1e-3


# Half of the shortest way [cells]: how long a shorter one is hangs on rounding.
SHORTEST_PATH = 1e-2


class Face(NamedTuple):
    """A face that overlaps a wall by `depth` at its corner, and by `slope` less for every metre
    from there, along a length [m]."""

    depth: Scalar
    slope: Scalar
    length: Scalar

    @property
    def ends(self) -> tuple[Array, Array]:
        """From which distance to which from the corner it overlaps [m]."""
        crosses = jnp.abs(self.slope) * self.length > jnp.abs(self.depth)
        there = positive_part(self.depth / jnp.where(crosses, self.slope, 1.0))
        first = jnp.where(crosses & (self.slope < 0), there, 0.0)
        return first, jnp.where(crosses & (self.slope > 0), there, self.length)

    def overlap(self) -> Array:
        """Integral of the overlap [m2]."""
        first, last = self.ends
        return (last - first) * (self.depth - 0.5 * self.slope * (first + last))

    def share(self, first: Scalar, last: Scalar) -> Array:
        """Integral [m2] of the overlap, times the corner's share, between two distances from it."""
        least, most = self.ends
        a, b = jnp.clip(first, least, most), jnp.clip(last, least, most)
        linear = 0.5 * (self.slope + self.depth / self.length) * (a + b)
        square = self.slope / (3.0 * self.length) * (a * a + a * b + b * b)
        return positive_part((b - a) * (self.depth - linear + square))


class FacePatch(NamedTuple):
    """Cells of a wall, worn so deep [m], `away` so far [m] from the middle of a corner's way of
    this `half` [m], under a face of a `slope` and `length` [m]; `covered`: their share that the
    face comes to; `outline`: how it overlaps them where it comes closest; `root`: as of
    `Elasticity`."""

    away: Array
    half: Scalar
    slope: Scalar
    length: Scalar
    covered: Array
    depth: Array
    outline: Outline
    root: Scalar

    def overlapped(self, level: Scalar) -> tuple[Array, Array]:
        """As of a `contact_patch.Patch`, where the corner is at a level [m]."""
        overlap, share = self.outline.at(level)
        return self.covered * overlap, self.covered * share

    def pressures(self, volume: Scalar, level: Scalar) -> Array:
        """As of a `contact_patch.Patch`, where the corner has come to a level [m]."""
        overlap, _ = self.overlapped(level)
        face = Face(level - self.depth, self.slope, self.length)
        mean = face.share(self.away - self.half, self.away + self.half) / (2.0 * self.half)
        loss = volume * (mean + LEAST_SHARE * overlap)
        return safe_divide(loss * overlap, loss + self.root * overlap)


class FaceContact(NamedTuple):
    """A corner at an `end` (-1 or 1) of a face that takes a volume [m3] off one wall (`side` 0 or
    1) of a `surface`. It is at a `place` [m] from the walls' middle in the mean of its way, `half`
    [m] to either side; `load` before anything is lost, and how deep the corner would sink into an
    unworn wall (`sunk`) [m]; the face's `slope` towards its other corner."""

    surface: "WallMap"
    volume: Scalar
    side: Scalar
    end: Scalar
    place: Scalar
    half: Scalar
    slope: Scalar
    load: Elasticity
    sunk: Scalar

    def in_columns(self, column: Int[Array, "*columns"]) -> Array:
        """1 of the wall that is worn, 0 of the other."""
        return (column == self.side).astype(float)

    def patch(self, columns: Array, row: Array, depth: Array) -> FacePatch:
        surface, half, slope = self.surface, self.half, self.slope
        face, cell = surface.face, surface.cell
        away = self.end * (self.place - surface.place(row))
        covered = columns * _share((away + half) / cell) * _share((face + half - away) / cell)
        nearest = jnp.clip(away - half, 0.0, face), jnp.clip(away + half, 0.0, face)
        fallen = positive_part(slope) * nearest[0] - positive_part(-slope) * nearest[1]
        rounding = 0.5 * jnp.abs(slope) * cell + SHARPEST * surface.clearance
        outline = Outline(1.0, depth + fallen, rounding)
        # As two spreads add up: over the way, and over the cell.
        spread = jnp.sqrt(half * half + 0.25 * cell * cell)
        return FacePatch(away, spread, slope, face, covered, depth, outline, self.load.root)

    def start(self, depth: Float[Array, "2 along"]) -> Scalar:
        # The cell that the corner has left behind.
        row = self.surface.row(self.place - 0.5 * self.end * self.surface.cell)
        here = jnp.clip(jnp.round(_number(row)), 0, self.surface.cells[1] - 1).astype(int)
        return entry(depth, (jnp.asarray(self.side).astype(int), here)) + self.sunk

    def touched(self, level: Scalar) -> Touched:
        # All cells that the face comes to.
        far, near = self.surface.face + self.half, self.half
        forward = self.end > 0
        wider = 0.5 * (self.surface.coarseness - 1.0)
        lower = self.surface.row(self.place - jnp.where(forward, far, near)) - wider
        upper = self.surface.row(self.place + jnp.where(forward, near, far)) + wider
        last = self.surface.cells[1] - 1.0
        # A cell is come to where its centre is less than half a cell away.
        first = jnp.clip(jnp.floor(_number(lower + 0.5)), 0.0, last)
        rows = jnp.clip(jnp.ceil(_number(upper - 0.5)), 0.0, last) - first + 1.0
        return Touched.of(self.side, 1.0, first, rows)


def _half_path_squared(middle: Scalar, square: Scalar) -> Scalar:
    """Square of half of a path [m2] of this mean place [m] and mean square [m2]: what is spread
    evenly to either side has a third of that as variance."""
    return 3.0 * positive_part(square - middle * middle)


def _corner_depth(area: Scalar, face: Scalar, half: Scalar, slope: Scalar) -> Scalar:
    """How deep [m] a corner sinks into an unworn wall that its face overlaps by an area [m2] along
    its way."""
    falls, rises = positive_part(slope), positive_part(-slope)
    full = 2.0 * half + face
    tilted = area < falls * (0.5 * face + 2.0 * half) * face
    root = jnp.sqrt(4.0 * half * half + 2.0 * area / jnp.where(tilted, falls, 1.0))
    flat = area + 0.5 * falls * face * face - rises * (0.5 * face + 2.0 * half) * face
    return jnp.where(tilted, 2.0 * area / (2.0 * half + root), flat / full)


def _share(distance: Array) -> Array:
    """Share of a cell that lies beyond a line, which is so many cells beyond its centre."""
    return jnp.clip(distance + 0.5, 0.0, 1.0)


def _number(row: Array) -> Array:
    """A row to begin with, also where there is none."""
    return jnp.where(jnp.isfinite(row), row, 0.0)


class WallMap(AbstractSurface):
    """Walls at -x (row 0) and x (row 1) of a guide, or of a slider: z from `middle` - length/2 to
    `middle` + length/2.

    Location features: where the slider's middle is along the walls, from theirs [m], its square
    [m2], by how much the overlap falls towards the face's other corner [m], the overlap at this
    corner [m], the wall (0 or 1) and the end of the face (-1 or 1).
    """

    cells: tuple[int, int] = eqx.field(static=True)
    length: Scalar = quantity(unit="m", meaning="length of the walls", above=0)
    middle: Scalar = quantity(unit="m", meaning="place of the walls' middle along the guide")
    face: Scalar = quantity(unit="m", meaning="length of the slider's faces", above=0)
    breadth: Scalar = quantity(unit="m", meaning="breadth of the faces", above=0)
    clearance: Scalar = quantity(unit="m", meaning="gap beside a centred slider", above=0)
    distance: Scalar = quantity(unit="m", meaning="distance of each wall from the middle", above=0)
    coarseness: Scalar = quantity(1.0, "1", "cells that are one, side by side", at_least=1)

    @property
    def cell(self) -> Scalar:
        """Length of a cell [m]."""
        return self.length / self.cells[1] * self.coarseness

    def row_area(self, row):
        return self.breadth * (self.length / self.cells[1])

    def over_three(self, depth):
        # Either row is a wall of its own.
        return mean_along(depth)

    def path(self, features):
        return 2.0 * safe_sqrt(_half_path_squared(features[0], features[1])) / self.cell

    def cells_per_contact(self, features, depth):
        fallen = LEAST_CELLS * self.cell * positive_part(features[2]) / self.face
        return (safe_divide(fallen, features[3] + depth),)

    def place(self, row: Array) -> Array:
        """Where the centres of cells lie, from the middle of the walls [m]."""
        return self.length * ((block_centre(row, self.coarse_along) + 0.5) / self.cells[1] - 0.5)

    def row(self, place: Scalar) -> Scalar:
        """A place from the middle of the walls [m] in units of cells."""
        return (place / self.length + 0.5) * self.cells[1] - 0.5

    def places(self) -> Float[Array, " along"]:
        """Where the centre of each cell lies along the guide (or slider) [m]."""
        rows = jnp.arange(self.cells[1])
        return self.middle + self.length * ((rows + 0.5) / self.cells[1] - 0.5)

    @property
    def flat(self):
        return True

    def within(self, place: Scalar) -> Array:
        """Whether a place along the guide [m] is on the walls."""
        return jnp.abs(place - self.middle) <= 0.5 * self.length

    def contact(self, volume, features):
        middle, square, fall, indentation, side, end = features
        half = jnp.sqrt(_half_path_squared(middle, square) + (SHORTEST_PATH * self.cell) ** 2)
        slope = fall / self.face
        least = LEAST_CELLS * self.cell * positive_part(slope) + LEAST_OVERLAP * self.clearance
        face = Face(jnp.maximum(indentation, least), slope, self.face)
        deepest = face.depth + positive_part(-fall)
        overlap = self.breadth * (face.overlap() + 2.0 * half * deepest)
        load = Elasticity(face.depth, overlap, self.breadth * face.share(0.0, self.face))
        depth = _corner_depth((volume + overlap) / self.breadth, self.face, half, slope)
        place = middle + 0.5 * end * self.face
        return FaceContact(self, volume, side, end, place, half, slope, load, depth)

    def depth_at(self, depth: Array, side: int, place: Scalar) -> Scalar:
        """Worn depth [m] of a wall (0 or 1) at a place along the guide [m]."""
        side_of_cell = self.side
        last = jnp.floor((self.cells[1] - 1) / self.coarseness)
        position = (self.row(place - self.middle) + 0.5) / self.coarseness - 0.5
        nearest = jnp.clip(jnp.round(position), 0.0, last)
        row = nearest.astype(int) * side_of_cell
        before, here, right = (
            entry(depth, (side, jnp.clip(row + k * side_of_cell, 0, self.cells[1] - 1)))
            for k in (-1, 0, 1)
        )
        before, right = (
            jnp.where(nearest == 0, _beyond(here, right), before),
            jnp.where(nearest == last, _beyond(here, before), right),
        )
        return spline(position - nearest, before, here, right)

    def depth_at_end(self, depth: Array, side: int, end: int) -> Scalar:
        """Worn depth [m] of a wall (0 or 1) at its lower (-1) or upper (1) end."""
        last = self.cells[1] - 1
        row, inside = (0, self.side) if end < 0 else (last, last - self.side)
        edge, further = (entry(depth, (side, jnp.clip(k, 0, last))) for k in (row, inside))
        return 0.5 * (_beyond(edge, further) + edge)


def _beyond(last: Array, inside: Array) -> Array:
    """Depth [m] beyond a last cell, beside that of the one further inside."""
    return last + positive_part(last - inside)
