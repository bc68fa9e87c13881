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
from jaxclear.multibody import constraints, kinematics, loops, start_constraints
from jaxclear.multibody.loops import Closure
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.motors_at_start import with_motors
from jaxclear.multibody.start_constraints import at_start
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System, longest_arm, motor_ends, prepare
from jaxclear.multibody.tree import Motion

LOOP, START, JOURNAL, GUESS, STRAIGHT = "loop", "given", "journal", "guess", "straight"


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
        rest = {
            "loops are open by {} [m, 1]": self.residuals,
            "their rates are {} [m/s, 1/s]": self.rates,
            "given coordinates are missed by {} [rad, longest arms]": self.missed,
            "given speeds by {} [the same in 1 s]": self.missed_speeds,
            "guesses are {} away [rad, longest arms]": self.away,
        }
        report = [words.format(f"{_largest(part):.2g}") for words, part in rest.items() if part]
        return f"{many}; at the most {', '.join(report)}." if report else f"{many}."


def _largest(parts: dict[str, Array]) -> float:
    return max(float(np.max(np.abs(part), initial=0.0)) for part in parts.values())


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
    rest: Float[Array, " rows"]
    measure: Float[Array, " rows"]
    fixed: Float[Array, " fixed"]
    rows: list[kinematics.JacobianRow]


def start_problem(mechanism: Mechanism, concentric: bool, worn: dict | None = None) -> Ask:
    """The equations of a mechanism's start.

    Args:
        mechanism: with `start`, `speeds` and `guess`.
        concentric: whether journals are put in the middle of their bearings.
        worn: depth maps [m] by joint and surface; None: new surfaces.
    """
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
            values, fast = rough.get(branch.name), speeds.get(branch.name)
            joint, end = ends.get(branch.name, (None, None))
            if values is None and joint in rough:
                (place,) = rough[joint]
                values = (end.ratio * place + (0 if end.offset is None else end.offset),)
            if fast is None and joint in speeds:
                fast = (end.ratio * speeds[joint][0],)
            part = link.joint.home if values is None else link.joint.start(values)
            fast = (0.0,) * branch.speed_count if fast is None else fast
            part, fast = at_start(branch, link.joint, part, fast)
            q.extend(part)
            v.extend(fast)
    return with_motors(mechanism, system, sp.stack(q), sp.stack(v), 0.0)


def retract(system: System, q: Array, step: Array) -> Array:
    """Coordinates moved along speeds for unit time, quaternions renormalised.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        q: coordinates of the tree, shape (coordinates,) [rad, m; 1 for quaternions].
        step: speeds times time, shape (speeds,) [rad, m].
    """
    branch_q, branch_step = unpack_motion(system, [*unstacked(q), *unstacked(step)])
    each = zip(system.links, branch_q, branch_step, strict=True)
    moved = map_many(
        lambda joint, q, step: tuple(joint.retracted(q, step)),
        [(link.joint, coordinates, move) for link, coordinates, move in each if coordinates],
    )
    return sp.stack([x for part in moved for x in part])


def motions_at(problem: Ask, q: Array, v: Array, time: Any) -> tuple[tuple, tuple, tuple]:
    """Coordinates and speeds by branch, and the motions of all links.

    Args:
        problem: equations of the start (`start_problem`).
        q: coordinates of the tree, shape (coordinates,) [rad, m; 1 for quaternions].
        v: free speeds, shape (speeds,) [rad/s, m/s].
        time: instant [s] at which drives are evaluated.
    """
    branch_q, branch_v = unpack_motion(problem.system, [*unstacked(q), *unstacked(v)])
    return branch_q, branch_v, kinematics.link_motions(problem.system, branch_q, branch_v, time)


def speed_scales(problem: Ask) -> Float[Array, " v"]:
    """For each free speed what counts as much as a radian a second."""
    return start_constraints.speed_scales(problem.system, problem.arm)


class Place(NamedTuple):
    """A mechanism at rest: coordinates by branch, and the motions of all links."""

    coordinates: tuple
    motions: tuple[Motion, ...]


def place_at(problem: Ask, q: Array, time: Any) -> Place:
    """The mechanism at rest at coordinates of the tree.

    Args:
        problem: equations of the start (`start_problem`).
        q: coordinates of the tree, shape (coordinates,) [rad, m; 1 for quaternions].
        time: instant [s] at which drives are evaluated.
    """
    branch_q, _, motions = motions_at(
        problem, q, jnp.zeros(problem.system.topology.speed_count), time
    )
    return Place(branch_q, motions)


