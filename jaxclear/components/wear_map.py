"""Where material is lost: worn depth on a cylinder (theta x z) or a sphere (azimuth x elevation).

Every cell loses what its own pressure takes, which follows from its own gap on the worn surface
(`contact_patch`): on a cylinder also along the tilted journal. Volume is conserved to rounding, and
depth is a smooth function of where and how much. What is lost between two saving times is spread
over the arc that the contact has gone through. Quadratic B-splines read the depth back when the
worn surface enters the gap.
"""

import functools
import math
from abc import abstractmethod

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.contact_patch import depth_lost, square_width
from jaxclear.components.cylinder_contact import Wall, loss_of
from jaxclear.components.touched_cells import (
    entry,
    through,
    ways,
    with_entry,
    worn_in_turn,
)
from jaxclear.ground.numerics import direction_angle, positive_part
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.wear import AbstractWearLaw

# Angle [rad] to either side of a contact that is looked at first.
REACH = 0.6


class Wearing(AbstractQuantified):
    """A surface that wears: its law (of this surface alone), and the number of cells around and
    along (azimuth and elevation on a sphere; of a guide and its slider only along). A scar narrower
    than a few of them has too small a depth, and the run says so; the tilted journal of a
    `JournalBearing` takes some hundred along.

    `acceleration` multiplies the worn volume: one simulated cycle standing for many (linear
    extrapolation, as in cycle-jump schemes). `worn_radius`: whether what the contact law takes from
    the geometry, its stiffness say, is that of the radius as worn at the contact, not as made.
    """

    law: AbstractWearLaw
    cells: tuple[int, int] = eqx.field(
        static=True,
        default=(288, 20),
        converter=lambda given: tuple(given) if isinstance(given, list) else given,
        metadata={"wanted": "2 whole numbers: cells around and along"},
    )
    acceleration: Scalar = quantity(1.0, "1", "worn volume per simulated volume", at_least=0)
    worn_radius: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        if self.cells[0] < 4 or self.cells[1] < 1:
            raise ValueError(
                f"a wear map must have at least 4 cells around and 1 along, not {self.cells}."
            )


def mean_along(depth: Float[Array, "around along"]) -> Float[Array, "around along"]:
    """Mean depth over each cell and those before and after it, along."""
    wider = jnp.concatenate([depth[:, :1], depth, depth[:, -1:]], axis=1)
    return (wider[:, :-2] + depth + wider[:, 2:]) / 3


class AbstractWearMap(AbstractQuantified):
    """Geometry of a wear map; the depth itself is an array (cells) [m] kept by the simulation."""

    cells: eqx.AbstractVar[tuple[int, int]]

    @property
    def flat(self) -> bool:
        """Whether it is that of flat walls, which a part can leave: locations are then no numbers,
        and the run ends. It is not unless overridden."""
        return False

    @abstractmethod
    def areas(self) -> Float[Array, "around along"]:
        """Area of each cell [m2]."""

    def over_three(self, depth: Float[Array, "around along"]) -> Float[Array, "around along"]:
        """Mean depth over each cell and those beside it, three to a side; beyond a last row it is
        as deep as there."""
        around = (jnp.roll(depth, 1, 0) + depth + jnp.roll(depth, -1, 0)) / 3
        return mean_along(around)

    @abstractmethod
    def reading(self, depth):
        """The depth in the form in which the gap reads it; made once for as long as the depth stays
        as it is.
        """

    @abstractmethod
    def deposit(self, depth, volume, features):
        """Depth after losing `volume` (events,) [m3] at `features` (events, n): means of each
        event's location, weighted by what was lost there.
        """

    def deposit_in_turn(self, depth, reading, pressures, volume, features):
        """(depth, its reading, `pressures`) after such a loss, within a kernel: of many cells, cell
        by cell, and only those that are touched. `reading`: None where no gap reads it.
        `pressures`: an array like the depth for each event, to be written over."""
        depth = self.deposit(depth, volume, features)
        return depth, None if reading is None else self.reading(depth), pressures


