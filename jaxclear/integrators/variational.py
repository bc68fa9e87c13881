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
from jaxclear.integrators.events import Peaks, no_peaks
from jaxclear.integrators.saltation import (
    Motion,
    Start,
    along,
    closed,
    cross_within,
    higher,
    motion_of,
    moves,
    through_touches,
)
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

    It is a function of (arrays, clock, state, last, peaks); `arrays` are those of the model and all
    others, `clock` begins with start and length [s].

    Args:
        formulation: of the run.
        rest: what is left of the model without its arrays.
        plain: `plain(arrays, clock, y, last, peaks)`: length [s] and state at the end, what the
            step
                    hands on, (numbers, what is known of the motion beside the run), and the peaks
            until then.
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

    def step(arrays, clock, y, last, peaks):
        h, end, (now, _), peaks = plain(arrays, clock, y, last, peaks)
        return h, end, (now, zeros_with(end[0], last[1])), peaks

    def moving(numbers, tangents):
        arrays, clock, y, *_ = numbers
        d_arr, d_clock, state, (_, resolved), d_peaks = tangents
        outputs = step(*numbers)
        h, end, (now, _), _ = outputs
        resolved, d_peaks = jax.tree.map(moved, (resolved, d_peaks))
        longer = moved(d_clock[1]) if moves(d_clock) else None
        d_in = d_arr[0], (d_clock[0], longer), moved(state)
        corrections = remember, close if bare(rest).projects else None
        here = arrays[0], clock[:2], y + resolved.away
        there, d_end, higher, resolved = _parted(motion, corrections, here, d_in, d_peaks, resolved)
        away = there - end
        share = gaps_crossed(unpacked(arrays[0], rest).system, away)
        resolved = resolved._replace(away=away, parted=jnp.maximum(resolved.parted, share))
        still = jax.tree.map(jnp.zeros_like, (h, now))
        return outputs, (still[0], d_end, (still[1], resolved), higher)

    rule = jax.custom_jvp(step)
    rule.defjvp(moving, symbolic_zeros=True)
    return rule


# How steps have derivatives through contacts: those of the motion that ends at touches within them,
# or of one that goes beside them.
THROUGH, BESIDE = "through touches", "beside the steps"


def derived_steps(
    kind: str | None, formulation: CompliantContact, rest: Any, plain: Callable, length: Callable
) -> Callable:
    """A step (arrays, clock, state, last, peaks) with its derivative through contacts.

    Args:
        kind: how the derivative goes through contacts; None: it is that of the step.
        formulation, rest, plain, length: as of `through_touches` and `resolved_steps`.
    """
    if kind == BESIDE:
        return resolved_steps(formulation, rest, plain)
    return plain if kind is None else through_touches(formulation, rest, plain, length)


def so_far(last: tuple) -> tuple:
    """What a step is handed where a saving interval begins."""
    zeros = lambda resolved: jax.tree.map(lambda each: zeros_with(each, each), resolved)
    same = lambda numbers, tangents: jax.tree.map(moved, tangents[0])
    return last[0], derived(zeros, same)(last[1])


def trusted_steps(kind: str | None, end: Any, peaks: Any, watch: Any, last: tuple) -> tuple:
    """Results of a run in steps, with derivatives where these can be trusted.

    Events have none beside a run, and rates at events none through touches.

    Args:
        kind: how derivatives go through contacts; None: they are those of the steps.
        end: state at the end, shape (n,).
        peaks: largest depths and forces.
        watch: events and transmitted forces.
        last: what the last step hands on.
    """
    if kind is None:
        return end, peaks, watch
    if kind == BESIDE:
        outputs = while_together((end, peaks, watch.transmitted), last[1].parted)
        outputs = allow_first_derivative(NO_SECOND, outputs)
        return *outputs[:2], without_derivative(watch)._replace(transmitted=outputs[2])
    if watch.events is not None:
        rates = without_derivative(watch.events.rates)
        watch = watch._replace(events=watch.events._replace(rates=rates))
    return allow_first_derivative(NO_SECOND, (end, peaks, watch))


