"""Where a mechanism stands at one position of its drives.

Newton's method on the loops, the seats of the journals following their reactions, from where the
neighbour stood: one kernel of machine code for all positions of all samples (`native`). An error of
a seat shrinks by the clearance's share of the links with every turn, so two to four turns reach
rounding. Derivatives are those of the solved equations (implicit function theorem), whatever turns
were taken.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from jaxclear.formulations.quasi_static import (
    SEAT,
    Posed,
    left_open,
    open_loops,
    solved,
    standing,
    standing_motion,
)
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.multibody.given import speed_scales
from jaxclear.multibody.start_equations import retract
from jaxclear.multibody.system import longest_arm, prepare
from jaxclear.native import while_loop
from jaxclear.results.positions import Positions

# Turns after which a position that has not settled counts as not found.
MOST_TURNS = 25
# A turn that changes coordinates [rad, shares of the longest arm] and seats by less than this is
# the last: what is left is its square, or its share by the clearances.
SETTLED = 1e-9
# By how much rows of loops that follow from the others may be open [m, 1]: what closes a loop as it
# was drawn counts as closed (`start_check.HELD`).
FOLLOWS = 1e-6
# Of a Newton step, in radians or shares of the longest arm.
LONGEST = 0.5


class Spot(eqx.Module):
    """Where the mechanism stands at one position: entries of the tree's coordinates, numbers of the
    seats that are not zero by construction, by how much the last turn moved them [1], and on which
    of its ways the mechanism is assembled: the sign of the loops' determinant, which changes where
    two of them meet and nowhere else (0 where there is no loop)."""

    q: Array
    seats: dict[str, Array]
    change: Array
    branch: Array


class Way(eqx.Module):
    """How positions are sought: which numbers of each seat move, and whether the loads pull (1) or
    push (-1)."""

    moving: dict[str, tuple[int, ...]] = eqx.field(static=True)
    side: float = eqx.field(static=True, default=1.0)

    @property
    def reversed(self) -> "Way":
        """The same under reversed loads."""
        return Way(self.moving, -self.side)

    def alone(self, scene: Posed, start: Spot) -> Spot:
        """Where the mechanism stands at one position, sought from a start."""
        return _settled(scene, start, self)

    def each(self, scene: Posed, position: Array, starts: Spot) -> Spot:
        """Where it stands at positions (positions, drives), each from its own start; pure."""
        one = lambda own, start: settle(scene.at(own), start, self)
        return jax.vmap(one)(position, starts)

    def read(self, scene: Posed, position: Array, spots: Spot) -> Positions:
        """What is read of the mechanism at positions (positions, drives) and where it stands."""
        seats = {
            name: jnp.zeros((len(position), SEAT)).at[:, list(own)].set(spots.seats[name])
            for name, own in self.moving.items()
        }
        closed = jnp.ones(len(position), bool)
        if scene.rows is not None:
            opened = jax.vmap(lambda own, s: self._open(scene.at(own), s))(position, spots)
            closed = opened <= FOLLOWS
        found = closed & (spots.change <= SETTLED)
        return Positions(scene, position, spots.q, seats, found, self.side, self.moving)

    def _open(self, scene: Posed, spot: Spot) -> Array:
        """By how much a row of the loops is open at the most [m, 1]."""
        left = left_open(scene, spot.q, self.opened(spot.seats))
        return jnp.max(jnp.abs(sp.stack(left)), initial=0.0)

    def amiss(self, scene: Posed, spot: Spot) -> tuple[dict[str, Any], dict[str, Any]]:
        """By how much loops are open [m, 1], by the joint that closes them, and how deep journals
        lie in their bearings: not at all."""
        return open_loops(*standing_motion(scene, spot.q, self.opened(spot.seats))), {}

    def opened(self, seats: dict[str, Array]) -> dict[str, tuple]:
        """The five numbers of each seat, those that are zero by construction as such."""
        return {
            name: tuple(seats[name][own.index(k)] if k in own else 0 for k in range(SEAT))
            for name, own in self.moving.items()
        }

    def middle(self) -> dict[str, Array]:
        """The numbers of each seat that move, of journals in the middle."""
        return {name: jnp.zeros(len(own)) for name, own in self.moving.items()}

    def closed(self, seats: dict[str, tuple]) -> dict[str, Array]:
        """The numbers of each seat that move."""
        return {name: sp.stack([seats[name][k] for k in own]) for name, own in self.moving.items()}


def way_of(scene: Posed) -> Way:
    """Which numbers of the seats move."""
    way = Way(dict.fromkeys(scene.gaps, ()))
    while True:
        found = moved_by(scene, way)
        if found == way:
            return way
        way = found


def moved_by(scene: Posed, way: Way) -> Way:
    """Which numbers of the seats the reactions move where those of a way may."""
    found: dict[str, tuple[int, ...]] = {}

    def seen(q, seats):
        now = standing(scene, q, way.opened(seats)).seats
        found.update({n: tuple(k for k in range(SEAT) if not sp.is_zero(now[n][k])) for n in now})
        return q

    count = prepare(scene.mechanism).topology.coordinate_count
    jax.eval_shape(seen, jnp.zeros(count), way.middle())
    return Way(found)


def turned(scene: Posed, spot: Spot, way: Way) -> Spot:
    """The spot after a turn: seats from the reactions, coordinates by Newton's step on the loops as
    the new seats have it."""
    now = standing(scene, spot.q, way.opened(spot.seats), way.side)
    seats, system = way.closed(now.seats), now.system
    count, arm = system.topology.speed_count, longest_arm(system)
    changes = [jnp.max(jnp.abs(seats[n] - spot.seats[n]), initial=0.0) / arm for n in seats]
    q = spot.q
    if count:
        left = scene.determining(left_open(scene, q, way.opened(seats)))
        rows = [[row.get(j, 0) for j in range(count)] for row in now.jacobian]
        step = sp.stack(solved(rows, [sp.neg(x) for x in left]))
        size = jnp.max(jnp.abs(step / speed_scales(system, arm)))
        q = retract(system, q, step * jnp.minimum(1.0, LONGEST / size))
        changes.append(size)
    branch = factorisation.orientation(rows) if count else jnp.zeros(())
    return Spot(q, seats, jnp.max(jnp.stack([*changes, jnp.zeros(())])), branch)


def settle(scene: Posed, start: Spot, way: Way) -> Spot:
    """The spot at which the loops close and every seat is that of its reaction; pure, with the
    derivatives of the solved equations with respect to the numbers of the scene."""
    arrays, rest = eqx.partition(scene, eqx.is_inexact_array)

    @jax.custom_jvp
    def found(arrays, start):
        own = eqx.combine(arrays, rest)
        more = lambda s: ~(s[0].change <= SETTLED) & (s[1] < MOST_TURNS)
        turn = lambda s: (turned(own, s[0], way), s[1] + 1)
        first = eqx.tree_at(lambda s: s.change, start, jnp.full((), jnp.inf))
        return while_loop(more, turn, (first, jnp.zeros((), int)))[0]

    @found.defjvp
    def tangents(primals, moved):
        spot = found(*primals)
        return spot, _tangent(primals[0], moved[0], rest, spot, way)

    return found(arrays, start)


_settled = eqx.filter_jit(settle)


def _tangent(arrays: Any, moved: Any, rest: Any, spot: Spot, way: Way) -> Spot:
    """How the spot moves with the numbers of the scene: implicit function theorem."""
    system = prepare(eqx.combine(arrays, rest).mechanism)
    count = system.topology.speed_count
    flat, unflatten = ravel_pytree(spot.seats)
    place = lambda step: retract(system, spot.q, step)

    def equations(arrays, unknowns):
        scene, seats = eqx.combine(arrays, rest), unflatten(unknowns[count:])
        now = standing(scene, place(unknowns[:count]), way.opened(seats), way.side)
        misses = unknowns[count:] - ravel_pytree(way.closed(now.seats))[0]
        return jnp.concatenate([sp.stack(now.left), misses])

    here = jnp.concatenate([jnp.zeros(count), flat])
    rows = jax.jacfwd(equations, argnums=1)(arrays, here)
    right = jax.jvp(lambda own: equations(own, here), (arrays,), (moved,))[1]
    # The inverse first, so that what is solved for stays linear and can be transposed.
    inverse = jax.vmap(lambda unit: _eliminated(rows, unit))(jnp.eye(len(here)))
    found = -jnp.sum(inverse * right[:, None], axis=0)
    q = jax.jvp(place, (here[:count],), (found[:count],))[1]
    return Spot(q, unflatten(found[count:]), jnp.zeros(()), jnp.zeros(()))


def _eliminated(rows: Array, right: Array) -> Array:
    lines = [jnp.append(row, value) for row, value in zip(rows, right, strict=True)]
    return jnp.stack(factorisation.eliminate(lines))