class CylinderMap(AbstractWearMap):
    """Wall of a bearing or journal: theta from x towards y in [0, 2 pi), z from -length/2 to
    length/2.

    Location features: direction (x, y), by how much the overlap falls towards the other end [m],
    one over half the contact's width (`narrowness`) [1/rad] and the end that carries (-1 or 1; 0:
    the whole length).
    """

    cells: tuple[int, int] = eqx.field(static=True)
    radius: Scalar = quantity(unit="m", meaning="radius of the wall", above=0)
    length: Scalar = quantity(unit="m", meaning="length of the wall", above=0)
    clearance: Scalar = quantity(unit="m", meaning="radial clearance in it", above=0)

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

    def narrowness(self, indentation: Scalar) -> Scalar:
        """One over half the width [1/rad] of a contact of some indentation [m]. Its mean over a
        loss tells how deep that is in the contact's middle."""
        return 1.0 / jnp.sqrt(square_width(indentation, self._cell, self.clearance))

    @property
    def _cell(self) -> float:
        return 2 * math.pi / self.cells[0]

    def position(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Where a place of the wall [m] lies, in units of cells: around, along."""
        return self._column(x, y), (z / self.length + 0.5) * self.cells[1] - 0.5

    def _column(self, x, y):
        return direction_angle(x, y) * (self.cells[0] / (2 * jnp.pi)) - 0.5

    @property
    def wall(self) -> Wall:
        """Its geometry alone."""
        return Wall(self.cells, self.radius, self.length, self.clearance)

    def deposit(self, depth, volume, features):
        around = self.cells[0]
        reach = math.ceil(REACH * around / (2 * math.pi))

        # A table: XLA would work them out anew for every cell of a column.
        table = ways(around)

        def wide():
            whole = jax.vmap(lambda *event: self._lost(table, depth, depth, *event))
            return depth + jnp.sum(whole(volume, features)[0], axis=0)

        if 2 * reach + 1 >= around:
            return wide()
        towards = direction_angle(features[:, 0], features[:, 1]) * (around / (2 * jnp.pi))
        first = (jnp.floor(towards).astype(int) - reach) % around
        width = 2 * reach + 1
        twice = jnp.concatenate([depth, depth[:width]])
        near = lambda these, start: jax.lax.dynamic_slice_in_dim(these, start, width)
        table_twice = jnp.concatenate([table, table[:width]])
        lost, fits = jax.vmap(
            lambda start, *event: self._lost(
                near(table_twice, start), near(twice, start), depth, *event
            )
        )(first, volume, features)

        def narrow():
            # Slices: to scatter costs XLA several times as much as the losses themselves.
            gained = jnp.zeros_like(twice)
            for start, own in zip(first, lost, strict=True):
                there = jax.lax.dynamic_slice_in_dim(gained, start, width)
                gained = jax.lax.dynamic_update_slice_in_dim(gained, there + own, start, 0)
            return depth + gained[:around].at[:width].add(gained[around:])

        # A choice of its own for each sample of a batch would be both branches: the wide one, which
        # costs several times as much, is entered where a sample needs it.
        fit = jnp.all(fits)
        rare = lambda: jnp.where(fit, narrow(), wide())
        return jax.lax.cond(eqxi.unvmap_all(fit), narrow, rare)

    def _lost(self, table, depth, of_all, volume, features):
        """(what each cell of columns in these directions, worn so deep [m], loses in an event [m],
        whether no other column is reached)."""
        loss = loss_of(self.wall, volume, features)
        columns = jax.tree.map(lambda each: each[:, None], loss.columns(table))
        patch = loss.cell(columns, jnp.arange(self.cells[1]), depth, loss.start(of_all))
        lost, level = depth_lost(volume, patch._replace(area=self.areas()[0]))
        return lost, (loss.reach(level) < REACH) | (volume == 0)

    def deposit_in_turn(self, depth, reading, pressures, volume, features):
        loss = functools.partial(loss_of, self.wall)
        worn = depth, reading, pressures
        return worn_in_turn(loss, self._read_anew, *worn, volume, features)

    def _read_anew(self, touched, depth, reading):
        """The reading where cells of these columns have changed."""
        around = self.cells[0]

        def one(_, place, reading):
            column = place[0]
            ends = []
            for own, (row, inside) in zip(reading, self._edges(), strict=True):
                last, further = (entry(depth, (column, each)) for each in (row, inside))
                ends.append(with_entry(own, (column + 1,), _to_the_edge(last, further)))
            return tuple(ends)

        reading = through(touched, (around, 1), one, reading, True)
        # The last column once more in front of the first, the first behind the last.
        for to, of in ((0, around), (around + 1, 1)):
            reading = tuple(with_entry(own, (to,), entry(own, (of,))) for own in reading)
        return reading

    def reading(self, depth):
        """Of each row at an end the depth at the edge, column by column, the last one in front and
        the first one behind: what a place reads of it is one small slice."""
        rows = []
        for row, inside in self._edges():
            edge = _to_the_edge(depth[:, row], depth[:, inside])
            rows.append(jnp.concatenate([edge[-1:], edge, edge[:1]]))
        return tuple(rows)

    def _edges(self) -> list[tuple[int, int]]:
        """(row, the next further inside) at the lower and the upper end; one of a single row."""
        last = self.cells[1] - 1
        return [(0, 1), (last, last - 1)] if last else [(0, 0)]

    def depth_at_end(self, reading: tuple, x: Scalar, y: Scalar, end: int) -> Scalar:
        """Worn depth at the direction (x, y) of the row at the lower (-1) or upper (1) end, in
        metres.
        """
        position = self._column(x, y)
        nearest = jnp.round(position)
        f = position - nearest
        first = nearest.astype(int) % self.cells[0]
        own = reading[0 if end < 0 else -1]
        left, here, right = jax.lax.dynamic_slice_in_dim(own, first, 3)
        # A quadratic B-spline.
        curvature = 0.5 * (left + right) - here
        return 0.125 * (left + 6.0 * here + right) + f * (0.5 * (right - left) + f * curvature)


def _to_the_edge(last: Array, inside: Array) -> Array:
    """Depth [m] at the edge of a last cell, beside that of the one further inside."""
    return last + 0.5 * positive_part(last - inside)
