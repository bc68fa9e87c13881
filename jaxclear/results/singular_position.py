"""Singular positions: where the rows of closed loops depend on each other at one position, a
linkage stretched flat, say.

There a linkage may go on in more than one way, reactions are not determined, and steps that come
near it can fail in any manner. Looked for only where a run has ended early: the motion is carried
on at its speeds with the loops closed, and the rank of their Jacobian is watched.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.quantity import constant
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.start_equations import (
    LOOP,
    ask,
    position_blocks,
    retract,
    settled,
    speed_scales,
    stacked,
)
from jaxclear.results.state_history import StateHistory

# Instants of the saving intervals around which a run ended; steps to close the loops at each.
INSTANTS, ITERATIONS = 256, 6
# Least singular value beside the largest, of rows that count alike, at and below which a position
# is singular: between two instants a linkage turns by about so much.
SINGULAR = 1e-2


class SingularPosition(NamedTuple):
    """Where rows depend on each other most: the `joint` that closes their loop, and when [s]."""

    joint: str
    time: float

    def __str__(self) -> str:
        return f'The loop is that through joint "{self.joint}", at about {self.time:.4g} s.'


def singular_position(history: StateHistory, ended: Any) -> SingularPosition | None:
    """The singular position at which a run ended; None where there is none, and for linkages whose
    rows depend on each other everywhere."""
    topology = history.mechanism.topology
    if not topology.loops or topology.depend:
        return None
    mechanism, states, times = constant((history.mechanism, history.states, history.time))
    last = int(np.searchsorted(np.asarray(times), float(ended), side="right")) - 1
    # The state before: a loop that came open was found open at the last.
    before, after = max(last - 1, 0), min(last + 1, len(times) - 1)
    count, speeds = topology.coordinate_count, topology.speed_count
    q, v = states[before, :count], states[before, count : count + speeds]
    instants = jnp.linspace(times[before], times[after], INSTANTS)
    rows, closed, closures = _followed(mechanism, q, v, instants)
    rows = np.asarray(rows)[np.asarray(closed)]
    if not rows.size or rows.shape[1] > rows.shape[2] or not np.all(np.isfinite(rows)):
        return None
    ways, sizes, _ = np.linalg.svd(rows)
    shares = sizes[:, -1] / sizes[:, 0]
    place = int(np.argmin(shares))
    if shares[place] > SINGULAR:
        return None
    # The forces that no motion feels: the loop in which they are largest.
    forces = ways[place][:, -1] ** 2
    each = [float(forces[np.asarray(closures) == k].sum()) for k in range(len(topology.loops))]
    time = np.asarray(instants)[np.asarray(closed)][place]
    return SingularPosition(topology.loops[int(np.argmax(each))], float(time))


@eqx.filter_jit
def _followed(
    mechanism: Mechanism, q: Float[Array, " q"], v: Float[Array, " v"], times: Float[Array, " n"]
) -> tuple[Array, Array, Array]:
    """(at each time the Jacobian of the loops' rows that count alike, whether the loops were
    closed there; the place of the loop of each row)."""
    asked = ask(mechanism, False)
    scales = speed_scales(asked)

    def loops(q, time):
        return [block for block in position_blocks(asked, q, time) if block.kind == LOOP]

    def follow(q, ahead):
        time, length = ahead
        q = retract(asked.system, q, length * v)
        q = jax.lax.fori_loop(0, ITERATIONS, lambda _, q: settled(asked, q, loops(q, time)), q)
        blocks = loops(q, time)
        rows, left = stacked(asked, blocks)
        measure = jnp.concatenate([block.measure for block in blocks])
        rows = rows * scales / measure[:, None]
        # To first order in what is left the position is the same.
        closed = jnp.max(jnp.abs(left)) <= SINGULAR**2 * asked.arm
        return q, (rows, closed)

    lengths = jnp.diff(times, prepend=times[:1])
    rows, closed = jax.lax.scan(follow, q, (times, lengths))[1]
    sizes = [len(block.left) for block in loops(q, times[0])]
    return rows, closed, jnp.asarray(np.repeat(np.arange(len(sizes)), sizes))
