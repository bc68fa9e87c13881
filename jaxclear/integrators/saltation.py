r"""Derivatives of steps through touches and releases.

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

None of this is in a program of which no derivative is asked.

Source: Müller 1995, Calculation of Lyapunov exponents for dynamic systems with discontinuities,
Chaos, Solitons & Fractals 5, 1671, doi:10.1016/0960-0779(94)00170-U, eq. 19.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.impact_speed import ContactMotion
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.ground.tangents import derived, moved, moving_with, pushed, where_wanted
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
    remembering, growth, events, error)`: the state with its impact speeds, the slopes, the growth
    (see `trust`) and the events noted so far (None: none are) at the end, at a fixed time behind
    touches and releases there, by the step's error.
    """

    rates: Callable
    shifted: Callable
    jumped: Callable


class Motion(NamedTuple):
    """Rates as a function of (arrays, shares, time, state), the motion of contacts as one of
    (arrays, time, state), normal forces of contacts that damp as one of (arrays, state, motion)."""

    rates: Callable
    contacts: Callable
    slips: Callable
    pressing: Callable
    layout: Layout


def motion_of(formulation: CompliantContact, rest: Any) -> Motion:
    """How a model moves, of which this is the `rest` beside its arrays."""

    @jax.jit
    def counted(arrays, shares, time, y):
        return formulation.rate(eqx.combine(arrays, rest), time, y, shares)[0]

    @jax.jit
    def contacts(arrays, time, y):
        return formulation.contacts(eqx.combine(arrays, rest), time, y)

    @jax.jit
    def slips(arrays, time, y):
        return formulation.slips(eqx.combine(arrays, rest), time, y)

    @jax.jit
    def pressing(arrays, y, motion):
        return formulation.normal_forces(eqx.combine(arrays, rest), y, motion)

    return Motion(counted, contacts, slips, pressing, rest.layout)


