"""The loop of a run: the state is carried from one saving time to the next.

Worn surfaces enter the gap as they were when they were updated last: after each part of a saving
interval in which a contact has moved by half a cell of its map, or as rarely as they say
(`Wearing.updates`). Wear is slow, the motion is fast, and a map that is constant within a part
costs the equations of motion nothing but its reading. The whole loop is one kernel, which wears
surfaces and writes what is saved itself. Where there are no kernels XLA goes from save to save, and
where steps are counted surfaces wear at each.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxclear.formulations.base import AbstractFormulation, model_of
from jaxclear.formulations.model import Model, State
from jaxclear.ground.grouping import packed, unpacked
from jaxclear.integrators.base import SLIVER, AbstractIntegrator, Interval
from jaxclear.integrators.checks import Outcome
from jaxclear.integrators.events import Events, Peaks, newest, together
from jaxclear.multibody import closure_coordinates, kinematics
from jaxclear.multibody.damped_stops import loads_to_settle, with_settled_loads
from jaxclear.multibody.forces import transmitting
from jaxclear.multibody.mechanism import Mechanism, stabilised_as_needed
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System, readings, rubbing_joints, wear_maps
from jaxclear.multibody.transmissions import between_worn_flanks
from jaxclear.native import (
    TableLayout,
    forwards_only,
    has_kernels,
    one_row,
    scan,
    verdict,
    while_loop,
)
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import Extremes, RunStats, Trajectory
from jaxclear.simulation import progress
from jaxclear.simulation.error_weights import error_weights
from jaxclear.simulation.initial_state import Past
from jaxclear.simulation.invariants import contact_labels, contact_names, is_too_deep, judged
from jaxclear.simulation.sampling import next_instant, sample_loads, sampled_loads
from jaxclear.simulation.saving import with_few_enough_steps
from jaxclear.simulation.wear import (
    Pending,
    Worn,
    is_off_surface,
    longest_path,
    losses,
    pending_losses,
    pending_wear,
    unworn,
    wear_all,
    wear_changed,
    worn_so_far,
)

# What a derivative in reverse mode is told where sweeps find the friction of ideal joints outside a
# kernel.
NOT_THROUGH_SWEEPS = (
    "a derivative in reverse mode (jax.grad, jax.vjp, jax.jacrev, jax.hessian) does not go through "
    "friction in ideal joints with steps_per_save: take forward mode (jax.jvp, jax.jacfwd), or "
    "leave steps_per_save out."
)


# A coordinate or speed so large is off by rounding by a radian, or a metre.
BOUNDLESS = 1 / np.finfo(float).eps


class Extras(NamedTuple):
    """What a run does beside its motion: the energies of its `balance`, a `report` of its progress,
    how many `events` (touches and releases) of each contact it keeps between two saving times, and
    whether its derivatives are those of the `discrete` run."""

    balance: bool = False
    report: bool = False
    events: int = 0
    discrete: bool = False


# Path [cells] that a contact takes between two updates of its surface: half a cell leaves the
# deepest place of the four-bar within 2 % (`benchmarks.claims.worn_depth`); longer ones are taken
# again up to twice that. In a run without such paths so many updates are made.
PATH, FEWEST_UPDATES = 0.5, 100
# How much longer or shorter than the part before a part between two updates is at most.
LONGER, SHORTER = 2.0, 0.125
# Shortest part between two updates, beside the run, where no step is asked for.
SHORTEST_PART = 1e-6


class Span(NamedTuple):
    """A saving interval from `start` to `stop` [s]; `progress`: its share of the whole run. Where
    surfaces wear: whether their wear is updated at its start (`wears`)."""

    start: Float[Array, " turns"]
    stop: Float[Array, " turns"]
    progress: Float[Array, " turns"]
    wears: Bool[Array, " turns"] | None = None


class Carry(NamedTuple):
    """What a run hands from turn to turn; `worn` are its worn surfaces (none where they are not to
    wear on), `read` these as gaps read them, `ended` [s] is the last time that it reached: when a
    state is saved, surfaces wear, or steps are to end; `steps` those accepted and rejected so far,
    `peaks` the largest of every contact (None: no integrator follows them), `transmitted` that of
    every coupling whose force follows from the state (None: there is none)."""

    state: State
    worn: Worn
    read: Worn
    warm_start: Any
    outcome: Int[Array, ""]
    ended: Float[Array, ""]
    steps: tuple[Int[Array, ""], Int[Array, ""]]
    peaks: Peaks | None
    transmitted: Any


# Worn surfaces stand in memory.
LONG: Any = Carry._make(name in ("worn", "read") for name in Carry._fields)
# Beside it what surfaces are still to lose, and the time to their next update.
LONG_CARRY = (LONG, True, False)


# Within this [s] friction comes whose bristle follows from the inertia: from rest a way is off by
# some 2 of it beside the time of a push, and steps that hold are as long.
DELAY = 5e-5


class Saved(NamedTuple):
    """What a turn leaves, and what is left of all: states, worn surfaces as gaps saw them (not as
    updated then: forces would be lower than the motion's), events (None: nobody asks)."""

    states: State
    read: Worn
    noted: Events | None


def run(
    mechanism: Mechanism,
    coordinates: Array,
    speeds: Array,
    times: Float[Array, " saves"],
    integrator: AbstractIntegrator,
    extras: Extras = Extras(),
    past: Past = Past(),
    updates: Any = 1,
) -> Trajectory:
    """The pure core of `simulate`: from consistent coordinates and speeds to a trajectory.

    Args:
        mechanism: as its formulation models it.
        coordinates: of the tree at the start, shape (coordinates,).
        speeds: free speeds at the start, shape (speeds,).
        times: saving times [s]; the run begins at the first.
        integrator: with its formulation.
        extras: what the run does beside the motion: energies, progress, events.
        past: worn surfaces and memories of an earlier run.
        updates: updates of worn surfaces as a multiple of the usual number, where steps are not
            counted.
    """
    formulation, integrator = integrator.formulation, with_few_enough_steps(integrator, times)
    inputs = mechanism, coordinates, speeds, times, integrator
    mechanism, turn, first = first_turn(*inputs, extras, past)
    model, worn, viewed = turn.model, first.worn, turn.model.seeing(first.read)
    spans = Span(times[:-1], times[1:], jnp.diff(times) / (times[-1] - times[0]))
    if _fits_one_kernel(integrator, extras, worn):
        last, saved = _run_in_one_kernel(turn, first, spans, updates)
    else:
        counted = integrator.steps_between_saves
        last, saved = _run_by_saves(turn, first, spans, counted, updates)
    if _sweeps_outside_kernels(model, integrator, first.warm_start):
        last, saved = forwards_only(NOT_THROUGH_SWEEPS, (last, saved))
    states = integrator.check_derivatives(viewed, times, saved.states, last.state, last.warm_start)
    history = StateHistory(mechanism, formulation, times, states, saved.read, extras.balance)
    stats, noted = RunStats(*last.steps, verdict(last.outcome)), saved.noted
    if noted is not None:
        noted = noted._replace(counts=noted.counts * (times[:-1] <= last.ended)[:, None])
    extremes = extremes_of(mechanism, model, last)
    ends = history, last.worn, last.outcome, last.ended, stats
    residual = integrator.law_residual(model, last.warm_start)
    finished = Trajectory(*ends, extremes=extremes, noted=noted)
    is_counted = integrator.steps_between_saves is not None
    return judged(finished, model, worn, residual, is_counted)


def extremes_of(mechanism: Mechanism, model: Model, last: Carry) -> Extremes | None:
    """Largest indentations and forces over a run; None where none were followed.

    Args:
        mechanism: names its contacts.
        model: of the run.
        last: what the loop carried at its end.
    """
    if last.peaks is None and last.transmitted is None:
        return None
    sent = {"transmitted": last.transmitted, "couplings": transmitting(model.system)}
    if last.peaks is None:
        return Extremes(jnp.zeros(0), None, (), **sent)
    # Steps that solve for the forces of flanks follow those of joints alone.
    count = len(last.peaks.depths)
    names, turn = contact_labels(mechanism, model)
    return Extremes(*last.peaks, names[:count], turn[:count], **sent)


def first_turn(
    mechanism: Mechanism,
    coordinates: Array,
    speeds: Array,
    times: Float[Array, " saves"],
    integrator: AbstractIntegrator,
    extras: Extras = Extras(),
    past: Past = Past(),
) -> "tuple[Mechanism, Turn, Carry]":
    """The mechanism as the steps take it, the turn of the loop, and what it carries first.

    Args:
        mechanism: as its formulation models it.
        coordinates: of the tree at the start, shape (coordinates,).
        speeds: free speeds at the start, shape (speeds,).
        times: saving times [s]; the run begins at the first.
        integrator, extras, past: as of `run`.
    """
    formulation = integrator.formulation
    mechanism = stabilised_as_needed(mechanism, integrator.opens_loops)
    if loads_to_settle(mechanism) and not formulation.forces_are_means:
        system, step = model_of(mechanism, formulation).system, integrator.requested_step()
        if integrator.steps_between_saves is not None:
            step = jnp.max(jnp.diff(times)) / integrator.steps_between_saves
        motion = unpack_motion(system, jnp.concatenate([coordinates, speeds]))
        motions = kinematics.link_motions(system, *motion, times[0])
        delay = DELAY if step is None else jnp.maximum(DELAY, step)
        mechanism = with_settled_loads(mechanism, system, motions, delay, times)
    model = model_of(mechanism, formulation, extras.balance)
    model = dataclasses.replace(model, events=extras.events, discrete=extras.discrete)
    layout = model.layout
    state = jnp.concatenate([coordinates, speeds, jnp.zeros(layout.size - layout.memory_start)])
    state = closure_coordinates.started(mechanism, model.system, layout, times[0], state)
    if past.remembered is not None:
        state = state.at[layout.remembered].set(past.remembered)
    worn = unworn(model.system) if past.worn is None else past.worn
    read = readings(model.system, worn)
    viewed = model.seeing(read)
    warm_start = _first_warm_start(viewed, integrator, times[0], state)
    turn = Turn(model, integrator, extras.report)
    reached, none = jnp.asarray(Outcome.REACHED), jnp.zeros((), int)
    first = Carry(state, worn, read, warm_start, reached, times[0], (none, none), None, None)
    number = jnp.zeros(())
    ahead = turn.interval_ahead(Span(number, number, number), jnp.ones((), bool), None)
    # None where the integrator follows none.
    shapes = jax.eval_shape(turn.advance, turn.arrays, read, ahead, state, warm_start)
    peaks = jax.tree.map(lambda each: jnp.full(each.shape, -jnp.inf), shapes.peaks)
    sent = jax.tree.map(jnp.zeros_like, shapes.transmitted)
    return mechanism, turn, first._replace(peaks=peaks, transmitted=sent)


def sketched(
    mechanism: Mechanism, formulation: AbstractFormulation, times: Any, events: int
) -> Trajectory:
    """A run of the form that `run` returns, in which nothing moves.

    It tells shapes and names of runs before one is compiled.

    Args:
        mechanism: as its formulation models it.
        formulation: of the run.
        times: saving times [s].
        events: number of events stored for each contact between two saving times.
    """
    model, count = model_of(mechanism, formulation), len(times)
    worn, contacts = unworn(model.system), contact_names(model)
    read = readings(model.system, worn)
    repeat = lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf)))
    states = jnp.zeros((count, model.layout.size))
    history = StateHistory(mechanism, formulation, times, states, jax.tree.map(repeat, read), False)
    none, blank = jnp.zeros((), int), jnp.zeros((count - 1, len(contacts), events))
    return Trajectory(
        history,
        worn,
        jnp.asarray(Outcome.REACHED),
        times[-1],
        RunStats(none, none, none),
        extremes=Extremes(
            *(jnp.zeros(len(contacts)), jnp.zeros(len(contacts))),
            *contact_labels(mechanism, model),
            *(jnp.zeros(len(transmitting(model.system))), transmitting(model.system)),
        ),
        noted=Events(blank, blank, blank[:, :, 0]) if events else None,
    )


