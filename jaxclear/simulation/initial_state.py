"""Where a run begins, and what it takes over from one before."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.base import AbstractFormulation, model_of
from jaxclear.ground.arguments import expect
from jaxclear.ground.module import AbstractModule
from jaxclear.ground.quantity import is_traced
from jaxclear.ground.wording import listed
from jaxclear.multibody import start_check
from jaxclear.multibody.assembly import Start, ready, ready_from_state
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import names
from jaxclear.results.state_history import State
from jaxclear.simulation.wear import Worn, initial_depths


class Past(AbstractModule):
    """What a run takes over from one before: depth maps of `worn` surfaces [m], and what is
    `remembered` beside the motion; None: new surfaces, nothing to remember."""

    worn: Worn | None = None
    remembered: Float[Array, " m"] | None = None


class Beginning(NamedTuple):
    """A mechanism that knows its redundant rows, its consistent start, what is taken over, a
    sentence where another way to assemble is about as near to what is guessed, or where it begins
    beyond a stop, and whether the start is sound where only a traced program knows."""

    mechanism: Mechanism
    start: Start
    past: Past
    doubt: str = ""
    sound: Any = True


def state_of(initial: State | None) -> State:
    """The state that is given for a run to begin with; None: its own start. Raises `ValueError`."""
    state = State() if initial is None else initial
    expect(state, State, "state", "a jaxclear.State, such as run.state()")
    return state


def beginning(mechanism: Mechanism, formulation: AbstractFormulation, state: State) -> Beginning:
    """Where a run of a mechanism with numbers begins.

    Args:
        mechanism: as its formulation models it.
        formulation: whose memories a past state may fill.
        state: worn surfaces, and the motion of an earlier run, if any.

    Raises:
        ValueError: the start is refused, or the state does not belong to the mechanism.
    """
    past = past_of(mechanism, formulation, state)
    if state.motion is None:
        start = ready(mechanism, state.concentric, past.worn)
        beyond = start_check.beyond_limits(start.mechanism, start.start)
        doubt = " ".join(filter(None, (start.doubt, beyond)))
        return Beginning(start.mechanism, start.start, past, doubt, start.sound)
    return Beginning(*ready_from_state(mechanism, *state.motion.moving), past)


def past_of(mechanism: Mechanism, formulation: AbstractFormulation, start: State) -> Past:
    """Worn surfaces and memories that a run takes over from a state.

    Memories of laws are taken over only where the laws remember the same.

    Args:
        mechanism: of the run.
        formulation: of the run, which decides what is remembered.
        start: state in which the run begins.

    Raises:
        ValueError: the state is that of another mechanism, or not finite.
    """
    surfaces, saved = initial_depths(mechanism, start.worn), start.motion
    if saved is None:
        return Past(surfaces)
    model = model_of(mechanism, formulation)
    labels = names(model.system, model.layout)
    moving = labels[: model.layout.memory_start]
    if saved.names != tuple(moving):
        raise ValueError(
            "the state is that of another mechanism: its coordinates and speeds are "
            f"{listed(saved.names)}, those of this one {listed(moving)}."
        )
    values = [saved.coordinates, saved.speeds, saved.remembered, saved.time]
    if not is_traced(values) and not all(bool(jnp.all(jnp.isfinite(x))) for x in values):
        raise ValueError("the state has numbers that are not finite.")
    fits = saved.remembered_names == tuple(labels[model.layout.remembered])
    return Past(surfaces, saved.remembered if fits else None)
