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
    for which equations of motion are solved; `joints`: those of joints alone. `seen`: contacts as
    functions of (arrays, time, state, shares), of flanks of play by whether they count as pressing;
    `depths`: theirs alone; `sided`: whether that makes a difference."""

    rates: Callable
    contacts: Callable
    slips: Callable
    pressing: Callable
    layout: Layout
    near: Callable
    joints: Callable
    seen: Callable
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
        seen = lambda arrays, time, y, _: contacts(arrays, time, y)
        depths = lambda *now: seen(*now).depths
        same = contacts, contacts, seen, depths
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

    sided = any(own.left_by_torque for own in bare(rest).system.transmissions.values())
    seen = by_shares if sided else lambda arrays, time, y, _: contacts(arrays, time, y)
    own = near, joints, seen, lambda *now: near(*now).depths
    return Motion(counted, contacts, slips, pressing, bare(rest).layout, *own, sided)


def equations(formulation: CompliantContact, rest: Any, plain: Callable) -> Equations:
    """Of a model, of which this is the `rest` beside its arrays; `plain`: its rates as a function
    of (arrays, time, state), and of shares where couplings have play."""

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
            functools.partial(_behind, model),
        ),
    )


def closed(contacts: ContactMotion) -> Any:
    """1 for every contact that is closed, 0 for one that is apart."""
    return jnp.where(contacts.depths >= 0, 1.0, 0.0)


def _at_moving_time(model: Motion, numbers: tuple, tangents: tuple) -> tuple:
    """The derivatives of (state, slopes, shift) at the start of a step."""
    step, (time, y), _ = numbers
    (way, *_), (time_way, state), slopes = tangents
    if not model.layout.joint_contacts:
        return *jax.tree.map(moved, (state, slopes)), jnp.zeros(())

    def moving(known):
        state, slopes, _ = known
        here, ways = (step.arrays, time, y), (way, time_way, state)
        flow = model.rates(step.arrays, step.shares, time, y)
        shift = _shift(model, step, here, ways, (flow, slopes))
        state = state + shift * flow
        ways = way, moved(time_way) + shift, state
        return state, _slopes(model, step.shares, here, ways, slopes), shift

    known = *jax.tree.map(moved, (state, slopes)), jnp.zeros(())
    return apply_if(jnp.any(step.shares > 0), moving, known)


def _shift(model: Motion, step: Step, here: tuple, ways: tuple, slopes: tuple) -> Any:
    """By how much later (its derivative) a contact does in a step what it is nearest to: to close
    or open, or to slide the other way. `slopes`: the rates of the state, and their derivatives."""
    (arrays, time, y), (flow, gains) = here, slopes
    of_joints = lambda each: each[: model.layout.joint_contacts] if model.layout.plays else each
    depths, rates, shares = map(of_joints, (*step.contacts, step.shares))
    sliding = lambda *now: of_joints(model.slips(*now))
    ahead = pushed(model.joints, here, ways)[1]
    both = lambda time, y: (model.joints(arrays, time, y).rates, sliding(arrays, time, y))
    gain, turning = jax.jvp(both, (time, y), (jnp.ones_like(time), flow))[1]
    # A contact that opens is to do so without a difference at the end.
    opening, length = rates < 0, step.length
    deeper = ahead.depths + jnp.where(opening, length * ahead.rates, 0.0)
    for each in jax.tree.leaves(gains):
        more = jax.jvp(lambda y: both(time, y)[0], (y,), (each,))[1]
        deeper = deeper + jnp.where(opening, 0.5 * length * length * more, 0.0)
    rates = jnp.where(opening & (gain < 0), rates + length * gain, rates)
    slips, aside = pushed(sliding, here, ways)
    inner = lambda one, other: jnp.sum(one * other, -1)
    speeds = safe_sqrt(inner(slips, slips)), safe_sqrt(inner(turning, turning))
    way = jnp.stack([abs(depths), speeds[0]])
    reach = step.length * jnp.stack([abs(rates), speeds[1]])
    near = (shares > 0) & (way < NEAR * reach)
    left = jnp.where(near, safe_divide(way, reach), jnp.inf)
    late = [safe_divide(deeper, rates), safe_divide(inner(aside, turning), inner(turning, turning))]
    nearest = near & (left == jnp.min(left))
    count = jnp.sum(jnp.where(nearest, 1.0, 0.0))
    return -safe_divide(jnp.sum(jnp.where(nearest, jnp.stack(late), 0.0)), count)


def _behind(model: Motion, numbers: tuple, tangents: tuple) -> tuple:
    """The derivatives of (state, slopes, growth, events) at the end of a step."""
    step, (time, y), *_, events = numbers
    (way, *_), (time_way, _), slopes, shift, *known = tangents
    arrays, before = step.arrays, step.shares
    here = arrays, time, y
    after = closed(model.near(*here))
    shifts = bool(model.layout.joint_contacts)

    def behind(known):
        state, slopes, growth, told = known
        if shifts:
            state = state - moved(shift) * model.rates(arrays, before, time, y)
        ways = way, time_way, state
        state, *moves = passed(model, here, ways, (before, after), events is not None)
        grown = _grown(growth, jnp.max(jnp.where(after > before, abs(moves[0]), 0.0)))
        slopes = _slopes(model, after, here, (way, time_way, state), slopes)
        return state, slopes, grown, _told(told, events, before != after, moves)

    changed = before != after
    wanted = jnp.any((before > 0) | changed if shifts else changed)
    state, growth, told = jax.tree.map(moved, tuple(known))
    return apply_if(wanted, behind, (state, jax.tree.map(moved, slopes), growth, told))


class Passed(NamedTuple):
    """Derivatives behind touches and releases at a fixed time: of the state; of every contact by
    how much later it touches or parts [s], and its rate there [m/s] (None: nobody asks)."""

    state: Any
    late: Any
    speeds: Any


def passed(model: Motion, here: tuple, ways: tuple, acting: tuple, asked: bool) -> Passed:
    """Behind an instant at which contacts that act by these shares, (before, after), touch and
    part; `here`: (arrays, time, state), `ways`: their derivatives before it; `asked`: for rates."""
    (arrays, time, y), (before, after), state = here, acting, ways[2]
    flow = model.rates(arrays, before, time, y)
    asked = asked or model.remembers or not model.layout.plays
    if asked:
        seen = lambda *here: model.seen(*here, before)
        falls, ahead = seen(*here).rates, pushed(seen, here, ways)[1]
        deeper = ahead.depths
    else:
        depths = lambda *here: model.depths(*here, before)
        falls, deeper = falling(model, here, before, flow), pushed(depths, here, ways)[1]
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
    if not asked:
        return Passed(state, late, None)
    along = lambda time, y: seen(arrays, time, y).rates
    gain = jax.jvp(along, (time, y), (jnp.ones_like(time), flow))[1]
    speeds = ahead.rates + gain * late
    state = with_impact_speeds(model.layout, state, after > before, speeds)
    return Passed(state, late, speeds)


def falling(model: Motion, here: tuple, acting: Any, flow: Any) -> Any:
    """How fast the depths of contacts that act by these shares change at (arrays, time, state),
    whose rate this `flow` is."""
    arrays, time, y = here
    depths = lambda time, y: model.depths(arrays, time, y, acting)
    return jax.jvp(depths, (time, y), (jnp.ones_like(time), flow))[1]


def _told(told: Any, events: Any, happened: Any, ways: tuple) -> Any:
    """Derivatives of the events noted so far, the last of each contact being what has happened at
    the end of this step, with derivatives of its instant and rate."""
    if events is None:
        return None
    places = jnp.arange(events.times.shape[1], dtype=float)
    here = (places == events.counts[:, None] - 1) & happened[:, None]
    times, rates = (
        jnp.where(here, way[:, None], each) for way, each in zip(ways, told, strict=False)
    )
    return told._replace(times=times, rates=rates)


def _grown(growth: Array, late: Scalar) -> Array:
    """After touches of which one comes that much later (0: none does)."""
    met, first, most = growth[0], growth[1], growth[2]
    met = met + jnp.where(late > 0, 1.0, 0.0)
    first = jnp.where(met <= FIRST, jnp.maximum(first, late), first)
    return jnp.stack([met, first, jnp.maximum(most, late)])


def _slopes(model: Motion, shares: Any, here: tuple, ways: tuple, slopes: Any) -> Any:
    """The derivatives of slopes at (arrays, time, state) with these derivatives."""
    rate = lambda arrays, time, y: model.rates(arrays, shares, time, y)
    found = pushed(rate, here, ways)[1]
    return jax.tree.map(lambda _: found, slopes)


def with_impact_speeds(layout: Layout, state: Any, taken: Any, speeds: Any) -> Any:
    """The state with these in the places of impact speeds that have been taken."""
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
    formulation: CompliantContact, rest: Any, plain: Callable, length: Callable, seen: Callable
) -> Callable:
    """A step with its derivative, as a function of (arrays, clock, state, last, met).

    `plain(arrays, clock, state, last)`: its length [s], the state at its end and what it leaves to
    the next: the contacts at its start and its length; `length(clock, contacts, last)`: the length
    by these contacts; `seen(arrays, end, met, (last, now))`: the peaks of the contacts, by what
    this step and the one before leave. `arrays`: of the model, all else,
    and peaks before the interval; `clock`: begins with the time [s]."""
    motion = motion_of(formulation, rest)

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
        acting = closed(begun.contacts)
        shifted, shift = at_moving_time(motion, begun, acting, (way[0], clock_way[0], state))
        clock_ways = moved(clock_way[0]) + shift, *clock_way[1:]
        here, ways = (arrays, clock, aware, last), (way, clock_ways, shifted, last_way)
        (h, end, now), (longer, gone, left) = pushed(plain, here, ways)
        gone = at_fixed_time(motion, begun, acting, end, (gone, shift))
        times = clock_way[0], longer if moves(clock_way) else None
        changed, apart = taken_apart(motion, begun, end, (way[0], times, state))
        gone = jnp.where(changed, apart, gone)
        stop = clock_way[0] if times[1] is None else moved(clock_way[0]) + moved(longer)
        ways = way[0], (clock_way[0], state), (stop, gone), met_way
        higher = _higher(motion, begun, (end, met, arrays[2]), ways)
        found = h, end, now, seen(arrays, end, met, (last, now))
        return found, (longer, gone, left, higher)

    step.defjvp(moving, symbolic_zeros=True)
    return step


def _higher(motion: Any, begun: Now, ended: tuple, ways: tuple) -> Any:
    """The derivative of the peaks behind a step. `ended`: its end, the peaks until its start, and
    in the run before its interval; `ways`: derivatives of (arrays, (time, state) at its start, at
    its end, peaks)."""
    end, known, so_far = ended
    start, stop = (begun.time, begun.state), (begun.time + begun.length, end)
    motions = motions_over(motion, begun, end)
    go = lambda arrays, *now: peaks(motion, arrays, now[:2], motions, now[2], so_far)
    return pushed(go, (begun.arrays, start, stop, known), ways)[1]


def motions_over(motion: Any, begun: Now, end: Any) -> tuple[ContactMotion, ContactMotion]:
    """The motion of the contacts at both ends of a step."""
    first = begun.contacts
    if motion.layout.plays:
        first = motion.contacts(begun.arrays, begun.time, begun.state)
    return first, motion.contacts(begun.arrays, begun.time + begun.length, end)


def at_moving_time(motion: Any, begun: Now, acting: Any, ways: tuple) -> tuple:
    """The derivative of the state where a step begins, at a time that moves with touches
    (`saltation`), and by how much that does. `ways`: derivatives of (arrays, time, state)."""
    way, time, state = ways
    step = Step(begun.arrays, begun.contacts, begun.length, acting)
    ways = (way, None, None), (time, moved(state)), ()
    state, _, shift = _at_moving_time(motion, (step, (begun.time, begun.state), ()), ways)
    return state, shift


def at_fixed_time(motion: Any, begun: Now, acting: Any, end: Any, moves: tuple) -> Any:
    """The derivative of the state where a step ends, at a fixed time. `moves`: (that at a time
    which moves, by how much that does)."""
    (way, shift), time = moves, begun.time + begun.length
    if not motion.layout.joint_contacts:
        return way
    back = lambda way: way - shift * motion.rates(begun.arrays, acting, time, end)
    return apply_if(jnp.any(acting > 0), back, way)


def moves(tree: Any) -> bool:
    """Whether any of these tangents is not 0."""
    return any(not isinstance(each, SymbolicZero) for each in jax.tree.leaves(tree))


def _remembering(formulation: CompliantContact, rest: Any, motion: Any) -> Callable:
    """The contacts at the start of a step, the state with its impact speeds there, and its
    derivative, from numbers and tangents of (arrays, time, state, last): the derivative of a speed
    that was taken within the last step is known since then."""
    places = impact_speed_places(motion.layout)

    def aware(arrays, time, y, last):
        contacts = motion.near(arrays, time, y)
        known = formulation.remember(unpacked(arrays, rest), y, last[0], contacts, last[1])
        return contacts, known

    def both(numbers, tangents):
        if not motion.remembers:
            return motion.near(*numbers[:3]), numbers[2], moved(tangents[2])
        (contacts, now), (_, state) = pushed(aware, numbers, tangents)
        y, before, known = numbers[2], numbers[3][0], moved(tangents[2])
        entries = [state[i] for i in range(len(state))]
        for i, place in enumerate(places):
            if place is not None:
                taken = (y[place] <= 0) & (now[place] > 0) & (before.depths[i] < 0)
                entries[place] = jnp.where(taken, known[place], entries[place])
        return contacts, now, jnp.stack(entries)

    return both


def taken_apart(motion: Any, begun: Now, end: Any, ways: tuple) -> tuple[Any, Any]:
    """A step in which a contact closes or parts, at whose end the state is about `end`: whether one
    has changed, and the derivative of the state at the end.
    `ways`: derivatives of arrays, of (time, length), and of the state."""
    way, (time_way, longer), state = ways
    time, h = begun.time, begun.length
    before = closed(begun.contacts)
    after = closed(motion.near(begun.arrays, time + h, end))
    changed = before != after
    any_changed = jnp.any(changed)

    def met(share):
        first, last = motions_over(motion, begun, end)
        path = (first.depths, last.depths, h * first.rates, h * last.rates)
        return passage(constant(path), 0.0, share, any_changed)

    shares = apply_if(any_changed, met, jnp.ones_like(before))
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
        part = Now(begun.arrays, at, y, length, motion.near(begun.arrays, at, y))
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
    return any_changed, state


def passed_within(motion: Any, begun: Now, ways: tuple, at: Any, y: Any, acts: tuple) -> tuple:
    """(state, its derivative, by how much later [s]) behind what is `hit` at a time."""
    (way, state), (acting, hit) = ways, acts
    flow, here = motion.rates(begun.arrays, acting, at, y), (begun.arrays, at, y)
    if motion.layout.plays:
        depths, rates = motion.depths(*here, acting), falling(motion, here, acting, flow)
    else:
        depths, rates = motion.contacts(*here)
    most = BEHIND * begun.length
    short = jnp.where(hit, -safe_divide(depths, rates) + most, 0.0)
    later = jnp.where(jnp.any(hit), jnp.max(jnp.where(hit, short, -begun.length)), 0.0)
    y, at = y + later * flow, at + later
    then = jnp.where(hit, 1 - acting, acting)
    ways = way, jnp.zeros(()), state
    found = passed(motion, (begun.arrays, at, y), ways, (acting, then), False)
    if not motion.remembers:
        return y, found.state, later
    taken = then > acting
    rates = motion.contacts(begun.arrays, at, y).rates
    y = with_impact_speeds(motion.layout, y, taken, rates)
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
