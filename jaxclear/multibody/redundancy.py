"""Which rows of closed loops are redundant: found where a mechanism is assembled, from its numbers.

Rows may depend on each other at one position (a linkage stretched flat) or wherever the loops are
closed (parallel cranks, Bennett's linkage). To tell, the mechanism is moved a little along what its
rows leave free and its loops are closed anew: the largest rank that is met is that of its motion.
Rows beyond it are redundant, and reactions are unique but for the forces in equilibrium with
themselves that these rows allow.
"""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.components.joint import AbstractRubbingJoint
from jaxclear.ground import sparse as sp
from jaxclear.multibody import constraints, kinematics
from jaxclear.multibody.mechanism import Mechanism, without_stabilisation
from jaxclear.multibody.newton import blocks_of, closed
from jaxclear.multibody.pose_rows import closing_rows
from jaxclear.multibody.start_equations import (
    Ask,
    Start,
    motions_at,
    retract,
    speed_scales,
    stacked,
    start_problem,
)
from jaxclear.multibody.topology import Redundancy
from jaxclear.native import in_one
from jaxclear.native.compiled import compiled_quickly

# A singular value this share of the largest, or less, is zero. Near a position where rows are
# dependent they are so to first order in the distance (`MOVED`); where they always are, to what
# is left of the closures.
DEPENDENT = 1e-6
# How far the mechanism is moved [rad, longest arms], in how many directions, and how long drives
# run meanwhile [s].
MOVED, DIRECTIONS, LATER = 0.02, 4, (0.0, 1e-4, 1e-3, 1e-2)
ITERATIONS = 30
# Beside the longest arm: what may be left of loops there, and how far from the start that may be.
CLOSED, NEAR = 1e-9, 0.5


class Row(NamedTuple):
    """A row of the loop that `joint` closes: its name, its place in the closure, that of the
    closure; `fixed`: no motion changes it; the joints `around` the loop."""

    joint: str
    name: str
    place: int
    closure: int
    fixed: bool
    around: tuple[str, ...]


class Place(NamedTuple):
    """A position with closed loops: the Jacobian (moving rows, v), beside lengths and turns that
    count alike; by connection the forces and torques (rows, 6) through it that are in equilibrium
    with a force 1 in a row [N, N m]; the longest arm [m]."""

    jacobian: Any
    through: dict[str, Any]
    arm: Any

    @property
    def rank(self) -> int:
        """Of the Jacobian."""
        return rank_of(np.asarray(self.jacobian))


def is_suspect(mechanism: Mechanism, start: Start) -> bool:
    """Whether rows may be redundant: no motion changes some, or some follow from the others at the
    start."""
    fixed = _counts_fixed_rows(mechanism) and any(
        len(start.residuals[name]) > len(start.jacobians[name])
        or (
            len(_fixed(mechanism, name)) > len(start.jacobians[name]) and _in_space(mechanism, name)
        )
        for name in mechanism.topology.loops
    )
    return fixed or has_dependent_rows(start)


def has_dependent_rows(start: Start) -> bool:
    """Whether rows that motion changes follow from others at the start."""
    jacobian = np.concatenate([np.asarray(part) for part in start.jacobians.values()])
    return rank_of(jacobian) < len(jacobian)


def _counts_fixed_rows(mechanism: Mechanism) -> bool:
    """Whether rows that no motion changes count: where joints always touch, those of the tree carry
    what they would."""
    joints = (connection.joint for connection in mechanism.connections.values())
    return not any(isinstance(joint, AbstractRubbingJoint) for joint in joints)


def _fixed(mechanism: Mechanism, loop: str) -> tuple[str, ...]:
    """The rows that close a loop; of a coupling the one that it has."""
    if loop in mechanism.couplings:
        return ("",)
    return closing_rows(mechanism.connections[loop].joint)


