"""Where material is lost: what wears by which law (`Wearing`), and what every map of worn depth
does. Maps of cells are `surface.AbstractSurface`; here is the one depth of parts without a gap that
wear into each other.
"""

import math
from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete, count, quantity
from jaxclear.laws.wear import AbstractWearLaw


class Wearing(AbstractQuantified):
    """A surface that wears.

    The surface is updated whenever a contact has moved by half a cell, and at the saving times;
    companion runs halve that path, and another one has cells twice as wide, so that errors of both
    are part of the estimate. A scar narrower than
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
        coarseness: number of cells side by side that are one [1], >= 1, <= 2: either 1 or 2, which
            companion runs take.

    Raises:
        ValueError: for fewer than 4 cells around or 1 along, or another coarseness.
    """

    law: AbstractWearLaw
    cells: tuple[int, int] = eqx.field(
        static=True,
        default=(288, 20),
        converter=lambda value: tuple(value) if isinstance(value, list) else value,
        metadata={"wanted": "2 whole numbers: cells around and along"},
    )
    acceleration: Scalar = quantity(1.0, "1", at_least=0)
    worn_radius: bool = eqx.field(static=True, default=False, kw_only=True)
    updates: int | None = count(None, kw_only=True)
    coarseness: Scalar = quantity(1.0, "1", at_least=1, at_most=2, kw_only=True)

    def __check_init__(self):
        if self.cells[0] < 4 or self.cells[1] < 1:
            raise ValueError(
                f"a wear map must have at least 4 cells around and 1 along, not {self.cells}."
            )
        if concrete(self.coarseness) not in (None, 1.0, 2.0):
            raise ValueError(f"coarseness of a Wearing must be 1 or 2, not {self.coarseness:g}.")


class AbstractWearMap(AbstractQuantified):
    """Geometry of a wear map; the depth itself is an array (cells) [m] kept by the simulation."""

    cells: eqx.AbstractVar[tuple[int, int]]

    def facing(self, loss: Any, features: Array) -> tuple["AbstractWearMap", Array]:
        """What a loss is put on where the other part has become thinner; as it is unless
        overridden.

        Args:
            loss: mean depth that the other part has lost [m].
            features: location features of each event, an array (events, n).

        Returns:
            the map and the features.
        """
        return self, features

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

    def footprint(self, features: Float[Array, " n"]) -> Array | None:
        """Which cells a contact wears in an event: events whose footprints are the same to a part
        of a cell wear a surface as one event of their whole volume.

        Args:
            features: location features of the event, an array (n,).

        Returns:
            places and sizes [cells], an array; None (default) where no events are alike.
        """
        return None

    def over_three(self, depth: Float[Array, "around along"]) -> Float[Array, "around along"]:
        """Mean depth over each cell and its neighbours, three to a side; beyond the last row the
        depth is that of the row. Of a map of one cell its depth.

        Args:
            depth: worn depth of each cell [m], an array (around, along).

        Returns:
            the means [m], an array (around, along).
        """
        return depth

    def deepest(self, depth: Float[Array, "around along"]) -> Array:
        """Depth of the deepest place, from the mean depths of the cells.

        Args:
            depth: mean worn depth of each cell [m], an array (around, along).

        Returns:
            the depth [m].
        """
        return jnp.max(depth)

    def reading(self, depth: Float[Array, "around along"]) -> Any:
        """The depth in the form in which the gap reads it, made once for as long as the depth does
        not change.

        Args:
            depth: worn depth of each cell [m], an array (around, along).

        Returns:
            arrays, for the methods that read the depth; the depth itself by default.
        """
        return depth

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

    def footprint(self, features):
        return jnp.zeros(0)

    def deposit(self, depth, volume, features):
        return depth + jnp.sum(volume) / self.area
