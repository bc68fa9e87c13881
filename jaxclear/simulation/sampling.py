"""Loads that look at the motion from time to time (a controller with a period): what they hold
changes at their instants alone, and steps end there.

An instant is a whole number of periods from the start. Parts of a saving interval lie between them,
so that nothing else of a run knows of them.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.load import AbstractStateLoad
from jaxclear.formulations.model import Model
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.multibody import kinematics
from jaxclear.multibody.forces import read_load
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import unpack_followed, unpack_motion
from jaxclear.multibody.system import System, coordinate_loads

# Share of a period by which rounding may miss an instant.
SLIVER = 1e-9


def sampled_loads(system: System) -> dict[str, Any]:
    """The loads that have a period, by name."""
    return {
        name: load for name, load in coordinate_loads(system) if load.sampled_every() is not None
    }


def check_instants(mechanism: Mechanism, integrator: AbstractIntegrator) -> None:
    """Raises `ValueError` where steps are counted between saving times, and loads have instants of
    their own there."""
    if integrator.steps_between_saves is None:
        return
    for name, load in mechanism.loads.items():
        if isinstance(load, AbstractStateLoad) and load.sampled_every() is not None:
            raise ValueError(
                f'load "{name}" has a period, at whose instants steps end, and '
                f"integrator.{type(integrator).__name__} counts its steps between saving times: "
                "give it a step in place of steps_per_save."
            )


def next_instant(system: System, time: Any, stop: Any) -> Any:
    """The next sampling instant of any load [s], at the latest `stop`.

    Args:
        system: with loads that sample the motion.
        time: instant [s]; the result is later.
        stop: end of the span [s].
    """
    ahead = stop
    for load in sampled_loads(system).values():
        period = load.sampled_every()
        instant = (jnp.floor(time / period + SLIVER) + 1) * period
        # One that is nearly the end is the end.
        ahead = jnp.where(instant < stop - SLIVER * period, jnp.minimum(ahead, instant), ahead)
    return ahead


def sample_loads(model: Model, time: Any, state: Float[Array, " n"]) -> Float[Array, " n"]:
    """The state with new outputs of the loads that sample the motion at this instant.

    Args:
        model: of the run.
        time: instant [s]; loads that do not sample at it keep their states.
        state: shape (n,).
    """
    system, layout = model.system, model.layout
    if not sampled_loads(system):
        return state
    entries = model.entries(state)
    q, v = unpack_motion(system, entries)
    motions = kinematics.link_motions(system, q, v, time)
    followed = unpack_followed(layout, entries)
    owners = [owner for owner, _ in layout.states]
    for name, load in sampled_loads(system).items():
        positions, speeds, _ = read_load(system, motions, load, name, followed)
        states = followed.states[name]
        result = load.sampled(time, positions, speeds, states)
        turns = time / load.sampled_every()
        is_now = jnp.abs(turns - jnp.round(turns)) < SLIVER
        first = layout.state_start + owners.index(name)
        for i, (before, after) in enumerate(zip(states, result, strict=True)):
            state = state.at[first + i].set(jnp.where(is_now, after, before))
    return state
