"""Where a ball wears its socket: depth in azimuth and elevation, and how a ball that goes through
an arc while it wears overlaps the cells, all over the sphere alike, poles included. Quadratic
B-splines read the map between their centres.
"""

import functools
import math
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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
    entry_at,
    half_steps,
    table_rows,
)
from jaxclear.ground.numerics import OFF_THE_TIES, arc_sine, direction_angle, safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity

# Mean square of an angle [rad2] below which a direction has stood still: rounding is below.
STILL = 1e-13


# Half an arc, beside a cell, below which a contact's direction is taken as one along the wall, for
# what tells it drowns in rounding; and below which cells do not resolve it, so that nothing real
# hangs on how it changes.
DROWNED, UNRESOLVED = 1e-4, 0.2


class Swept(NamedTuple):
    """How a ball overlaps cells at most, as it goes through an arc of this `half` [rad]: across its
    way as `nearest` tells, and less beyond the arc; cells lie `away` so far from the middle of that
    and are so `long` in its direction [rad]."""

    nearest: Outline
    away: Array
    half: Scalar
    long: Array

    @property
    def cosine(self) -> Array | Scalar:
        """As of an `Outline`."""
        return self.nearest.cosine

    def at(self, level: Scalar) -> tuple[Array, Array]:
        """As of an `Outline`: means over what a cell has of the arc, and of the parabolas beyond
        it."""
        overlap, share = self.nearest.at(level)
        width = safe_sqrt(2.0 * safe_divide(overlap, self.nearest.margin))

        def until(place):
            inside = jnp.clip(place, -self.half, self.half)
            beyond = jnp.clip(place - inside, -width, width)
            covered = inside + beyond
            return covered, covered - beyond * safe_divide(beyond, width) ** 2 / 3.0

        first, last = until(self.away - 0.5 * self.long), until(self.away + 0.5 * self.long)
        covered, filled = ((b - a) / self.long for a, b in zip(first, last, strict=True))
        return overlap * filled, share * covered


class Point(NamedTuple):
    """Where a ball touches. It comes closest towards a direction (`normal`) of length 1 (not
    `directed`: 0), and goes through an arc of half that angle [rad] about it in the direction of
    its `travel`, of length 1 or less where cells do not resolve the arc."""

    normal: tuple[Scalar, ...]
    directed: Array
    travel: Float[Array, "3"]
    half_arc: Scalar


def _direction_of_spread(
    normal: Float[Array, "3"], products: Float[Array, "5"], drowned: float
) -> tuple[Array, Scalar]:
    """(direction across the mean `normal` in which directions spread most, how much more there than
    across it relative to both) from the mean products of their components. Where they spread by
    little beside an angle at which they are `drowned` [rad], it is that `_tangent_to`: the mean
    over a cell that is taken in it is that of its pressure, whichever it is."""
    xx, xy, xz, yy, yz = products
    spread = jnp.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1.0 - xx - yy]])
    across = jnp.eye(3) - jnp.outer(normal, normal)
    spread = across @ spread @ across
    both, more = _sum_and_difference(spread)
    moves = both > STILL
    some = _tangent_to(normal)
    # Cells with unlike sides would tell which way rounding points.
    spread = jnp.where(moves, spread, 0.0) + drowned * drowned * jnp.outer(some, some)
    of_both, of_more = _sum_and_difference(spread)
    largest = spread - 0.5 * (of_both - of_more) * across
    x, y, z = (largest[i, i] for i in range(3))
    of_others = jnp.where(y >= z, largest[1], largest[2])
    column = jnp.where((x >= y) & (x >= z), largest[0], of_others)
    travel = safe_divide(column, safe_sqrt(jnp.sum(column * column)))
    return travel, jnp.where(moves, safe_divide(more, both), 0.0)


def _sum_and_difference(spread: Float[Array, "3 3"]) -> tuple[Scalar, Scalar]:
    """Of the two spreads that a plane tensor has."""
    both = jnp.trace(spread)
    return both, safe_sqrt(2.0 * jnp.sum(spread * spread) - both * both)


def _tangent_to(normal: Float[Array, "3"]) -> Float[Array, "3"]:
    """A direction of length 1 across a normal, in the plane of the two axes nearest to it."""
    x, y, z = normal
    zero = jnp.zeros_like(x)
    first = jnp.abs(x) * OFF_THE_TIES >= jnp.abs(z)
    axis = jnp.where(first, jnp.stack([-y, x, zero]), jnp.stack([zero, -z, y]))
    return safe_divide(axis, safe_sqrt(jnp.sum(axis * axis)))


def spline_weights(position: Float[Array, "..."]) -> tuple[Array, Float[Array, "... 3"]]:
    """Index of the nearest cell and the weights of it and its neighbours, for a position in units
    of cells.

    Quadratic B-spline: continuous slope, weights add up to one.
    """
    nearest = jnp.round(position)
    f = position - nearest
    weights = jnp.stack([0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2], axis=-1)
    return nearest.astype(int), weights


