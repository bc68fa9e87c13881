"""The loop of a run: the state is carried from one saving time to the next.

Worn surfaces enter the gap as they were at the last saving time, and are updated at every saving
time: wear is slow, the motion is fast, and a map that is constant within an interval costs the
equations of motion nothing but its reading. Where nothing wears, the whole loop is one kernel,
which writes what is saved itself.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from jaxclear.formulations.base import model_of
from jaxclear.formulations.model import Model, State
from jaxclear.integrators.base import AbstractIntegrator, Interval
from jaxclear.integrators.checks import Check
from jaxclear.integrators.events import Events
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody import closure_coordinates
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import Layout
from jaxclear.multibody.system import readings, rubbing_joints
from jaxclear.native import forwards_only, one_row, scan, verdict
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import RunStats, Trajectory
from jaxclear.simulation import progress, spot_checks, wear_by_saves
from jaxclear.simulation.beginning import Past
from jaxclear.simulation.referee import refereed
from jaxclear.simulation.spot_checks import Plan, Turns
from jaxclear.simulation.wear import Worn, deposit, unworn

# What a derivative in reverse mode is told where the run is not one kernel.
NOT_BACKWARDS = (
    "a derivative in reverse mode (jax.grad, jax.vjp, jax.jacrev, jax.hessian) does not go through "
    "a run that checks its steps and whose surfaces wear, or that shows its progress: take forward "
    "mode (jax.jvp, jax.jacfwd; jax.jacfwd of it for second derivatives), or FixedStep or "
    "ImplicitStep with steps_per_save."
)
# What it is told where sweeps find the friction of ideal joints outside a kernel.
NOT_THROUGH_SWEEPS = (
    "a derivative in reverse mode (jax.grad, jax.vjp, jax.jacrev, jax.hessian) does not go through "
    "friction in ideal joints on ImplicitStep, or with steps_per_save: take forward mode (jax.jvp, "
    "jax.jacfwd), or FixedStep without steps_per_save."
)


class Extras(NamedTuple):
    """What a run does beside its motion: the energies of its `balance`, a `report` of its progress,
    and how many `events` (touches and releases) of each contact it keeps between two saving
    times."""

    balance: bool = False
    report: bool = False
    events: int = 0


class Carry(NamedTuple):
    """What a run hands from turn to turn; `ended` [s] is the last saving time that it reached,
    `steps` those accepted and rejected so far."""

    state: State
    worn: Worn
    warm_start: Any
    outcome: Int[Array, ""]
    ended: Float[Array, ""]
    steps: tuple[Int[Array, ""], Int[Array, ""]]


def run(
    mechanism: Mechanism,
    coordinates: Array,
    speeds: Array,
    times: Float[Array, " saves"],
    integrator: AbstractIntegrator,
    extras: Extras = Extras(),
    past: Past = Past(),
) -> Trajectory:
    """The pure core of `simulate`: from consistent coordinates and speeds, and what is left of a
    past, to a trajectory."""
    formulation = integrator.formulation
    model = model_of(mechanism, formulation, extras.balance)
    model = dataclasses.replace(model, events=extras.events)
    layout = model.layout
    state = jnp.concatenate([coordinates, speeds, jnp.zeros(layout.size - layout.memory_start)])
    state = closure_coordinates.started(mechanism, model.system, layout, times[0], state)
    if past.remembered is not None:
        state = state.at[layout.remembered].set(past.remembered)
    worn = unworn(model.system) if past.worn is None else past.worn
    plan = spot_checks.plan(times, integrator.usual_step)
    warm_start = _first_warm_start(model_of_worn(model, worn), integrator, times[0], state)
    reached, none = jnp.asarray(Outcome.REACHED), jnp.zeros((), int)
    first = Carry(state, worn, warm_start, reached, times[0], (none, none))
    turn, unpack = _turns(model, integrator, extras.report)
    # Worn surfaces are more numbers than a kernel carries, the host hears nothing of it on its way,
    # and counted steps are gone through backwards.
    whole = not (worn or extras.report) and integrator.steps_between_saves is None
    through = _in_one_kernel if whole else _from_save_to_save
    done = through(plan, turn, first)
    if _sweeps_outside_kernels(model, integrator, warm_start):
        done = forwards_only(NOT_THROUGH_SWEEPS, done)
    last, (states, read, packed), ends = done
    figures, noted = jax.vmap(unpack)(packed)
    states = jnp.concatenate([state[None], states])
    read = jax.tree.map(lambda depths: jnp.concatenate([depths[:1], depths]), read)
    history = StateHistory(mechanism, formulation, times, states, read, extras.balance)
    stats = RunStats(*last.steps, verdict(last.outcome))
    begun = times[:-1] <= last.ended
    if noted is not None:
        noted = noted._replace(counts=jnp.where(begun[:, None], noted.counts, 0.0))
    trajectory = Trajectory(history, last.worn, last.outcome, last.ended, stats, noted=noted)
    kept = {check: jnp.where(begun, each.T, 0.0).T for check, each in figures.items()}
    means = formulation.forces_are_means
    windows = spot_checks.figures(model, plan, states, ends, means)
    windows |= wear_by_saves.figures(model, worn, last.worn, states)
    return refereed(trajectory, model, kept, windows)


def _first_warm_start(
    model: Model, integrator: AbstractIntegrator, time: Array, state: State
) -> Any:
    """What warm-starts the first step. It asks for forces, which compile faster as a kernel."""
    arrays, rest = eqx.partition((model, integrator), eqx.is_array)

    def first(arrays, time, state):
        model, integrator = eqx.combine(arrays, rest)
        return integrator.first_warm_start(model, time, state)

    return one_row(first, arrays, time, state)


def _sweeps_outside_kernels(model: Model, integrator: AbstractIntegrator, warm_start: Any) -> bool:
    """Whether ideal joints have friction that counted steps, or the first implicit one, ask for.
    Where forces are means over steps the first step starts from none."""
    joints = rubbing_joints(model.system).values()
    counted = integrator.steps_between_saves is not None
    begun = bool(jax.tree.leaves(warm_start)) and not integrator.formulation.forces_are_means
    return (counted or begun) and any(joint.friction is not None for joint in joints)


def _turns(model: Model, integrator: AbstractIntegrator, report: bool) -> tuple[Callable, Callable]:
    """(a turn as it stands in the loop, traced once however often it stands there; how the figures
    that it leaves are unpacked, known once it has been traced)."""
    arrays, rest = eqx.partition((model, integrator), eqx.is_array)
    unpack: list[Callable] = []

    @jax.jit
    def one(arrays, now, turn):
        now, (*left, found) = _turn(*eqx.combine(arrays, rest), now, turn)
        # A loop of XLA pays for every array that its turns leave.
        some = bool(jax.tree.leaves(found))
        packed, unpacked = ravel_pytree(found) if some else (jnp.zeros(0), lambda _: found)
        unpack.append(unpacked)
        return now, (*left, packed)

    def turn(now, span):
        if report:
            jax.debug.callback(progress.advance, span.progress)
        return one(arrays, now, span)

    return turn, lambda packed: unpack[0](packed)


def _in_one_kernel(plan: Plan, turn: Callable, first: Carry) -> tuple[Carry, Any, Array | None]:
    """(what the last turn hands on, what every saving interval has left, the states at the ends of
    all parts), turn by turn in the order in which they are gone through."""
    parts = plan.parts
    lengths = parts.stop - parts.first
    order = np.concatenate(list(map(np.arange, parts.first, parts.stop)))
    own, goes_on = (np.repeat(each, lengths) for each in (parts.own, parts.goes_on))
    turns = jax.tree.map(lambda each: each[order], plan.turns)
    if not len(plan.windows):
        return *scan(turn, first, turns), None

    def one(carry, row):
        now, shadow = carry
        span, is_own, follows = row
        end, left = turn(_choose(follows, shadow, now), span)
        shadow = now._replace(state=end.state, warm_start=end.warm_start)
        return (_choose(is_own, end, now), shadow), (left, end.outcome)

    (last, _), (left, outcomes) = scan(one, (first, first), (turns, own, goes_on))
    stops = np.cumsum(lengths)
    lost = outcomes[stops - 1] == Outcome.NOT_FINITE
    ends = jnp.where(lost[:, None], jnp.nan, left[0][stops - 1])
    pieces = [slice(*piece) for piece in zip(stops - lengths, stops, strict=True)]
    own_pieces = [piece for piece, is_own in zip(pieces, parts.own, strict=True) if is_own]
    whole = lambda each: jnp.concatenate([each[piece] for piece in own_pieces])
    return last, jax.tree.map(whole, left), ends


def _from_save_to_save(plan: Plan, turn: Callable, first: Carry) -> tuple[Carry, Any, Array | None]:
    """As `_in_one_kernel`, each turn by itself. What shadows are apart from the run is seen to
    between parts, so that the run's own turns pay nothing for them."""
    if not len(plan.windows):
        return *jax.lax.scan(turn, first, plan.turns), None
    count = plan.intervals
    left = jax.eval_shape(turn, first, jax.tree.map(lambda each: each[0], plan.turns))[1]
    rows = jax.tree.map(lambda each: jnp.zeros((count, *each.shape), each.dtype), left)

    def one(index, carry):
        now, rows = carry
        now, row = turn(now, jax.tree.map(lambda each: each[index], plan.turns))
        # A shadow's go to the last row, which is the run's own in the end.
        put = lambda each, values: jax.lax.dynamic_update_index_in_dim(each, values, index, 0)
        return now, jax.tree.map(put, rows, row)

    def through(carry, part):
        now, shadow, rows = carry
        begin = _choose(part.goes_on, shadow, now)
        end, rows = jax.lax.fori_loop(part.first, part.stop, one, (begin, rows))
        state = jnp.where(end.outcome == Outcome.NOT_FINITE, jnp.nan, end.state)
        shadow = now._replace(state=end.state, warm_start=end.warm_start)
        return (_choose(part.own, end, now), shadow, rows), state

    (last, _, rows), ends = jax.lax.scan(through, (first, first, rows), plan.parts)
    return forwards_only(NOT_BACKWARDS, (last, rows, ends))