def _fits_one_kernel(integrator: AbstractIntegrator, extras: Extras, worn: Worn) -> bool:
    """Whether a run is one kernel: the host hears nothing of that on its way, counted steps are
    gone through backwards, and surfaces wear cell by cell by machine code alone."""
    on_host = extras.report or integrator.steps_between_saves is not None
    return not on_host and (not worn or has_kernels())


class UpdateLimits(NamedTuple):
    """Between two updates of worn surfaces: the longest `path` of a contact [cells], and the
    `shortest` and the `longest` time [s]."""

    path: Any
    shortest: Any
    longest: Any


def _update_limits(
    system: System, spans: Span, step: Any, updates: Any
) -> tuple[UpdateLimits, Span]:
    """(limits between updates, saving intervals, which know whether surfaces are due where all of
    these are to wear more rarely than states are saved). `step` [s]: that asked for, or None."""
    duration = spans.stop[-1] - spans.start[0]
    # Surfaces wear at saving times as well, however many: more updates are within the intervals.
    widest = jnp.where(jnp.asarray(updates) > 1, jnp.max(spans.stop - spans.start), duration)
    longest = jnp.minimum(duration / FEWEST_UPDATES, widest) / updates
    shortest = SHORTEST_PART * duration if step is None else step
    requested = [s.updates for each in wear_maps(system).values() for _, s in each.values()]
    most = [each for each in requested if each is not None]
    if most and len(most) == len(requested):
        share = updates * max(most) / duration
        # An interval that is as long as is asked for but for rounding is.
        counts = jnp.floor(share * (spans.start - spans.start[0]) + SLIVER)
        is_due = jnp.concatenate([jnp.ones(1, bool), jnp.diff(counts) > 0])
        spans, shortest = spans._replace(wears=is_due), jnp.maximum(shortest, (1 - SLIVER) / share)
    return UpdateLimits(PATH / updates, shortest, jnp.maximum(longest, shortest)), spans


