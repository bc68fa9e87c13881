"""Derivatives through touches and releases that fall within a step of a given length.

A step itself does not know that a contact closes within it. Its derivative here does: where one
closes or parts it is that of the motion, by a method of order 4: up to a touch, behind it, and on
to the end. Elsewhere it is that of the step, in contact at times that move with touches
(`saltation`). So it converges to that of the motion as steps become shorter. How fast hangs on the
method: what goes along with the motion is large beside what is left of it behind a touch, and what
a step departs from the motion by is as large.

None of this is in a program of which no derivative is asked.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.impact_speed import ContactMotion, passage
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import Scalar, constant
from jaxclear.ground.tangents import moved, pushed, where_wanted
from jaxclear.integrators import saltation
from jaxclear.integrators.explicit_methods import CHAINS
from jaxclear.integrators.peaks import peaks
from jaxclear.multibody.state import impact_speed_places

# Within a step that is taken apart: the classic method of order 4.
NODES, WEIGHTS = CHAINS["rk4"]
# So far behind a touch [shares of the step] a part of a step ends, beyond what rounding leaves.
BEHIND = 1e-6


class Now(NamedTuple):
    """Where a step of a `length` [s] begins: `time` [s], state, the `contacts` there."""

    arrays: Any
    time: Scalar
    state: Any
    length: Scalar
    contacts: ContactMotion


def through_touches(
    formulation: CompliantContact, rest: Any, plain: Callable, length: Callable, seen: Callable
) -> Callable:
    """A step with its derivative, as a function of (arrays, clock, state, last, met).

    `plain(arrays, clock, state, last)`: its length [s], the state at its end and what it leaves to
    the next: the contacts at its start and its length; `length(clock, contacts, last)`: the length
    by these contacts; `seen(arrays, end, met, (last, now))`: the peaks of the contacts, by what
    this step and the one before leave. `arrays`: of the model, all else,
    and peaks before the interval; `clock`: begins with the time [s]."""
    motion = saltation.motion_of(formulation, rest)

    @jax.custom_jvp
    def step(arrays, clock, y, last, met):
        length, end, now = plain(arrays, clock, y, last)
        met = seen(arrays, end, met, (last, now))
        return length, end, now, met

    def moving(numbers, tangents):
        arrays, clock, y, last, met = numbers
        way, clock_way, state, last_way, met_way = tangents
        remembering = _remembering(formulation, rest, motion)
        contacts, aware, state = remembering(
            (arrays[0], clock[0], y, last), (way[0], clock_way[0], state, last_way)
        )
        h = length(clock, contacts, last)
        begun = Now(arrays[0], clock[0], aware, h, ContactMotion(*contacts))
        acting = saltation.closed(begun.contacts)
        shifted, shift = at_moving_time(motion, begun, acting, (way[0], clock_way[0], state))
        clock_ways = moved(clock_way[0]) + shift, *clock_way[1:]
        here, ways = (arrays, clock, aware, last), (way, clock_ways, shifted, last_way)
        (h, end, now), (longer, gone, left) = pushed(plain, here, ways)
        gone = at_fixed_time(motion, begun, acting, end, (gone, shift))
        times = clock_way[0], longer if moves(clock_way) else None
        apart = taken_apart(motion, begun, end, (way[0], times, state))
        gone = jnp.where(apart.changed, apart.way, gone)
        stop = clock_way[0] if times[1] is None else moved(clock_way[0]) + moved(longer)
        ways = way[0], (clock_way[0], state), (stop, gone), met_way
        higher = _higher(motion, begun, (end, apart.contacts, met, arrays[2]), ways)
        found = h, end, now, seen(arrays, end, met, (last, now))
        return found, (longer, gone, left, higher)

    step.defjvp(moving, symbolic_zeros=True)
    return step


def _higher(motion: Any, begun: Now, ended: tuple, ways: tuple) -> Any:
    """The derivative of the peaks behind a step. `ended`: its end, the contacts there, the peaks
    until its start, and in the run before its interval; `ways`: derivatives of (arrays, (time,
    state) at its start, at its end, peaks)."""
    end, contacts, known, so_far = ended
    start, stop = (begun.time, begun.state), (begun.time + begun.length, end)
    motions = begun.contacts, contacts
    go = lambda arrays, *now: peaks(motion, arrays, now[:2], motions, now[2], so_far)
    return pushed(go, (begun.arrays, start, stop, known), ways)[1]


def at_moving_time(motion: Any, begun: Now, acting: Any, ways: tuple) -> tuple:
    """The derivative of the state where a step begins, at a time that moves with touches
    (`saltation`), and by how much that does. `ways`: derivatives of (arrays, time, state)."""
    way, time, state = ways
    step = saltation.Step(begun.arrays, begun.contacts, begun.length, acting)
    ways = (way, None, None), (time, moved(state)), ()
    state, _, shift = saltation.at_moving_time(motion, (step, (begun.time, begun.state), ()), ways)
    return state, shift


def at_fixed_time(motion: Any, begun: Now, acting: Any, end: Any, moves: tuple) -> Any:
    """The derivative of the state where a step ends, at a fixed time. `moves`: (that at a time
    which moves, by how much that does)."""
    (way, shift), time = moves, begun.time + begun.length
    back = lambda way: way - shift * motion.rates(begun.arrays, acting, time, end)
    return where_wanted(jnp.any(acting > 0), back, way)


def moves(tree: Any) -> bool:
    """Whether any of these tangents is not 0."""
    return any(not isinstance(each, SymbolicZero) for each in jax.tree.leaves(tree))


def _remembering(formulation: CompliantContact, rest: Any, motion: Any) -> Callable:
    """The contacts at the start of a step, the state with its impact speeds there, and its
    derivative, from numbers and tangents of (arrays, time, state, last): the derivative of a speed
    that was taken within the last step is known since then."""
    places = impact_speed_places(motion.layout)
    wanted = any(place is not None for place in places)

    def aware(arrays, time, y, last):
        contacts = motion.contacts(arrays, time, y)
        known = formulation.remember(eqx.combine(arrays, rest), y, last[0], contacts, last[1])
        return contacts, known

    def both(numbers, tangents):
        if not wanted:
            return motion.contacts(*numbers[:3]), numbers[2], moved(tangents[2])
        (contacts, now), (_, state) = pushed(aware, numbers, tangents)
        y, before, known = numbers[2], numbers[3][0], moved(tangents[2])
        entries = [state[i] for i in range(len(state))]
        for i, place in enumerate(places):
            if place is not None:
                taken = (y[place] <= 0) & (now[place] > 0) & (before.depths[i] < 0)
                entries[place] = jnp.where(taken, known[place], entries[place])
        return contacts, now, jnp.stack(entries)

    return both


class Apart(NamedTuple):
    """A step taken apart, where a contact has `changed`: the derivative of the state at its end,
    and the `contacts` at the end of the step as it is."""

    changed: Any
    way: Any
    contacts: ContactMotion


def taken_apart(motion: Any, begun: Now, end: Any, ways: tuple) -> Apart:
    """A step in which a contact closes or parts, at whose end the state is about `end`.
    `ways`: derivatives of arrays, of (time, length), and of the state."""
    way, (time_way, longer), state = ways
    time, h = begun.time, begun.length
    before = saltation.closed(begun.contacts)
    contacts = motion.contacts(begun.arrays, time + h, end)
    after = saltation.closed(contacts)
    path = (begun.contacts.depths, contacts.depths, h * begun.contacts.rates, h * contacts.rates)
    changed = before != after
    any_changed = jnp.any(changed)
    shares = passage(constant(path), 0.0, jnp.ones_like(before), any_changed)
    turns = jnp.where(any_changed, jnp.sum(changed.astype(int)) + 1, 0)
    if longer is not None:
        state = state - moved(time_way) * motion.rates(begun.arrays, before, time, begun.state)

    def turn(carry):
        i, share, y, state, acting = carry
        pending = acting != after
        until = jnp.maximum(jnp.min(jnp.where(pending, shares, 1.0)), share)
        hit = pending & (shares <= until)
        length = (until - share) * h
        at = time + share * h
        part = Now(begun.arrays, at, y, length, motion.contacts(begun.arrays, at, y))
        y, state = along(motion, part, acting, (way, state))
        at = time + until * h
        y, state, later = passed_within(motion, begun, (way, state), at, y, (acting, hit))
        acting = jnp.where(hit, after, acting)
        return i + 1, until + later / h, y, state, acting

    first = jnp.zeros((), int), jnp.zeros(()), begun.state, state, before
    state = jax.lax.while_loop(lambda carry: carry[0] < turns, turn, first)[3]
    if longer is not None:
        moves = moved(time_way) + moved(longer)
        state = state + moves * motion.rates(begun.arrays, after, time + h, end)
    return Apart(any_changed, state, contacts)


def passed_within(motion: Any, begun: Now, ways: tuple, at: Any, y: Any, acts: tuple) -> tuple:
    """(state, its derivative, by how much later [s]) behind what is `hit` at a time."""
    (way, state), (acting, hit) = ways, acts
    flow = motion.rates(begun.arrays, acting, at, y)
    now = motion.contacts(begun.arrays, at, y)
    most = BEHIND * begun.length
    short = jnp.where(hit, -safe_divide(now.depths, now.rates) + most, 0.0)
    later = jnp.where(jnp.any(hit), jnp.max(jnp.where(hit, short, -begun.length)), 0.0)
    y, at = y + later * flow, at + later
    then = jnp.where(hit, 1 - acting, acting)
    ways = way, jnp.zeros(()), state
    found = saltation.passed(motion, (begun.arrays, at, y), ways, (acting, then))
    taken = then > acting
    rates = motion.contacts(begun.arrays, at, y).rates
    y = saltation.with_impact_speeds(motion.layout, y, taken, rates)
    return y, found.state, later


def along(motion: Any, begun: Now, acting: Any, ways: tuple) -> tuple:
    """(state, its derivative) at the end of a part of a motion in which contacts act by these
    shares. `ways`: derivatives of (arrays, state)."""
    way, state = ways
    go = lambda arrays, time, y: gone_on(motion, arrays, acting, time, begun.length, y)
    state, shift = at_moving_time(motion, begun, acting, (way, jnp.zeros(()), state))
    end, state = pushed(go, (begun.arrays, begun.time, begun.state), (way, shift, state))
    return end, at_fixed_time(motion, begun, acting, end, (state, shift))


def gone_on(motion: Any, arrays: Any, shares: Any, time: Any, length: Any, y: Any) -> Any:
    """The state after a time in which contacts act by these shares (None: as their indentations
    have it)."""
    nodes, weights = jnp.asarray(NODES), jnp.asarray(WEIGHTS)

    def stage(carry, i):
        total, slope = carry
        node = nodes[i] * length
        slope = motion.rates(arrays, shares, time + node, y + node * slope)
        return (total + (length * weights[i]) * slope, slope), None

    return jax.lax.scan(stage, (y, jnp.zeros_like(y)), np.arange(len(NODES)))[0][0]
