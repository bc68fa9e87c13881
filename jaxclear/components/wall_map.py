"""Where a slider wears its guide, and a guide its slider: depth along the two flat walls of either.
Cells share a loss as in `wall_contact`."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.contact_patch import depth_lost
from jaxclear.components.touched_cells import entry, through, with_entry, worn_in_turn
from jaxclear.components.wall_contact import Wall, loss_of
from jaxclear.components.wear_map import AbstractWearMap, mean_along
from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import Scalar, quantity


class WallMap(AbstractWearMap):
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

    def areas(self) -> Float[Array, "2 along"]:
        return jnp.full(self.cells, 1.0) * self.wall.area

    def over_three(self, depth):
        # Either row is a wall of its own.
        return mean_along(depth)

    def places(self) -> Float[Array, " along"]:
        """Where the centre of each cell lies along the guide (or slider) [m]."""
        return self.middle + self.wall.place(jnp.arange(self.cells[1]))

    @property
    def flat(self):
        return True

    @property
    def wall(self) -> Wall:
        """Its geometry alone."""
        return Wall(self.cells, self.length, self.face, self.breadth, self.clearance)

    def within(self, place: Scalar) -> Array:
        """Whether a place along the guide [m] is on the walls."""
        return jnp.abs(place - self.middle) <= 0.5 * self.length

    def deposit(self, depth, volume, features):
        lost = jax.vmap(self._lost, (None, 0, 0))(depth, volume, features)
        return depth + jnp.sum(lost, axis=0)

    def _lost(self, depth, volume, features):
        """What each cell loses in an event [m]."""
        loss = loss_of(self.wall, volume, features)
        side = features[4].astype(int)
        own = jax.lax.dynamic_slice(depth, (side, jnp.zeros_like(side)), (1, self.cells[1]))
        patch = loss.cell(None, jnp.arange(self.cells[1]), own, loss.start(depth))
        lost, _ = depth_lost(volume, patch._replace(area=self.areas()[0]))
        return jnp.where(jnp.arange(2)[:, None] == side, lost, 0.0)

    def deposit_in_turn(self, depth, reading, pressures, volume, features):
        loss = functools.partial(loss_of, self.wall)
        worn = depth, reading, pressures
        return worn_in_turn(loss, self._read_anew, *worn, volume, features)

    def _read_anew(self, touched, depth, reading):
        """The reading where these cells of a wall have changed."""

        def one(_, place, reading):
            return with_entry(reading, (place[0], place[1] + 1), entry(depth, place))

        reading = through(touched, self.cells, one, reading, True)
        for side in (0, 1):
            for last, inside, beyond in self._ends():
                edge = _beyond(entry(depth, (side, last)), entry(depth, (side, inside)))
                reading = with_entry(reading, (side, beyond), edge)
        return reading

    def _ends(self) -> tuple[tuple[int, int, int], ...]:
        """(last cell of a wall, the next further inside, the place beyond in the reading) at its
        lower and upper end."""
        last = self.cells[1] - 1
        return (0, min(1, last), 0), (last, max(last - 1, 0), last + 2)

    def reading(self, depth):
        """The cells of each wall, with one more beyond either end: what a place reads of it is one
        small slice."""
        beyond = [_beyond(depth[:, last], depth[:, inside]) for last, inside, _ in self._ends()]
        return jnp.concatenate([beyond[0][:, None], depth, beyond[1][:, None]], axis=1)

    def depth_at(self, reading: Array, side: int, place: Scalar) -> Scalar:
        """Worn depth [m] of a wall (0 or 1) at a place along the guide [m]."""
        along = self.cells[1]
        position = ((place - self.middle) / self.length + 0.5) * along - 0.5
        nearest = jnp.clip(jnp.round(position), 0.0, along - 1.0)
        f = position - nearest
        first = side, nearest.astype(int)
        left, here, right = jax.lax.dynamic_slice(reading, first, (1, 3))[0]
        # A quadratic B-spline.
        curvature = 0.5 * (left + right) - here
        return 0.125 * (left + 6.0 * here + right) + f * (0.5 * (right - left) + f * curvature)

    def depth_at_end(self, reading: Array, side: int, end: int) -> Scalar:
        """Worn depth [m] of a wall (0 or 1) at its lower (-1) or upper (1) end."""
        first = 0 if end < 0 else self.cells[1]
        return 0.5 * (entry(reading, (side, first)) + entry(reading, (side, first + 1)))


def _beyond(last: Array, inside: Array) -> Array:
    """Depth [m] beyond a last cell, beside that of the one further inside."""
    return last + positive_part(last - inside)