def _first_warm_start(
    model: Model, integrator: AbstractIntegrator, time: Array, state: State
) -> Any:
    """What warm-starts the first step. It asks for forces, which compile faster as a kernel."""
    arrays, rest = packed((model, integrator))

    def first(arrays, time, state):
        model, integrator = unpacked(arrays, rest)
        return integrator.first_warm_start(model, time, state)

    return one_row(first, arrays, time, state)


def _sweeps_outside_kernels(model: Model, integrator: AbstractIntegrator, warm_start: Any) -> bool:
    """Whether ideal joints have friction that counted steps, or the first implicit one, ask for.
    Where forces are means over steps the first step starts from none."""
    joints = rubbing_joints(model.system).values()
    counted = integrator.steps_between_saves is not None
    has_start = bool(jax.tree.leaves(warm_start)) and not integrator.formulation.forces_are_means
    return (counted or has_start) and any(joint.friction is not None for joint in joints)


class Turn:
    """One turn of the loop, from a saving time to the next, as a function of (`Carry`, `Span`)."""

    def __init__(self, model: Model, integrator: AbstractIntegrator, report: bool):
        self.model, self.report, self.step = model, report, integrator.requested_step()
        self.breaks = integrator.breaks
        self.arrays, rest = packed((model, integrator))

        def advance(arrays, read, ahead, state, warm_start):
            model, integrator = unpacked(arrays, rest)
            viewed = model.seeing(read)
            return integrator.advance(viewed, ahead, state, warm_start)

        # Traced once, however often a turn stands in the program.
        self.advance = jax.jit(advance)

    def interval_ahead(self, span: Span, running: Array, peaks: Peaks | None) -> Interval:
        """The interval of a span, with the peaks of the run until then.

        Args:
            span: between two saving times.
            running: whether the run goes on.
            peaks: largest depths and forces so far; None: the run begins.
        """
        weights, none = error_weights(self.model), jnp.full(self.model.layout.contacts, -jnp.inf)
        if not none.size:
            return Interval(span.start, span.stop, weights, running)
        last = Peaks(none, none) if peaks is None else peaks
        last = last._replace(forces=none) if last.forces is None else last
        return Interval(span.start, span.stop, weights, running, last)

    def worn_as(self, now: Carry, worn: Worn, read: Worn) -> Carry:
        """What the loop carries, with new depth maps, and shafts moved along with their flanks.

        Args:
            now: what it carried before.
            worn: depth maps [m] by joint and surface.
            read: the same in the form in which gaps read them.
        """
        model = self.model
        state = between_worn_flanks(model.system, model.layout, (now.read, read), now.state)
        return now._replace(state=state, worn=worn, read=read)

    def motion(self, now: Carry, span: Span, under_way: Any = None) -> tuple:
        """The motion through an interval, without the wear of surfaces.

        Args:
            now: state at its start, a `Carry`.
            span: the interval.
            under_way: steps of it that are under way, a tuple as of an `Interval`; None: it is gone
                through at once.

        Returns:
            what is handed on but for worn surfaces, a `Carry`; what these lose, `Losses`; events;
            steps under way: where there are some the others are not valid yet.
        """
        if self.report:
            jax.debug.callback(progress.advance, span.progress)
        model, layout = self.model, self.model.layout
        running = (now.outcome == Outcome.REACHED).astype(bool)
        ahead = self.interval_ahead(span, running, now.peaks)._replace(under_way=under_way)
        start = sample_loads(model, span.start, now.state)
        result = self.advance(self.arrays, now.read, ahead, start, now.warm_start)
        moving = result.state[: layout.memory_start]
        sound = jnp.all(jnp.isfinite(result.state)) & jnp.all(abs(moving) < BOUNDLESS)
        reached = closure_coordinates.anchored(model.system, layout, span.stop, result.state)
        state = jnp.where(running & sound, reached, now.state)
        # What is not held to a tolerance (worn volumes, energies) can be lost while the steps still
        # succeed.
        failed = ~sound & (result.outcome == Outcome.REACHED)
        ending = jnp.where(failed, Outcome.NOT_FINITE, result.outcome)
        is_off = is_off_surface(model.system, layout, result.state)
        if is_off is not False:
            ending = jnp.where(is_off, Outcome.GUIDE_RANGE_EXCEEDED, ending)
        if result.peaks is not None:
            is_deep = (ending == Outcome.REACHED) & is_too_deep(model.system, result.peaks.depths)
            ending = jnp.where(is_deep, Outcome.PENETRATION_EXCEEDED, ending)
        outcome = jnp.where(running, ending, now.outcome)
        ended = jnp.where(running & (outcome == Outcome.REACHED), span.stop, now.ended)
        more = lambda before, new: before + jnp.where(running, new, 0)
        steps = jax.tree.map(more, now.steps, (result.accepted, result.rejected))
        largest = lambda old, new: newest(old, new, running & ~jnp.isnan(old))
        peaks = jax.tree.map(largest, now.peaks, result.peaks)
        rises = lambda before, new: jnp.where(running & (new > before), new, before)
        sent = jax.tree.map(rises, now.transmitted, result.transmitted)
        ends = result.warm_start, outcome, ended, steps, peaks, sent
        after = Carry(state, now.worn, now.read, *ends)
        return after, losses(layout, now.state, state), result.events, result.under_way


