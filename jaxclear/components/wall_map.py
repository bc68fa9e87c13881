"""Where a slider wears its guide, and a guide its slider: depth along the two flat walls of either,
by the face of a slider that one of its corners presses against the wall.

The face is a straight line between its two corners, so on an unworn wall their overlaps tell that
of every place between them. Pressure goes with the overlap, as of flat faces (Winkler's
foundation), and each corner takes its share of it, as the line from 1 there to 0 at the other
corner tells: both together press as the face does. Source: Johnson 1985, Contact Mechanics, section
4.3, doi:10.1017/CBO9781139171731.

A corner that moves while it wears leaves to each cell the mean of its pressures there over its way.
The pressure is that after the loss, as in `surface`.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.surface import (
    LEAST_SHARE,
    SHARPEST,
    AbstractSurface,
    Contact,
    Outline,
    Touched,
    edge_depth,
    entry_at,
    spline,
)
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
    `Contact`."""

    away: Array
    half: Scalar
    slope: Scalar
    length: Scalar
    covered: Array
    depth: Array
    outline: Outline
    root: Scalar

    def overlapped(self, level: Scalar) -> tuple[Array, Array]:
        """As of a `surface.Patch`, where the corner is at a level [m]."""
        overlap, share = self.outline.at(level)
        return self.covered * overlap, self.covered * share

    def pressures(self, volume: Scalar, level: Scalar) -> Array:
        """As of a `surface.Patch`, where the corner has come to a level [m]."""
        overlap, _ = self.overlapped(level)
        face = Face(level - self.depth, self.slope, self.length)
        mean = face.share(self.away - self.half, self.away + self.half) / (2.0 * self.half)
        loss = volume * (mean + LEAST_SHARE * overlap)
        return safe_divide(loss * overlap, loss + self.root * overlap)