def _parted(
    motion: Motion, corrections: tuple, here: tuple, d_in: tuple, higher: Any, resolved: Resolved
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


def followed(motion: Motion, remember: Callable, clock: tuple, d_in: tuple, request: tuple) -> Part:
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
        unfinished, lambda part: _further(motion, remember, clock, d_arr, part), first
    )


def _further(motion: Motion, remember: Callable, clock: tuple, d_arr: Any, part: Part) -> Part:
    """A part further, or how long it may be."""
    arrays, start, total = clock
    time = start + part.done
    contacts = motion.contacts(arrays, time, part.y)
    y, acting = remember(part.y, contacts), closed(contacts)
    remaining = total - part.done
    start_of = Start(arrays, time, y, remaining, contacts, acting)
    resolved, unresolved = _resolved(motion, start_of, total)
    resolved = jnp.where(jnp.any(acting > 0), resolved, remaining)
    length = jnp.minimum(jnp.minimum(resolved, part.limit), remaining)
    start_of = start_of._replace(length=length)
    end, state = along(motion, start_of, (d_arr, part.d_state))
    after = motion.contacts(arrays, time + length, end)
    landing = jnp.any(part.event > 0)
    crossed, share = _crossed(start_of, after)
    hit = landing & ((part.event > 0) | (closed(after) != acting))
    late = jnp.where(hit, -safe_divide(after.depths, after.rates), -jnp.inf)
    late = jnp.where(landing, jnp.max(late), (share - 1) * length)
    there = jnp.where(landing, abs(late) <= AT_TOUCH * total, ~jnp.any(crossed))
    fine = _at_end(motion, start_of, (end, state), total, d_arr, hit, part)
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


def _crossed(start: Start, after: ContactMotion) -> tuple[Any, Any]:
    """Which contacts touch or part within a part, at whose end they move so, and at which share of
    it the first does."""
    length, outwards = start.length, jnp.where(start.shares > 0, -1.0, 1.0)
    depths = start.contacts.depths, after.depths
    path: tuple = *depths, length * start.contacts.rates, length * after.rates
    path = (*(outwards * each for each in path),)
    top = summit(path)
    highest = cubic(path, top)[0]
    last = jnp.where(highest > path[1], top, 1.0)
    highest = jnp.maximum(highest, path[1])
    crossed = (highest > 0) | ((highest >= 0) & (start.shares <= 0))
    shares = passage(path, 0.0, last, jnp.any(crossed))
    share = jnp.min(jnp.where(crossed, shares, 1.0))
    return crossed & (shares <= share), share


def _at_end(
    motion: Motion, start: Start, ended: tuple, total: Any, d_arr: Any, hit: Any, part: Part
) -> Part:
    """Behind the end of a part, (state, its derivative) `ended`, at which contacts are `hit`;
    `done` is by how much later [s]."""
    y, state = ended
    still = jnp.zeros(())
    d_in = d_arr, (still, part.d_state), (still, state), part.peaks[1]
    highest = higher(motion, start, y, (part.peaks[0],), d_in)
    at = start._replace(time=start.time + start.length, length=total)

    def behind(values):
        y, state, _ = values
        return cross_within(motion, at._replace(state=y), (d_arr, state), hit)

    y, state, late = apply_if(jnp.any(hit), behind, (y, state, still))
    return Part(
        late, part.turns, y, state, highest, jnp.asarray(jnp.inf), jnp.zeros_like(hit, float)
    )


def _resolved(motion: Motion, start: Start, total: Any) -> tuple[Any, Any]:
    """How long a part may be [s], and whether its contacts cannot be followed, of which so long is
    left of a `total` time [s]. Contacts are looked at where it begins; those that have closed just
    now also where the time would end without them."""
    arrays, time, y, remaining, (depths, rates), acting = start
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
