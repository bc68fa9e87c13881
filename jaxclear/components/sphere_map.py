"""Where a ball wears its socket: depth in azimuth and elevation. Cells share a loss as in
`contact_patch`, all over the sphere alike, poles included."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.contact_patch import depth_lost, square_width
from jaxclear.components.sphere_contact import Wall, loss_of
from jaxclear.components.stencil import stencil
from jaxclear.components.touched_cells import all_shared, taken_off
from jaxclear.components.wear_map import AbstractWearMap
from jaxclear.ground.quantity import Scalar, quantity


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
        return 1.0 / square_width(indentation, self.wall.cell, self.clearance)

    def position(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Where a direction (x, y, z) lies, in units of cells: azimuth, elevation."""
        return self.wall.position(x, y, z)

    @property
    def wall(self) -> Wall:
        """Its geometry alone."""
        return Wall(self.cells, self.radius, self.clearance)

    def deposit(self, depth, volume, features):
        lost = jax.vmap(self._lost, (None, 0, 0))(depth, volume, features)
        return depth + jnp.sum(lost, axis=0)

    def _lost(self, depth, volume, features):
        """What each cell loses in an event [m]."""
        loss = loss_of(self.wall, volume, features)
        patch = loss.patch(self.directions(), depth, self.areas()[0])
        return depth_lost(volume, patch._replace(start=loss.start(depth)))[0]

    def deposit_in_turn(self, depth, reading, pressures, volume, features):
        loss = functools.partial(loss_of, self.wall)
        shares, pressures = all_shared(loss, depth, pressures, volume, features)
        # The gap reads the depths themselves.
        if reading is not None:
            reading = taken_off(shares, pressures, reading)
        return taken_off(shares, pressures, depth), reading, pressures

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
