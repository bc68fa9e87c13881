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


class Step(NamedTuple):
    """A step of a model with these arrays: how its contacts were at the start, and its length [s],
    both without derivatives. `acting`: 1 for a contact that counts as closed, 0 for one that does
    as apart (None: as its indentation has it)."""

    arrays: Any
    contacts: ContactMotion
    length: Scalar
    acting: Any = None

    @property
    def shares(self) -> Any:
        """Which contacts count as closed."""
        return closed(self.contacts) if self.acting is None else self.acting


class Equations(NamedTuple):
    """Of a model, by its arrays, with derivatives: `rates(arrays, shares, time, state)`, and what
    goes around a step, where `slopes` holds the slope with which the next one begins, if any.

    `shifted(step, (time, state), slopes)`: state and slopes at its start, at times that move by the
    derivative of a third number, which is 0; `jumped(step, (time, state), slopes, shift,
    remembering, growth, events)`: the state with its impact speeds, the slopes, the growth (see
    `derivative_error`) and the events noted so far (None: none are) at the end, at a fixed time
    behind touches and releases there.
    """

    rates: Callable
    shifted: Callable
    jumped: Callable


class Motion(NamedTuple):
    """Rates as a function of (arrays, shares, time, state), the motion of contacts as one of
    (arrays, time, state), normal forces of contacts that damp as one of (arrays, state, motion).
    `near`: as contacts, of flanks that are left by their torque without the rates of their depths,
    for which equations of motion are solved; `joints`: those of joints alone. `observe`: contacts
    as functions of (arrays, time, state, shares), of flanks of play by whether they count as
    pressing; `depths`: theirs alone; `sided`: whether that makes a difference."""

    rates: Callable
    contacts: Callable
    slips: Callable
    pressing: Callable
    layout: Layout
    near: Callable
    joints: Callable
    observe: Callable
    depths: Callable
    sided: bool

    @property
    def remembers(self) -> bool:
        """Whether some contact remembers the speed with which it was met."""
        return any(place is not None for place in impact_speed_places(self.layout))


def motion_of(formulation: CompliantContact, rest: Any) -> Motion:
    """How a model moves, of which this is the `rest` beside its arrays."""

    @jax.jit
    def counted(arrays, shares, time, y):
        return formulation.rate(unpacked(arrays, rest), time, y, shares)[0]

    # Of joints rates follow from the geometry alone.
    how = {"exact": True} if bare(rest).layout.plays else {}

    @jax.jit
    def contacts(arrays, time, y):
        return formulation.contacts(unpacked(arrays, rest), time, y, **how)

    @jax.jit
    def slips(arrays, time, y):
        return formulation.slips(unpacked(arrays, rest), time, y)

    @jax.jit
    def pressing(arrays, y, motion):
        return formulation.normal_forces(unpacked(arrays, rest), y, motion)

    if not bare(rest).layout.plays:
        view = lambda arrays, time, y, _: contacts(arrays, time, y)
        depths = lambda *now: view(*now).depths
        same = contacts, contacts, view, depths
        return Motion(counted, contacts, slips, pressing, bare(rest).layout, *same, sided=False)
    count = bare(rest).layout.joint_contacts

    @jax.jit
    def by_shares(arrays, time, y, shares):
        return formulation.contacts(unpacked(arrays, rest), time, y, shares[count:], **how)

    @jax.jit
    def near(arrays, time, y, shares=None):
        flanks = None if shares is None else shares[count:]
        return formulation.contacts(unpacked(arrays, rest), time, y, flanks)

    def joints(*now):
        depths, rates = near(*now)
        return ContactMotion(depths[:count], rates[:count])

    sided = any(t.separates_by_torque for t in bare(rest).system.transmissions.values())
    view = by_shares if sided else lambda arrays, time, y, _: contacts(arrays, time, y)
    t = near, joints, view, lambda *now: near(*now).depths
    return Motion(counted, contacts, slips, pressing, bare(rest).layout, *t, sided)


