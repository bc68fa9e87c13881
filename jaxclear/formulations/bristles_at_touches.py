"""Deflections of bristles after an explicit step in which their contact has closed or parted.

At a touch a deflection begins to follow the slip, at a release to straighten: its rate jumps, and
the stages of a step see it as that of one side or the other. By how much that counts the time in
contact too long or too short is known once the step is done, as is where in it the contact has
closed; what is counted amiss is put right where the next step begins. It was up to a third of a
step's slide at every impact, of random sign, so that wear fell with the step no faster than by
chance: a journal that hops on bristles was 1.8 % off in steps of 5 us, and is 0.2 %
(benchmarks/attack.py, case 527).
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.formulations.impact_speed import ContactMotion
from jaxclear.formulations.model import Model, State
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import constant
from jaxclear.ground.tangents import where_wanted
from jaxclear.multibody.contact_point import slip_speed
from jaxclear.multibody.state import unpack_memories

Stages = tuple[tuple[float, ...], tuple[float, ...]]


def has_bristles(model: Model) -> bool:
    """True where some contact has any."""
    return any(bristles for _, kinds in model.layout.memories for _, bristles in kinds)


def put_right(
    formulation: Any,
    model: Model,
    now: tuple[Any, State],
    motions: tuple[ContactMotion, ContactMotion],
    step: tuple[Any, Stages],
) -> State:
    """The state after a step with deflections for the time in contact. `now`: (time [s], state)
    there; `motions`: the contacts at both its ends; `step`: its length [s], and (nodes, weights) of
    its stages. Derivatives of what is put right are left out: they follow the motion, not what
    steps count."""
    _, state = now
    model, now, (before, after), length = constant((model, now, motions, step[0]))
    changed = (before.depths < 0) != (after.depths < 0)

    def found(_):
        nodes, weights = step[1]
        way = after.depths - before.depths
        share = jnp.clip(safe_divide(-before.depths, way), 0.0, 1.0)
        early = (jnp.asarray(nodes)[:, None] < share).astype(float)
        amiss = length * (share - jnp.asarray(weights) @ early)
        # Of a touch the time before it is apart, of a release it is in contact.
        amiss = jnp.where(changed, jnp.where(after.depths < 0, amiss, -amiss), 0.0)
        return _moves(model, now[1], formulation.slips(model, *now), amiss)

    return state + where_wanted(jnp.any(changed), found, jnp.zeros_like(now[1]))


def _moves(model: Model, state: State, slips: Any, amiss: Any) -> Any:
    """What entries of the state lack where each contact was closed for a time [s] longer."""
    entries, place, k = [0.0] * len(state), model.layout.memory_start, 0
    memories = unpack_memories(model.layout, model.entries(state))
    for name, kinds in model.layout.memories:
        laws = model.system.bearings[name].contact_laws
        for (remembers, count), own, memory in zip(kinds, laws, memories[name], strict=True):
            place += remembers
            if count:
                slip = tuple(slips[k, i] for i in range(count))
                closed, apart = (
                    own.friction.tractions(normal, memory.bristles, slip, slip_speed(slip))[1]
                    for normal in (1.0, 0.0)
                )
                for i in range(count):
                    entries[place + i] = amiss[k] * (closed[i] - apart[i])
            place, k = place + count, k + 1
    return jnp.stack([jnp.asarray(each, float) for each in entries])
