r"""Derivatives of steps through touches and releases: saltation at events.

Where a contact closes or parts the equations change, and the instant :math:`t^*` at which they do
moves with whatever a derivative is by. With the derivative :math:`dy^-` of the state at the end of
a step that ends there (at a fixed time), indentation :math:`\delta`, rates :math:`f^-` before and
:math:`f^+` after,

.. math:: dt^* = -\frac{d\delta}{\dot\delta}, \qquad dy^+ = dy^- + (f^- - f^+)\,dt^*,

and an impact speed that is taken there moves by :math:`d\dot\delta + \ddot\delta^-\,dt^*`: a
"saltation matrix". Steps end at touches only to within a tolerance. Beyond the touch a stage would
feel contact stiffness that the flow before it has not got, so that derivatives, within a step, are
those of equations whose contacts count as they were at its start.

In contact, stages that resolve forces need not resolve their derivatives: near a touch the
stiffness changes as the square root of time, faster where a damper sets in, and where slip changes
its sign friction is a stiff damper for a moment. Differences without indentation (without slip)
hardly feel that: so derivatives are taken at times that move with what a contact is nearest to.
What goes along with the motion, :math:`f\,dt`, a step carries on as it is.

A step of a given length does not know that a contact closes within it. Its derivative here
(`through_touches`) does: where one closes or parts it is that of the motion, by a method of order
4: up to a touch, behind it, and on to the end. So it converges to that of the motion as steps
become shorter. How fast hangs on the method: what goes along with the motion is large beside what
is left of it behind a touch, and what a step departs from the motion by is as large.

Flanks of play press by a spring whose stiffness does not change, and rub on nothing: steps resolve
their derivatives as they do the motion, at times that do not move.

None of this is in a program of which no derivative is asked.

Source: Müller 1995, Calculation of Lyapunov exponents for dynamic systems with discontinuities,
Chaos, Solitons & Fractals 5, 1671, doi:10.1016/0960-0779(94)00170-U, eq. 19.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.impact_speed import ContactMotion, passage
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import bare, unpacked
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, constant
from jaxclear.ground.tangents import apply_if, derived, moved, moving_with, pushed
from jaxclear.integrators.events import peaks
from jaxclear.multibody.state import Layout, impact_speed_places

# A contact is near to its touch or release, or to the end of its slip, if so many steps as long as
# this one would take it there at its rate.
NEAR = 200.0
# So many touches are the first ones, by which the growth of a derivative is measured: at the first
# of all nothing may move yet (of a stiffness), or little.
FIRST = 3


class Start(NamedTuple):
    """Where a step, or a part of one, of a model with these arrays begins: `time` [s], state,
    length [s], the `contacts` there, without derivatives, and which of these act within it: 1 for a
    contact that counts as closed, 0 for one that does as apart (None: as its indentation has
    it)."""

    arrays: Any
    time: Scalar
    state: Any
    length: Scalar
    contacts: ContactMotion
    acting: Any = None

    @property
    def shares(self) -> Any:
        """Which contacts count as closed."""
        return closed(self.contacts) if self.acting is None else self.acting


class Equations(NamedTuple):
    """Of a model, by its arrays, with derivatives: `rates(arrays, shares, time, state)`, and what
    goes around a step, where `slopes` holds the slope with which the next one begins, if any.

    `shifted(start, slopes)`: state and slopes at its start, at times that move by the derivative of
    a third number, which is 0; `jumped(end, slopes, shift, remembering, growth, events)`: the state
    with its impact speeds, the slopes, the growth (see `derivative_error`) and the events noted so
    far (None: none are) at the end, a `Start` with the contacts and shares of the step, at a fixed
    time behind touches and releases there.
    """

    rates: Callable
    shifted: Callable
    jumped: Callable


class Motion(NamedTuple):
    """Of a model: rates as a function of (arrays, shares, time, state), its contacts as one of
    (arrays, time, state, shares, exact), slips as one of (arrays, time, state), normal forces of
    contacts that damp as one of (arrays, state, motion); `sided`: whether flanks of play are left
    by their torque, so that their depths depend on whether they count as pressing, and their rates
    on the equations of motion."""

    rates: Callable
    observed: Callable
    slips: Callable
    pressing: Callable
    layout: Layout
    sided: bool

    @property
    def remembers(self) -> bool:
        """Whether some contact remembers the speed with which it was met."""
        return any(place is not None for place in impact_speed_places(self.layout))

    def contacts(
        self, arrays: Any, time: Any, y: Any, shares: Any = None, exact: bool = True
    ) -> ContactMotion:
        """The motion of the contacts.

        Args:
            arrays: of the model.
            time: instant [s].
            y: state, shape (n,).
            shares: 1 for flanks that count as pressing, 0 for others; None: by their positions.
            exact: whether rates are those of the depths, for which equations of motion are solved.
        """
        shares, exact = (shares, exact) if self.sided else (None, True)
        return self.observed(arrays, time, y, shares, exact)

    def near(self, arrays: Any, time: Any, y: Any) -> ContactMotion:
        """The motion of the contacts, with rates for which no equations of motion are solved.

        Args:
            arrays: of the model.
            time: instant [s].
            y: state, shape (n,).
        """
        return self.contacts(arrays, time, y, None, False)


def motion_of(formulation: CompliantContact, rest: Any) -> Motion:
    """How a model moves, of which this is the `rest` beside its arrays."""
    model = bare(rest)

    @jax.jit
    def rates(arrays, shares, time, y):
        return formulation.rate(unpacked(arrays, rest), time, y, shares)[0]

    @functools.partial(jax.jit, static_argnums=4)
    def observed(arrays, time, y, shares, exact):
        flanks = None if shares is None else shares[model.layout.joint_contacts :]
        return formulation.contacts(unpacked(arrays, rest), time, y, flanks, exact)

    @jax.jit
    def slips(arrays, time, y):
        return formulation.slips(unpacked(arrays, rest), time, y)

    @jax.jit
    def pressing(arrays, y, motion):
        return formulation.normal_forces(unpacked(arrays, rest), y, motion)

    sided = any(train.separates_by_torque for train in model.system.transmissions.values())
    return Motion(rates, observed, slips, pressing, model.layout, sided)


def equations(formulation: CompliantContact, rest: Any, plain: Callable) -> Equations:
    """Right side and its derivatives with touches, for steps under error control.

    Args:
        formulation: of the run.
        rest: what is left of the model without its arrays.
        plain: rates as a function of (arrays, time, state), and of shares where couplings have
            play.
    """

    motion = motion_of(formulation, rest)

    def rates(arrays, shares, *now):
        return plain(arrays, *now, shares) if motion.layout.plays else plain(arrays, *now)

    def shifted(numbers, tangents):
        d_start, slopes = tangents
        return at_moving_time(motion, numbers[0], d_start[:3], slopes)

    return Equations(
        derived(rates, lambda numbers, tangents: pushed(motion.rates, numbers, tangents)[1]),
        derived(lambda start, slopes: (start.state, slopes, jnp.zeros(())), shifted),
        derived(
            lambda end, slopes, shift, remembering, growth, events: (
                remembering,
                slopes,
                *moving_with(remembering[0], (growth, events)),
            ),
            functools.partial(_behind, motion),
        ),
    )


def closed(contacts: ContactMotion) -> Any:
    """1 for every contact that is closed, 0 for one that is apart."""
    return jnp.where(contacts.depths >= 0, 1.0, 0.0)


def at_moving_time(motion: Motion, start: Start, d_in: tuple, slopes: Any = ()) -> tuple:
    """Derivatives of state and slopes at a step's start, at a time that moves, and its shift [s].

    The time moves with touches.

    Args:
        motion: of the model.
        start: of the step: arrays, time, state, length and contacts.
        d_in: derivatives of arrays, time and state.
        slopes: that the solver keeps between steps.
    """
    d_arr, d_time, state = d_in
    if not motion.layout.joint_contacts:
        return *jax.tree.map(moved, (state, slopes)), jnp.zeros(())

    def moving(values):
        state, slopes, _ = values
        here, d_in = start[:3], (d_arr, d_time, state)
        flow = motion.rates(start.arrays, start.shares, start.time, start.state)
        shift = _shift(motion, start, d_in, (flow, slopes))
        state = state + shift * flow
        d_in = d_arr, moved(d_time) + shift, state
        return state, _slopes(motion, start.shares, here, d_in, slopes), shift

    tangents_in = *jax.tree.map(moved, (state, slopes)), jnp.zeros(())
    return apply_if(jnp.any(start.shares > 0), moving, tangents_in)


def _shift(motion: Motion, start: Start, d_in: tuple, slopes: tuple) -> Any:
    """By how much later (its derivative) a contact does in a step what it is nearest to: to close
    or open, or to slide the other way. `slopes`: the rates of the state, and their derivatives."""
    (arrays, time, y), (flow, gains) = start[:3], slopes
    of_joints = lambda tree: jax.tree.map(lambda x: x[: motion.layout.joint_contacts], tree)
    (depths, rates), shares = of_joints((start.contacts, start.shares))
    joints = lambda *now: of_joints(motion.near(*now))
    sliding = lambda *now: of_joints(motion.slips(*now))
    ahead = pushed(joints, start[:3], d_in)[1]
    both = lambda time, y: (joints(arrays, time, y).rates, sliding(arrays, time, y))
    gain, turning = jax.jvp(both, (time, y), (jnp.ones_like(time), flow))[1]
    # A contact that opens is to do so without a difference at the end.
    opening, length = rates < 0, start.length
    deeper = ahead.depths + jnp.where(opening, length * ahead.rates, 0.0)
    for each in jax.tree.leaves(gains):
        more = jax.jvp(lambda y: both(time, y)[0], (y,), (each,))[1]
        deeper = deeper + jnp.where(opening, 0.5 * length * length * more, 0.0)
    rates = jnp.where(opening & (gain < 0), rates + length * gain, rates)
    slips, aside = pushed(sliding, start[:3], d_in)
    inner = lambda one, other: jnp.sum(one * other, -1)
    speeds = safe_sqrt(inner(slips, slips)), safe_sqrt(inner(turning, turning))
    travel = jnp.stack([abs(depths), speeds[0]])
    reach = length * jnp.stack([abs(rates), speeds[1]])
    near = (shares > 0) & (travel < NEAR * reach)
    remaining = jnp.where(near, safe_divide(travel, reach), jnp.inf)
    late = [safe_divide(deeper, rates), safe_divide(inner(aside, turning), inner(turning, turning))]
    nearest = near & (remaining == jnp.min(remaining))
    count = jnp.sum(jnp.where(nearest, 1.0, 0.0))
    return -safe_divide(jnp.sum(jnp.where(nearest, jnp.stack(late), 0.0)), count)


def _behind(motion: Motion, numbers: tuple, tangents: tuple) -> tuple:
    """The derivatives of (state, slopes, growth, events) at the end of a step."""
    end, *_, events = numbers
    (d_arr, d_time, *_), slopes, shift, *values = tangents
    here, before = end[:3], end.shares
    after = closed(motion.near(*here))
    shifts = bool(motion.layout.joint_contacts)

    def behind(values):
        state, slopes, growth, noted = values
        if shifts:
            state = state - moved(shift) * motion.rates(end.arrays, before, *here[1:])
        state, *moves = cross(motion, here, (d_arr, d_time, state), (before, after))
        grown = _grown(growth, jnp.max(jnp.where(after > before, abs(moves[0]), 0.0)))
        slopes = _slopes(motion, after, here, (d_arr, d_time, state), slopes)
        return state, slopes, grown, _events_after(noted, events, before != after, moves)

    changed = before != after
    needed = jnp.any((before > 0) | changed if shifts else changed)
    state, growth, noted = jax.tree.map(moved, tuple(values))
    return apply_if(needed, behind, (state, jax.tree.map(moved, slopes), growth, noted))


class Crossed(NamedTuple):
    """Derivatives behind touches and releases at a fixed time: of the state; of every contact by
    how much later it touches or parts [s], and its rate there [m/s]."""

    state: Any
    late: Any
    speeds: Any


def cross(motion: Motion, here: tuple, d_in: tuple, acting: tuple) -> Crossed:
    """State and derivative behind an instant at which contacts touch and part.

    Args:
        motion: of the model.
        here: arrays, time [s] and state.
        d_in: their derivatives before the instant.
        acting: shares of the contacts before and after, 1 in contact and 0 apart.
    """
    (arrays, time, y), (before, after), state = here, acting, d_in[2]
    flow = motion.rates(arrays, before, time, y)
    view = lambda arrays, time, y: motion.contacts(arrays, time, y, before)
    falls, ahead = view(*here).rates, pushed(view, here, d_in)[1]
    late = jnp.where(before != after, -safe_divide(ahead.depths, falls), 0.0)
    places = jnp.arange(len(late))

    # Rates are not linear in shares: friction follows the size of a force. So each that changes is
    # gone over by itself.
    def one(carry):
        acting, flow, state = carry
        first = places == jnp.min(jnp.where(acting != after, places, len(places)))
        acting = jnp.where(first, after, acting)
        behind = motion.rates(arrays, acting, time, y)
        moving = jnp.sum(jnp.where(first, late, 0.0))
        return acting, behind, state + moving * (flow - behind)

    changes = lambda carry: jnp.any(carry[0] != after)
    state = jax.lax.while_loop(changes, one, (before, flow, state))[2]
    gain = jax.jvp(lambda *now: view(arrays, *now).rates, (time, y), (jnp.ones_like(time), flow))[1]
    speeds = ahead.rates + gain * late
    return Crossed(with_impact_speeds(motion.layout, state, after > before, speeds), late, speeds)


def _events_after(noted: Any, events: Any, happened: Any, d_in: tuple) -> Any:
    """Derivatives of the events noted so far, the last of each contact being what has happened at
    the end of this step, with derivatives of its instant and rate."""
    if events is None:
        return None
    places = jnp.arange(events.times.shape[1], dtype=float)
    here = (places == events.counts[:, None] - 1) & happened[:, None]
    times, rates = (jnp.where(here, d[:, None], each) for d, each in zip(d_in, noted, strict=False))
    return noted._replace(times=times, rates=rates)


def _grown(growth: Array, late: Scalar) -> Array:
    """After touches of which one comes that much later (0: none does)."""
    touched, first, most = growth[0], growth[1], growth[2]
    touched = touched + jnp.where(late > 0, 1.0, 0.0)
    first = jnp.where(touched <= FIRST, jnp.maximum(first, late), first)
    return jnp.stack([touched, first, jnp.maximum(most, late)])


def _slopes(motion: Motion, shares: Any, here: tuple, d_in: tuple, slopes: Any) -> Any:
    """The derivatives of slopes at (arrays, time, state) with these derivatives."""
    rate = lambda arrays, time, y: motion.rates(arrays, shares, time, y)
    slope = pushed(rate, here, d_in)[1]
    return jax.tree.map(lambda _: slope, slopes)


def with_impact_speeds(layout: Layout, state: Any, taken: Any, speeds: Any) -> Any:
    """The state with new impact speeds where contacts have touched.

    Args:
        layout: where impact speeds sit.
        state: shape (n,).
        taken: which contacts have touched.
        speeds: of touch [m/s].
    """
    entries = [state[i] for i in range(layout.size)]
    for i, place in enumerate(impact_speed_places(layout)):
        if place is not None:
            entries[place] = jnp.where(taken[i], speeds[i], entries[place])
    return sp.stack(entries)


# Within a step that is taken apart: the classic method of order 4.
NODES, WEIGHTS = (0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)
# So far behind a touch [shares of the step] a part of a step ends, beyond what rounding leaves.
BEHIND = 1e-6


def through_touches(
    formulation: CompliantContact, rest: Any, plain: Callable, length: Callable
) -> Callable:
    """A step with its derivative, as a function of (arrays, clock, state, last, peaks).

    `arrays` are those of the model, all others, and peaks before the interval; `clock` begins with
    the time [s].

    Args:
        formulation: of the run.
        rest: what is left of the model without its arrays.
        plain: `plain(arrays, clock, state, last, peaks)`: length [s], state at the end, what
            the step
            hands on, ((contacts at its start, its length), None), and the peaks of the contacts.
        length: `length(clock, contacts, last)`: length of a step by these contacts [s].
    """
    motion = motion_of(formulation, rest)

    def moving(numbers, tangents):
        arrays, clock, y, last, peaks = numbers
        d_arr, d_clock, state, d_last, d_peaks = tangents
        here, d_in = (arrays[0], clock[0], y), (d_arr[0], d_clock[0], state)
        contacts, aware, state = _remembering(
            formulation, rest, motion, (*here, last[0]), (*d_in, d_last[0])
        )
        start = Start(arrays[0], clock[0], aware, length(clock, contacts, last[0]), contacts)
        shifted, _, shift = at_moving_time(motion, start, (*d_in[:2], state))
        d_clocks = moved(d_clock[0]) + shift, *d_clock[1:]
        go = lambda *now: plain(*now, peaks)
        here, d_in = (arrays, clock, aware, last), (d_arr, d_clocks, shifted, d_last)
        results, (longer, d_end, d_now, _) = pushed(go, here, d_in)
        end = results[1]
        d_end = at_fixed_time(motion, start, end, d_end, shift)
        times = d_clock[0], longer if moves(d_clock) else None
        changed, separated = separate(motion, start, end, (d_arr[0], times, state))
        d_end = jnp.where(changed, separated, d_end)
        stop = d_clock[0] if times[1] is None else moved(d_clock[0]) + moved(longer)
        d_in = d_arr[0], (d_clock[0], state), (stop, d_end), d_peaks
        d_peaks = higher(motion, start, end, (peaks, arrays[2]), d_in)[1]
        return results, (longer, d_end, d_now, d_peaks)

    step = jax.custom_jvp(plain)
    step.defjvp(moving, symbolic_zeros=True)
    return step


def higher(motion: Motion, start: Start, end: Any, highest: tuple, d_in: tuple) -> tuple:
    """The peaks behind a step, and their derivative.

    Args:
        motion: of the model.
        start: of the step: arrays, time, state, length and contacts.
        end: state at its end, shape (n,).
        highest: peaks until its start, and in the run before its interval.
        d_in: derivatives of arrays, of (time, state) at both ends, and of the peaks.
    """
    stop = start.time + start.length, end
    motions = motions_over(motion, start, end)
    go = lambda arrays, *now: peaks(motion, arrays, now[:2], motions, now[2], *highest[1:])
    return pushed(go, (start.arrays, start[1:3], stop, highest[0]), d_in)


def motions_over(motion: Motion, start: Start, end: Any) -> tuple[ContactMotion, ContactMotion]:
    """Motion of the contacts at both ends of a step.

    Args:
        motion: of the model.
        start: arrays, time, state and length.
        end: state at the end, shape (n,).
    """
    first = start.contacts
    if motion.sided:
        first = motion.contacts(*start[:3])
    return first, motion.contacts(start.arrays, start.time + start.length, end)


def at_fixed_time(motion: Motion, start: Start, end: Any, d_end: Any, shift: Any) -> Any:
    """Derivative of the state at the end of a step, at a fixed time.

    Args:
        motion: of the model.
        start: of the step: arrays, time, state, length and contacts.
        end: state at the end, shape (n,).
        d_end: its derivative at a time that moves.
        shift: how much that time moves [s].
    """
    if not motion.layout.joint_contacts:
        return d_end
    shares, time = start.shares, start.time + start.length
    back = lambda d_end: d_end - shift * motion.rates(start.arrays, shares, time, end)
    return apply_if(jnp.any(shares > 0), back, d_end)


def moves(tree: Any) -> bool:
    """Whether any of these tangents is not 0."""
    return any(not isinstance(each, SymbolicZero) for each in jax.tree.leaves(tree))


def _remembering(
    formulation: CompliantContact, rest: Any, motion: Motion, numbers: tuple, tangents: tuple
) -> tuple:
    """The contacts at the start of a step, the state with its impact speeds there, and its
    derivative, from numbers and tangents of (arrays, time, state, last): the derivative of a speed
    that was taken within the last step is known since then."""

    def aware(arrays, time, y, last):
        contacts = motion.near(arrays, time, y)
        remembered = formulation.remember(unpacked(arrays, rest), y, last[0], contacts, last[1])
        return contacts, remembered

    if not motion.remembers:
        contacts = motion.near(*numbers[:3])
        return contacts, numbers[2], moved(tangents[2])
    (contacts, now), (_, state) = pushed(aware, numbers, tangents)
    y, before, remembered = numbers[2], numbers[3][0], moved(tangents[2])
    entries = [state[i] for i in range(len(state))]
    for i, place in enumerate(impact_speed_places(motion.layout)):
        if place is not None:
            taken = (y[place] <= 0) & (now[place] > 0) & (before.depths[i] < 0)
            entries[place] = jnp.where(taken, remembered[place], entries[place])
    return contacts, now, jnp.stack(entries)


def separate(motion: Motion, start: Start, end: Any, d_in: tuple) -> tuple[Any, Any]:
    """Whether a contact changes within a step, and the derivative of the state at its end.

    Args:
        motion: of the model.
        start: arrays, time, state and length.
        end: about the state at the end, shape (n,).
        d_in: derivatives of arrays, of (time, length), and of the state.
    """
    d_arr, (d_time, longer), state = d_in
    arrays, time, y, h, *_ = start
    before = start.shares
    after = closed(motion.near(arrays, time + h, end))
    changed = before != after
    any_changed = jnp.any(changed)

    def gap_at(share):
        first, last = motions_over(motion, start, end)
        path = (first.depths, last.depths, h * first.rates, h * last.rates)
        return passage(constant(path), 0.0, share, any_changed)

    shares = apply_if(any_changed, gap_at, jnp.ones_like(before))
    turns = jnp.where(any_changed, jnp.sum(changed.astype(int)) + 1, 0)
    if longer is not None:
        state = state - moved(d_time) * motion.rates(arrays, before, time, y)

    def turn(carry):
        i, share, y, state, acting = carry
        pending = acting != after
        until = jnp.maximum(jnp.min(jnp.where(pending, shares, 1.0)), share)
        hit = pending & (shares <= until)
        at, contacts = time + share * h, motion.near(arrays, time + share * h, y)
        part = Start(arrays, at, y, (until - share) * h, contacts, acting)
        y, state = along(motion, part, (d_arr, state))
        part = Start(arrays, time + until * h, y, h, contacts, acting)
        y, state, later = cross_within(motion, part, (d_arr, state), hit)
        return i + 1, until + later / h, y, state, jnp.where(hit, after, acting)

    first = jnp.zeros((), int), jnp.zeros(()), y, state, before
    state = jax.lax.while_loop(lambda carry: carry[0] < turns, turn, first)[3]
    if longer is not None:
        moves = moved(d_time) + moved(longer)
        state = state + moves * motion.rates(arrays, after, time + h, end)
    return any_changed, state


def cross_within(motion: Motion, start: Start, d_in: tuple, hit: Any) -> tuple:
    """(state, its derivative, delay [s]) behind contacts that change where a part of a step begins.

    Args:
        motion: of the model.
        start: of the part: arrays, time, state, length and contacts.
        d_in: derivatives of arrays and state.
        hit: which contacts change.
    """
    (d_arr, state), (arrays, at, y, length, _, acting) = d_in, start
    flow = motion.rates(arrays, acting, at, y)
    depths, rates = motion.contacts(arrays, at, y, acting)
    short = jnp.where(hit, -safe_divide(depths, rates) + BEHIND * length, 0.0)
    later = jnp.where(jnp.any(hit), jnp.max(jnp.where(hit, short, -length)), 0.0)
    y, at = y + later * flow, at + later
    then = jnp.where(hit, 1 - acting, acting)
    state = cross(motion, (arrays, at, y), (d_arr, jnp.zeros(()), state), (acting, then)).state
    if motion.remembers:
        rates = motion.contacts(arrays, at, y).rates
        y = with_impact_speeds(motion.layout, y, then > acting, rates)
    return y, state, later


def along(motion: Motion, start: Start, d_in: tuple) -> tuple:
    """(state, its derivative) at the end of a part of a motion in which no contact changes.

    Args:
        motion: of the model.
        start: of the part: arrays, time, state, length and contacts.
        d_in: derivatives of arrays and state.
    """
    d_arr, state = d_in
    go = lambda arrays, time, y: flow_end(motion, arrays, start.shares, time, start.length, y)
    state, _, shift = at_moving_time(motion, start, (d_arr, jnp.zeros(()), state))
    end, state = pushed(go, start[:3], (d_arr, shift, state))
    return end, at_fixed_time(motion, start, end, state, shift)


def flow_end(motion: Any, arrays: Any, shares: Any, time: Any, length: Any, y: Any) -> Any:
    """The state after a time in which no contact changes.

    Args:
        motion: of the model.
        arrays: of the model.
        shares: of the contacts, 1 in contact and 0 apart; None: by their indentations.
        time, length: start and duration [s].
        y: state at the start, shape (n,).
    """
    nodes, weights = jnp.asarray(NODES), jnp.asarray(WEIGHTS)

    def stage(carry, i):
        total, slope = carry
        node = nodes[i] * length
        slope = motion.rates(arrays, shares, time + node, y + node * slope)
        return (total + (length * weights[i]) * slope, slope), None

    return jax.lax.scan(stage, (y, jnp.zeros_like(y)), np.arange(len(NODES)))[0][0]