def equations(formulation: CompliantContact, rest: Any, plain: Callable) -> Equations:
    """Right side and its derivatives with touches, for steps under error control.

    Args:
        formulation: of the run.
        rest: what is left of the model without its arrays.
            plain: rates as a function of (arrays, time, state), and of shares where couplings have
            play.
    """

    model = motion_of(formulation, rest)

    def rates(arrays, shares, *now):
        return plain(arrays, *now, shares) if bare(rest).layout.plays else plain(arrays, *now)

    def as_counted(numbers, tangents):
        return pushed(model.rates, numbers, tangents)[1]

    return Equations(
        derived(rates, as_counted),
        derived(
            lambda step, now, slopes: (now[1], slopes, jnp.zeros(())),
            functools.partial(_at_moving_time, model),
        ),
        derived(
            lambda step, now, slopes, shift, remembering, growth, events: (
                remembering,
                slopes,
                *moving_with(remembering[0], (growth, events)),
            ),
            functools.partial(_differentiate_end, model),
        ),
    )


def closed(contacts: ContactMotion) -> Any:
    """1 for every contact that is closed, 0 for one that is apart."""
    return jnp.where(contacts.depths >= 0, 1.0, 0.0)


def _at_moving_time(model: Motion, numbers: tuple, tangents: tuple) -> tuple:
    """The derivatives of (state, slopes, shift) at the start of a step."""
    step, (time, y), _ = numbers
    (d_arr, *_), (d_time, state), slopes = tangents
    if not model.layout.joint_contacts:
        return *jax.tree.map(moved, (state, slopes)), jnp.zeros(())

    def moving(values):
        state, slopes, _ = values
        here, d_in = (step.arrays, time, y), (d_arr, d_time, state)
        flow = model.rates(step.arrays, step.shares, time, y)
        shift = _shift(model, step, here, d_in, (flow, slopes))
        state = state + shift * flow
        d_in = d_arr, moved(d_time) + shift, state
        return state, _differentiate_slopes(model, step.shares, here, d_in, slopes), shift

    tangents_in = *jax.tree.map(moved, (state, slopes)), jnp.zeros(())
    return apply_if(jnp.any(step.shares > 0), moving, tangents_in)


def _shift(model: Motion, step: Step, here: tuple, d_in: tuple, slopes: tuple) -> Any:
    """By how much later (its derivative) a contact does in a step what it is nearest to: to close
    or open, or to slide the other way. `slopes`: the rates of the state, and their derivatives."""
    (arrays, time, y), (flow, gains) = here, slopes
    of_joints = lambda each: each[: model.layout.joint_contacts] if model.layout.plays else each
    depths, rates, shares = map(of_joints, (*step.contacts, step.shares))
    sliding = lambda *now: of_joints(model.slips(*now))
    ahead = pushed(model.joints, here, d_in)[1]
    both = lambda time, y: (model.joints(arrays, time, y).rates, sliding(arrays, time, y))
    gain, turning = jax.jvp(both, (time, y), (jnp.ones_like(time), flow))[1]
    # A contact that opens is to do so without a difference at the end.
    opening, length = rates < 0, step.length
    deeper = ahead.depths + jnp.where(opening, length * ahead.rates, 0.0)
    for each in jax.tree.leaves(gains):
        more = jax.jvp(lambda y: both(time, y)[0], (y,), (each,))[1]
        deeper = deeper + jnp.where(opening, 0.5 * length * length * more, 0.0)
    rates = jnp.where(opening & (gain < 0), rates + length * gain, rates)
    slips, aside = pushed(sliding, here, d_in)
    inner = lambda one, other: jnp.sum(one * other, -1)
    speeds = safe_sqrt(inner(slips, slips)), safe_sqrt(inner(turning, turning))
    travel = jnp.stack([abs(depths), speeds[0]])
    reach = step.length * jnp.stack([abs(rates), speeds[1]])
    near = (shares > 0) & (travel < NEAR * reach)
    remaining = jnp.where(near, safe_divide(travel, reach), jnp.inf)
    late = [safe_divide(deeper, rates), safe_divide(inner(aside, turning), inner(turning, turning))]
    nearest = near & (remaining == jnp.min(remaining))
    count = jnp.sum(jnp.where(nearest, 1.0, 0.0))
    return -safe_divide(jnp.sum(jnp.where(nearest, jnp.stack(late), 0.0)), count)