def _advance_by_updates(
    motion: Callable,
    system: System,
    limits: UpdateLimits,
    step: Any,
    settled: Callable,
    loop: Callable,
    resumed: Any,
) -> Callable:
    """A part of a saving interval that is gone through from update to update of worn surfaces, by a
    while `loop`, as (what is handed on, span) -> (that, what is left). `motion` as of a `Turn`,
    `settled` wears surfaces; `step` [s]: of an integrator whose steps have a length, so that
    updates come after whole ones; `resumed`: () where a turn may leave steps under way, else None.

    A part in which a contact has gone more than twice as far as it is to is taken again, shorter.
    """

    def end_of_part(time, length, stop):
        if step is not None:
            length = jnp.maximum(jnp.floor(length / step * (1 + SLIVER)), 1.0) * step
        # No part shorter than the shortest is left, and time grows.
        inside = (time + length + (1 - SLIVER) * limits.shortest <= stop) & (time + length > time)
        return jnp.where(inside, time + length, stop)

    def parts(first, span):
        def one(now):
            time, (carry, pending, length), noted, steps = now
            end = end_of_part(time, length, span.stop)
            wears = None if span.wears is None else span.wears | (time > span.start)
            if steps:
                wears = ~steps[0] if wears is None else wears & ~steps[0]
            carry, pending = settled(carry, pending, wears)
            part = span._replace(start=time, stop=end)
            moved, wear, more, steps = motion(carry._replace(worn={}), part, steps)
            path, taken = longest_path(system, wear), end - time
            change = jnp.where(path > 0, limits.path / jnp.where(path > 0, path, 1.0), LONGER)
            target = taken * jnp.clip(change, SHORTER, LONGER)
            target = jnp.clip(target, limits.shortest, limits.longest)
            # What cannot be shorter is taken as it is.
            fits = ~(path > 2.0 * limits.path) | (end_of_part(time, target, span.stop) >= end)
            # A part that a saving time has cut off says nothing of longer ones.
            cut_off = fits & (end >= span.stop)
            target = jnp.where(cut_off, jnp.maximum(target, length), target)
            if steps:
                fits, target = fits & ~steps[0], jnp.where(steps[0], length, target)
            chosen = lambda new, old: jnp.where(fits, new, old)
            # Worn surfaces are the same in both.
            after = jax.tree.map(
                chosen, moved._replace(worn=(), read=()), carry._replace(worn=(), read=())
            )
            after = after._replace(worn=carry.worn, read=carry.read)
            if more is not None:
                noted = jax.tree.map(chosen, together(noted, more), noted)
            return chosen(end, time), (after, pending, target), noted, steps

        shapes = jax.eval_shape(motion, first[0]._replace(worn={}), span, resumed)[2:]
        nothing, steps = jax.tree.map(lambda each: jnp.zeros(each.shape, each.dtype), shapes)
        begin = span.start, first, nothing, steps
        _, carry, noted, _ = loop(lambda now: now[0] < span.stop, one, begin)
        return carry, ((), noted)

    return parts


