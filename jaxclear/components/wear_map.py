"""Where material is lost: worn depth on a cylinder (theta x z) or a sphere (azimuth x elevation).

A volume is spread with quadratic B-splines around the contact's direction and, on a cylinder, over
the length on which the tilted journal overlaps the wall, so depth is a smooth function of where and
how much; weights add up to one, so volume is conserved to rounding. The same splines read the depth
back when the worn surface enters the gap.
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.numerics import TINY_SQUARE, safe_sqrt
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.wear import AbstractWearLaw


class Wearing(AbstractQuantified):
    """A surface that wears: its law (of this surface alone), and the number of cells around and
    along (azimuth and elevation on a sphere).

    `acceleration` multiplies the worn volume: one simulated cycle standing for many (linear
    extrapolation, as in cycle-jump schemes).
    """

    law: AbstractWearLaw
    cells: tuple[int, int] = eqx.field(
        static=True,
        default=(72, 20),
        converter=lambda given: tuple(given) if isinstance(given, list) else given,
        metadata={"wanted": "2 whole numbers: cells around and along"},
    )
    acceleration: Scalar = quantity(1.0, "1", "worn volume per simulated volume", at_least=0)

    def __check_init__(self):
        if self.cells[0] < 4 or self.cells[1] < 1:
            raise ValueError(
                f"a wear map must have at least 4 cells around and 1 along, not {self.cells}."
            )


class AbstractWearMap(AbstractQuantified):
    """Geometry of a wear map; the depth itself is an array (cells) [m] kept by the simulation."""

    cells: eqx.AbstractVar[tuple[int, int]]

    @abstractmethod
    def areas(self) -> Float[Array, "around along"]:
        """Area of each cell [m2]."""

    @abstractmethod
    def reading(self, depth):
        """The depth in the form in which the gap reads it; made once for as long as the depth stays
        as it is.
        """

    @abstractmethod
    def deposit(self, depth, volume, features):
        """Depth after losing `volume` (events,) [m3] at `features` (events, n), each event's
        location.
        """


def spline_weights(position: Float[Array, "..."]) -> tuple[Array, Float[Array, "... 3"]]:
    """Index of the nearest cell and the weights of it and its neighbours, for a position in units
    of cells.

    Quadratic B-spline: continuous slope, weights add up to one.
    """
    nearest = jnp.round(position)
    f = position - nearest
    weights = jnp.stack([0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2], axis=-1)
    return nearest.astype(int), weights


def direction_angle(x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    """atan2(y, x), and 0 with zero derivative at the origin, where a direction does not exist."""
    somewhere = x * x + y * y > TINY_SQUARE
    return jnp.where(
        somewhere, jnp.arctan2(jnp.where(somewhere, y, 0.0), jnp.where(somewhere, x, 1.0)), 0.0
    )


class CylinderMap(AbstractWearMap):
    """Wall of a bearing or journal: theta from x towards y in [0, 2 pi), z from -length/2 to
    length/2.

    Location features: direction (x, y), overlap length [m] and the end it starts from (-1 or 1).
    """

    cells: tuple[int, int] = eqx.field(static=True)
    radius: Scalar = quantity(unit="m", meaning="radius of the wall", above=0)
    length: Scalar = quantity(unit="m", meaning="length of the wall", above=0)

    def areas(self) -> Float[Array, "around along"]:
        around, along = self.cells
        return (
            jnp.full(self.cells, 1.0) * (2 * jnp.pi * self.radius / around) * (self.length / along)
        )

    def angles(self) -> Float[Array, " around"]:
        """Direction of the centre of each cell [rad]."""
        return (jnp.arange(self.cells[0]) + 0.5) * (2 * jnp.pi / self.cells[0])

    def heights(self) -> Float[Array, " along"]:
        """z of the centre of each cell [m]."""
        return self.length * ((jnp.arange(self.cells[1]) + 0.5) / self.cells[1] - 0.5)

    def deposit(self, depth, volume, features):
        around, along = self.cells
        x, y, overlap, end = jnp.moveaxis(features, -1, 0)
        nearest, weights = spline_weights(direction_angle(x, y) * (around / (2 * jnp.pi)) - 0.5)
        columns = (nearest[:, None] + jnp.arange(-1, 2)) % around
        edges = jnp.arange(along + 1) * (self.length / along)
        # A triangular pressure over the overlap, largest at the end: share beyond distance s is (1
        # - s/overlap)^2.
        remaining = (
            jnp.clip(1.0 - edges / jnp.maximum(overlap, 1e-9 * self.length)[:, None], 0.0, 1.0) ** 2
        )
        remaining = remaining.at[:, -1].set(0.0)
        rows = remaining[:, :-1] - remaining[:, 1:]
        rows = jnp.where(end[:, None] < 0, rows, rows[:, ::-1])
        lost = volume[:, None, None] * weights[:, :, None] * rows[:, None, :]
        return depth.at[columns].add(lost / self.areas()[0, 0])

    def reading(self, depth):
        """For the lower and upper end: coefficients (around, 3) of the spline 1, f, f^2 around each
        cell, contiguous so that one lookup costs one small slice."""
        rows = []
        for edge in (depth[:, 0], depth[:, -1]):
            left, right = jnp.roll(edge, 1), jnp.roll(edge, -1)
            rows.append(
                jnp.stack(
                    [
                        0.125 * (left + 6.0 * edge + right),
                        0.5 * (right - left),
                        0.5 * (left + right) - edge,
                    ],
                    -1,
                )
            )
        return tuple(rows)

    def depth_at_end(self, reading: tuple, x: Scalar, y: Scalar, end: int) -> Scalar:
        """Worn depth at the direction (x, y) of the row at the lower (-1) or upper (1) end, in
        metres.
        """
        around = self.cells[0]
        position = direction_angle(x, y) * (around / (2 * jnp.pi)) - 0.5
        nearest = jnp.round(position)
        f = position - nearest
        constant, slope, curvature = reading[0 if end < 0 else 1][nearest.astype(int) % around]
        return constant + f * (slope + f * curvature)


class SphereMap(AbstractWearMap):
    """Wall of a socket: azimuth from x towards y in [0, 2 pi), elevation from -pi/2 to pi/2.

    Location features: direction (x, y, z). At a pole the azimuth is undefined and the smallest
    cells share the loss.
    """

    cells: tuple[int, int] = eqx.field(static=True)
    radius: Scalar = quantity(unit="m", meaning="radius of the socket", above=0)

    def areas(self) -> Float[Array, "around along"]:
        around, along = self.cells
        bands = jnp.diff(jnp.sin(jnp.linspace(-jnp.pi / 2, jnp.pi / 2, along + 1)))
        return jnp.ones((around, 1)) * bands * (2 * jnp.pi / around) * self.radius**2

    def angles(self) -> Float[Array, " around"]:
        """Azimuth of the centre of each cell [rad]."""
        return (jnp.arange(self.cells[0]) + 0.5) * (2 * jnp.pi / self.cells[0])

    def _stencil(self, x, y, z):
        around, along = self.cells
        azimuth = direction_angle(x, y)
        elevation = direction_angle(safe_sqrt(x * x + y * y), z)
        column, across = spline_weights(azimuth * (around / (2 * jnp.pi)) - 0.5)
        row, upwards = spline_weights((elevation / jnp.pi + 0.5) * along - 0.5)
        offsets = jnp.arange(-1, 2)
        columns = (column[..., None] + offsets) % around
        # What falls beyond a pole is kept in the last band, so that no volume is lost.
        rows = jnp.clip(row[..., None] + offsets, 0, along - 1)
        return (
            columns[..., :, None],
            rows[..., None, :],
            across[..., :, None] * upwards[..., None, :],
        )

    def deposit(self, depth, volume, features):
        columns, rows, weights = self._stencil(*jnp.moveaxis(features, -1, 0))
        lost = volume[:, None, None] * weights
        return depth.at[columns, rows].add(lost / self.areas()[columns, rows])

    def reading(self, depth):
        return depth

    def depth_towards(
        self, depth: Float[Array, "around along"], x: Scalar, y: Scalar, z: Scalar
    ) -> Scalar:
        """Worn depth in the direction (x, y, z) [m]."""
        columns, rows, weights = self._stencil(x, y, z)
        return jnp.sum(weights * depth[columns, rows], axis=(-2, -1))