class Corner(NamedTuple):
    """Where a corner at an `end` (-1 or 1) of a face touches one wall: at a `place` [m] from the
    walls' middle in the mean of its way, `half` [m] to either side; the face's `slope` towards its
    other corner."""

    end: Scalar
    place: Scalar
    half: Scalar
    slope: Scalar


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

    length: Scalar = quantity(unit="m", meaning="length of the walls", above=0)
    middle: Scalar = quantity(unit="m", meaning="place of the walls' middle along the guide")
    face: Scalar = quantity(unit="m", meaning="length of the slider's faces", above=0)
    breadth: Scalar = quantity(unit="m", meaning="breadth of the faces", above=0)
    clearance: Scalar = quantity(unit="m", meaning="gap beside a centred slider", above=0)
    distance: Scalar = quantity(unit="m", meaning="distance of each wall from the middle", above=0)

    @property
    def flat(self):
        return True

    @property
    def extent(self):
        return self.length

    @property
    def cell(self) -> Scalar:
        """Length of a cell [m]."""
        return self.length / self.cells[1] * self.coarseness

    def row_area(self, row):
        return self.breadth * (self.length / self.cells[1])

    def path(self, features):
        return 2.0 * safe_sqrt(_half_path_squared(features[0], features[1])) / self.cell

    def cells_per_contact(self, features, depth):
        fallen, overlap = positive_part(features[2]), features[3] + depth
        # Cells widen no contact that goes from end to end.
        along = jnp.where(fallen > overlap, safe_divide(fallen, overlap), 0.0)
        return (LEAST_CELLS * self.cell / self.face * along,)

    def places(self) -> Float[Array, " along"]:
        """Where the centre of each cell lies along the guide (or slider) [m]."""
        return self.middle + self.heights()

    def within(self, place: Scalar) -> Array:
        """Whether a place along the guide [m] is on the walls."""
        return jnp.abs(place - self.middle) <= 0.5 * self.length

    def footprint(self, features):
        middle, _, _, _, side, end = features
        face, half = self._face(features)
        first, last = face.ends
        far = face.slope * (last - first)
        # Where the middle of the pressure lies along the face.
        beyond = far / (6.0 * (2.0 * (face.depth - face.slope * first) - far))
        centre = first + (last - first) * (0.5 - beyond)
        places = jnp.stack([middle, half, centre, last - first]) / self.cell
        return jnp.concatenate([places, jnp.stack([side, end]) * self.cells[1]])

    def _face(self, features: Array) -> tuple[Face, Array]:
        """(how the face overlaps an unworn wall, half of its way [m]) in a loss."""
        middle, square, fall, indentation, _, _ = features
        half = jnp.sqrt(_half_path_squared(middle, square) + (SHORTEST_PATH * self.cell) ** 2)
        slope = fall / self.face
        least = LEAST_CELLS * self.cell * positive_part(slope) + LEAST_OVERLAP * self.clearance
        return Face(jnp.maximum(indentation, least), slope, self.face), half

    def contact(self, volume, features):
        middle, _, fall, _, side, end = features
        face, half = self._face(features)
        slope = face.slope
        deepest = face.depth + positive_part(-fall)
        overlap = self.breadth * (face.overlap() + 2.0 * half * deepest)
        root = self.breadth * face.share(0.0, self.face)
        reach = _corner_depth((volume + overlap) / self.breadth, self.face, half, slope)
        corner = middle + 0.5 * end * self.face
        # The cell that the corner has left behind.
        row = self.row(corner - 0.5 * end * self.cell)
        place = Corner(end, corner, half, slope)
        return Contact(volume, overlap, root, reach, side, row, place)

    def in_columns(self, contact, column):
        """1 of the wall that is worn, 0 of the other."""
        return (column == contact.column).astype(float)

    def patch(self, contact, columns, row, depth):
        corner, face, cell = contact.place, self.face, self.cell
        half, slope = corner.half, corner.slope
        away = corner.end * (corner.place - self.height(row))
        covered = columns * _share((away + half) / cell) * _share((face + half - away) / cell)
        nearest = jnp.clip(away - half, 0.0, face), jnp.clip(away + half, 0.0, face)
        fallen = positive_part(slope) * nearest[0] - positive_part(-slope) * nearest[1]
        rounding = 0.5 * jnp.abs(slope) * cell + SHARPEST * self.clearance
        outline = Outline(1.0, depth + fallen, rounding)
        # As two spreads add up: over the way, and over the cell.
        spread = jnp.sqrt(half * half + 0.25 * cell * cell)
        return FacePatch(away, spread, slope, face, covered, depth, outline, contact.root)

    def start(self, contact, depth):
        row = jnp.clip(jnp.round(_number(contact.row)), 0, self.cells[1] - 1).astype(int)
        return entry_at(depth, (jnp.asarray(contact.column).astype(int), row)) + contact.deepest

    def touched(self, contact, level):
        # All cells that the face comes to.
        corner = contact.place
        far, near = self.face + corner.half, corner.half
        forward = corner.end > 0
        wider = 0.5 * (self.coarseness - 1.0)
        lower = self.row(corner.place - jnp.where(forward, far, near)) - wider
        upper = self.row(corner.place + jnp.where(forward, near, far)) + wider
        last = self.cells[1] - 1.0
        # A cell is come to where its centre is less than half a cell away.
        first = jnp.clip(jnp.floor(_number(lower + 0.5)), 0.0, last)
        rows = jnp.clip(jnp.ceil(_number(upper - 0.5)), 0.0, last) - first + 1.0
        return Touched.of(contact.column, 1.0, first, rows)

    def depth_at(self, depth: Array, side: int, place: Scalar) -> Scalar:
        """Worn depth [m] of a wall at a place along the guide.

        Args:
            depth: of each cell [m], shape (2, along).
            side: which wall, 0 or 1.
            place: along the guide [m].
        """
        last = jnp.floor((self.cells[1] - 1) / self.coarseness)
        position = (self.row(place - self.middle) + 0.5) / self.coarseness - 0.5
        nearest = jnp.clip(jnp.round(position), 0.0, last)
        row = nearest.astype(int) * self.side
        before, here, right = (
            entry_at(depth, (side, jnp.clip(row + k * self.side, 0, self.cells[1] - 1)))
            for k in (-1, 0, 1)
        )
        before, right = (
            jnp.where(nearest == 0, 2.0 * edge_depth(here, right) - here, before),
            jnp.where(nearest == last, 2.0 * edge_depth(here, before) - here, right),
        )
        return spline(position - nearest, before, here, right)

    def depth_at_end(self, depth: Array, side: int, end: int) -> Scalar:
        """Worn depth [m] of a wall at one of its ends, extrapolated from the last cells.

        Args:
            depth: of each cell [m], shape (2, along).
            side: which wall, 0 or 1.
            end: -1 for the lower and 1 for the upper end.
        """
        last = self.cells[1] - 1
        row, inside = (0, self.side) if end < 0 else (last, last - self.side)
        return edge_depth(*(entry_at(depth, (side, jnp.clip(k, 0, last))) for k in (row, inside)))
