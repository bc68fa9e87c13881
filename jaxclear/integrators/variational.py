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

from jaxclear.formulations import closing
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
from jaxclear.integrators.derivative_error import NO_SECOND, PARTED, beside, unknown_way
from jaxclear.integrators.events import Peaks, nothing_met, peaks
from jaxclear.integrators.saltation import Now, along, closed, motion_of, moves, passed_within
from jaxclear.multibody.reach import gaps_passed
from jaxclear.multibody.state import bristle_places


class Beside(NamedTuple):
    """Zeros. Their derivatives are, of the motion beside a run: how far its state is `away` from
    the run's, how far its places have `parted` from these at most [1] of the narrowest gap, and the
    `peaks` of each contact."""

    away: Array
    parted: Scalar
    peaks: Peaks


def nothing_beside(size: int, contacts: int, damped: bool) -> Beside:
    """Where a run begins, of which the state has this size, and some contact is `damped`."""
    return Beside(jnp.zeros(size), jnp.zeros(()), nothing_met(jnp.zeros(contacts), damped))


def beside_steps(formulation: CompliantContact, rest: Any, plain: Callable) -> Callable:
    """A step with the derivative of the motion beside it, as a function of (arrays, clock, state,
    last, met, beside).

    `plain(arrays, clock, y, last, met)`: the state at its end, what it leaves to the next, and the
    peaks until then. `arrays`: of the model, and of all else; `clock`: its start and length [s];
    `rest`: of the model."""
    motion = motion_of(formulation, rest)

    def remember(arrays, y, contacts, length):
        """Contacts that are apart forget their impact speeds; those that begin closed have one."""
        if not formulation.remembers(bare(rest)):
            return y
        model = unpacked(arrays, rest)
        return formulation.remember(model, y, contacts, contacts, length)

    def close(arrays, time, length, y):
        return closing.closed(unpacked(arrays, rest), time, y, length)

    def step(arrays, clock, y, last, met, beside):
        end, *found = plain(arrays, clock, y, last, met)
        return end, *found, zeros_with(end[0], beside)

    @jax.custom_jvp
    def known(*numbers):
        return step(*numbers)

    def moving(numbers, tangents):
        arrays, clock, y, *_ = numbers
        way, clock_way, state, _, met_way, beside = tangents
        found = step(*numbers)
        end, now, *_ = found
        beside, met_way = jax.tree.map(moved, (beside, met_way))
        longer = moved(clock_way[1]) if moves(clock_way) else None
        ways = way[0], (clock_way[0], longer), moved(state)
        begun = y + beside.away
        own = remember, close if bare(rest).projects else None
        ended = _parted(motion, own, (arrays[0], clock, begun), ways, met_way, beside)
        there, gone, higher, beside = ended
        away = there - end
        share = gaps_passed(unpacked(arrays[0], rest).system, away)
        beside = beside._replace(away=away, parted=jnp.maximum(beside.parted, share))
        return found, (gone, jax.tree.map(jnp.zeros_like, now), higher, beside)

    known.defjvp(moving, symbolic_zeros=True)
    return known


def so_far(beside: Beside) -> Beside:
    """What is known where a saving interval begins."""
    zeros = lambda beside: jax.tree.map(lambda each: zeros_with(each, each), beside)
    same = lambda numbers, tangents: jax.tree.map(moved, tangents[0])
    return derived(zeros, same)(beside)


def trusted_beside(end: Any, met: Any, watch: Any, known: Beside) -> tuple:
    """All that was found of a run, where the derivative of the motion beside it can be trusted;
    events have none."""
    end, met = allow_first_derivative(NO_SECOND, beside((end, met), known.parted))
    return end, met, unknown_way(watch) if watch is not None else None


