"""Which rows of closed loops are redundant: found where a mechanism is assembled, from its numbers.

Rows may depend on each other at one position (a linkage stretched flat) or wherever the loops are
closed (parallel cranks, Bennett's linkage). To tell, the mechanism is moved a little along what its
rows leave free and its loops are closed anew: the largest rank that is met is that of its motion.
Rows beyond it are redundant, and reactions are unique but for the forces in equilibrium with
themselves that these rows allow.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.joint import AbstractRubbingJoint
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import compiled_quickly
from jaxclear.multibody import constraints
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.start_equations import (
    LOOP,
    Ask,
    Start,
    ask,
    motions_at,
    position_blocks,
    retract,
    settled,
    speed_scales,
    stacked,
)
from jaxclear.multibody.topology import Redundancy

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


class Place(NamedTuple):
    """A position with closed loops: coordinates, time [s], Jacobian of all rows that motion
    changes, beside lengths and turns that count alike, and its rank."""

    coordinates: Any
    time: Any
    jacobian: np.ndarray
    rank: int


def is_suspect(mechanism: Mechanism, start: Start) -> bool:
    """Whether rows may be redundant: no motion changes some, or some follow from the others at the
    start."""
    names = mechanism.topology.loops
    fixed = _counts_fixed(mechanism) and any(
        len(start.residuals[n]) > len(start.jacobians[n]) for n in names
    )
    jacobian = np.concatenate([np.asarray(start.jacobians[n]) for n in names])
    return fixed or _rank(jacobian) < len(jacobian)


def _counts_fixed(mechanism: Mechanism) -> bool:
    """Whether rows that no motion changes count: where joints always touch, those of the tree carry
    what they would."""
    joints = (connection.joint for connection in mechanism.connections.values())
    return not any(isinstance(joint, AbstractRubbingJoint) for joint in joints)


def redundancy(mechanism: Mechanism, start: Start, time: Any) -> Redundancy | None:
    """What is redundant in the loops of a mechanism with numbers; None where rows depend on each
    other at this position only."""
    asked = ask(mechanism, False)
    place = _most_of_rank(asked, start, time)
    rows = list(_rows(asked, place))
    moving = [row for row in rows if not row.fixed]
    if place.rank == len(rows):
        return None
    follow = [own for own, new in zip(moving, _new(place.jacobian), strict=True) if not new]
    extra = [row for row in rows if row.fixed or row in follow]
    named = tuple((row.joint, row.name) for row in extra)
    return Redundancy(place.rank, named, _undetermined(asked, place, rows))


def _most_of_rank(asked: Ask, start: Start, time: Any) -> Place:
    """The start, or the position near it in which the rows are of a larger rank."""
    scales, arm = np.asarray(speed_scales(asked)), float(asked.arm)
    best = _place(asked, start.coordinates, time)
    free = np.linalg.svd(best.jacobian)[2][best.rank :]
    random = np.random.default_rng(0)
    times = (LATER if asked.mechanism.driven else LATER[:1]) if len(scales) else ()
    for later in times:
        for _ in range(DIRECTIONS if len(free) else 1):
            way = random.normal(size=len(free)) @ free
            step = MOVED * way / max(np.linalg.norm(way), 1e-300) * scales
            q, left = _moved(asked.mechanism, start.coordinates, jnp.asarray(step), time + later)
            apart = np.max(np.abs(np.asarray(q - start.coordinates)), initial=0.0)
            if float(left) <= CLOSED * max(arm, 1.0) and apart <= NEAR * max(arm, 1.0):
                place = _place(asked, q, time + later)
                best = place if place.rank > best.rank else best
    return best


@compiled_quickly
def _moved(mechanism: Mechanism, q: Array, step: Array, time: Any) -> tuple[Array, Array]:
    """Coordinates moved by a step, the loops closed anew, and what is left of these [m, 1]."""
    asked = ask(mechanism, False)

    def of_loops(q):
        return [block for block in position_blocks(asked, q, time) if block.kind == LOOP]

    q = retract(asked.system, q, step)
    improve = lambda q, _: (settled(asked, q, of_loops(q)), None)
    q, _ = jax.lax.scan(improve, q, length=ITERATIONS)
    return q, jnp.max(jnp.abs(stacked(asked, of_loops(q))[1]), initial=0.0)


@compiled_quickly
def _jacobian(mechanism: Mechanism, q: Array, time: Any) -> Float[Array, "rows v"]:
    asked = ask(mechanism, False)
    loops = [block for block in position_blocks(asked, q, time) if block.kind == LOOP]
    return stacked(asked, loops)[0] * speed_scales(asked)


def _place(asked: Ask, q: Array, time: Any) -> Place:
    jacobian = np.asarray(_jacobian(asked.mechanism, q, time))
    return Place(q, time, jacobian, _rank(jacobian))


def _rank(rows: np.ndarray) -> int:
    """Rank of rows each of which counts alike."""
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    largest = sizes.max(initial=0.0)
    if not rows.size:
        return 0
    alike = rows[sizes[:, 0] > DEPENDENT * largest]
    if not len(alike):
        return 0
    alike = alike / np.linalg.norm(alike, axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(alike, tol=DEPENDENT))


def _new(jacobian: np.ndarray) -> Iterator[bool]:
    """For each row whether it says what those before it do not."""
    ranks = [_rank(jacobian[: i + 1]) for i in range(len(jacobian))]
    return (rank > before for rank, before in zip(ranks, [0, *ranks], strict=False))


class Row(NamedTuple):
    """A row of the loop that `joint` closes: its name, its place in the closure, that of the
    closure; `fixed`: no motion changes it."""

    joint: str
    name: str
    place: int
    closure: int
    fixed: bool


def _rows(asked: Ask, place: Place) -> Iterator[Row]:
    """The rows of all loops, those that no motion changes included where they say something."""
    motions, fixed = _motions(asked, place), _counts_fixed(asked.mechanism)
    system = asked.system
    for k, (joint, closure) in enumerate(zip(system.topology.loops, system.closures, strict=True)):
        found = constraints.constraint_rows(system, motions, closure)
        counted = {*found.kept, *(found.fixed if fixed else ())}
        for i in sorted(counted):
            yield Row(joint, closure.rows[i], i, k, i in found.fixed)


def _motions(asked: Ask, place: Place) -> tuple:
    still = jnp.zeros(asked.system.topology.speed_count)
    return motions_at(asked, place.coordinates, still, place.time)[2]


def _undetermined(asked: Ask, place: Place, rows: list[Row]) -> tuple[str, ...]:
    """Joints through which forces can pass that are in equilibrium with themselves."""
    system, motions = asked.system, _motions(asked, place)
    jacobian = np.zeros((len(rows), place.jacobian.shape[1]))
    jacobian[[not row.fixed for row in rows]] = place.jacobian
    found: set[str] = set()
    for forces in np.linalg.svd(jacobian.T)[2][place.rank :]:
        own: tuple[dict[int, Any], ...] = tuple({} for _ in system.closures)
        for row, force in zip(rows, forces, strict=True):
            own[row.closure][row.place] = force
        closing, through = constraints.wrenches_of_rows(system, motions, own)
        names = (*system.topology.loops, *(branch.name for branch in system.topology.branches))
        acting = zip(names, (*closing, *through), strict=True)
        found |= {name for name, wrench in acting if _acts(asked, *wrench)}
    return tuple(name for name in asked.mechanism.connections if name in found)


def _acts(asked: Ask, force: sp.Vec, torque: sp.Vec) -> bool:
    """Whether a wrench is there, beside forces and torques on the longest arm of about 1."""
    size = max(float(np.max(np.abs(np.asarray(sp.stack(part))))) for part in (force, torque))
    return size > DEPENDENT * min(1.0, float(asked.arm))