def _advance_by_instants(turn: Turn, loop: Callable, part: Callable) -> Callable:
    """A part of a saving interval that is gone through from instant to instant of what is sampled,
    and of what steps are to end at, by a while `loop`; the part itself where there are none."""
    system, breaks = turn.model.system, turn.breaks
    if not sampled_loads(system) and breaks is None:
        return part

    def parts(first, span):
        saved = jax.eval_shape(part, first, span)[1]
        nothing = jax.tree.map(lambda each: jnp.zeros(each.shape, each.dtype), saved)

        def turn(now):
            time, carry, (_, noted) = now
            ahead = next_instant(system, time, span.stop)
            if breaks is not None:
                ahead = jnp.min(jnp.where(breaks > time, breaks, ahead), initial=ahead)
            progress = span.progress * (ahead - time) / (span.stop - span.start)
            carry, (saved, more) = part(
                carry, span._replace(start=time, stop=ahead, progress=progress)
            )
            return ahead, carry, (saved, None if more is None else together(noted, more))

        return loop(lambda now: now[0] < span.stop, turn, (span.start, first, nothing))[1:]

    return parts


def through_interval(turn: Turn) -> Callable[[Carry, Span], Carry]:
    """A saving interval of a run in which nothing wears, as (what is handed on, span) -> that."""

    def part(now, span):
        now, _, noted, _ = turn.motion(now, span)
        return now, ((), noted)

    interval = _advance_by_instants(turn, while_loop, part)
    return lambda now, span: interval(now, span)[0]


