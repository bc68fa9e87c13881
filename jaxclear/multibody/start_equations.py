"""The equations that a start satisfies, in the order in which they count: loops are closed, what is
given is held in the order given, journals lie in the middle of their bearings, beams are straight
and do not bend as far as the others let them. What these leave free is as near to all that is
guessed as it can be, in radians and shares of the longest arm together.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.beam import parts_of_beams
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_many
from jaxclear.ground.grouping import LARGEST_UNROLLED, unstacked
from jaxclear.ground.printing import with_text_repr
from jaxclear.ground.quantity import is_traced
from jaxclear.multibody import constraints, given, kinematics, loops
from jaxclear.multibody.given import at_start
from jaxclear.multibody.loops import Closure
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.motors_at_start import turned
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System, longest_arm, motor_ends, prepare
from jaxclear.multibody.tree import Motion

LOOP, GIVEN, JOURNAL, GUESS, STRAIGHT = "loop", "given", "journal", "guess", "straight"


@with_text_repr
class Start(NamedTuple):
    """Consistent coordinates and speeds, and by name how they meet what is asked of them: what is
    left of each closure [m, 1], its Jacobian, what is left of the loops' rates [m/s, 1/s], by how
    much coordinates [rad, longest arms] and speeds given are missed, for each clearance joint
    (deepest overlap, overlap allowed at a start) [m], and how far each guess is away [rad, longest
    arms]. `rows`: the Jacobian of all that is held, in radians and longest arms, by which two ways
    to assemble are told apart.
    """

    coordinates: Float[Array, " q"]
    speeds: Float[Array, " v"]
    residuals: dict[str, Float[Array, " rows"]]
    jacobians: dict[str, Float[Array, "rows v"]]
    rates: dict[str, Float[Array, " rows"]]
    missed: dict[str, Float[Array, " numbers"]]
    missed_speeds: dict[str, Float[Array, " numbers"]]
    depths: dict[str, Float[Array, " 2"]]
    away: dict[str, Float[Array, " numbers"]]
    rows: Float[Array, "rows v"]

    def __str__(self) -> str:
        """How many coordinates there are, and how far it is from what is asked of it."""
        many = f"A start of {len(self.coordinates)} coordinates and {len(self.speeds)} speeds"
        if is_traced(self):
            return f"{many}, traced."
        left = {
            "loops are open by {} [m, 1]": self.residuals,
            "their rates are {} [m/s, 1/s]": self.rates,
            "given coordinates are missed by {} [rad, longest arms]": self.missed,
            "given speeds by {} [the same in 1 s]": self.missed_speeds,
            "guesses are {} away [rad, longest arms]": self.away,
        }
        told = [words.format(f"{_largest(own):.2g}") for words, own in left.items() if own]
        return f"{many}; at the most {', '.join(told)}." if told else f"{many}."


def _largest(parts: dict[str, Array]) -> float:
    return max(float(np.max(np.abs(own), initial=0.0)) for own in parts.values())


class Ask(NamedTuple):
    """What is asked of a start: the mechanism, ready and as given, whether journals are to be
    concentric, the longest arm [m], the depths of surfaces that are worn as it starts [m], and
    whether beams are to be straight."""

    mechanism: Mechanism
    system: System
    concentric: bool
    arm: Any
    worn: dict[str, dict[str, Array]]
    straight: bool = True


class Block(NamedTuple):
    """Equations in the free speeds of one closure or one given name, of a kind: what is left to
    change, what counts as much as a radian [m, 1], what no motion changes, and its Jacobian, number
    by number."""

    kind: str
    name: str
    left: Float[Array, " rows"]
    measure: Float[Array, " rows"]
    fixed: Float[Array, " fixed"]
    rows: list[kinematics.JacobianRow]


def ask(mechanism: Mechanism, concentric: bool, worn: dict | None = None) -> Ask:
    """What is asked of a mechanism's start, with surfaces `worn` so deep [m] (None: new ones)."""
    system = prepare(mechanism)
    # A measure only: the start is not to follow its changes.
    arm = jax.lax.stop_gradient(longest_arm(system))
    return Ask(mechanism, system, concentric, arm, worn or {})


def guess(mechanism: Mechanism, system: System | None = None) -> tuple[Array, Array]:
    """Coordinates and speeds from the mechanism's own rough start (`system`: it, prepared). A motor
    of which nothing is told stands and turns as its joint wants it, where that is of the tree."""
    q: list[Any] = []
    v: list[Any] = []
    system = prepare(mechanism) if system is None else system
    rough, speeds = mechanism.guess | mechanism.start, mechanism.speeds
    ends: dict[Any, Any] = {
        end.coordinate: (joint, end) for joint, end in motor_ends(mechanism).items()
    }
    for branch, link in zip(system.topology.branches, system.links, strict=True):
        if branch.coordinate_count:
            known, fast = rough.get(branch.name), speeds.get(branch.name)
            joint, end = ends.get(branch.name, (None, None))
            if known is None and joint in rough:
                (place,) = rough[joint]
                known = (end.ratio * place + (0 if end.offset is None else end.offset),)
            if fast is None and joint in speeds:
                fast = (end.ratio * speeds[joint][0],)
            own = link.joint.home if known is None else link.joint.start(known)
            fast = (0.0,) * branch.speed_count if fast is None else fast
            own, fast = at_start(branch, link.joint, own, fast)
            q.extend(own)
            v.extend(fast)
    return turned(mechanism, system, sp.stack(q), sp.stack(v), 0.0)