def _differentiate_end(model: Motion, numbers: tuple, tangents: tuple) -> tuple:
    """The derivatives of (state, slopes, growth, events) at the end of a step."""
    step, (time, y), *_, events = numbers
    (d_arr, *_), (d_time, _), slopes, shift, *values = tangents
    arrays, before = step.arrays, step.shares
    here = arrays, time, y
    after = closed(model.near(*here))
    shifts = bool(model.layout.joint_contacts)

    def behind(values):
        state, slopes, growth, noted = values
        if shifts:
            state = state - moved(shift) * model.rates(arrays, before, time, y)
        d_in = d_arr, d_time, state
        state, *moves = cross(model, here, d_in, (before, after), events is not None)
        grown = _growth_after(growth, jnp.max(jnp.where(after > before, abs(moves[0]), 0.0)))
        slopes = _differentiate_slopes(model, after, here, (d_arr, d_time, state), slopes)
        return state, slopes, grown, _events_after(noted, events, before != after, moves)

    changed = before != after
    needed = jnp.any((before > 0) | changed if shifts else changed)
    state, growth, noted = jax.tree.map(moved, tuple(values))
    return apply_if(needed, behind, (state, jax.tree.map(moved, slopes), growth, noted))


class Crossed(NamedTuple):
    """Derivatives behind touches and releases at a fixed time: of the state; of every contact by
    how much later it touches or parts [s], and its rate there [m/s] (None: nobody asks)."""

    state: Any
    late: Any
    speeds: Any


def cross(model: Motion, here: tuple, d_in: tuple, acting: tuple, always: bool) -> Crossed:
    """State and derivative behind an instant at which contacts touch and part.

    Args:
        model: motion of the model.
        here: arrays, time [s] and state.
        d_in: their derivatives before the instant.
        acting: shares of the contacts before and after, 1 in contact and 0 apart.
        always: whether rates of the contacts are needed as well.
    """
    (arrays, time, y), (before, after), state = here, acting, d_in[2]
    flow = model.rates(arrays, before, time, y)
    always = always or model.remembers or not model.layout.plays
    if always:
        view = lambda *here: model.observe(*here, before)
        falls, ahead = view(*here).rates, pushed(view, here, d_in)[1]
        deeper = ahead.depths
    else:
        depths = lambda *here: model.depths(*here, before)
        falls, deeper = falling(model, here, before, flow), pushed(depths, here, d_in)[1]
    late = jnp.where(before != after, -safe_divide(deeper, falls), 0.0)
    places = jnp.arange(len(late))

    # Rates are not linear in shares: friction follows the size of a force. So each that changes is
    # gone over by itself.
    def one(carry):
        acting, flow, state = carry
        first = places == jnp.min(jnp.where(acting != after, places, len(places)))
        acting = jnp.where(first, after, acting)
        behind = model.rates(arrays, acting, time, y)
        moving = jnp.sum(jnp.where(first, late, 0.0))
        return acting, behind, state + moving * (flow - behind)

    changes = lambda carry: jnp.any(carry[0] != after)
    state = jax.lax.while_loop(changes, one, (before, flow, state))[2]
    if not always:
        return Crossed(state, late, None)
    along = lambda time, y: view(arrays, time, y).rates
    gain = jax.jvp(along, (time, y), (jnp.ones_like(time), flow))[1]
    speeds = ahead.rates + gain * late
    state = with_impact_speeds(model.layout, state, after > before, speeds)
    return Crossed(state, late, speeds)


def falling(model: Motion, here: tuple, acting: Any, flow: Any) -> Any:
    """Rate of the depths of contacts along the motion [m/s].

    Args:
        model: motion of the model.
        here: arrays, time [s] and state.
        acting: shares of the contacts, 1 in contact and 0 apart.
        flow: rate of the state.
    """
    arrays, time, y = here
    depths = lambda time, y: model.depths(arrays, time, y, acting)
    return jax.jvp(depths, (time, y), (jnp.ones_like(time), flow))[1]