def _run_in_one_kernel(turn: Turn, first: Carry, spans: Span, updates: Any) -> tuple[Carry, Saved]:
    """(what the last turn hands on, what is left at all saving times). Before a part at whose start
    they are due surfaces are worn by what was lost until then, and after the last."""
    model, count, step = turn.model, len(spans.start), turn.step
    pending = pending_wear(model.system, model.layout, first.state) if first.worn else None

    def settled(now: Carry, pending: Pending, wears: Any = None) -> tuple[Carry, Pending]:
        values = now.worn, now.read, pending
        worn, read, pending = worn_so_far(model.system, model.layout, values, now.state, wears)
        return turn.worn_as(now, worn, read), pending

    def by_kernel(condition, body, first):
        return while_loop(condition, body, first, (False, LONG_CARRY, *[False] * (len(first) - 2)))

    if pending is None:
        length = None

        def part(carry, span):
            now, _, noted, _ = turn.motion(carry[0], span)
            return (now, None, None), ((), noted)

    else:
        limits, spans = _update_limits(model.system, spans, step, updates)
        length = limits.longest
        functions = settled, by_kernel
        part = _advance_by_updates(turn.motion, model.system, limits, step, *functions, ())
    part = _advance_by_instants(turn, by_kernel, part)

    def one(carry, span):
        carry, (_, noted) = part(carry, span)
        return carry, ((carry[0].state, carry[0].read), noted)

    rows = np.arange(count)
    tables = [TableLayout(rows + 1, count + 1, (first.state, first.read)), TableLayout(rows, count)]
    done, ((states, read), noted) = scan(one, (first, pending, length), spans, tables, LONG_CARRY)
    if pending is not None:
        last = lambda now, _: ((*settled(*now[:2]), now[2]), ())
        done = scan(last, done, np.zeros(1), long=LONG_CARRY)[0]
    return done[0], Saved(states, read, noted)


