"""Singular positions of closed loops: found in runs that pass them, and where runs end.

There rows of loops depend on each other, a linkage is stretched flat, say, and drives do not say
which way it goes on. A drive may also ask for what no position of a loop meets, a dead point:
forces grow without bound there, so a run ends for what seems another reason.

Runs that end early are looked at from their last saved state on: are there positions that close the
loops with the drives as they move (`_can_close`), and does the rank of their Jacobian fall
(`_singular_end`)?

Of runs of one mechanism that reach their end, loops that drives hold are looked at all along
(`singular_positions`): the determinant of their rows is 0 at a singular position. Between saved
states the motion is followed, its loops closed, in parts so short that the determinant cannot miss
a zero; what saved states show to be far from one is not followed. So what is told does not hang on
saving times. Newton's method on [loops, determinant] = 0 confirms what is found, or drops it.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxclear.ground.quantity import constant, is_traced
from jaxclear.integrators.checks import Outcome
from jaxclear.multibody import constraints
from jaxclear.multibody.constraints import DrivenLoop, driven_loops
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.newton import blocks_of, closed, levenberg, shorten_step
from jaxclear.multibody.start_equations import (
    Ask,
    motions_at,
    retract,
    scale,
    speed_scales,
    stacked,
    start_problem,
)
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.singular_position import SingularPosition
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import Trajectory

# Instants of the saving intervals around which the run ended; steps to close the loops at each,
# and to follow them.
INSTANTS, ITERATIONS, FEW_ITERATIONS = 256, 12, 6
# How runs end that meet a singular position.
MAY_BE_SINGULAR = (
    Outcome.STEP_TOO_SMALL,
    Outcome.TOO_MANY_STEPS,
    Outcome.NOT_FINITE,
    Outcome.ENERGY_GAINED,
    Outcome.LOOP_OPEN,
)
# What may be left of a closure [rad, longest arms], and of a determinant beside its largest.
CLOSED = 1e-6
# Least singular value beside the largest, of rows that count alike, at and below which a position
# is singular: between two instants a linkage turns by about so much. Of a determinant beside its
# largest: what may be one.
NEARLY = 1e-2
# A loop is followed in parts in which no coordinate moves farther [rad, longest arms]: a zero of
# its determinant is a share of a radian from the next. Saved states show as much where their
# motion between is no more than `CONFIRMED`.
FOLLOWED, CONFIRMED = 0.05, 0.5
# Share of a time over which rates are taken.
AHEAD = 1e-4
# Instants within a saving interval at which it is asked how far drives have moved.
DRIVES_LISTED = 16
# Parts of a saving interval, steps to close the loops of each, candidates that are kept of it, and
# steps of Newton's method that confirm one (at a dead centre the drive stands still, and it halves
# what is left).
MOST_PARTS, CLOSING, CANDIDATES, NEWTON = 4096, 3, 8, 40
# What damps such a step at the least: below the squares of rows that halve to nothing there.
HALVING = 1e-14


def diagnosed(trajectory: Trajectory) -> Trajectory:
    """The run with the singular positions that it met; one that ended early at one, or at a dead
    point, says so. One that is being traced may be anything and is left alone
    (`diagnosed_outcome`)."""
    if is_traced(trajectory.outcome) or np.ndim(trajectory.outcome):
        return trajectory
    if trajectory.succeeded:
        singular = singular_positions(trajectory)
        return (
            dataclasses.replace(trajectory, singular_positions=singular) if singular else trajectory
        )
    outcome = diagnosed_outcome(trajectory)
    near = None
    if int(outcome) in MAY_BE_SINGULAR:
        near = _singular_end(trajectory.history, constant(trajectory.ended))
    if near is None:
        return dataclasses.replace(trajectory, outcome=outcome)
    outcome = jnp.full_like(outcome, int(Outcome.SINGULAR_POSITION))
    return dataclasses.replace(trajectory, outcome=outcome, singular_positions=(near,))


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
    closable = _can_close(mechanism, q, times[before], times[after], early)
    return jnp.where(early & ~closable, Outcome.DEAD_POINT, outcome)


@eqx.filter_jit
def _can_close(
    mechanism: Mechanism, q: Float[Array, " q"], start: Any, stop: Any, requested: Bool[Array, ""]
) -> Bool[Array, ""]:
    """Whether coordinates that close the loops follow from q at all times from `start` to `stop`
    [s]; true without a look where that is not asked for."""
    problem = start_problem(mechanism, False)

    def continues(carry):
        done, _, follows = carry
        return (done < INSTANTS) & follows & requested

    def follow(carry):
        done, q, _ = carry
        time = start + (stop - start) * done / (INSTANTS - 1)
        q = closed(problem, q, time, ITERATIONS)
        residual = jnp.max(jnp.abs(stacked(problem, blocks_of(problem, q, time))[1]), initial=0.0)
        return done + 1, q, residual <= CLOSED * jnp.minimum(problem.arm, 1.0)

    return jax.lax.while_loop(continues, follow, (jnp.asarray(0), q, jnp.asarray(True)))[2]


def _singular_end(history: StateHistory, ended: Any) -> SingularPosition | None:
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
    rows, follows, closures = _jacobians_along(mechanism, q, v, instants)
    rows = np.asarray(rows)[np.asarray(follows)]
    if not rows.size or rows.shape[1] > rows.shape[2] or not np.all(np.isfinite(rows)):
        return None
    left_vectors, sizes, _ = np.linalg.svd(rows)
    shares = sizes[:, -1] / sizes[:, 0]
    place = int(np.argmin(shares))
    if shares[place] > NEARLY:
        return None
    # The forces that no motion feels: the loop in which they are largest.
    forces = left_vectors[place][:, -1] ** 2
    each = [float(forces[np.asarray(closures) == k].sum()) for k in range(len(topology.loops))]
    time = np.asarray(instants)[np.asarray(follows)][place]
    return SingularPosition(topology.loops[int(np.argmax(each))], float(time))


@eqx.filter_jit
def _jacobians_along(
    mechanism: Mechanism, q: Float[Array, " q"], v: Float[Array, " v"], times: Float[Array, " n"]
) -> tuple[Array, Array, Array]:
    """(at each time the Jacobian of the loops' rows that count alike, whether the loops were
    closed there; the place of the loop of each row)."""
    problem = start_problem(mechanism, False)

    def follow(q, ahead):
        time, length = ahead
        q = retract(problem.system, q, length * v)
        q = closed(problem, q, time, FEW_ITERATIONS, damped=True)
        blocks = blocks_of(problem, q, time)
        residual = stacked(problem, blocks)[1]
        # To first order in what is left the position is the same.
        closed_enough = jnp.max(jnp.abs(residual), initial=0.0) <= NEARLY**2 * problem.arm
        return q, (scale(problem, blocks)[0], closed_enough)

    lengths = jnp.diff(times, prepend=times[:1])
    rows, follows = jax.lax.scan(follow, q, (times, lengths))[1]
    sizes = [len(block.rest) for block in blocks_of(problem, q, times[0])]
    return rows, follows, jnp.asarray(np.repeat(np.arange(len(sizes)), sizes))


class _Rows(NamedTuple):
    """Rows of all loops that count alike: entries by free speed, what is left of each, the place of
    its loop."""

    entries: list[dict[int, Any]]
    residuals: Float[Array, " rows"]
    closures: list[int]


def _scaled_rows(problem: Ask, q: Array, time: Any) -> _Rows:
    """In radians and longest arms."""
    system, scales = problem.system, speed_scales(problem)
    motions = motions_at(problem, q, jnp.zeros(system.topology.speed_count), time)[2]
    entries, misfits, closures = [], [], []
    for k, closure in enumerate(system.closures):
        loop_rows = constraints.constraint_rows(system, motions, closure)
        counts = constraints.measures(closure, loop_rows, problem.arm)
        for measure, row, residual in zip(
            counts, loop_rows.jacobian, loop_rows.residuals, strict=True
        ):
            entries.append({j: x * scales[j] / measure for j, x in row.items()})
            misfits.append(jnp.asarray(residual / measure, float))
            closures.append(k)
    return _Rows(entries, jnp.stack(misfits) if misfits else jnp.zeros(0), closures)


def _matrix_of_rows(rows: _Rows, r: DrivenLoop) -> Float[Array, "n n"]:
    matrix = [[rows.entries[i].get(j, 0.0) for j in r.columns] for i in r.rows]
    return jnp.stack([jnp.stack([jnp.asarray(x, float) for x in row]) for row in matrix])


def _determinants(problem: Ask, q: Array, time: Any) -> Float[Array, " held"]:
    rows = _scaled_rows(problem, q, time)
    values = [jnp.linalg.det(_matrix_of_rows(rows, loop)) for loop in driven_loops(rows.entries)]
    return jnp.stack(values) if values else jnp.zeros(0)


def _rates(problem: Ask, q: Array, v: Array, time: Any, length: Any) -> tuple[Array, Array]:
    """Determinants of the loops that drives hold, and their rates along a motion, by a difference
    over a share of a `length` [s]: a derivative takes twice as long to compile."""
    ahead = AHEAD * length
    places = jnp.stack([q, retract(problem.system, q, ahead * v)])
    now, then = jax.vmap(lambda *at: _determinants(problem, *at))(
        places, time + ahead * jnp.arange(2)
    )
    return now, (then - now) / ahead


@compiled_quickly
def _along(mechanism: Mechanism, q: Array, v: Array, times: Array) -> tuple[Array, ...]:
    """At each saved state: determinants, their rates, how fast the fastest coordinate is
    [rad/s, longest arms/s]; and how far the drives move in each saving interval."""
    problem = start_problem(mechanism, False)
    scales = speed_scales(problem)
    lengths = jnp.diff(times, append=times[-1:] + times[-1:] - times[-2:-1])
    values, rates = jax.vmap(lambda *state: _rates(problem, *state))(q, v, times, lengths)
    shares = jnp.linspace(0.0, 1.0, DRIVES_LISTED)
    instants = times[:-1, None] + jnp.diff(times)[:, None] * shares
    moved = jnp.zeros(len(times) - 1)
    for name in mechanism.driven:
        joint = mechanism.connections[name].joint
        place = jax.vmap(jax.vmap(lambda time, j=joint: 1.0 * j.drive.motion(time)[0]))(instants)
        unit = problem.arm if joint.units == ("m",) else 1.0
        moved = jnp.maximum(moved, jnp.sum(abs(jnp.diff(place, axis=1)), axis=1) / unit)
    return values, rates, jnp.max(abs(v / scales), axis=1, initial=0.0), moved


class _Candidates(NamedTuple):
    """Where a determinant may be 0, by interval and place: between which instants [s], of which
    loop, from which coordinates on."""

    number: Int[Array, " intervals"]
    starts: Float[Array, "intervals most"]
    ends: Float[Array, "intervals most"]
    loop: Int[Array, "intervals most"]
    places: Float[Array, "intervals most q"]


def _may_be_zero(before: tuple, after: tuple, length: Any, usual: Array) -> Bool[Array, " held"]:
    """Whether a determinant may be 0 within a time, by its values and rates at both ends; `usual`:
    its size."""
    (a, slope_a), (b, slope_b) = before, after
    toward = (a * slope_a < 0) & (b * slope_b > 0)
    reach = (abs(a) < 2 * length * abs(slope_a)) & (abs(b) < 2 * length * abs(slope_b))
    at_an_end = jnp.minimum(abs(a), abs(b)) < NEARLY * usual
    return (a * b <= 0) | (toward & reach) | at_an_end


@compiled_quickly
def _follow_intervals(
    mechanism: Mechanism, motion: tuple[Array, ...], spans: tuple[Array, ...], usual: Array
) -> _Candidates:
    """The candidates of intervals, from the motion (q, v) at their begins; `spans`: when they begin
    and end [s], and how many of them count."""
    problem, (q, v), (starts, ends, number) = start_problem(mechanism, False), motion, spans
    scales = speed_scales(problem)

    def closer(place, done, time):
        step = scales * levenberg(*scale(problem, blocks_of(problem, place, time)), HALVING)
        return retract(problem.system, place, step), done + step

    def part(carry):
        k, parts, time, place, speed, last, results = carry
        remaining = ends[k] - time
        fast = jnp.max(abs(speed / scales))
        length = jnp.minimum(remaining, FOLLOWED / jnp.maximum(fast, FOLLOWED / remaining))
        there = jnp.where(length < remaining, time + length, ends[k])
        ahead = retract(problem.system, place, length * speed), length * speed
        after, done = jax.lax.fori_loop(0, CLOSING, lambda _, now: closer(*now, there), ahead)
        now = _rates(problem, after, done / length, there, length)
        zero = _may_be_zero(last, now, length, usual)
        any_zero, at = jnp.any(zero), jnp.minimum(results.number[k], CANDIDATES - 1)
        keep = lambda array, value: array.at[k, at].set(jnp.where(any_zero, value, array[k, at]))
        results = _Candidates(
            results.number.at[k].add(jnp.where(any_zero, 1, 0)),
            keep(results.starts, time),
            keep(results.ends, there),
            keep(results.loop, jnp.argmax(zero)),
            keep(results.places, place),
        )
        return k, parts + 1, there, after, done / length, now, results

    def interval(k, results):
        first = _rates(problem, q[k], v[k], starts[k], ends[k] - starts[k])
        entry = k, 0, starts[k], q[k], v[k], first, results
        continues = lambda carry: (carry[2] < ends[k]) & (carry[1] < MOST_PARTS)
        return jax.lax.while_loop(continues, part, entry)[-1]

    many = (len(starts), CANDIDATES)
    nothing = _Candidates(
        jnp.zeros(many[0], int),
        jnp.zeros(many),
        jnp.zeros(many),
        jnp.zeros(many, int),
        jnp.zeros((*many, q.shape[1])),
    )
    return jax.lax.fori_loop(0, number, interval, nothing)


@compiled_quickly
def _confirm_zero(
    mechanism: Mechanism, q: Array, begin: Any, end: Any, loop_index: Any, usual: Array
) -> tuple[Array, ...]:
    """(when the loops are closed and the determinant is 0, what is left of either, for each free
    speed how much it moves where nothing moves the loops, for each row its share of the forces
    that no motion feels), by Newton's method from the middle of a time [s] on."""
    problem = start_problem(mechanism, False)
    scales, span = speed_scales(problem), end - begin

    def missed(moved):
        place, time = retract(problem.system, q, scales * moved[:-1]), begin + span * moved[-1]
        rows = _scaled_rows(problem, place, time)
        return jnp.append(rows.residuals, (_determinants(problem, place, time) / usual)[loop_index])

    def nearer_to_it(_, moved):
        step = levenberg(jax.jacfwd(missed)(moved), missed(moved), HALVING)
        return moved + shorten_step(step, jnp.ones(len(step)))

    first = jnp.zeros(len(scales) + 1).at[-1].set(0.5)
    moved = jax.lax.fori_loop(0, NEWTON, nearer_to_it, first)
    time, place = begin + span * moved[-1], retract(problem.system, q, scales * moved[:-1])
    rows = _scaled_rows(problem, place, time)
    columns, forces = [], []
    for part in driven_loops(rows.entries):
        u, _, right = jnp.linalg.svd(_matrix_of_rows(rows, part))
        columns.append(jnp.zeros(len(scales)).at[jnp.array(part.columns)].set(abs(right[-1])))
        forces.append(jnp.zeros(len(rows.residuals)).at[jnp.array(part.rows)].set(u[:, -1] ** 2))
    loops = jnp.zeros(len(mechanism.topology.loops)).at[jnp.array(rows.closures)]
    return (
        time,
        jnp.max(abs(missed(moved))),
        jnp.stack(columns)[loop_index],
        loops.add(jnp.stack(forces)[loop_index]),
    )