def _events_after(noted: Any, events: Any, happened: Any, d_in: tuple) -> Any:
    """Derivatives of the events noted so far, the last of each contact being what has happened at
    the end of this step, with derivatives of its instant and rate."""
    if events is None:
        return None
    places = jnp.arange(events.times.shape[1], dtype=float)
    here = (places == events.counts[:, None] - 1) & happened[:, None]
    times, rates = (jnp.where(here, d[:, None], each) for d, each in zip(d_in, noted, strict=False))
    return noted._replace(times=times, rates=rates)


def _growth_after(growth: Array, late: Scalar) -> Array:
    """After touches of which one comes that much later (0: none does)."""
    touched, first, most = growth[0], growth[1], growth[2]
    touched = touched + jnp.where(late > 0, 1.0, 0.0)
    first = jnp.where(touched <= FIRST, jnp.maximum(first, late), first)
    return jnp.stack([touched, first, jnp.maximum(most, late)])


def _differentiate_slopes(model: Motion, shares: Any, here: tuple, d_in: tuple, slopes: Any) -> Any:
    """The derivatives of slopes at (arrays, time, state) with these derivatives."""
    rate = lambda arrays, time, y: model.rates(arrays, shares, time, y)
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


class Now(NamedTuple):
    """Where a step of a `length` [s] begins: `time` [s], state, the `contacts` there."""

    arrays: Any
    time: Scalar
    state: Any
    length: Scalar
    contacts: ContactMotion


def through_touches(
    formulation: CompliantContact, rest: Any, plain: Callable, length: Callable, view: Callable
) -> Callable:
    """A step with its derivative, as a function of (arrays, clock, state, last, peaks).

    `arrays` are those of the model, all others, and peaks before the interval; `clock` begins with
    the
    time [s].

    Args:
        formulation: of the run.
        rest: what is left of the model without its arrays.
            plain: `plain(arrays, clock, state, last)`: length [s] and end of the step, and what it
            hands on:
            the contacts at its start and its length.
        length: `length(clock, contacts, last)`: length of a step by these contacts [s].
            view: `view(arrays, end, peaks, (last, now))`: peaks of the contacts, by what the step
            before and
            this one hand on.
    """
    motion = motion_of(formulation, rest)

    @jax.custom_jvp
    def step(arrays, clock, y, last, peaks):
        length, end, now = plain(arrays, clock, y, last)
        peaks = view(arrays, end, peaks, (last, now))
        return length, end, now, peaks

    def moving(numbers, tangents):
        arrays, clock, y, last, peaks = numbers
        d_arr, d_clock, state, d_last, d_peaks = tangents
        remembering = _remember_contacts(formulation, rest, motion)
        contacts, aware, state = remembering(
            (arrays[0], clock[0], y, last), (d_arr[0], d_clock[0], state, d_last)
        )
        h = length(clock, contacts, last)
        start = Now(arrays[0], clock[0], aware, h, ContactMotion(*contacts))
        acting = closed(start.contacts)
        shifted, shift = at_moving_time(motion, start, acting, (d_arr[0], d_clock[0], state))
        d_clocks = moved(d_clock[0]) + shift, *d_clock[1:]
        here, d_in = (arrays, clock, aware, last), (d_arr, d_clocks, shifted, d_last)
        (h, end, now), (longer, d_end, d_now) = pushed(plain, here, d_in)
        d_end = at_fixed_time(motion, start, acting, end, (d_end, shift))
        times = d_clock[0], longer if moves(d_clock) else None
        changed, separated = separate(motion, start, end, (d_arr[0], times, state))
        d_end = jnp.where(changed, separated, d_end)
        stop = d_clock[0] if times[1] is None else moved(d_clock[0]) + moved(longer)
        d_in = d_arr[0], (d_clock[0], state), (stop, d_end), d_peaks
        higher = _differentiate_peaks(motion, start, (end, peaks, arrays[2]), d_in)
        results = h, end, now, view(arrays, end, peaks, (last, now))
        return results, (longer, d_end, d_now, higher)

    step.defjvp(moving, symbolic_zeros=True)
    return step