def retract(system: System, q: Array, step: Array) -> Array:
    """Coordinates moved along speeds for unit time, quaternions renormalised."""
    own_q, own_step = unpack_motion(system, [*unstacked(q), *unstacked(step)])
    each = zip(system.links, own_q, own_step, strict=True)
    moved = map_many(
        lambda joint, q, step: tuple(joint.retracted(q, step)),
        [(link.joint, coordinates, move) for link, coordinates, move in each if coordinates],
    )
    return sp.stack([x for own in moved for x in own])


def motions_at(asked: Ask, q: Array, v: Array, time: Any) -> tuple[tuple, tuple, tuple]:
    """Coordinates and speeds by branch, and the motions of all links."""
    own_q, own_v = unpack_motion(asked.system, [*unstacked(q), *unstacked(v)])
    return own_q, own_v, kinematics.link_motions(asked.system, own_q, own_v, time)


def speed_scales(asked: Ask) -> Float[Array, " v"]:
    """For each free speed what counts as much as a radian a second."""
    return given.speed_scales(asked.system, asked.arm)


class Place(NamedTuple):
    """A mechanism at rest: coordinates by branch, and the motions of all links."""

    own: tuple
    motions: tuple[Motion, ...]


def place_at(asked: Ask, q: Array, time: Any) -> Place:
    """The mechanism at rest at coordinates of the tree."""
    own_q, _, motions = motions_at(asked, q, jnp.zeros(asked.system.topology.speed_count), time)
    return Place(own_q, motions)


def position_blocks(asked: Ask, q: Array, time: Any) -> list[Block]:
    """What is left to change in the coordinates for all that is held, in order."""
    return held_blocks(asked, place_at(asked, q, time))


def held_blocks(asked: Ask, place: Place) -> list[Block]:
    """The same at a place."""
    motions = place.motions
    return [
        *(_closure_block(asked, motions, n, c, LOOP, False) for n, c in _loops(asked)),
        *_coordinate_blocks(asked, place, GIVEN),
        *_journal_blocks(asked, motions, False),
        *_coordinate_blocks(asked, place, STRAIGHT),
    ]


def guess_blocks(asked: Ask, place: Place) -> list[Block]:
    """How far coordinates are from all that is guessed, angles by the shorter way."""
    return _coordinate_blocks(asked, place, GUESS)


def _straight(asked: Ask, *parts: str) -> dict[str, tuple]:
    """What hinges of beams are at of which nothing is given in these parts."""
    hinges = parts_of_beams(asked.mechanism.loads) if asked.straight else ()
    given_of = {name for part in parts for name in getattr(asked.mechanism, part)}
    carried = {branch.name for branch in asked.system.topology.branches}
    return {name: (0.0,) for name in hinges if name in carried - given_of}


def _coordinate_blocks(asked: Ask, place: Place, kind: str) -> list[Block]:
    """Coordinates that are given, guessed, or straight."""
    blocks: list[Block] = []
    if kind == STRAIGHT:
        told_of: Any = _straight(asked, "start", "guess").items()
    else:
        told_of = asked.mechanism.given["start" if kind == GIVEN else "guess"].items()
    sources = [given.source(asked.mechanism, asked.system, name) for name, _ in told_of]
    values_of = [values for _, values in told_of]
    equations = given.coordinate_equations(
        asked.system, place.motions, place.own, sources, values_of, kind == GUESS
    )
    for (name, values), where, found in zip(told_of, sources, equations, strict=True):
        told = where.joint.told(values)
        blocks.append(_given_block(asked, kind, name, where, found, told))
    return blocks


def speed_blocks(asked: Ask, q: Array, v: Array, time: Any) -> list[Block]:
    """What is left to change in the speeds, in order."""
    own_q, own_v, motions = motions_at(asked, q, v, time)
    blocks = [_closure_block(asked, motions, n, c, LOOP, True) for n, c in _loops(asked)]
    fast = asked.mechanism.given["speeds"]
    still = _straight(asked, "speeds")
    later: list[Block] = []
    for name, values in (fast | still).items():
        where = given.source(asked.mechanism, asked.system, name)
        found = given.speed_equations(asked.system, motions, own_q, own_v, where, values)
        told = (True,) * len(values)
        kind, there = (GIVEN, blocks) if name in fast else (STRAIGHT, later)
        there.append(_given_block(asked, kind, name, where, found, told))
    return blocks + _journal_blocks(asked, motions, True) + later


