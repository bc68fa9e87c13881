"""Dead points: a drive asks a closed loop for a place that it cannot reach.

Forces grow without bound there, so a run ends for what seems another reason. Looked for only where
a run has ended early: the loops are closed anew, from the last saved state on, with the drives as
they move; where that fails no motion exists.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.components.joint.base import drive_of
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.start_equations import (
    LOOP,
    ask,
    nearer,
    position_blocks,
    stacked,
)
from jaxclear.results.trajectory import Trajectory

# Instants of the saving intervals around which the run ended; steps to close the loops at each.
INSTANTS, ITERATIONS = 256, 12
# What may be left of a closure [rad, longest arms].
CLOSED = 1e-6


def diagnosed(trajectory: Trajectory) -> Trajectory:
    """The run; one that ended early at a dead point says so, but for one that is being traced."""
    if isinstance(trajectory.outcome, jax.core.Tracer):
        return trajectory
    mechanism = trajectory.history.mechanism
    driven = any(drive_of(c.joint) is not None for c in mechanism.connections.values())
    if trajectory.succeeded or not driven or not mechanism.topology.loops:
        return trajectory
    times = np.asarray(trajectory.history.time)
    last = int(np.searchsorted(times, float(trajectory.ended), side="right")) - 1
    # The state before: a loop that came open was found open at the last.
    before, after = max(last - 1, 0), min(last + 1, len(times) - 1)
    q = trajectory.history.states[before, : mechanism.topology.coordinate_count]
    instants = jnp.linspace(times[before], times[after], INSTANTS)
    if bool(_closable(mechanism, q, instants)):
        return trajectory
    return dataclasses.replace(trajectory, outcome=jnp.asarray(Outcome.DEAD_POINT))


@eqx.filter_jit
def _closable(
    mechanism: Mechanism, q: Float[Array, " q"], times: Float[Array, " instants"]
) -> Bool[Array, ""]:
    """Whether coordinates that close the loops follow from q at all times."""
    asked = ask(mechanism, False)

    def loops(q, time):
        return [block for block in position_blocks(asked, q, time) if block.kind == LOOP]

    def follow(q, time):
        q = jax.lax.fori_loop(0, ITERATIONS, lambda _, q: nearer(asked, q, loops(q, time)), q)
        left = jnp.max(jnp.abs(stacked(asked, loops(q, time))[1]))
        return q, left <= CLOSED * jnp.minimum(asked.arm, 1.0)

    return jnp.all(jax.lax.scan(follow, q, times)[1])
