"""A mechanism over positions of its drives, without time: `positions`.

Newton's method on the loops, the seats of the journals following their reactions, from where the
neighbour stood: one kernel of machine code for all positions of all samples (`native`). An error of
a seat shrinks by the clearance's share of the links with every turn, so two to four turns reach
rounding. Derivatives are those of the solved equations (implicit function theorem), whatever turns
were taken.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxclear.formulations.quasi_static import SEAT, Posed, left_open, posed, solved, standing
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_flags, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.wording import described
from jaxclear.multibody.assembly import assemble_arrays, is_sound
from jaxclear.multibody.given import speed_scales
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.start_equations import retract
from jaxclear.multibody.system import longest_arm, prepare
from jaxclear.native import while_loop
from jaxclear.results.positions import Positions

# Turns after which a position that has not settled counts as not found.
MOST_TURNS = 25
# A turn that changes coordinates [rad, shares of the longest arm] and seats by less than this is
# the last: what is left is its square, or its share by the clearances.
SETTLED = 1e-9
# Steps from a position to the next that lead along the way on which the mechanism was assembled.
STEPS_BETWEEN = 4
# Steps where the way of assembly changes; and a coordinate [rad, m] that moves further than this
# within STEPS_BETWEEN of a position has jumped.
MOST_BETWEEN, JUMP = 64, 1.0
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

    def opened(self, seats: dict[str, Array]) -> dict[str, tuple]:
        """The five numbers of each seat, those that are zero by construction as such."""
        return {
            name: tuple(seats[name][own.index(k)] if k in own else 0 for k in range(SEAT))
            for name, own in self.moving.items()
        }

    def closed(self, seats: dict[str, tuple]) -> dict[str, Array]:
        """The numbers of each seat that move."""
        return {name: sp.stack([seats[name][k] for k in own]) for name, own in self.moving.items()}


def way_of(scene: Posed) -> Way:
    """Which numbers of the seats move; raises `ValueError` for what has no unique reactions."""
    system = prepare(scene.mechanism)
    way = Way(dict.fromkeys(scene.gaps, ()))
    while True:
        found: dict[str, tuple[int, ...]] = {}

        def seen(q, seats, way=way, found=found):
            now = standing(scene, q, way.opened(seats)).seats
            found.update(
                {n: tuple(k for k in range(SEAT) if not sp.is_zero(now[n][k])) for n in now}
            )
            return q

        seats = {name: jnp.zeros(len(own)) for name, own in way.moving.items()}
        jax.eval_shape(seen, jnp.zeros(system.topology.coordinate_count), seats)
        if found == way.moving:
            return way
        way = Way(found)


def turned(scene: Posed, spot: Spot, way: Way) -> Spot:
    """The spot after a turn: seats from the reactions, coordinates by Newton's step on the loops as
    the new seats have it."""
    now = standing(scene, spot.q, way.opened(spot.seats), way.side)
    seats, system = way.closed(now.seats), now.system
    count, arm = system.topology.speed_count, longest_arm(system)
    changes = [jnp.max(jnp.abs(seats[n] - spot.seats[n]), initial=0.0) / arm for n in seats]
    q = spot.q
    if count:
        left = left_open(scene, q, way.opened(seats))
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


def positions_at(
    scene: Posed, position: Float[Array, "positions drives"], starts: Spot, way: Way
) -> Positions:
    """The mechanism at positions of its drives, each from its own start; pure."""
    spots = jax.vmap(lambda own, start: settle(scene.at(own), start, way))(position, starts)
    seats = {
        name: jnp.zeros((len(position), SEAT)).at[:, list(own)].set(spots.seats[name])
        for name, own in way.moving.items()
    }
    finite = jnp.all(jnp.isfinite(spots.q), axis=-1)
    # From where the nominal mechanism stands a sample may fall to another way of assembly.
    found = finite & (spots.change <= SETTLED) & (spots.branch == starts.branch)
    return Positions(scene, position, spots.q, seats, found, way.side, way.moving)


@eqx.filter_jit
def _settled(scene: Posed, start: Spot, way: Way) -> Spot:
    return settle(scene, start, way)


@eqx.filter_jit
def _assembled(scene: Posed, way: Way) -> tuple[Spot, Array]:
    start = assemble_arrays(scene.mechanism)
    seats = {name: jnp.zeros(len(own)) for name, own in way.moving.items()}
    spot = Spot(start.coordinates, seats, jnp.zeros(()), jnp.zeros(()))
    return spot, is_sound(scene.mechanism, start)


def _led(scene: Posed, start: Spot, before: np.ndarray, now: np.ndarray, way: Way) -> Spot:
    """The spot at the next position, led there in steps: in many more where the way of assembly
    changes. Raises `ValueError` where it jumps, however short the steps."""
    for count in (STEPS_BETWEEN, MOST_BETWEEN):
        spot, longest = start, 0.0
        for share in np.arange(1, count + 1) / count:
            last, spot = spot, _settled(scene.at(before + share * (now - before)), spot, way)
            longest = max(longest, float(jnp.max(jnp.abs(spot.q - last.q), initial=0.0)))
        if spot.branch == start.branch or not spot.change <= SETTLED:
            return spot
    # Two ways of assembly that meet, as those of a parallelogram, are passed step by step.
    if longest > JUMP * STEPS_BETWEEN / MOST_BETWEEN:
        named = ", ".join(f"{n} = {x:.6g}" for n, x in zip(scene.held, now, strict=True))
        raise ValueError(
            f"the mechanism jumps to another way of its assembly before {named}: a dead point lies "
            "between this position and the one before, or close by. Give positions on one side of "
            "it."
        )
    return spot


def spots_along(scene: Posed, position: np.ndarray, way: Way) -> Spot:
    """Where the mechanism stands at each position, gone through in their order. Raises
    `ValueError` for the first that it does not reach."""
    spot, sound = _assembled(scene.at(position[0]), way)
    spots, before = [], position[0]
    for i, now in enumerate(position):
        spot = _led(scene, spot, before, now, way) if i else _settled(scene.at(now), spot, way)
        if not (sound and spot.change <= SETTLED):
            named = ", ".join(f"{n} = {x:.6g}" for n, x in zip(scene.held, now, strict=True))
            raise ValueError(
                f"the mechanism cannot be assembled at position {i} ({named}): no place of its "
                "bodies closes the loops there, or a dead point lies on the way from the position "
                "before. Give positions within reach, closer together."
            )
        spots.append(spot)
        before = now
    return jax.tree.map(lambda *own: jnp.stack(own), *spots)


def checked_positions(positions: Any) -> tuple[tuple[str, ...], np.ndarray]:
    """Joints that are held, and their coordinates (positions, joints) [rad, m]."""
    expect(positions, Mapping, "positions", "a dictionary from joints to their coordinates")
    columns = {}
    for name, values in positions.items():
        try:
            column = np.asarray(values, float)
        except (TypeError, ValueError):
            column = np.full((), np.nan)
        if column.ndim != 1 or not len(column) or not np.all(np.isfinite(column)):
            raise ValueError(
                f'positions of joint "{name}" are {described(values)}; they must be finite numbers '
                "in a row [rad, m]."
            )
        columns[name] = column
    if not columns or len({len(column) for column in columns.values()}) > 1:
        raise ValueError(
            "positions must tell at least one joint, and as many coordinates of each as of the "
            "others."
        )
    return tuple(columns), np.stack(list(columns.values()), axis=1)


@answering
def positions(
    mechanism: Mechanism, positions: Mapping[str, Any], *, both_ways: bool = False
) -> Positions:
    """A mechanism at rest at positions of its drives, without time.

    `positions`: coordinates [rad, m] by joint, as many of each; every drive must be among them, and
    enough joints that the loops determine the rest. Loads are quasi-static: they press each journal
    against its bearing without friction and inertia. `both_ways`: also under reversed loads
    (`.reversed`), for lost motion. Raises `ValueError` with a sentence for what cannot be asked or
    is out of reach.
    """
    check_double_precision()
    expect(mechanism, Mechanism, "what is positioned", "a jaxclear.Mechanism")
    check_flags("positions", both_ways=both_ways)
    held, places = checked_positions(positions)
    scene = posed(mechanism, held)
    way = way_of(scene)
    starts = spots_along(scene, places, way)
    return both(scene, jnp.asarray(places), starts, way, both_ways)


def both(scene: Posed, places: Array, starts: Spot, way: Way, both_ways: bool) -> Positions:
    """The positions, with those under reversed loads where these are wanted."""
    found = positions_at(scene, places, starts, way)
    if not both_ways:
        return found
    other = positions_at(scene, places, starts, Way(way.moving, -way.side))
    return eqx.tree_at(lambda p: p.other, found, other, is_leaf=lambda x: x is None)