def _in_space(mechanism: Mechanism, loop: str) -> bool:
    """Whether a loop may be loaded across the plane of its motion: rows that say nothing are held
    there too. A coupling is loaded by its one row alone."""
    if loop in mechanism.couplings:
        return False
    topology, closing = mechanism.topology, mechanism.connections[loop]
    ends = {topology.index(marker.body) for marker in (closing.parent, closing.child)}
    return any(
        len(mechanism.bodies[topology.branches[i].body].inertia) > 1
        for subtree in topology.subtrees
        if ends & {*subtree}
        for i in subtree
    )


def redundancy(mechanism: Mechanism, start: Start, time: Any) -> Redundancy | None:
    """Which rows of the loops are redundant; None where rows depend at this position only.

    Args:
        mechanism: with numbers.
        start: consistent coordinates, at which ranks are determined.
        time: instant [s] of the drives.
    """
    rows = eqx.filter_eval_shape(_list_rows, mechanism, start.coordinates, time)
    moving = [row for row in rows if not row.fixed]
    # What is in equilibrium with itself passes through all joints of its loop.
    acting = {name for row in rows if row.fixed for name in row.around}
    joints = tuple(name for name in mechanism.connections if name in acting)
    rank, follow = len(moving), []
    if has_dependent_rows(start):
        place = _most_of_rank(mechanism, rows, start, time)
        rank, joints = place.rank, _undetermined(mechanism, rows, place)
        new = is_new(np.asarray(place.jacobian))
        follow = [row for row, names in zip(moving, new, strict=True) if not names]
    called = lambda row: "" if row.joint in mechanism.couplings else row.name
    extra = tuple((row.joint, called(row)) for row in rows if row.fixed or row in follow)
    return Redundancy(rank, bool(follow), extra, joints) if extra else None


def with_search(redundancy: Redundancy | None, start: Start) -> Redundancy:
    """The same of loops that are closed by a damped search only."""
    rank = sum(len(jacobian) for jacobian in start.jacobians.values())
    return dataclasses.replace(redundancy or Redundancy(rank, False), far=True)


def _most_of_rank(mechanism: Mechanism, rows: tuple[Row, ...], start: Start, time: Any) -> Place:
    """The start, or the position near it in which the rows are of a larger rank."""
    mechanism, begin = without_stabilisation(mechanism), np.asarray(start.coordinates)
    scales, instant = np.asarray(_scales_of(mechanism)), np.asarray(time, float)
    best = _place_of(mechanism, rows, start.coordinates, jnp.asarray(instant))
    arm = float(best.arm)
    free = np.linalg.svd(best.jacobian)[2][best.rank :]
    random = np.random.default_rng(0)
    times = (LATER if mechanism.driven else LATER[:1]) if len(scales) else ()
    for now in (jnp.asarray(instant + later) for later in times):
        for _ in range(DIRECTIONS if len(free) else 1):
            direction = random.normal(size=len(free)) @ free
            step = MOVED * direction / max(np.linalg.norm(direction), 1e-300) * scales
            q, rest = _moved(mechanism, start.coordinates, jnp.asarray(step), now)
            far = np.max(np.abs(np.asarray(q) - begin), initial=0.0)
            if float(rest) <= CLOSED * max(arm, 1.0) and far <= NEAR * max(arm, 1.0):
                place = _place_of(mechanism, rows, q, now)
                best = place if place.rank > best.rank else best
    return best


@compiled_quickly
def _scales_of(mechanism: Mechanism) -> Array:
    return speed_scales(start_problem(mechanism, False))


@compiled_quickly
def _moved(mechanism: Mechanism, q: Array, step: Array, time: Any) -> tuple[Array, Array]:
    """Coordinates moved by a step, the loops closed anew, and what is left of these [m, 1]."""
    problem = start_problem(mechanism, False)

    def close():
        there = closed(problem, retract(problem.system, q, step), time, ITERATIONS, damped=True)
        rest = stacked(problem, blocks_of(problem, there, time))[1]
        return there, jnp.max(jnp.abs(rest), initial=0.0)

    return in_one(close)