def singular_positions(trajectory: Trajectory) -> tuple[SingularPosition, ...]:
    """The singular positions of loops that drives hold, in a run of one mechanism that has reached
    its end; nothing is worked out where no drive moves a loop."""
    history = trajectory.history
    topology = history.mechanism.topology
    if not topology.loops or topology.depend or not history.mechanism.driven:
        return ()
    mechanism, states, times = constant((history.mechanism, history.states, history.time))
    count = topology.coordinate_count
    q, v = states[:, :count], states[:, count : count + topology.speed_count]
    if not v.shape[1]:
        return ()
    values, rates, fast, driven = map(np.asarray, _along(mechanism, q, v, times))
    if not values.shape[1] or not np.all(np.isfinite(values)):
        return ()
    instants, usual = np.asarray(times), np.max(abs(values), axis=0)
    doubtful = np.flatnonzero(_doubtful_intervals(values, rates, fast, driven, np.diff(instants)))
    if not len(doubtful):
        return ()
    places = np.resize(doubtful, 2 ** int(np.ceil(np.log2(max(len(doubtful), 8)))))
    spans = times[places], times[places + 1], jnp.asarray(len(doubtful))
    candidates = _follow_intervals(mechanism, (q[places], v[places]), spans, jnp.asarray(usual))
    sure = []
    for k in range(len(doubtful)):
        for at in range(min(int(candidates.number[k]), CANDIDATES)):
            begin, end, loop = (
                candidates.starts[k, at],
                candidates.ends[k, at],
                candidates.loop[k, at],
            )
            one = _confirm_zero(mechanism, candidates.places[k, at], begin, end, loop, usual)
            time, residual = float(one[0]), float(one[1])
            near = begin - (end - begin) <= time <= end + (end - begin)
            if residual <= CLOSED and near:
                sure.append((time, int(loop), np.asarray(one[2]), np.asarray(one[3])))
    return _describe_singular(history, sure, instants, values, np.asarray(v))


