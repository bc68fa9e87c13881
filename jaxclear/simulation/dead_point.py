"""Dead points: a drive asks a closed loop for a place that it cannot reach.

Forces grow without bound there, so a run ends for what seems another reason. Looked for only where
a run has ended early: the loops are closed anew, from the last saved state on, with the drives as
they move; where that fails no motion exists. A run of one mechanism that ended at a singular
position (`singular_position`) says that too.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxclear.ground.quantity import constant, is_traced
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.start_equations import (
    LOOP,
    ask,
    nearer,
    position_blocks,
    stacked,
)
from jaxclear.results.singular_position import singular_position
from jaxclear.results.trajectory import Trajectory

# Instants of the saving intervals around which the run ended; steps to close the loops at each.
INSTANTS, ITERATIONS = 256, 12
# How runs end that meet a singular position.
MAY_BE_SINGULAR = (
    Outcome.STEP_TOO_SMALL,
    Outcome.TOO_MANY_STEPS,
    Outcome.NOT_FINITE,
    Outcome.ENERGY_GAINED,
    Outcome.LOOP_TORN,
)
# What may be left of a closure [rad, longest arms].
CLOSED = 1e-6


def diagnosed(trajectory: Trajectory) -> Trajectory:
    """The run; one that ended early at a dead point says so. One that is being traced may be
    anything and is left alone (`diagnosed_outcome`)."""
    if is_traced(trajectory.outcome) or trajectory.succeeded:
        return trajectory
    outcome = diagnosed_outcome(trajectory)
    near = None
    if not np.ndim(outcome) and int(outcome) in MAY_BE_SINGULAR:
        near = singular_position(trajectory.history, trajectory.ended)
    if near is not None:
        outcome = jnp.full_like(outcome, int(Outcome.SINGULAR_POSITION))
    return dataclasses.replace(trajectory, outcome=outcome)


def diagnosed_outcome(trajectory: Trajectory) -> Int[Array, ""]:
    """How a run ended, dead points told; pure. In a batch the search goes on only while some run of
    it has ended early."""
    history, outcome = trajectory.history, trajectory.outcome
    if not history.mechanism.driven or not history.mechanism.topology.loops:
        return outcome
    # Nothing here is to be differentiated.
    mechanism, states, times = constant((history.mechanism, history.states, history.time))
    last = jnp.searchsorted(times, jax.lax.stop_gradient(trajectory.ended), side="right") - 1
    # The state before: a loop that came open was found open at the last.
    before, after = jnp.maximum(last - 1, 0), jnp.minimum(last + 1, len(times) - 1)
    q = states[before, : mechanism.topology.coordinate_count]
    early = outcome != Outcome.REACHED
    closable = _closable(mechanism, q, times[before], times[after], early)
    return jnp.where(early & ~closable, Outcome.DEAD_POINT, outcome)


@eqx.filter_jit
def _closable(
    mechanism: Mechanism, q: Float[Array, " q"], start: Any, stop: Any, asked_for: Bool[Array, ""]
) -> Bool[Array, ""]:
    """Whether coordinates that close the loops follow from q at all times from `start` to `stop`
    [s]; true without a look where that is not asked for."""
    asked = ask(mechanism, False)

    def loops(q, time):
        return [block for block in position_blocks(asked, q, time) if block.kind == LOOP]

    def goes_on(carry):
        done, _, closed = carry
        return (done < INSTANTS) & closed & asked_for

    def follow(carry):
        done, q, _ = carry
        time = start + (stop - start) * done / (INSTANTS - 1)
        q = jax.lax.fori_loop(0, ITERATIONS, lambda _, q: nearer(asked, q, loops(q, time)), q)
        left = jnp.max(jnp.abs(stacked(asked, loops(q, time))[1]))
        return done + 1, q, left <= CLOSED * jnp.minimum(asked.arm, 1.0)

    return jax.lax.while_loop(goes_on, follow, (jnp.asarray(0), q, jnp.asarray(True)))[2]