@compiled_quickly
def _place_of(mechanism: Mechanism, rows: tuple[Row, ...], q: Array, time: Any) -> Place:
    """Which rows of loops depend on each other at these coordinates."""
    problem = start_problem(mechanism, False)
    system = problem.system

    def through(motions, forces):
        part: tuple[dict[int, Any], ...] = tuple({} for _ in system.closures)
        for row, force in zip(rows, forces, strict=True):
            part[row.closure][row.place] = force
        closing, inboard = constraints.wrenches_of_rows(system, motions, part)
        names = (*system.topology.loops, *(branch.name for branch in system.topology.branches))
        acting = zip(names, (*closing, *inboard), strict=True)
        return {name: sp.stack((*wrench.force, *wrench.torque)) for name, wrench in acting}

    def placed():
        # One row after the other: XLA compiles long functions of short arrays more slowly.
        motions = _motions(problem, q, time)
        jacobian = stacked(problem, blocks_of(problem, q, time))[0] * speed_scales(problem)
        return jacobian, jax.lax.map(functools.partial(through, motions), jnp.eye(len(rows)))

    jacobian, forces = in_one(placed)
    return Place(jacobian, forces, problem.arm)


def rank_of(rows: np.ndarray) -> int:
    """Rank of rows each of which counts alike."""
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    largest = sizes.max(initial=0.0)
    if not rows.size:
        return 0
    same = rows[sizes[:, 0] > DEPENDENT * largest]
    if not len(same):
        return 0
    same = same / np.linalg.norm(same, axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(same, tol=DEPENDENT))


def is_new(jacobian: np.ndarray) -> Iterator[bool]:
    """For each row whether it says what those before it do not."""
    ranks = [rank_of(jacobian[: i + 1]) for i in range(len(jacobian))]
    return (rank > before for rank, before in zip(ranks, [0, *ranks], strict=False))


def _list_rows(mechanism: Mechanism, q: Array, time: Any) -> tuple[Row, ...]:
    """The rows of all loops, those that no motion changes included where they say something or may
    be loaded."""
    problem, counts_fixed, rows = start_problem(mechanism, False), _counts_fixed_rows(mechanism), []
    system, motions = problem.system, _motions(problem, q, time)
    loops = zip(system.topology.loops, system.closures, strict=True)
    for k, (joint, closure) in enumerate(loops):
        steps = [kinematics.ancestry(system, x) for x in (closure.parent_link, closure.child_link)]
        around = [system.topology.branches[i].name for i in {*steps[0]} ^ {*steps[1]}]
        result = constraints.constraint_rows(system, motions, closure)
        fixed = range(len(closure.rows)) if _in_space(mechanism, joint) else result.fixed
        counted = sorted({*result.moving, *(fixed if counts_fixed else ())})
        rows += [
            Row(joint, closure.rows[i], i, k, i not in result.moving, (joint, *around))
            for i in counted
        ]
    return tuple(rows)


def _motions(problem: Ask, q: Array, time: Any) -> tuple:
    return motions_at(problem, q, jnp.zeros(problem.system.topology.speed_count), time)[2]


def _undetermined(mechanism: Mechanism, rows: tuple[Row, ...], place: Place) -> tuple[str, ...]:
    """Joints, and couplings, through which forces can pass that are in equilibrium with themselves:
    of more than rounding, beside forces and torques on the longest arm of about 1."""
    jacobian = np.zeros((len(rows), place.jacobian.shape[1]))
    jacobian[[not row.fixed for row in rows]] = place.jacobian
    directions = np.linalg.svd(jacobian.T)[2][place.rank :]
    least = DEPENDENT * min(1.0, float(place.arm))
    largest = {
        n: np.abs(directions @ np.asarray(part)).max(initial=0.0)
        for n, part in place.through.items()
    }
    for row, part in zip(rows, directions.T, strict=True):
        # The row of a coupling is what it transmits; on coordinates it acts through no joint.
        if row.joint in mechanism.couplings:
            largest[row.joint] = np.abs(part).max(initial=0.0)
    values = (*mechanism.connections, *mechanism.couplings)
    return tuple(name for name in values if largest.get(name, 0.0) > least)
