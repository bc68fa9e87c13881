"""The loop of a run: the state is carried from one saving time to the next.

Worn surfaces enter the gap as they were at the last saving time, and are updated at every saving
time: wear is slow, the motion is fast, and a map that is constant within an interval costs the
equations of motion nothing but its reading.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.formulations.base import model_of
from jaxclear.formulations.model import Model, State
from jaxclear.integrators.base import AbstractIntegrator, Interval
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody import closure_coordinates
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import Layout
from jaxclear.multibody.system import readings
from jaxclear.native import verdict
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import RunStats, Trajectory
from jaxclear.simulation import progress, spot_checks
from jaxclear.simulation.beginning import Past
from jaxclear.simulation.referee import refereed
from jaxclear.simulation.spot_checks import Turns
from jaxclear.simulation.wear import Worn, deposit, unworn

# Weight of the laws' memories in the error control: they need not be exact, but a step longer than
# their time constant would make them explode (tests/oracles/test_contact_conservation.py has a long
# flight that failed with weight 0).
MEMORY_WEIGHT = 1e-2


class Carry(NamedTuple):
    """What a run hands from turn to turn; `ended` [s] is the last saving time that it reached."""

    state: State
    worn: Worn
    warm_start: Any
    outcome: Int[Array, ""]
    ended: Float[Array, ""]


def run(
    mechanism: Mechanism,
    coordinates: Array,
    speeds: Array,
    times: Float[Array, " saves"],
    integrator: AbstractIntegrator,
    balance: bool = False,
    report: bool = False,
    past: Past = Past(),
) -> Trajectory:
    """The pure core of `simulate`: from consistent coordinates and speeds, and what is left of a
    past, to a trajectory."""
    formulation = integrator.formulation
    model = model_of(mechanism, formulation, balance)
    layout = model.layout
    state = jnp.concatenate([coordinates, speeds, jnp.zeros(layout.size - layout.memory_start)])
    state = closure_coordinates.started(mechanism, model.system, layout, times[0], state)
    if past.remembered is not None:
        state = state.at[layout.remembered].set(past.remembered)
    worn = unworn(model.system) if past.worn is None else past.worn
    plan = spot_checks.plan(times, integrator.usual_step)
    warm_start = integrator.first_warm_start(model_of_worn(model, worn), times[0], state)
    first = Carry(state, worn, warm_start, jnp.asarray(Outcome.REACHED), times[0])
    shadow = (state, warm_start) if len(plan.shadows) else None

    def turn(carry, span):
        if report:
            jax.debug.callback(progress.advance, span.progress)
        return _turn(model, integrator, carry, span)

    (last, _), saved = jax.lax.scan(turn, (first, shadow), plan.turns)
    ends, read, (accepted, rejected), figures = saved
    states = jnp.concatenate([state[None], _rows(ends, plan.own)])
    before = np.concatenate([plan.own[:1], plan.own])
    read = jax.tree.map(lambda depths: _rows(depths, before), read)
    history = StateHistory(mechanism, formulation, times, states, read, balance)
    stats = RunStats(accepted.sum(), rejected.sum(), verdict(last.outcome))
    trajectory = Trajectory(history, last.worn, last.outcome, last.ended, stats)
    kept = {check: _rows(each, plan.own) for check, each in figures.items()}
    return refereed(trajectory, kept | spot_checks.figures(model, plan, states, ends))


def _rows(values: Array, places: np.ndarray) -> Array:
    """Some rows of what every turn has left."""
    return values if len(places) == len(values) else values[places]


def _turn(
    model: Model, integrator: AbstractIntegrator, carry: tuple, turn: Turns
) -> tuple[tuple, tuple]:
    """One turn of the loop: a saving interval of the run, or a shadow, of which nothing stays but
    its last state."""
    now, shadow = carry
    running = now.outcome == Outcome.REACHED
    worn_model = model_of_worn(model, now.worn)
    ahead = Interval(turn.start, turn.stop, _error_weights(model.layout), running)
    begin = (now.state, now.warm_start)
    if shadow is not None:
        begin = _choose(turn.goes_on, shadow, begin)
        ahead = ahead._replace(share=turn.share)
    result = integrator.advance(worn_model, ahead, *begin)
    sound = jnp.all(jnp.isfinite(result.state))
    counts = running & turn.own
    reached = closure_coordinates.anchored(model.system, model.layout, turn.stop, result.state)
    state = jnp.where(counts & sound, reached, now.state)
    worn = deposit(model.system, model.layout, now.worn, now.state, state)
    # What is not held to a tolerance (memories, worn volumes) can be lost while the steps still
    # succeed.
    lost = ~sound & (result.outcome == Outcome.REACHED)
    found = jnp.where(lost, Outcome.NOT_FINITE, result.outcome)
    outcome = jnp.where(counts, found, now.outcome)
    ended = jnp.where(counts & (outcome == Outcome.REACHED), turn.stop, now.ended)
    steps = (jnp.where(counts, result.accepted, 0), jnp.where(counts, result.rejected, 0))
    figures = {c: jnp.where(counts, x, 0.0) for c, x in (result.figures or {}).items()}
    row, warm_start = state, result.warm_start
    if shadow is not None:
        row = jnp.where(turn.own, state, result.state)
        warm_start = _choose(turn.own, result.warm_start, now.warm_start)
        shadow = (result.state, result.warm_start)
    after = Carry(state, worn, warm_start, outcome, ended)
    return (after, shadow), (row, worn_model.worn, steps, figures)


def _choose(condition: Any, these: Any, those: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), these, those)


def model_of_worn(model: Model, worn: Worn) -> Model:
    """The model with its gaps reading surfaces of these depths."""
    return dataclasses.replace(model, worn=readings(model.system, worn))


def _error_weights(layout: Layout) -> Float[Array, " n"]:
    """Weights of the state's entries in an error control."""
    rest = layout.size - layout.memory_start - layout.memory_count
    counts = np.array([layout.memory_start, layout.memory_count, rest])
    return jnp.repeat(jnp.array([1.0, MEMORY_WEIGHT, 0.0]), counts)