def _parted(
    motion: Any, own: tuple, here: tuple, ways: tuple, higher: Any, beside: Beside
) -> tuple:
    """(state, its derivative, that of the peaks, what is known) behind a step from
    `here` (arrays, clock, state); `own`: how its impact speeds are remembered, and its loops closed
    (None: they are not). Where run and motion have parted nothing goes on."""
    remember, close = own
    arrays, (time, whole), y = here
    way, (time_way, longer), state = ways
    moving = longer is not None
    rates = lambda at, y: motion.rates(arrays, closed(motion.contacts(arrays, at, y)), at, y)
    if moving:
        state = state - moved(time_way) * rates(time, y)
    aware = lambda y, contacts: remember(arrays, y, contacts, whole)
    together = beside.parted <= PARTED
    known = together, y, (beside.peaks, higher)
    part = followed(motion, aware, (arrays, time, whole), (way, state), known)
    y, state, (highest, higher) = part.y, part.way, part.peaks
    if close is not None:
        at = time + whole
        still = SymbolicZero.from_primal_value(at)
        y, state = pushed(close, (arrays, at, whole, y), (way, still, still, state))
    if moving:
        state = state + (moved(time_way) + longer) * rates(time + whole, y)
    ended = part.done >= whole * (1 - SLIVER)
    parted = jnp.where(ended, beside.parted, jnp.inf)
    beside = Beside(beside.away, parted, highest)
    return y, state, higher, beside


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
    derivative (`way`), (the peaks, their derivatives), and how long the next part may be [s] so
    that the contacts that are `due` touch or part at its end. nan is done where parts are too long
    for a contact."""

    done: Scalar
    turns: Any
    y: Any
    way: Any
    peaks: tuple[Peaks, Peaks]
    limit: Scalar
    due: Any


class _Gone(NamedTuple):
    """A part gone through: where it began, its contacts that acted, the state at its end and its
    derivative, the contacts there."""

    begun: Now
    acting: Any
    end: Any
    way: Any
    contacts: ContactMotion


def followed(motion: Any, remember: Callable, clock: tuple, ways: tuple, known: tuple) -> Part:
    """A motion over a time, where it is `wanted`. `remember(state, contacts)`: the state as it
    knows its impact speeds. `clock`: (arrays, start [s], length [s]), `ways`: the derivatives of
    the arrays and of the state, at times that do not move; `known`: (wanted, the state, (the peaks,
    their derivatives))."""
    (_, _, whole), (way, state), (wanted, y, highest) = clock, ways, known
    nothing = jnp.zeros(())
    first = Part(
        done=nothing,
        turns=jnp.zeros((), int),
        y=y,
        way=state,
        peaks=highest,
        limit=jnp.asarray(jnp.inf),
        due=jnp.zeros_like(highest[0].depths),
    )
    most = jnp.where(wanted, MOST_TURNS, 0)

    def left(part):
        return (part.done < whole * (1 - SLIVER)) & (part.turns < most)

    return jax.lax.while_loop(
        left, lambda part: _further(motion, remember, clock, way, part), first
    )


def _further(motion: Any, remember: Callable, clock: tuple, way: Any, part: Part) -> Part:
    """A part further, or how long it may be."""
    arrays, start, whole = clock
    time = start + part.done
    contacts = motion.contacts(arrays, time, part.y)
    y, acting = remember(part.y, contacts), closed(contacts)
    left = whole - part.done
    begun = Now(arrays, time, y, left, contacts)
    resolved, lost = _resolved(motion, begun, acting, (whole, left))
    resolved = jnp.where(jnp.any(acting > 0), resolved, left)
    length = jnp.minimum(jnp.minimum(resolved, part.limit), left)
    gone = _through(motion, begun._replace(length=length), acting, (way, part.way))
    landing = jnp.any(part.due > 0)
    after, crossed, share = gone.contacts, *_crossed(gone)
    hit = landing & ((part.due > 0) | (closed(after) != acting))
    late = jnp.where(hit, -safe_divide(after.depths, after.rates), -jnp.inf)
    late = jnp.where(landing, jnp.max(late), (share - 1) * length)
    there = jnp.where(landing, abs(late) <= AT_TOUCH * whole, ~jnp.any(crossed))
    fine = _at_end(motion, gone, whole, way, (hit, part))
    fine = fine._replace(done=jnp.where(length < left, part.done + length, whole) + fine.done)
    # What would pass the end after all touches no more.
    again = (late + length < left) & (length > 0)
    due = jnp.where(landing, part.due, jnp.where(crossed, 1.0, 0.0))
    short = part._replace(
        limit=jnp.where(again, late + length, jnp.inf), due=jnp.where(again, due, 0.0)
    )
    found = jax.tree.map(lambda a, b: jnp.where(there, a, b), fine, short)
    done = jnp.where(lost, jnp.nan, found.done)
    return found._replace(done=done, turns=part.turns + 1)


def _through(motion: Any, begun: Now, acting: Any, ways: tuple) -> _Gone:
    """A part in which the contacts act that did at its start."""
    end, state = along(motion, begun, acting, ways)
    contacts = motion.contacts(begun.arrays, begun.time + begun.length, end)
    return _Gone(begun, acting, end, state, contacts)


def _crossed(gone: _Gone) -> tuple[Any, Any]:
    """Which contacts touch or part within a part, and at which share of it the first does."""
    begun, after, length = gone.begun, gone.contacts, gone.begun.length
    outwards = jnp.where(gone.acting > 0, -1.0, 1.0)
    depths = begun.contacts.depths, after.depths
    path: tuple = *depths, length * begun.contacts.rates, length * after.rates
    path = (*(outwards * each for each in path),)
    top = summit(path)
    highest = cubic(path, top)[0]
    last = jnp.where(highest > path[1], top, 1.0)
    highest = jnp.maximum(highest, path[1])
    crossed = (highest > 0) | ((highest >= 0) & (gone.acting <= 0))
    shares = passage(path, 0.0, last, jnp.any(crossed))
    share = jnp.min(jnp.where(crossed, shares, 1.0))
    return crossed & (shares <= share), share


def _at_end(motion: Any, gone: _Gone, whole: Any, way: Any, known: tuple) -> Part:
    """Behind the end of a part, at which contacts are `hit`; `done` is by how much later [s]."""
    (begun, acting, end, state, after), (hit, part) = gone, known
    later = begun.time + begun.length
    ends, motions = ((begun.time, begun.state), (later, end)), (begun.contacts, after)
    higher = lambda arrays, *now: peaks(motion, arrays, now[:2], motions, now[2])
    ways = way, (jnp.zeros(()), part.way), (jnp.zeros(()), state), part.peaks[1]
    highest = pushed(higher, (begun.arrays, *ends, part.peaks[0]), ways)

    def behind(known):
        state, y, _ = known
        at = begun._replace(length=whole)
        y, state, late = passed_within(motion, at, (way, state), later, y, (acting, hit))
        return state, y, late

    known = state, end, jnp.zeros(())
    state, y, late = apply_if(jnp.any(hit), behind, known)
    ahead = jnp.asarray(jnp.inf), jnp.zeros_like(acting)
    return Part(late, part.turns, y, state, highest, *ahead)


def _resolved(motion: Any, begun: Now, acting: Any, clock: tuple) -> tuple[Any, Any]:
    """How long a part may be [s], and whether its contacts cannot be followed; `clock`: the whole
    time, and what is left of it [s]. Contacts are looked at where it begins; those that have closed
    just now also where the time would end without them."""
    arrays, time, y, _, (depths, rates) = begun
    whole, left = clock
    apart = jnp.zeros_like(acting)
    n, m = motion.layout.coordinates, motion.layout.memory_start
    entries = np.arange(motion.layout.size)
    places, moves = entries < n, (entries >= n) & (entries < m)
    bristles = np.isin(entries, bristle_places(motion.layout))

    def look(carry):
        i, (time, y), fastest = carry
        acting = closed(motion.contacts(arrays, time, y))
        pushes = jax.jvp(lambda own: motion.rates(arrays, own, time, y), (apart,), (acting,))[1]
        along = lambda way: jax.jvp(lambda y: motion.rates(arrays, acting, time, y), (y,), (way,))
        resisted = along(jnp.where(moves, pushes, 0.0))[1]
        returned = along(jnp.where(places, resisted, 0.0))[1]
        size = lambda way, own=moves: safe_sqrt(jnp.sum(jnp.where(own, way * way, 0.0)))
        damped = safe_divide(size(resisted), size(pushes))
        vibrating = safe_sqrt(safe_divide(size(returned), size(pushes)))
        if bristles.any():
            settling = along(jnp.where(bristles, y, 0.0))[1]
            settling = safe_divide(size(settling, bristles), size(y, bristles))
            damped = jnp.maximum(damped, settling)
        wanted = jnp.maximum(vibrating / ANGLE, damped / BRAKED)
        pace = jnp.stack([wanted, jnp.maximum(vibrating, 0.5 * damped)])
        ahead = y + left * motion.rates(arrays, apart, time, y)
        return i + 1, (time + left, ahead), jnp.maximum(fastest, pace)

    deepens = (acting > 0) & (rates > 0)
    new = jnp.any(deepens & (depths < left * EARLY * rates))
    looks = jnp.where(jnp.any(acting > 0), jnp.where(new, 2, 1), 0)
    first = jnp.zeros((), int), (time, y), jnp.zeros(2)
    fastest = jax.lax.while_loop(lambda carry: carry[0] < looks, look, first)[2]
    longest = 1 / jnp.maximum(fastest[0], EARLY / whole)
    share = jnp.where(deepens, 1.0, PARTING)
    ways = jnp.where(acting > 0, safe_divide(share * depths, abs(rates)), jnp.inf)
    length = jnp.clip(jnp.min(ways), EARLY * longest, longest)
    shortest = whole / MOST_PARTS
    return jnp.maximum(length, shortest), shortest * fastest[1] > WIDEST
