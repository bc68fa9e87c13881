"""Where a ball wears its socket: depth in azimuth and elevation. Cells share a loss as in
`contact_patch`, all over the sphere alike, poles included."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.contact_patch import (
    SHARPEST,
    Outline,
    Patch,
    Way,
    arc,
    arc_with_cell,
    depth_lost,
    depth_of,
    point_contact,
    point_sunk,
    square_width,
)
from jaxclear.components.stencil import stencil
from jaxclear.components.wear_map import AbstractWearMap, direction_angle
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity

# Mean square of an angle [rad2] below which a direction has stood still: rounding is below.
STILL = 1e-13


class SphereMap(AbstractWearMap):
    """Wall of a socket: azimuth from x towards y in [0, 2 pi), elevation from -pi/2 to pi/2.

    Location features: direction (x, y, z), its products (xx, xy, xz, yy, yz), which tell the arc
    that it has gone through, and one over the square of the contact's half width (`narrowness`)
    [1/rad2].
    """

    cells: tuple[int, int] = eqx.field(static=True)
    radius: Scalar = quantity(unit="m", meaning="radius of the socket", above=0)
    clearance: Scalar = quantity(unit="m", meaning="radial clearance in it", above=0)

    def areas(self) -> Float[Array, "around along"]:
        around, along = self.cells
        bands = jnp.diff(jnp.sin(jnp.linspace(-jnp.pi / 2, jnp.pi / 2, along + 1)))
        return jnp.ones((around, 1)) * bands * (2 * jnp.pi / around) * self.radius**2

    def angles(self) -> Float[Array, " around"]:
        """Azimuth of the centre of each cell [rad]."""
        return (jnp.arange(self.cells[0]) + 0.5) * (2 * jnp.pi / self.cells[0])

    def narrowness(self, indentation: Scalar) -> Scalar:
        """One over the square of half the width [1/rad2] of a contact of some indentation [m]. Its
        mean over a loss tells how deep that is in the contact's middle."""
        return 1.0 / square_width(indentation, self._cell, self.clearance)

    @property
    def _cell(self) -> float:
        """Mean of a cell's two sides at the equator [rad]."""
        around, along = self.cells
        return 0.5 * (2 * math.pi / around + math.pi / along)

    def position(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Where a direction (x, y, z) lies, in units of cells: azimuth, elevation."""
        around, along = self.cells
        azimuth = direction_angle(x, y)
        elevation = direction_angle(safe_sqrt(x * x + y * y), z)
        return azimuth * (around / (2 * jnp.pi)) - 0.5, (elevation / jnp.pi + 0.5) * along - 0.5

    def directions_of(self, features):
        return features[..., :3]

    def covered(self, features):
        square = safe_divide(1.0, features[..., 8])
        return safe_sqrt(square), 0.25 * square

    def deposit(self, depth, volume, features):
        lost = jax.vmap(self._lost, (None, 0, 0))(depth, volume, features)
        return depth + jnp.sum(lost, axis=0)

    def _lost(self, depth, volume, features):
        """What each cell loses in an event [m]."""
        mean, products, narrowness = features[:3], features[3:8], features[8]
        length = safe_sqrt(jnp.sum(mean * mean))
        normal = safe_divide(mean, length)
        travel, share = _travel(normal, products)
        half_arc = arc(length) * safe_sqrt(share)
        places = self.directions()
        ahead, sideways = places @ normal, jnp.abs(places @ travel)
        c, s = jnp.cos(half_arc), jnp.sin(half_arc)
        inside = sideways * c < ahead * s
        beside = safe_sqrt(ahead * ahead + sideways * sideways)
        cosine = jnp.where(inside, beside, ahead * c + sideways * s)
        # Without a direction all are as near.
        cosine = jnp.where(length > 0, cosine, 1.0)
        overlap = depth_of(safe_divide(1.0, narrowness), self._cell, self.clearance)
        rounded = lambda cosine: (
            self.clearance * (0.5 * self._cell * safe_sqrt(1.0 - cosine * cosine) + SHARPEST)
        )
        room = self.clearance + depth
        load = point_contact(overlap, self.radius, self.clearance, half_arc)
        sunk = point_sunk(volume + load.overlap, self.radius, self.clearance)
        beside = jnp.where(length > 0, beside, 1.0)
        way = Way(
            direction_angle(ahead, sideways),
            Outline(beside, room, rounded(beside)),
            arc_with_cell(half_arc, self._cell),
            room,
        )
        patch = Patch(
            Outline(cosine, room, rounded(cosine)),
            way,
            self.areas()[0],
            1.0,
            self.clearance + depth.ravel()[jnp.argmax(cosine)] + sunk,
            load,
        )
        return depth_lost(volume, patch)[0]

    def directions(self) -> Float[Array, "around along 3"]:
        """Direction of the centre of each cell."""
        along = self.cells[1]
        azimuth = self.angles()[:, None]
        elevation = ((jnp.arange(along) + 0.5) / along - 0.5) * jnp.pi
        level = jnp.cos(elevation)
        parts = (jnp.cos(azimuth) * level, jnp.sin(azimuth) * level, jnp.sin(elevation))
        return jnp.stack([*parts[:2], jnp.broadcast_to(parts[2], self.cells)], axis=-1)

    def reading(self, depth):
        return depth

    def depth_towards(
        self, depth: Float[Array, "around along"], x: Scalar, y: Scalar, z: Scalar
    ) -> Scalar:
        """Worn depth in the direction (x, y, z) [m]."""
        columns, rows, weights = stencil(*self.position(x, y, z), self.cells)
        return jnp.sum(weights * depth[columns, rows], axis=(-2, -1))


def _travel(normal: Float[Array, "3"], products: Float[Array, "5"]) -> tuple[Array, Scalar]:
    """(direction across the mean `normal` in which directions spread most, how much more there than
    across it relative to both) from the mean products of their components."""
    xx, xy, xz, yy, yz = products
    spread = jnp.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1.0 - xx - yy]])
    across = jnp.eye(3) - jnp.outer(normal, normal)
    spread = across @ spread @ across
    both = jnp.trace(spread)
    more = safe_sqrt(2.0 * jnp.sum(spread * spread) - both * both)
    largest = spread - 0.5 * (both - more) * across
    column = largest[jnp.argmax(jnp.diagonal(largest))]
    there = both > STILL
    travel = safe_divide(column, safe_sqrt(jnp.sum(column * column)))
    return jnp.where(there, travel, 0.0), jnp.where(there, safe_divide(more, both), 0.0)