def equations(formulation: CompliantContact, rest: Any, plain: Callable) -> Equations:
    """Of a model, of which this is the `rest` beside its arrays; `plain`: its rates as a function
    of (arrays, time, state)."""

    model = motion_of(formulation, rest)

    def as_counted(numbers, tangents):
        return pushed(model.rates, numbers, tangents)[1]

    return Equations(
        derived(lambda arrays, _, *now: plain(arrays, *now), as_counted),
        derived(
            lambda step, now, slopes: (now[1], slopes, jnp.zeros(())),
            functools.partial(at_moving_time, model),
        ),
        derived(
            lambda step, now, slopes, shift, remembering, growth, events, error: (
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


def at_moving_time(model: Motion, numbers: tuple, tangents: tuple) -> tuple:
    """The derivatives of (state, slopes, shift) at the start of a step."""
    step, (time, y), _ = numbers
    (way, *_), (time_way, state), slopes = tangents

    def moving(known):
        state, slopes, _ = known
        here, ways = (step.arrays, time, y), (way, time_way, state)
        flow = model.rates(step.arrays, step.shares, time, y)
        shift = _shift(model, step, here, ways, (flow, slopes))
        state = state + shift * flow
        ways = way, moved(time_way) + shift, state
        return state, _slopes(model, step.shares, here, ways, slopes), shift

    known = *jax.tree.map(moved, (state, slopes)), jnp.zeros(())
    return where_wanted(jnp.any(step.shares > 0), moving, known)


def _shift(model: Motion, step: Step, here: tuple, ways: tuple, slopes: tuple) -> Any:
    """By how much later (its derivative) a contact does in a step what it is nearest to: to close
    or open, or to slide the other way. `slopes`: the rates of the state, and their derivatives."""
    (depths, rates), (arrays, time, y), (flow, gains) = step.contacts, here, slopes
    ahead = pushed(model.contacts, here, ways)[1]
    both = lambda time, y: (model.contacts(arrays, time, y).rates, model.slips(arrays, time, y))
    gain, turning = jax.jvp(both, (time, y), (jnp.ones_like(time), flow))[1]
    # A contact that opens is to do so without a difference at the end.
    opening, length = rates < 0, step.length
    deeper = ahead.depths + jnp.where(opening, length * ahead.rates, 0.0)
    for each in jax.tree.leaves(gains):
        more = jax.jvp(lambda y: both(time, y)[0], (y,), (each,))[1]
        deeper = deeper + jnp.where(opening, 0.5 * length * length * more, 0.0)
    rates = jnp.where(opening & (gain < 0), rates + length * gain, rates)
    slips, aside = pushed(model.slips, here, ways)
    inner = lambda one, other: jnp.sum(one * other, -1)
    speeds = safe_sqrt(inner(slips, slips)), safe_sqrt(inner(turning, turning))
    way = jnp.stack([abs(depths), speeds[0]])
    reach = step.length * jnp.stack([abs(rates), speeds[1]])
    near = (step.shares > 0) & (way < NEAR * reach)
    left = jnp.where(near, safe_divide(way, reach), jnp.inf)
    late = [safe_divide(deeper, rates), safe_divide(inner(aside, turning), inner(turning, turning))]
    nearest = near & (left == jnp.min(left))
    count = jnp.sum(jnp.where(nearest, 1.0, 0.0))
    return -safe_divide(jnp.sum(jnp.where(nearest, jnp.stack(late), 0.0)), count)


def _behind(model: Motion, numbers: tuple, tangents: tuple) -> tuple:
    """The derivatives of (state, slopes, growth, events) at the end of a step."""
    step, (time, y), *_, events, _ = numbers
    (way, *_), (time_way, _), slopes, shift, *known = tangents
    arrays, before = step.arrays, step.shares
    here = arrays, time, y
    after = closed(model.contacts(*here))

    def behind(known):
        state, slopes, growth, told = known
        state = state - moved(shift) * model.rates(arrays, before, time, y)
        ways = way, time_way, state
        state, *moves = passed(model, here, ways, (before, after))
        grown = _grown(growth, jnp.max(jnp.where(after > before, abs(moves[0]), 0.0)))
        slopes = _slopes(model, after, here, (way, time_way, state), slopes)
        return state, slopes, grown, _told(told, events, before != after, moves)

    wanted = jnp.any((before > 0) | (before != after))
    state, growth, told, error = jax.tree.map(moved, tuple(known))
    growth = _with_error(model.layout, step.length, state, growth, error)
    return where_wanted(wanted, behind, (state, jax.tree.map(moved, slopes), growth, told))


class Passed(NamedTuple):
    """Derivatives behind touches and releases at a fixed time: of the state; of every contact by
    how much later it touches or parts [s], and its rate there [m/s]."""

    state: Any
    late: Any
    speeds: Any


def passed(model: Motion, here: tuple, ways: tuple, acting: tuple) -> Passed:
    """Behind an instant at which contacts that act by these shares, (before, after), touch and
    part; `here`: (arrays, time, state), `ways`: their derivatives before it."""
    (arrays, time, y), (before, after), state = here, acting, ways[2]
    flow, now = model.rates(arrays, before, time, y), model.contacts(*here)
    ahead = pushed(model.contacts, here, ways)[1]
    late = jnp.where(before != after, -safe_divide(ahead.depths, now.rates), 0.0)
    rate = lambda shares: model.rates(arrays, shares, time, y)
    state = state + jax.jvp(rate, (before,), ((before - after) * late,))[1]
    along = lambda time, y: model.contacts(arrays, time, y).rates
    gain = jax.jvp(along, (time, y), (jnp.ones_like(time), flow))[1]
    speeds = ahead.rates + gain * late
    state = with_impact_speeds(model.layout, state, after > before, speeds)
    return Passed(state, late, speeds)


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


def _with_error(layout: Layout, length: Scalar, state: Any, growth: Array, error: Any) -> Array:
    """The growth after a step of this length [s] with such an error of its state: of their places,
    and of the way that their speeds make in such a step."""
    n, m = layout.coordinates, layout.memory_start

    def size(numbers):
        way = jnp.concatenate([numbers[:n], length * numbers[n:m]])
        return jnp.max(abs(way), initial=0.0)

    share = safe_divide(size(error), size(state))
    return jnp.stack([growth[0], growth[1], growth[2], jnp.maximum(growth[3], share)])


def _grown(growth: Array, late: Scalar) -> Array:
    """After touches of which one comes that much later (0: none does)."""
    met, first, most = growth[0], growth[1], growth[2]
    met = met + jnp.where(late > 0, 1.0, 0.0)
    first = jnp.where(met <= FIRST, jnp.maximum(first, late), first)
    return jnp.concatenate([jnp.stack([met, first, jnp.maximum(most, late)]), growth[3:]])


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
