"""How far parts without a gap have worn into each other: one depth, volume over bearing area."""

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.wear_map import AbstractWearMap
from jaxclear.ground.quantity import Scalar, quantity


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
