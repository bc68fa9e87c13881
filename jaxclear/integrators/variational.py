"""The variational equations beside steps that do not resolve contacts: derivatives of the motion.

A step that damps a contact, or goes through it at once, cannot tell how a number moves what is
behind: its own derivative converges slowly, or to nothing. But where runs are to be differentiated
the motion itself can go beside the steps, in parts of these that are as short as contacts ask for
and end at touches and releases (`followed`). Derivatives are those of that motion, at its places.
How far the run has parted from it is known at every step: where that is too far the derivative is
not the run's, and nan (`derivative_error.beside`); the motion goes no further then. Where loops are
closed anew after every step, those of the motion are too, and the step itself ends closed: what
closes the run's says nothing of the motion.

In flight a part goes on to the end; in contact by a share of its vibration, and of the time in
which friction stops a slip. Parts end where contacts touch and part: one that would pass such an
instant is taken again, as long as Hermite's cubic says, and on until it ends there. Derivatives are
taken at times that move with touches (`saltation`), so that no part of a derivative is that of a
step across one.

The motion is a derivative of zeros, which a loop carries: so none of it is in a program of which no
derivative is asked.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from jaxclear.formulations import loop_closing
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.impact_speed import ContactMotion, cubic, passage, summit
from jaxclear.ground.grouping import bare, unpacked
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.ground.tangents import (
    allow_first_derivative,
    apply_if,
    derived,
    moved,
    pushed,
    zeros_with,
)
from jaxclear.integrators.base import SLIVER
from jaxclear.integrators.derivative_error import (
    NO_SECOND,
    PARTED,
    while_together,
    without_derivative,
)
from jaxclear.integrators.events import Peaks, no_peaks, peaks
from jaxclear.integrators.saltation import Now, along, closed, cross_within, motion_of, moves
from jaxclear.multibody.length_scales import gaps_crossed
from jaxclear.multibody.state import bristle_places


class Resolved(NamedTuple):
    """Zeros. Their derivatives are, of the motion beside a run: how far its state is `away` from
    the run's, how far its places have `parted` from these at most [1] of the narrowest gap, and the
    `peaks` of each contact."""

    away: Array
    parted: Scalar
    peaks: Peaks


def not_resolved(size: int, contacts: int, damped: bool) -> Resolved:
    """The record of the motion beside a run, at its start.

    Args:
        size: of the state.
        contacts: their number.
        damped: whether some contact damps, so that its peak force is followed.
    """
    return Resolved(jnp.zeros(size), jnp.zeros(()), no_peaks(jnp.zeros(contacts), damped))


def resolved_steps(formulation: CompliantContact, rest: Any, plain: Callable) -> Callable:
    """A step with the derivative of the motion beside it.

    It is a function of (arrays, clock, state, last, peaks, resolved); `arrays` are those of the
    model and
    all others, `clock` is start and length [s].

    Args:
        formulation: of the run.
        rest: what is left of the model without its arrays.
            plain: `plain(arrays, clock, y, last, peaks)`: the state at the end, what the step hands
            on, and
            the peaks until then.
    """
    motion = motion_of(formulation, rest)

    def remember(arrays, y, contacts, length):
        """Contacts that are apart forget their impact speeds; those that begin closed have one."""
        if not formulation.remembers(bare(rest)):
            return y
        model = unpacked(arrays, rest)
        return formulation.remember(model, y, contacts, contacts, length)

    def close(arrays, time, length, y):
        return loop_closing.closed(unpacked(arrays, rest), time, y, length)

    def step(arrays, clock, y, last, peaks, resolved):
        end, *rest_of = plain(arrays, clock, y, last, peaks)
        return end, *rest_of, zeros_with(end[0], resolved)

    @jax.custom_jvp
    def rule(*numbers):
        return step(*numbers)

    def moving(numbers, tangents):
        arrays, clock, y, *_ = numbers
        d_arr, d_clock, state, _, d_peaks, resolved = tangents
        outputs = step(*numbers)
        end, now, *_ = outputs
        resolved, d_peaks = jax.tree.map(moved, (resolved, d_peaks))
        longer = moved(d_clock[1]) if moves(d_clock) else None
        d_in = d_arr[0], (d_clock[0], longer), moved(state)
        start = y + resolved.away
        corrections = remember, close if bare(rest).projects else None
        ended = _parted(motion, corrections, (arrays[0], clock, start), d_in, d_peaks, resolved)
        there, d_end, higher, resolved = ended
        away = there - end
        share = gaps_crossed(unpacked(arrays[0], rest).system, away)
        resolved = resolved._replace(away=away, parted=jnp.maximum(resolved.parted, share))
        return outputs, (d_end, jax.tree.map(jnp.zeros_like, now), higher, resolved)

    rule.defjvp(moving, symbolic_zeros=True)
    return rule


def so_far(resolved: Resolved) -> Resolved:
    """What is known where a saving interval begins."""
    zeros = lambda resolved: jax.tree.map(lambda each: zeros_with(each, each), resolved)
    same = lambda numbers, tangents: jax.tree.map(moved, tangents[0])
    return derived(zeros, same)(resolved)


def trust_resolved(end: Any, peaks: Any, watch: Any, resolved: Resolved) -> tuple:
    """Results of a run, with derivatives where the motion beside it is trusted; events have none.

    Args:
        end: state at the end, shape (n,).
        peaks: largest depths and forces.
        watch: events and transmitted forces.
        resolved: the motion beside the run, with how far it parted.
    """
    outputs = end, peaks, watch.transmitted
    outputs = allow_first_derivative(NO_SECOND, while_together(outputs, resolved.parted))
    return *outputs[:2], without_derivative(watch)._replace(transmitted=outputs[2])


def _parted(
    motion: Any, corrections: tuple, here: tuple, d_in: tuple, higher: Any, resolved: Resolved
) -> tuple:
    """(state, its derivative, that of the peaks, what is known) behind a step from
    `here` (arrays, clock, state); `corrections`: how its impact speeds are remembered, and its
    loops closed (None: they are not). Where run and motion have parted nothing goes on."""
    remember, close = corrections
    arrays, (time, total), y = here
    d_arr, (d_time, longer), state = d_in
    moving = longer is not None
    rates = lambda at, y: motion.rates(arrays, closed(motion.contacts(arrays, at, y)), at, y)
    if moving:
        state = state - moved(d_time) * rates(time, y)
    aware = lambda y, contacts: remember(arrays, y, contacts, total)
    together = resolved.parted <= PARTED
    request = together, y, (resolved.peaks, higher)
    part = followed(motion, aware, (arrays, time, total), (d_arr, state), request)
    y, state, (highest, higher) = part.y, part.d_state, part.peaks
    if close is not None:
        at = time + total
        still = SymbolicZero.from_primal_value(at)
        y, state = pushed(close, (arrays, at, total, y), (d_arr, still, still, state))
    if moving:
        state = state + (moved(d_time) + longer) * rates(time + total, y)
    ended = part.done >= total * (1 - SLIVER)
    parted = jnp.where(ended, resolved.parted, jnp.inf)
    resolved = Resolved(resolved.away, parted, highest)
    return y, state, higher, resolved


# A part in contact goes no further than by this angle of the contact's vibration [rad], and in it
# friction brakes no more than this share of a slip, and bristles settle by no more of what they
# lack.
ANGLE, BRAKED = 0.05, 0.5
# Near a touch or release stiffness and dampers change fast: a part goes no further than as deep
# again, where a contact opens by no more than this share of what is left of it; by `EARLY` of the
# usual length at the least.
PARTING, EARLY = 0.1, 0.125
# A time is divided into no more parts of contact, and they are followed no further: by so large an
# angle of a vibration in one [rad].
MOST_PARTS, WIDEST = 64.0, 1.0
# So many parts are gone through at the most, those that were too long included.
MOST_TURNS = 128
# A part ends at a touch where it does to within this share of the whole time.
AT_TOUCH = 1e-3


class Part(NamedTuple):
    """Where a motion is: what is `done` of the time [s] in so many `turns`, the state, its
    derivative (`d_state`), (the peaks, their derivatives), and how long the next part may be [s] so
    that contacts that would touch or part on the way do so at its end. nan is done where parts are
    too long for a contact."""

    done: Scalar
    turns: Any
    y: Any
    d_state: Any
    peaks: tuple[Peaks, Peaks]
    limit: Scalar
    event: Any


class _Substep(NamedTuple):
    """A part gone through: where it began, its contacts that acted, the state at its end and its
    derivative, the contacts there."""

    start: Now
    acting: Any
    end: Any
    d_state: Any
    contacts: ContactMotion


def followed(motion: Any, remember: Callable, clock: tuple, d_in: tuple, request: tuple) -> Part:
    """A motion over a time with its derivative, where it is needed.

    Args:
        motion: of the model.
        remember: `remember(state, contacts)`: the state with its impact speeds.
        clock: arrays, start and length [s].
        d_in: derivatives of arrays and state, at times that do not move.
        request: whether it is needed, the state, and (peaks, their derivatives).
    """
    (_, _, total), (d_arr, state), (needed, y, highest) = clock, d_in, request
    nothing = jnp.zeros(())
    first = Part(
        done=nothing,
        turns=jnp.zeros((), int),
        y=y,
        d_state=state,
        peaks=highest,
        limit=jnp.asarray(jnp.inf),
        event=jnp.zeros_like(highest[0].depths),
    )
    most = jnp.where(needed, MOST_TURNS, 0)

    def unfinished(part):
        return (part.done < total * (1 - SLIVER)) & (part.turns < most)

    return jax.lax.while_loop(
        unfinished, lambda part: _advance_part(motion, remember, clock, d_arr, part), first
    )


def _advance_part(motion: Any, remember: Callable, clock: tuple, d_arr: Any, part: Part) -> Part:
    """A part further, or how long it may be."""
    arrays, start, total = clock
    time = start + part.done
    contacts = motion.contacts(arrays, time, part.y)
    y, acting = remember(part.y, contacts), closed(contacts)
    remaining = total - part.done
    at_start = Now(arrays, time, y, remaining, contacts)
    resolved, unresolved = _length_of_part(motion, at_start, acting, (total, remaining))
    resolved = jnp.where(jnp.any(acting > 0), resolved, remaining)
    length = jnp.minimum(jnp.minimum(resolved, part.limit), remaining)
    trial = _through(motion, at_start._replace(length=length), acting, (d_arr, part.d_state))
    landing = jnp.any(part.event > 0)
    after, crossed, share = trial.contacts, *_crossings_in_part(trial)
    hit = landing & ((part.event > 0) | (closed(after) != acting))
    late = jnp.where(hit, -safe_divide(after.depths, after.rates), -jnp.inf)
    late = jnp.where(landing, jnp.max(late), (share - 1) * length)
    there = jnp.where(landing, abs(late) <= AT_TOUCH * total, ~jnp.any(crossed))
    fine = _advance_to_change(motion, trial, total, d_arr, (hit, part))
    fine = fine._replace(done=jnp.where(length < remaining, part.done + length, total) + fine.done)
    # What would pass the end after all touches no more.
    again = (late + length < remaining) & (length > 0)
    event = jnp.where(landing, part.event, jnp.where(crossed, 1.0, 0.0))
    short = part._replace(
        limit=jnp.where(again, late + length, jnp.inf), event=jnp.where(again, event, 0.0)
    )
    next_part = jax.tree.map(lambda a, b: jnp.where(there, a, b), fine, short)
    done = jnp.where(unresolved, jnp.nan, next_part.done)
    return next_part._replace(done=done, turns=part.turns + 1)


def _through(motion: Any, start: Now, acting: Any, d_in: tuple) -> _Substep:
    """A part in which the contacts act that did at its start."""
    end, state = along(motion, start, acting, d_in)
    contacts = motion.contacts(start.arrays, start.time + start.length, end)
    return _Substep(start, acting, end, state, contacts)


def _crossings_in_part(sub: _Substep) -> tuple[Any, Any]:
    """Which contacts touch or part within a part, and at which share of it the first does."""
    start, after, length = sub.start, sub.contacts, sub.start.length
    outwards = jnp.where(sub.acting > 0, -1.0, 1.0)
    depths = start.contacts.depths, after.depths
    path: tuple = *depths, length * start.contacts.rates, length * after.rates
    path = (*(outwards * each for each in path),)
    top = summit(path)
    highest = cubic(path, top)[0]
    last = jnp.where(highest > path[1], top, 1.0)
    highest = jnp.maximum(highest, path[1])
    crossed = (highest > 0) | ((highest >= 0) & (sub.acting <= 0))
    shares = passage(path, 0.0, last, jnp.any(crossed))
    share = jnp.min(jnp.where(crossed, shares, 1.0))
    return crossed & (shares <= share), share


def _advance_to_change(motion: Any, sub: _Substep, total: Any, d_arr: Any, state_of: tuple) -> Part:
    """Behind the end of a part, at which contacts are `hit`; `done` is by how much later [s]."""
    (start, acting, end, state, after), (hit, part) = sub, state_of
    later = start.time + start.length
    ends, motions = ((start.time, start.state), (later, end)), (start.contacts, after)
    higher = lambda arrays, *now: peaks(motion, arrays, now[:2], motions, now[2])
    d_in = d_arr, (jnp.zeros(()), part.d_state), (jnp.zeros(()), state), part.peaks[1]
    highest = pushed(higher, (start.arrays, *ends, part.peaks[0]), d_in)

    def behind(values):
        state, y, _ = values
        at = start._replace(length=total)
        y, state, late = cross_within(motion, at, (d_arr, state), later, y, (acting, hit))
        return state, y, late

    state_of = state, end, jnp.zeros(())
    state, y, late = apply_if(jnp.any(hit), behind, state_of)
    ahead = jnp.asarray(jnp.inf), jnp.zeros_like(acting)
    return Part(late, part.turns, y, state, highest, *ahead)


def _length_of_part(motion: Any, start: Now, acting: Any, clock: tuple) -> tuple[Any, Any]:
    """How long a part may be [s], and whether its contacts cannot be followed; `clock`: the whole
    time, and what is left of it [s]. Contacts are looked at where it begins; those that have closed
    just now also where the time would end without them."""
    arrays, time, y, _, (depths, rates) = start
    total, remaining = clock
    zeros = jnp.zeros_like(acting)
    n, m = motion.layout.coordinates, motion.layout.memory_start
    entries = np.arange(motion.layout.size)
    places, moves = entries < n, (entries >= n) & (entries < m)
    bristles = np.isin(entries, bristle_places(motion.layout))

    def look(carry):
        i, (time, y), fastest = carry
        acting = closed(motion.contacts(arrays, time, y))
        pushes = jax.jvp(lambda on: motion.rates(arrays, on, time, y), (zeros,), (acting,))[1]
        along = lambda d: jax.jvp(lambda y: motion.rates(arrays, acting, time, y), (y,), (d,))
        resisted = along(jnp.where(moves, pushes, 0.0))[1]
        returned = along(jnp.where(places, resisted, 0.0))[1]
        size = lambda d, on=moves: safe_sqrt(jnp.sum(jnp.where(on, d * d, 0.0)))
        damped = safe_divide(size(resisted), size(pushes))
        vibrating = safe_sqrt(safe_divide(size(returned), size(pushes)))
        if bristles.any():
            settling = along(jnp.where(bristles, y, 0.0))[1]
            settling = safe_divide(size(settling, bristles), size(y, bristles))
            damped = jnp.maximum(damped, settling)
        cuts = jnp.maximum(vibrating / ANGLE, damped / BRAKED)
        pace = jnp.stack([cuts, jnp.maximum(vibrating, 0.5 * damped)])
        ahead = y + remaining * motion.rates(arrays, zeros, time, y)
        return i + 1, (time + remaining, ahead), jnp.maximum(fastest, pace)

    deepens = (acting > 0) & (rates > 0)
    new = jnp.any(deepens & (depths < remaining * EARLY * rates))
    looks = jnp.where(jnp.any(acting > 0), jnp.where(new, 2, 1), 0)
    first = jnp.zeros((), int), (time, y), jnp.zeros(2)
    fastest = jax.lax.while_loop(lambda carry: carry[0] < looks, look, first)[2]
    longest = 1 / jnp.maximum(fastest[0], EARLY / total)
    share = jnp.where(deepens, 1.0, PARTING)
    lengths = jnp.where(acting > 0, safe_divide(share * depths, abs(rates)), jnp.inf)
    length = jnp.clip(jnp.min(lengths), EARLY * longest, longest)
    shortest = total / MOST_PARTS
    return jnp.maximum(length, shortest), shortest * fastest[1] > WIDEST