def stencil(
    column: Float[Array, "..."], row: Float[Array, "..."], cells: tuple[int, ...], side: Any = 1
) -> tuple[Array, Array, Float[Array, "... 3 3"]]:
    """(columns, rows, weights) of the nine cells from which a spline reads a position.

    Beyond the first and last row the last cell counts, so that weights still sum to 1.

    Args:
        column: position around, in units of coarse cells.
        row: position in elevation, in units of coarse cells.
        cells: numbers of cells of the map, around and in elevation.
        side: cells of the map along one side of a coarse cell.
    """
    nearest, across = spline_weights(column)
    level, upwards = spline_weights(row)
    offsets = jnp.arange(-1, 2)
    columns = ((nearest[..., None] + offsets) * side) % cells[0]
    rows = jnp.clip((level[..., None] + offsets) * side, 0, cells[1] - 1)
    weights = across[..., :, None] * upwards[..., None, :]
    return columns[..., :, None], rows[..., None, :], weights


class SphereMap(AbstractRound):
    """Wall of a socket: azimuth from x towards y in [0, 2 pi), elevation from -pi/2 to pi/2.

    Location features: direction (x, y, z), its products (xx, xy, xz, yy, yz), which tell the arc
    that it has gone through, and one over the square of the contact's half width (`narrowness`)
    [1/rad2].
    """

    axes: ClassVar = 3
    width: ClassVar = (8, -2.0)
    extent: ClassVar = math.pi
    radius: Scalar = quantity(unit="m", meaning="radius of the socket", above=0)
    clearance: Scalar = quantity(unit="m", meaning="radial clearance in it", above=0)

    @property
    def sides(self) -> tuple[Scalar, Scalar]:
        """Of a cell at the equator, around and along [rad]."""
        around, along = self.cells
        return 2 * math.pi / around * self.coarseness, math.pi / along * self.coarse_along

    @property
    def cell(self):
        """A groove of that width is resolved where it runs along the longer side."""
        return functools.reduce(jnp.minimum, self.sides)

    def elevations(self) -> Float[np.ndarray, "steps 2"]:
        """Cosine and sine of the elevation of the centre of each row, and of the edge above."""
        along = self.cells[1]
        angles = ((0.5 * np.arange(2 * along) + 0.5) / along - 0.5) * np.pi
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def row_area(self, row):
        around, along = self.cells
        bands = np.diff(np.sin(np.linspace(-np.pi / 2, np.pi / 2, along + 1)))
        table = bands[:, None] * (2 * np.pi / around)
        return table_rows(table, row)[..., 0] * self.radius * self.radius

    def cells_per_contact(self, features, depth):
        square = self.square_in_scar(1.0 / features[8], depth)
        return (self.cell / jnp.sqrt(square),) * 2

    def directions(self) -> Float[Array, "around along 3"]:
        """Direction of the centre of each cell."""
        azimuth, (level, height) = half_steps(self.cells[0])[::2, None], self.elevations()[::2].T
        parts = azimuth[..., 0] * level, azimuth[..., 1] * level
        return jnp.stack([*parts, jnp.broadcast_to(height, self.cells)], axis=-1)

    def narrowness(self, indentation: Scalar) -> Scalar:
        """One over the square of half the width [1/rad2] of a contact of some indentation [m]. Its
        mean over a loss tells how deep that is in the contact's middle."""
        return 1.0 / self.square_width(indentation)

    def position(self, x: Any, y: Any, z: Any) -> tuple[Array, Array]:
        """Cell coordinates (azimuth, elevation) of a direction, in units of cells.

        Args:
            x, y, z: direction from the ball's centre; its length does not count.
        """
        return self.column(x, y), self.row(direction_angle(safe_sqrt(x * x + y * y), z))

    def footprint(self, features):
        point = self._point(features)
        width = safe_sqrt(2.0 * self.depth_of(safe_divide(1.0, features[8])) / self.clearance)
        return jnp.stack([*point.normal, *(point.half_arc * point.travel), width]) / self.cell

    def _point(self, features: Array) -> "Point":
        """Where a ball touches in a loss."""
        normal, length = self.mean_direction(features)
        travel, share = _direction_of_spread(jnp.stack(normal), features[3:8], DROWNED * self.cell)
        return Point(normal, length > 0, travel, arc(length) * safe_sqrt(share))

    def contact(self, volume, features):
        normal, directed, travel, half_arc = self._point(features)
        square, unresolved = half_arc * half_arc, (UNRESOLVED * self.cell) ** 2
        fixed = jax.lax.stop_gradient(travel)
        resolved = square / jnp.sqrt(square * square + unresolved * unresolved)
        travel = fixed + jax.lax.stop_gradient(resolved) * (travel - fixed)
        depth = self.depth_of(safe_divide(1.0, features[8]))
        half_width = safe_sqrt(2.0 * depth / self.clearance)
        area = self.radius * self.radius * half_width
        overlap = area * depth * (0.5 * jnp.pi * half_width + 8 / 3 * half_arc)
        root = 2 / 3 * jnp.pi * area * safe_sqrt(depth) * half_width
        deepest = safe_sqrt((volume + overlap) * self.clearance / jnp.pi) / self.radius
        place = Point(normal, directed, travel, half_arc)
        return Contact(volume, overlap, root, deepest, *self.position(*normal), place)

    def in_columns(self, contact, column):
        """Cosine and sine of the azimuth."""
        return block_row(half_steps(self.cells[0]), column, self.coarseness)

    def patch(self, contact, columns, row, depth):
        point = contact.place
        level, z = block_row(self.elevations(), row, self.coarse_along)
        x, y = columns[0] * level, columns[1] * level
        ahead, sideways = (x * a + y * b + z * c for a, b, c in (point.normal, point.travel))
        across = safe_sqrt(ahead * ahead + sideways * sideways)
        # A cell's sides, along the mean normal and along the travel.
        wide, high = self.sides
        level = safe_sqrt(x * x + y * y)
        pairs = (point.normal, ahead), (point.travel, sideways)
        around = [wide * (x * step[1] - y * step[0]) for step, _ in pairs]
        along = [high * safe_divide(step[2] - z * share, level) for step, share in pairs]

        def extent(a, b):
            """Of a cell, along a part of the one and one of the other, as two spreads add up."""
            first, second = (a * side[0] + b * side[1] for side in (around, along))
            return safe_sqrt(first * first + second * second)

        a, b = safe_divide(ahead, across), safe_divide(sideways, across)
        # Without a direction all are as near.
        cosine = jnp.where(point.directed, across, 1.0)
        away = jnp.where(point.directed, direction_angle(ahead, jnp.abs(sideways)), 0.0)
        margin = self.clearance + depth
        nearest = Outline(cosine, margin, self.clearance * (0.5 * extent(a, b) + SHARPEST))
        long = extent(-b, a) + SHARPEST
        outline = Swept(nearest, away, point.half_arc, long)
        half = arc_with_cell(point.half_arc, long)
        return Patch(outline, nearest, away, half, margin, 1.0, contact.root)

    def start(self, contact, depth):
        # In the middle of its arc. Between two cells either rounding must choose the same.
        around, along = self.cells
        place, off = (contact.column, contact.row), OFF_THE_TIES - 0.5
        column, row = (jnp.floor(each + off).astype(int) for each in place)
        there = entry_at(depth, (column % around, jnp.clip(row, 0, along - 1)))
        return self.clearance + there + contact.deepest

    def touched(self, contact, level):
        # Those of a cap about its mean direction.
        point, (around, along) = contact.place, self.cells
        # A cell that lies aslant of the travel is touched from as far as its diagonal.
        diagonal = math.sqrt(2.0) * functools.reduce(jnp.maximum, self.sides)
        reach = point.half_arc + self.angle_touched(level, diagonal)
        level = safe_sqrt(1.0 - point.normal[2] * point.normal[2])
        # A cap that holds a pole lies on all columns.
        across = jnp.sin(jnp.minimum(reach, 0.5 * jnp.pi))
        all_around = (across >= level) | ~point.directed
        wide = arc_sine(jnp.where(all_around, 1.0, safe_divide(across, level)))
        wider = 0.5 * (self.coarseness - 1.0)
        wide, high = wide * (around / (2 * jnp.pi)) + wider, reach * (along / jnp.pi) + wider
        lower = jnp.where(point.directed, jnp.maximum(-jnp.floor(high - contact.row), 0.0), 0.0)
        last = along - 1.0
        upper = jnp.where(point.directed, jnp.minimum(jnp.floor(contact.row + high), last), last)
        columns = self.columns_within(contact.column, wide, all_around)
        return Touched.of(*columns, lower, upper - lower + 1.0)

    def depth_towards(
        self, depth: Float[Array, "around along"], x: Scalar, y: Scalar, z: Scalar
    ) -> Scalar:
        """Worn depth [m] in a direction from the ball's centre.

        Args:
            depth: of each cell [m].
            x, y, z: direction; its length does not count.
        """
        sides = self.coarseness, self.coarse_along
        azimuth, elevation = (
            (at + 0.5) / side - 0.5 for at, side in zip(self.position(x, y, z), sides, strict=True)
        )
        columns, rows, weights = stencil(azimuth, elevation, self.cells, self.side)
        return jnp.sum(weights * depth[columns, rows], axis=(-2, -1))