def _turn(
    model: Model, integrator: AbstractIntegrator, now: Carry, turn: Turns
) -> tuple[Carry, tuple[State, Worn, tuple[dict[Check, Array], Events | None]]]:
    """One turn of the loop: what it hands on, and what it leaves: the state at its end, the worn
    surfaces as its gaps saw them, and its figures with its events."""
    running = now.outcome == Outcome.REACHED
    worn_model = model_of_worn(model, now.worn)
    ahead = Interval(turn.start, turn.stop, _error_weights(model.layout), running, turn.share)
    result = integrator.advance(worn_model, ahead, now.state, now.warm_start)
    sound = jnp.all(jnp.isfinite(result.state))
    reached = closure_coordinates.anchored(model.system, model.layout, turn.stop, result.state)
    state = jnp.where(running & sound, reached, now.state)
    worn = deposit(model.system, model.layout, now.worn, now.state, state)
    # What is not held to a tolerance (worn volumes, energies) can be lost while the steps still
    # succeed.
    lost = ~sound & (result.outcome == Outcome.REACHED)
    found = jnp.where(lost, Outcome.NOT_FINITE, result.outcome)
    outcome = jnp.where(running, found, now.outcome)
    ended = jnp.where(running & (outcome == Outcome.REACHED), turn.stop, now.ended)
    taken = jax.tree.map(
        lambda before, more: before + jnp.where(running, more, 0),
        now.steps,
        (result.accepted, result.rejected),
    )
    after = Carry(state, worn, result.warm_start, outcome, ended, taken)
    return after, (state, worn_model.worn, (result.figures or {}, result.events))


def _choose(condition: Any, these: Any, those: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), these, those)


def model_of_worn(model: Model, worn: Worn) -> Model:
    """The model with its gaps reading surfaces of these depths."""
    return dataclasses.replace(model, worn=readings(model.system, worn))


def _error_weights(layout: Layout) -> Float[Array, " n"]:
    """Weights of the state's entries in an error control: deflections of bristles are lengths, held
    as places are (a hundred times looser, what a contact wore was 2 % off); what follows the motion
    is not held."""
    held = layout.memory_start + layout.memory_count
    return jnp.asarray(np.repeat([1.0, 0.0], [held, layout.size - held]))