def _differentiate_peaks(motion: Any, first: Now, ended: tuple, d_in: tuple) -> Any:
    """The derivative of the peaks behind a step. `ended`: its end, the peaks until its start, and
    in the run before its interval; `d_in`: derivatives of (arrays, (time, state) at its start, at
    its end, peaks)."""
    end, highest, so_far = ended
    start, stop = (first.time, first.state), (first.time + first.length, end)
    motions = motions_over(motion, first, end)
    go = lambda arrays, *now: peaks(motion, arrays, now[:2], motions, now[2], so_far)
    return pushed(go, (first.arrays, start, stop, highest), d_in)[1]


def motions_over(motion: Any, start: Now, end: Any) -> tuple[ContactMotion, ContactMotion]:
    """Motion of the contacts at both ends of a step.

    Args:
        motion: of the model.
        start: arrays, time, state and length.
        end: state at the end, shape (n,).
    """
    first = start.contacts
    if motion.layout.plays:
        first = motion.contacts(start.arrays, start.time, start.state)
    return first, motion.contacts(start.arrays, start.time + start.length, end)


def at_moving_time(motion: Any, start: Now, acting: Any, d_in: tuple) -> tuple:
    """Derivative of the state at a step's start, at a time that moves with touches, and its shift.

    Args:
        motion: of the model.
        start: arrays, time, state and length.
        acting: shares of the contacts, 1 in contact and 0 apart.
        d_in: derivatives of arrays, time and state.
    """
    d_arr, time, state = d_in
    step = Step(start.arrays, start.contacts, start.length, acting)
    d_in = (d_arr, None, None), (time, moved(state)), ()
    state, _, shift = _at_moving_time(motion, (step, (start.time, start.state), ()), d_in)
    return state, shift


def at_fixed_time(motion: Any, start: Now, acting: Any, end: Any, moves: tuple) -> Any:
    """Derivative of the state at the end of a step, at a fixed time.

    Args:
        motion: of the model.
        start: arrays, time, state and length.
        acting: shares of the contacts, 1 in contact and 0 apart.
        end: state at the end, shape (n,).
        moves: derivative of the state at a time that moves, and how much that moves [s].
    """
    (d_arr, shift), time = moves, start.time + start.length
    if not motion.layout.joint_contacts:
        return d_arr
    back = lambda d_arr: d_arr - shift * motion.rates(start.arrays, acting, time, end)
    return apply_if(jnp.any(acting > 0), back, d_arr)


def moves(tree: Any) -> bool:
    """Whether any of these tangents is not 0."""
    return any(not isinstance(each, SymbolicZero) for each in jax.tree.leaves(tree))


def _remember_contacts(formulation: CompliantContact, rest: Any, motion: Any) -> Callable:
    """The contacts at the start of a step, the state with its impact speeds there, and its
    derivative, from numbers and tangents of (arrays, time, state, last): the derivative of a speed
    that was taken within the last step is known since then."""
    places = impact_speed_places(motion.layout)

    def aware(arrays, time, y, last):
        contacts = motion.near(arrays, time, y)
        remembered = formulation.remember(unpacked(arrays, rest), y, last[0], contacts, last[1])
        return contacts, remembered

    def both(numbers, tangents):
        if not motion.remembers:
            return motion.near(*numbers[:3]), numbers[2], moved(tangents[2])
        (contacts, now), (_, state) = pushed(aware, numbers, tangents)
        y, before, remembered = numbers[2], numbers[3][0], moved(tangents[2])
        entries = [state[i] for i in range(len(state))]
        for i, place in enumerate(places):
            if place is not None:
                taken = (y[place] <= 0) & (now[place] > 0) & (before.depths[i] < 0)
                entries[place] = jnp.where(taken, remembered[place], entries[place])
        return contacts, now, jnp.stack(entries)

    return both