def _doubtful_intervals(
    values: np.ndarray, rates: np.ndarray, fast: np.ndarray, driven: np.ndarray, lengths: np.ndarray
) -> np.ndarray:
    """Which saving intervals may hold a zero of a determinant, as far as their ends tell."""
    steps = lengths[:, None]
    before, after = abs(values[:-1]), abs(values[1:])
    reached = before < 2 * steps * abs(rates[:-1])
    reached |= after < 2 * steps * abs(rates[1:])
    moved = np.maximum(lengths * np.maximum(fast[:-1], fast[1:]), driven)
    changed = values[:-1] * values[1:] <= 0
    return np.any(reached | changed, axis=1) | (moved > CONFIRMED)


def _describe_singular(
    history: StateHistory, sure: list[tuple], times: np.ndarray, values: np.ndarray, v: np.ndarray
) -> tuple[SingularPosition, ...]:
    """What is found, each once, with what the run did there."""
    topology = history.mechanism.topology
    alone: list[tuple] = []
    for one in sorted(sure, key=lambda one: one[0]):
        close = CLOSED * (times[-1] - times[0])
        if not any(one[1] == other[1] and one[0] - other[0] <= close for other in alone):
            alone.append(one)
    speeds = [branch.name for branch in topology.branches for _ in range(branch.speed_count)]
    positions = []
    for time, driven, columns, forces in alone:
        clear = abs(values[:, driven]) > NEARLY * np.max(abs(values[:, driven]))
        before = np.flatnonzero(clear & (times < time))
        after = np.flatnonzero(clear & (times > time))
        # Of several that move alike the one nearest to the ground.
        free = int(np.argmax(columns > 0.5 * np.max(columns)))
        reversed_, around = None, (0.0, 0.0)
        if len(before) and len(after):
            a, b = before[-1], after[0]
            between = [x for x in alone if x[1] == driven and times[a] < x[0] < times[b]]
            if len(between) == 1:
                reversed_ = bool(values[a, driven] * values[b, driven] > 0)
                around = float(v[a, free]), float(v[b, free])
        loop = topology.loops[int(np.argmax(forces))]
        drives = history.mechanism.driven
        positions.append(SingularPosition(loop, time, speeds[free], drives, reversed_, around))
    return tuple(positions)