def position_blocks(problem: Ask, q: Array, time: Any) -> list[Block]:
    """Equations in the coordinates for all that is held, in order of priority.

    Args:
        problem: equations of the start (`start_problem`).
        q: coordinates at which residual and Jacobian are taken, shape (coordinates,).
        time: instant [s] at which drives are evaluated.
    """
    return blocks_at(problem, place_at(problem, q, time))


def blocks_at(problem: Ask, place: Place) -> list[Block]:
    """The same at a place."""
    motions = place.motions
    return [
        *(_closure_block(problem, motions, n, c, LOOP, False) for n, c in _loops(problem)),
        *_coordinate_blocks(problem, place, START),
        *_journal_blocks(problem, motions, False),
        *_coordinate_blocks(problem, place, STRAIGHT),
    ]


def guess_blocks(problem: Ask, place: Place) -> list[Block]:
    """How far coordinates are from all that is guessed, angles by the shorter way."""
    return _coordinate_blocks(problem, place, GUESS)


def _straight_values(problem: Ask, *parts: str) -> dict[str, tuple]:
    """What hinges of beams are at of which nothing is given in these parts."""
    hinges = parts_of_beams(problem.mechanism.loads) if problem.straight else ()
    start_names = {name for part in parts for name in getattr(problem.mechanism, part)}
    carried = {branch.name for branch in problem.system.topology.branches}
    return {name: (0.0,) for name in hinges if name in carried - start_names}


def _coordinate_blocks(problem: Ask, place: Place, kind: str) -> list[Block]:
    """Coordinates that are given, guessed, or straight."""
    blocks: list[Block] = []
    if kind == STRAIGHT:
        entries: Any = _straight_values(problem, "start", "guess").items()
    else:
        entries = problem.mechanism.start_arguments["start" if kind == START else "guess"].items()
    sources = [
        start_constraints.source(problem.mechanism, problem.system, name) for name, _ in entries
    ]
    values_of = [values for _, values in entries]
    equations = start_constraints.coordinate_equations(
        problem.system, place.motions, place.coordinates, sources, values_of, kind == GUESS
    )
    for (name, values), where, equation in zip(entries, sources, equations, strict=True):
        report = where.joint.start_mask(values)
        blocks.append(_start_block(problem, kind, name, where, equation, report))
    return blocks


def speed_blocks(problem: Ask, q: Array, v: Array, time: Any) -> list[Block]:
    """Equations in the speeds for all that is held, in order of priority.

    Args:
        problem: equations of the start (`start_problem`).
        q: coordinates of the tree, shape (coordinates,) [rad, m; 1 for quaternions].
        v: free speeds at which the residual is taken, shape (speeds,).
        time: instant [s] at which drives are evaluated.
    """
    branch_q, branch_v, motions = motions_at(problem, q, v, time)
    blocks = [_closure_block(problem, motions, n, c, LOOP, True) for n, c in _loops(problem)]
    fast = problem.mechanism.start_arguments["speeds"]
    still = _straight_values(problem, "speeds")
    later: list[Block] = []
    for name, values in (fast | still).items():
        where = start_constraints.source(problem.mechanism, problem.system, name)
        result = start_constraints.speed_equations(
            problem.system, motions, branch_q, branch_v, where, values
        )
        report = (True,) * len(values)
        kind, there = (START, blocks) if name in fast else (STRAIGHT, later)
        there.append(_start_block(problem, kind, name, where, result, report))
    return blocks + _journal_blocks(problem, motions, True) + later


def outside_tree(mechanism: Mechanism) -> bool:
    """Whether coordinates of a joint outside the tree are given or guessed."""
    carried = {branch.name for branch in mechanism.topology.branches}
    return not {*mechanism.start, *mechanism.guess} <= carried


def is_solved(mechanism: Mechanism, concentric: bool) -> bool:
    """Whether the rough start is the start: nothing but coordinates of the tree is asked for."""
    topology = mechanism.topology
    carried = {branch.name for branch in topology.branches}
    closed = not topology.loops and not (concentric and topology.clearances)
    report = not outside_tree(mechanism) and {*mechanism.speeds} <= carried
    return topology.speed_count == 0 or (closed and report)