def separate(motion: Any, start: Now, end: Any, d_in: tuple) -> tuple[Any, Any]:
    """Whether a contact changes within a step, and the derivative of the state at its end.

    Args:
        motion: of the model.
        start: arrays, time, state and length.
        end: about the state at the end, shape (n,).
        d_in: derivatives of arrays, of (time, length), and of the state.
    """
    d_arr, (d_time, longer), state = d_in
    time, h = start.time, start.length
    before = closed(start.contacts)
    after = closed(motion.near(start.arrays, time + h, end))
    changed = before != after
    any_changed = jnp.any(changed)

    def gap_at(share):
        first, last = motions_over(motion, start, end)
        path = (first.depths, last.depths, h * first.rates, h * last.rates)
        return passage(constant(path), 0.0, share, any_changed)

    shares = apply_if(any_changed, gap_at, jnp.ones_like(before))
    turns = jnp.where(any_changed, jnp.sum(changed.astype(int)) + 1, 0)
    if longer is not None:
        state = state - moved(d_time) * motion.rates(start.arrays, before, time, start.state)

    def turn(carry):
        i, share, y, state, acting = carry
        pending = acting != after
        until = jnp.maximum(jnp.min(jnp.where(pending, shares, 1.0)), share)
        hit = pending & (shares <= until)
        length = (until - share) * h
        at = time + share * h
        part = Now(start.arrays, at, y, length, motion.near(start.arrays, at, y))
        y, state = along(motion, part, acting, (d_arr, state))
        at = time + until * h
        y, state, later = cross_within(motion, start, (d_arr, state), at, y, (acting, hit))
        acting = jnp.where(hit, after, acting)
        return i + 1, until + later / h, y, state, acting

    first = jnp.zeros((), int), jnp.zeros(()), start.state, state, before
    state = jax.lax.while_loop(lambda carry: carry[0] < turns, turn, first)[3]
    if longer is not None:
        moves = moved(d_time) + moved(longer)
        state = state + moves * motion.rates(start.arrays, after, time + h, end)
    return any_changed, state


def cross_within(motion: Any, start: Now, d_in: tuple, at: Any, y: Any, acts: tuple) -> tuple:
    """(state, its derivative, delay [s]) behind contacts that change at an instant within a step.

    Args:
        motion: of the model.
        start: arrays, time, state and length of the step.
        d_in: derivatives of arrays and state.
        at: instant [s].
        y: state at the instant, shape (n,).
        acts: shares of the contacts before, and which of them change.
    """
    (d_arr, state), (acting, hit) = d_in, acts
    flow, here = motion.rates(start.arrays, acting, at, y), (start.arrays, at, y)
    if motion.layout.plays:
        depths, rates = motion.depths(*here, acting), falling(motion, here, acting, flow)
    else:
        depths, rates = motion.contacts(*here)
    most = BEHIND * start.length
    short = jnp.where(hit, -safe_divide(depths, rates) + most, 0.0)
    later = jnp.where(jnp.any(hit), jnp.max(jnp.where(hit, short, -start.length)), 0.0)
    y, at = y + later * flow, at + later
    then = jnp.where(hit, 1 - acting, acting)
    d_in = d_arr, jnp.zeros(()), state
    crossing = cross(motion, (start.arrays, at, y), d_in, (acting, then), False)
    if not motion.remembers:
        return y, crossing.state, later
    taken = then > acting
    rates = motion.contacts(start.arrays, at, y).rates
    y = with_impact_speeds(motion.layout, y, taken, rates)
    return y, crossing.state, later


def along(motion: Any, start: Now, acting: Any, d_in: tuple) -> tuple:
    """(state, its derivative) at the end of a motion in which no contact changes.

    Args:
        motion: of the model.
        start: arrays, time, state and length.
        acting: shares of the contacts, 1 in contact and 0 apart.
        d_in: derivatives of arrays and state.
    """
    d_arr, state = d_in
    go = lambda arrays, time, y: flow_end(motion, arrays, acting, time, start.length, y)
    state, shift = at_moving_time(motion, start, acting, (d_arr, jnp.zeros(()), state))
    end, state = pushed(go, (start.arrays, start.time, start.state), (d_arr, shift, state))
    return end, at_fixed_time(motion, start, acting, end, (state, shift))


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
