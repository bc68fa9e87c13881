"""The loop of a run: the state is carried from one saving time to the next.

Worn surfaces enter the gap as they were at the last saving time, and are updated at every saving
time: wear is slow, the motion is fast, and a map that is constant within an interval costs the
equations of motion nothing but its reading. The whole loop is one kernel, which wears surfaces and
writes what is saved itself. Where there are no kernels, and where steps are counted, XLA goes from
save to save.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxclear.formulations.base import model_of
from jaxclear.formulations.model import Model, State
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody import closure_coordinates
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import readings, rubbing_joints
from jaxclear.native import Kept, forwards_only, has_kernels, one_row, scan, verdict
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import RunStats, Trajectory
from jaxclear.simulation import spot_checks, wear_by_cells, wear_by_saves
from jaxclear.simulation.beginning import Past
from jaxclear.simulation.looks import looked_at
from jaxclear.simulation.referee import refereed
from jaxclear.simulation.shadows import in_memory, kept_of_shadows, where_shadows_go_on
from jaxclear.simulation.spot_checks import COARSE_ON, ON, Plan
from jaxclear.simulation.step_lengths import with_few_enough_steps
from jaxclear.simulation.tally import nothing_yet
from jaxclear.simulation.turns import Carry, Left, turns_of
from jaxclear.simulation.wear import Pending, Worn, pending_wear, unworn, worn_so_far

# Worn surfaces stand in memory.
LONG: Any = Carry._make(name in ("worn", "read") for name in Carry._fields)
# What a derivative in reverse mode is told where the run is neither pushed forwards nor one kernel.
NOT_BACKWARDS = (
    "a derivative in reverse mode (jax.grad, jax.vjp, jax.jacrev, jax.hessian) does not go through "
    "a run that shows its progress: leave progress_bar out, or take forward mode (jax.jvp, "
    "jax.jacfwd; jax.jacfwd of it for second derivatives)."
)
# What it is told where sweeps find the friction of ideal joints outside a kernel.
NOT_THROUGH_SWEEPS = (
    "a derivative in reverse mode (jax.grad, jax.vjp, jax.jacrev, jax.hessian) does not go through "
    "friction in ideal joints with steps_per_save: take forward mode (jax.jvp, jax.jacfwd), or "
    "leave steps_per_save out."
)


class Extras(NamedTuple):
    """What a run does beside its motion: the energies of its `balance`, a `report` of its progress,
    how many `events` (touches and releases) of each contact it keeps between two saving times, and
    whether its derivatives are those of the `discrete` run."""

    balance: bool = False
    report: bool = False
    events: int = 0
    discrete: bool = False


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
    formulation, integrator = integrator.formulation, with_few_enough_steps(integrator, times)
    model = model_of(mechanism, formulation, extras.balance)
    model = dataclasses.replace(model, events=extras.events, discrete=extras.discrete)
    layout = model.layout
    state = jnp.concatenate([coordinates, speeds, jnp.zeros(layout.size - layout.memory_start)])
    state = closure_coordinates.started(mechanism, model.system, layout, times[0], state)
    if past.remembered is not None:
        state = state.at[layout.remembered].set(past.remembered)
    worn = unworn(model.system) if past.worn is None else past.worn
    means = formulation.forces_are_means
    plan = spot_checks.plan(times, integrator.usual_step, means)
    read = readings(model.system, worn)
    seen = dataclasses.replace(model, worn=read)
    warm_start = _first_warm_start(seen, integrator, times[0], state)
    reached, none = jnp.asarray(Outcome.REACHED), jnp.zeros((), int)
    begun, whole = (state, read, warm_start), _whole(integrator, extras, worn)
    turn, shapes, unpack = turns_of(model, integrator, extras.report, begun, whole)
    tally = nothing_yet(shapes, model, state, len(plan.windows), means)
    first = Carry(state, worn, read, warm_start, reached, times[0], (none, none), tally)
    if whole:
        pending = pending_wear(model.system, layout, state) if worn else None
        done = _in_one_kernel(plan, turn, functools.partial(_settled, model), (first, pending))
    else:
        done = _from_save_to_save(plan, turn, first)
    if _sweeps_outside_kernels(model, integrator, warm_start):
        done = forwards_only(NOT_THROUGH_SWEEPS, done)
    last, left, ends = done
    states, read = left.saved
    states = integrator.known_states(seen, times, states, last.state, last.warm_start)
    noted, figures = unpack(left)
    history = StateHistory(mechanism, formulation, times, states, read, extras.balance)
    stats = RunStats(*last.steps, verdict(last.outcome))
    if noted is not None:
        noted = noted._replace(counts=noted.counts * (times[:-1] <= last.ended)[:, None])
    trajectory = Trajectory(history, last.worn, last.outcome, last.ended, stats, noted=noted)
    windows = spot_checks.figures(model, plan, states, ends, last.tally, means)
    windows |= wear_by_saves.figures(model, worn, last.worn, states)
    windows |= wear_by_cells.figures(model, worn, last.worn)
    return refereed(trajectory, model, last.tally, figures, windows)


def _whole(integrator: AbstractIntegrator, extras: Extras, worn: Worn) -> bool:
    """Whether a run is one kernel: the host hears nothing of that on its way, counted steps are
    gone through backwards, and surfaces wear cell by cell by machine code alone."""
    told = extras.report or integrator.steps_between_saves is not None
    return not told and (not worn or has_kernels())


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


def _settled(
    model: Model, now: Carry, pending: Pending | None, unless: Any = False
) -> tuple[Carry, Pending | None]:
    """What a run hands from turn to turn, once its surfaces are worn by what it has lost."""
    if pending is None:
        return now, None
    found = now.worn, now.read, pending
    worn, read, pending = worn_so_far(model.system, model.layout, found, now.state, unless)
    return now._replace(worn=worn, read=read), pending


def _in_one_kernel(
    plan: Plan, turn: Callable, settled: Callable, begun: tuple[Carry, Pending | None]
) -> tuple[Carry, Left, Array | None]:
    """(what the last turn hands on, what is left: states and worn surfaces at all saving times and
    the rest by saving intervals, the states at the ends of the windows' turns), turn by turn in the
    order in which they are gone through. Before a turn surfaces are `settled`."""
    parts = plan.parts
    lengths = parts.stop - parts.first
    order = np.concatenate(list(map(np.arange, parts.first, parts.stop)))
    own, goes_on = (np.repeat(each, lengths) for each in (parts.own, parts.goes_on))
    turns = jax.tree.map(lambda each: each[order], plan.turns)
    kept = _kept(plan.intervals, begun[0], order, own)
    if not len(plan.windows):

        def alone(carry, span):
            now, pending = settled(*carry)
            now, left = turn(now, span)
            return (now, pending), left

        done, left = scan(alone, begun, turns, kept, (LONG, True))
        return _at_last(settled, done), Left(*left), None

    part = lambda carry: (carry.state, carry.warm_start, carry.outcome)
    names = "state", "warm_start", "outcome"
    but = lambda carry, part: carry._replace(**dict(zip(names, part, strict=True)))
    shadow, unpacked = in_memory(part(begun[0]))

    def one(carry, row):
        now, shadow, pending = carry
        span, is_own, follows, followed = row
        now, pending = settled(now, pending, follows)
        of_begin = where_shadows_go_on(follows, shadow, unpacked, part(now))
        begin = but(now, of_begin) if goes_on.any() else now
        end, left = turn(begin, span)
        if goes_on.any():
            shadow = kept_of_shadows(followed, shadow, (*part(end)[:2], now.outcome))
        after = but(end, _choose(is_own, part(end), part(now)))
        return (after, shadow, pending), (*left, _end(end))

    shadows = np.where(own, np.sum(~own), np.cumsum(~own) - 1)
    kept.append(Kept(shadows, np.sum(~own)))
    followed = np.append(goes_on[1:], False)
    carry, rows = (begun[0], shadow, begun[1]), (turns, own, goes_on, followed)
    (last, _, pending), (*left, ends) = scan(one, carry, rows, kept, (LONG, True, True))
    return _at_last(settled, (last, pending)), Left(*left), ends


def _kept(count: int, first: Carry, order: np.ndarray, own: np.ndarray) -> list[Kept]:
    """How what turns leave is kept, of a run of so many saving intervals that are gone through in
    this order, some of them not its `own`."""
    looks = looked_at(count)
    numbers = np.searchsorted(looks, order)
    seen = own & (looks[numbers.clip(max=len(looks) - 1)] == order)
    return [
        Kept(np.where(own, order + 1, count + 1), count + 1, (first.state, first.read)),
        Kept(np.where(own, order, count), count),
        Kept(np.where(seen, numbers, len(looks)), len(looks)),
    ]


def _at_last(settled: Callable, done: tuple[Carry, Pending | None]) -> Carry:
    """What the last turn hands on, its surfaces worn by what it lost."""
    if done[1] is None:
        return done[0]
    last = lambda now, _: (settled(*now), ())
    return scan(last, done, np.zeros(1), long=(LONG, True))[0][0]


def _from_save_to_save(
    plan: Plan, turn: Callable, first: Carry
) -> tuple[Carry, Left, Array | None]:
    """As `_in_one_kernel`, each turn by itself; windows are gone through after the run, from what
    its turns began with, so that these pay nothing for them."""
    if not len(plan.windows):
        last, rows = jax.lax.scan(turn, first, plan.turns)
        return last, _from_the_start(first.state, rows), None

    def one(now, span):
        after, left = turn(now, span)
        return after, (left, ravel_pytree(now.warm_start)[0])

    own = jax.tree.map(lambda each: each[: plan.intervals], plan.turns)
    last, (rows, begun) = jax.lax.scan(one, first, own)
    ends = _through_windows(plan, turn, (first, last), rows.saved, begun)
    return forwards_only(NOT_BACKWARDS, (last, _from_the_start(first.state, rows), ends))


def _through_windows(
    plan: Plan,
    turn: Callable,
    run: tuple[Carry, Carry],
    saved: tuple[Float[Array, "turns n"], Worn],
    begun: Float[Array, "turns k"],
) -> Float[Array, "shadows n"]:
    """States at the ends of the windows' turns, of a `run` with such a beginning and end, of whose
    turns this is left: the state after each and the surfaces that it saw, and what warm-started
    it. Surfaces do not wear in windows."""
    (first, last), (states, read) = run, saved
    states = jnp.concatenate([first.state[None], states])
    begun = jnp.concatenate([begun, ravel_pytree(last.warm_start)[0][None]])
    unpacked = ravel_pytree(first.warm_start)[1]
    # What goes on from the run's own turn begins where that has ended.
    ends_own = np.array([plan.whole and name == COARSE_ON for name in plan.names])
    follows = np.array([name in ON for name in plan.names]) & ~ends_own
    at = np.repeat(plan.windows, len(plan.names))
    begins = at + np.tile(ends_own, len(plan.windows))
    reached = plan.times[at] <= last.ended
    outcomes = jnp.where(reached, Outcome.REACHED, last.outcome).astype(last.outcome.dtype)

    def one(shadow, row):
        span, state, warm_start, surfaces, outcome, goes_on = row
        state, warm_start = _choose(goes_on, shadow, (state, warm_start))
        now = last._replace(worn={}, read=surfaces, state=state, outcome=outcome)
        end, _ = turn(now._replace(warm_start=unpacked(warm_start)), span)
        return (end.state, ravel_pytree(end.warm_start)[0]), _end(end)

    spans = jax.tree.map(lambda each: each[plan.intervals :], plan.turns)
    surfaces = jax.tree.map(lambda depths: depths[at], read)
    goes_on = jnp.asarray(np.tile(follows, len(plan.windows)))
    rows = spans, states[begins], begun[begins], surfaces, outcomes, goes_on
    return jax.lax.scan(one, (first.state, begun[0]), rows)[1]


def _end(end: Carry) -> State:
    """The state at the end of a window's turn; nan where it has been lost."""
    return jnp.where(end.outcome == Outcome.NOT_FINITE, jnp.nan, end.state)


def _from_the_start(state: State, left: Left) -> Left:
    """What all turns have left, with the state at the start and the surfaces that the first one
    saw in front, and only the figures that go with a look."""
    states, read = left.saved
    read = jax.tree.map(lambda depths: jnp.concatenate([depths[:1], depths]), read)
    states = jnp.concatenate([state[None], states])
    return Left((states, read), left.noted, left.figures[looked_at(len(left.figures))])


def _choose(condition: Any, these: Any, those: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), these, those)