def stacked(problem: Ask, blocks: list[Block]) -> tuple[Array, Array]:
    """(Jacobian, what is left) of all blocks."""
    none = jnp.zeros((0, problem.system.topology.speed_count))
    if len(blocks) >= LARGEST_UNROLLED:
        rows = [row for block in blocks for row in block.rows]
        return _dense_rows(problem, rows), jnp.concatenate([block.rest for block in blocks])
    return (
        jnp.concatenate([none, *jacobians(problem, blocks)]),
        jnp.concatenate([none.ravel(), *(block.rest for block in blocks)]),
    )


def jacobians(problem: Ask, blocks: list[Block]) -> list[Array]:
    """The Jacobian of each block."""
    if len(blocks) < LARGEST_UNROLLED:
        return [_dense_rows(problem, block.rows) for block in blocks]
    ends = np.cumsum([len(block.rows) for block in blocks])
    return jnp.split(stacked(problem, blocks)[0], ends[:-1])


def scale(problem: Ask, blocks: list[Block]) -> tuple[Array, Array]:
    """The same by radians and longest arms, of speeds too."""
    rows, rest = stacked(problem, blocks)
    measure = jnp.concatenate([jnp.zeros(0), *(block.measure for block in blocks)])
    return rows * speed_scales(problem) / measure[:, None], rest / measure


def leaves_free(problem: Ask, blocks: list[Block]) -> bool:
    """Whether equations are fewer than the free speeds; of loops only those count that are known to
    be independent."""
    topology = problem.system.topology
    counts = dict.fromkeys((LOOP, START, JOURNAL, STRAIGHT), 0)
    for block in blocks:
        counts[block.kind] += len(block.rest)
    if topology.redundancy is not None:
        counts[LOOP] = min(counts[LOOP], topology.redundancy.rank)
    return sum(counts.values()) < topology.speed_count


def _loops(problem: Ask) -> list[tuple[str, Closure]]:
    return list(zip(problem.system.topology.loops, problem.system.closures, strict=True))


def _concentric_journals(problem: Ask) -> list[tuple[str, Closure]]:
    bearings = problem.system.bearings if problem.concentric else {}
    return [(name, bearing.closure) for name, bearing in bearings.items()]


def _journal_blocks(problem: Ask, motions: tuple[Motion, ...], rates: bool) -> list[Block]:
    """Journals that are to be concentric."""
    journals = _concentric_journals(problem)
    closures = [closure for _, closure in journals]
    relative = kinematics.relative_motions(closures, motions)
    turning = [
        (_row_rates(c.rows), (), part.pose) for c, part in zip(closures, relative, strict=True)
    ]
    rows = kinematics.relative_jacobians(problem.system, motions, closures, turning)
    return [
        _closure_block(problem, motions, name, closure, JOURNAL, rates, *part)
        for (name, closure), part in zip(journals, zip(relative, rows, strict=True), strict=True)
    ]


@functools.cache
def _row_rates(rows: tuple[str, ...]) -> Callable:
    """The rates of such rows: one function, so that closures of them are alike."""
    return functools.partial(loops.row_rates, rows)


def _closure_block(
    problem: Ask,
    motions: tuple[Motion, ...],
    name: str,
    closure: Closure,
    kind: str,
    rates: bool,
    *values: Any,
) -> Block:
    """Equations of a closure; `values`: motion of its markers, and its Jacobian, where many are
    asked for."""
    result = constraints.constraint_rows(problem.system, motions, closure, *values)
    return Block(
        kind,
        name,
        sp.stack(result.rates if rates else result.residuals),
        sp.stack(constraints.measures(closure, result, problem.arm)),
        sp.stack(() if rates else tuple(result.fixed.values())),
        result.jacobian,
    )


def _start_block(
    problem: Ask, kind: str, name: str, where: Any, result: Any, flags: tuple
) -> Block:
    measure = [
        x
        for x, flag in zip(start_constraints.scales(where.joint, problem.arm), flags, strict=True)
        if flag
    ]
    return Block(
        kind, name, sp.stack(result.missed), sp.stack(measure), jnp.zeros(0), result.jacobian
    )


def _dense_rows(problem: Ask, rows: list[kinematics.JacobianRow]) -> Float[Array, "rows v"]:
    count = problem.system.topology.speed_count
    entries = {(i, j): x for i, row in enumerate(rows) for j, x in row.items()}
    return factorisation.dense_array(entries, (len(rows), count))