def outside_tree(mechanism: Mechanism) -> bool:
    """Whether coordinates of a joint outside the tree are given or guessed."""
    carried = {branch.name for branch in mechanism.topology.branches}
    return not {*mechanism.start, *mechanism.guess} <= carried


def is_solved(mechanism: Mechanism, concentric: bool) -> bool:
    """Whether the rough start is the start: nothing but coordinates of the tree is asked for."""
    topology = mechanism.topology
    carried = {branch.name for branch in topology.branches}
    closed = not topology.loops and not (concentric and topology.clearances)
    told = not outside_tree(mechanism) and {*mechanism.speeds} <= carried
    return topology.speed_count == 0 or (closed and told)


def stacked(asked: Ask, blocks: list[Block]) -> tuple[Array, Array]:
    """(Jacobian, what is left) of all blocks."""
    none = jnp.zeros((0, asked.system.topology.speed_count))
    if len(blocks) >= LARGEST_UNROLLED:
        rows = [row for block in blocks for row in block.rows]
        return _dense(asked, rows), jnp.concatenate([block.left for block in blocks])
    return (
        jnp.concatenate([none, *jacobians(asked, blocks)]),
        jnp.concatenate([none.ravel(), *(block.left for block in blocks)]),
    )


def jacobians(asked: Ask, blocks: list[Block]) -> list[Array]:
    """The Jacobian of each block."""
    if len(blocks) < LARGEST_UNROLLED:
        return [_dense(asked, block.rows) for block in blocks]
    ends = np.cumsum([len(block.rows) for block in blocks])
    return jnp.split(stacked(asked, blocks)[0], ends[:-1])


def alike(asked: Ask, blocks: list[Block]) -> tuple[Array, Array]:
    """The same by radians and longest arms, of speeds too."""
    rows, left = stacked(asked, blocks)
    measure = jnp.concatenate([jnp.zeros(0), *(block.measure for block in blocks)])
    return rows * speed_scales(asked) / measure[:, None], left / measure


def leaves_free(asked: Ask, blocks: list[Block]) -> bool:
    """Whether equations are fewer than the free speeds; of loops only those count that are known to
    be independent."""
    topology = asked.system.topology
    counts = dict.fromkeys((LOOP, GIVEN, JOURNAL, STRAIGHT), 0)
    for block in blocks:
        counts[block.kind] += len(block.left)
    if topology.redundancy is not None:
        counts[LOOP] = min(counts[LOOP], topology.redundancy.rank)
    return sum(counts.values()) < topology.speed_count


def _loops(asked: Ask) -> list[tuple[str, Closure]]:
    return list(zip(asked.system.topology.loops, asked.system.closures, strict=True))


def _journals(asked: Ask) -> list[tuple[str, Closure]]:
    bearings = asked.system.bearings if asked.concentric else {}
    return [(name, bearing.closure) for name, bearing in bearings.items()]


def _journal_blocks(asked: Ask, motions: tuple[Motion, ...], rates: bool) -> list[Block]:
    """Journals that are to be concentric."""
    journals = _journals(asked)
    closures = [closure for _, closure in journals]
    relative = kinematics.relative_motions(closures, motions)
    turning = [
        (_row_rates(c.rows), (), own.pose) for c, own in zip(closures, relative, strict=True)
    ]
    rows = kinematics.relative_jacobians(asked.system, motions, closures, turning)
    return [
        _closure_block(asked, motions, name, closure, JOURNAL, rates, *own)
        for (name, closure), own in zip(journals, zip(relative, rows, strict=True), strict=True)
    ]


@functools.cache
def _row_rates(rows: tuple[str, ...]) -> Callable:
    """The rates of such rows: one function, so that closures of them are alike."""
    return functools.partial(loops.row_rates, rows)


def _closure_block(
    asked: Ask,
    motions: tuple[Motion, ...],
    name: str,
    closure: Closure,
    kind: str,
    rates: bool,
    *known: Any,
) -> Block:
    """`known`: motion of the closure's markers, and its Jacobian, where many are asked for."""
    found = constraints.constraint_rows(asked.system, motions, closure, *known)
    return Block(
        kind,
        name,
        sp.stack(found.rates if rates else found.residuals),
        sp.stack(constraints.measures(closure, found, asked.arm)),
        sp.stack(() if rates else tuple(found.fixed.values())),
        found.jacobian,
    )


def _given_block(asked: Ask, kind: str, name: str, where: Any, found: Any, told: tuple) -> Block:
    measure = [
        x for x, known in zip(given.scales(where.joint, asked.arm), told, strict=True) if known
    ]
    return Block(
        kind, name, sp.stack(found.missed), sp.stack(measure), jnp.zeros(0), found.jacobian
    )


def _dense(asked: Ask, rows: list[kinematics.JacobianRow]) -> Float[Array, "rows v"]:
    count = asked.system.topology.speed_count
    entries = {(i, j): x for i, row in enumerate(rows) for j, x in row.items()}
    return factorisation.placed(entries, (len(rows), count))