def _run_by_saves(
    turn: Turn, first: Carry, spans: Span, counted: int | None, updates: Any
) -> tuple[Carry, Saved]:
    """As `_run_in_one_kernel`, each turn by itself; XLA wears surfaces. Where steps are `counted`
    it goes backwards through them, and surfaces wear behind each turn."""
    system, layout, step = turn.model.system, turn.model.layout, turn.step
    motion = turn.motion if counted is not None or not first.read else _as_a_kernel(turn.motion)
    by_path = bool(first.worn) and counted is None
    entry: tuple = (first,)

    def settled(now: Carry, since: Array, wears: Any = None) -> tuple[Carry, Array]:
        events, since = pending_losses(layout, since, now.state, wears)
        return turn.worn_as(now, *wear_changed(system, now.worn, now.read, events)), since

    if by_path:
        limits, spans = _update_limits(system, spans, step, updates)
        entry = first, pending_wear(system, layout, first.state).since, limits.longest
        functions = settled, jax.lax.while_loop
        between = _advance_by_updates(motion, system, limits, step, *functions, None)

    def part(carry, span):
        if by_path:
            carry, (_, noted) = between(carry, span)
            return carry, (carry[0].read, noted)
        (now,) = carry
        worn, read = now.worn, now.read
        now, losses_now, noted, _ = motion(now._replace(worn={}), span)
        if worn:
            now = turn.worn_as(now, *wear_all(system, worn, read, losses_now))
        return (now,), (read, noted)

    if counted is None:
        part = _advance_by_instants(turn, jax.lax.while_loop, part)

    def one(carry, span):
        carry, (read, noted) = part(carry, span)
        return carry, (carry[0].state, read, noted)

    carry, (states, read, noted) = jax.lax.scan(one, entry, spans)
    last = settled(*carry[:2])[0] if by_path else carry[0]
    joined = lambda first, rows: jnp.concatenate([first[None], rows])
    read = jax.tree.map(lambda depths: jnp.concatenate([depths[:1], depths]), read)
    return last, Saved(joined(first.state, states), read, noted)


def _as_a_kernel(motion: Callable) -> Callable:
    """A turn's motion as a kernel of its own, between whose calls surfaces wear: XLA would start
    each of its operations on a few numbers by itself."""

    def alone(now: Carry, span: Span, _: Any = None) -> tuple:
        read = now.read

        def turn(now, _):
            after, *saved = motion(now._replace(read=read), span)
            return after._replace(read={}), saved

        after, saved = scan(turn, now._replace(read={}), np.zeros(1))
        return after._replace(read=read), *jax.tree.map(lambda each: each[0], saved)

    return alone
