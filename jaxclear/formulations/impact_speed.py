r"""The speed with which a contact closes: taken at the touch itself, held while the contact lasts.

Laws that divide by the impact speed :math:`\dot\delta^{(-)}` ask for the approach speed at first
touch. No rate of a state tells it without a lag, so steps take it: a step sees indentation and rate
at both its ends, and where it begins apart and ends in contact, the speed at the crossing follows
from both. A contact that parts forgets, and the next touch is a new impact. Between a touch and the
end of the step in which it falls the law takes the rate of the moment for the impact speed: at
first they are the same.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model, State
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, constant
from jaxclear.ground.tangents import apply_if, derived, moved, moving_with
from jaxclear.multibody.contact_point import slip_speed
from jaxclear.multibody.state import unpack_memories

PerContact = Float[Array, " contacts"]
# The least speed that is remembered [m/s]: 0 says that the contact is apart.
LEAST_SPEED = 1e-30
# Steps to a root of a cubic. Where one ends short of it, rounding decides whether a step that ends
# there is tried again: with four, runs were another at 1e-4 by the order of their arithmetic.
STEPS = 6


class ContactMotion(NamedTuple):
    """Indentation [m] and its rate [m/s] of every possible contact at an instant."""

    depths: PerContact
    rates: PerContact


def remembered(
    speed: PerContact, before: ContactMotion, after: ContactMotion, length: Scalar
) -> PerContact:
    """Impact speeds [m/s] at the end of a step.

    They are 0 where a contact is apart, the approach speed at the touch where it has closed, and
    unchanged elsewhere.

    Args:
        speed: at its start [m/s].
        before, after: motion of the contacts at its start and end.
        length: of the step [s].
    """
    touched = jnp.where(speed > 0, speed, at_touch(before, after, length))
    return jnp.where(after.depths < 0, 0.0, touched)


def at_touch(before: ContactMotion, after: ContactMotion, length: Scalar) -> PerContact:
    r"""Speed [m/s] > 0 with which an indentation passes through 0 in a step.

    The square of a rate is linear in the place where the acceleration is constant; what
    :math:`\delta_1 - \delta_0` departs from the trapezoidal rule by tells the next term. Exact to
    the third power of the step, as is the slope of Hermite's cubic, without a root to find. Where
    the rate changes its sign (the journal has turned, or passed the middle of its bearing, where
    the normal turns) the first term alone. Where the indentation does not pass through 0 the speed
    of the nearer end.

    Args:
        before, after: motion of the contacts at the start and end of the step.
        length: of the step [s].
    """
    direction = after.depths - before.depths
    share = jnp.clip(safe_divide(-before.depths, direction), 0.0, 1.0)
    early, late = before.rates * before.rates, after.rates * after.rates
    mean = (1.0 / length) * direction
    # Of a tiny step the way is rounding beside the place, and its rates tell that it is straight.
    most = jnp.abs(after.rates - before.rates)
    remainder = jnp.clip(mean - 0.5 * (before.rates + after.rates), -most, most)
    curved = 12 * mean * remainder * share * (1 - share)
    curved = jnp.where(before.rates > 0, curved, 0.0)
    return jnp.maximum(safe_sqrt(early + share * (late - early) + curved), LEAST_SPEED)


def cubic(path: tuple, share: Array) -> tuple[Array, Array]:
    """Hermite's cubic through an indentation and its slope at both ends of a step, `path` (first,
    last, slope at the first, at the last, by the share of the step), and its slope there."""
    first, _, leaving, _ = path
    bend, twist = _cubic_coefficients(path)
    return (
        first + share * (leaving + share * (bend + share * twist)),
        leaving + share * (2 * bend + 3 * share * twist),
    )


def bends(path: tuple) -> tuple[Array, Array]:
    """The cubic's second derivatives, by the share of the step, at both its ends."""
    bend, twist = _cubic_coefficients(path)
    return 2 * bend, 2 * bend + 6 * twist


def _cubic_coefficients(path: tuple) -> tuple[Array, Array]:
    """The cubic's coefficients of the second and third power."""
    first, last, leaving, arriving = path
    direction = last - first
    return 3 * direction - 2 * leaving - arriving, leaving + arriving - 2 * direction


class Passage(NamedTuple):
    """The contacts at the beginning, halfway and at the end of a step."""

    before: ContactMotion
    middle: ContactMotion
    after: ContactMotion


def passage(path: tuple, level: Scalar, last: Array, target: Any = None) -> Array:
    """Share of a step at which a cubic passes a level, by bracketed Newton steps.

    Args:
        path: Hermite's cubic of each contact: values and scaled slopes at the ends [m].
        level: that is passed [m].
        last: share at which the cubic is on the other side of it than at the start [1].
        target: whether anything is searched for; None: always, with derivatives in reverse mode
            too.
    """
    low, high = jnp.zeros_like(last), last
    first, there = path[0] - level, cubic(path, last)[0] - level
    share = jnp.clip(last * safe_divide(first, first - there), 0.0, last)

    def one(low, high, share):
        value, slope = cubic(path, share)
        early = (value >= level) == (first >= 0)
        low, high = jnp.where(early, share, low), jnp.where(early, high, share)
        newton = share - safe_divide(value - level, slope)
        inside = (newton >= low) & (newton <= high)
        return low, high, jnp.where(inside, newton, 0.5 * (low + high))

    out = low, high, share
    if target is None:
        for _ in range(STEPS):
            out = one(*out)
        return out[2]
    turns = jnp.where(target, STEPS, 0)
    turn = lambda carry: (carry[0] + 1, *one(*carry[1:]))
    return jax.lax.while_loop(lambda carry: carry[0] < turns, turn, (jnp.zeros((), int), *out))[3]


def with_path_derivative(path: tuple, share: Array) -> Array:
    """A share of the step at which the cubic passes 0, with its derivative by the path."""

    def late(numbers, tangents):
        (path, share), (directions, _) = numbers, jax.tree.map(moved, tangents)
        return -safe_divide(cubic(directions, share)[0], cubic(path, share)[1])

    return derived(lambda path, share: moving_with(path[1], share), late)(path, constant(share))


def end_at_passage(
    before: ContactMotion,
    middle: ContactMotion,
    after: ContactMotion,
    length: Scalar,
    beyond: Scalar,
    least: Scalar = 0.0,
) -> Scalar:
    """Share of a step at which it would have ended at the first touch or release in it; 1 if none.

    Signs of the rates at the ends do not indicate a touch between them: a journal that has touched,
    parted and passed the middle of its bearing comes nearer to the wall at both. So each half of
    the step is searched, with Hermite's cubic, which is exact for a path in free fall.

    Args:
        before, middle, after: motion of the contacts in the step.
        length: of the step [s].
        beyond: distance beyond the wall that counts as a passage [m].
        least: smallest time [s] between a passage and the step's end that counts; no share is
            shorter.
    """
    outwards = jnp.where(before.depths >= 0, -1.0, 1.0)

    def half(first, last):
        ends = (first.depths, last.depths, 0.5 * length * first.rates, 0.5 * length * last.rates)
        path = tuple(outwards * each for each in ends)
        share = summit(path)
        top = cubic(path, share)[0]
        higher = top > path[1]
        return path, jnp.where(higher, share, 1.0), jnp.where(higher, top, path[1]) > beyond

    (early, summit_early, soon), (late, summit_late, then) = (
        half(before, middle),
        half(middle, after),
    )
    path = tuple(jnp.where(soon, a, b) for a, b in zip(early, late, strict=True))
    last = jnp.where(soon, summit_early, summit_late)
    within = passage(path, 0.5 * beyond, last, jnp.any(soon | then))
    shares = jnp.maximum(0.5 * (within + jnp.where(soon, 0.0, 1.0)), safe_divide(least, length))
    report = (soon | then) & ((1 - shares) * length > least)
    return jnp.min(jnp.where(report, shares, 1.0), initial=1.0)


def summit(path: tuple) -> Array:
    """The share of the step at which the cubic is highest between its ends; an end, where it rises
    or falls all the way."""
    leaving = path[2]
    bend, twist = _cubic_coefficients(path)
    root = safe_sqrt(bend * bend - 3 * twist * leaving)
    # The root of the slope at which it falls, by that of two forms which does not cancel.
    falling = jnp.where(
        bend < 0, safe_divide(leaving, root - bend), -safe_divide(bend + root, 3 * twist)
    )
    return jnp.clip(falling, 0.0, 1.0)


def taken_in_flight(speed: Scalar, flight: tuple, length: Scalar) -> Scalar:
    """Impact speed [m/s] for an implicit step.

    In contact it is unchanged; of a contact that is apart it is the speed with which it would touch
    within the step unhindered: that in the middle, with the acceleration along the normal from the
    speeds and from the curvature of the path.

    Args:
        speed: at the start of the step [m/s].
        flight: indentation [m] at the start, and in the middle to which the start's speeds
            lead; its
            rate there [m/s], and what half a step without contact adds to it.
        length: of the step [s].
    """
    depth, middle, approach, gain = flight
    mean = approach + gain
    share = jnp.clip(safe_divide(-depth, length * mean), 0.0, 1.0)
    curved = 4 * (depth - middle + 0.5 * length * approach) / length
    touch = mean + (2 * share - 1) * (gain + curved)
    return jnp.where(depth < 0, jnp.maximum(touch, LEAST_SPEED), speed)


Stages = tuple[tuple[float, ...], tuple[float, ...]]


def has_bristles(model: Model) -> bool:
    """True where some contact has any."""
    return any(bristles for _, kinds in model.layout.memories for _, bristles in kinds)


def put_right(
    formulation: Any,
    model: Model,
    now: tuple[Any, State],
    motions: tuple[ContactMotion, ContactMotion],
    step: tuple[Any, Stages],
) -> State:
    """The state after a step, with deflections corrected for the time in contact.

    The correction is not differentiated: derivatives follow the motion, not the stages of a step.

    Args:
        formulation: whose slips move the deflections.
        model: of the run.
        now: time [s] and state at the end of the step.
        motions: of the contacts at its start and end.
        step: its length [s], and (nodes, weights) of its stages.
    """
    _, state = now
    model, now, (before, after), length = constant((model, now, motions, step[0]))
    changed = (before.depths < 0) != (after.depths < 0)

    def solve(_):
        nodes, weights = step[1]
        direction = after.depths - before.depths
        share = jnp.clip(safe_divide(-before.depths, direction), 0.0, 1.0)
        early = (jnp.asarray(nodes)[:, None] < share).astype(float)
        amiss = length * (share - jnp.asarray(weights) @ early)
        # Of a touch the time before it is apart, of a release it is in contact.
        amiss = jnp.where(changed, jnp.where(after.depths < 0, amiss, -amiss), 0.0)
        return _state_corrections(model, now[1], formulation.slips(model, *now), amiss)

    return state + apply_if(jnp.any(changed), solve, jnp.zeros_like(now[1]))


def _state_corrections(model: Model, state: State, slips: Any, amiss: Any) -> Any:
    """What entries of the state lack where each contact was closed for a time [s] longer."""
    entries, place, k = [0.0] * len(state), model.layout.memory_start, 0
    memories = unpack_memories(model.layout, model.entries(state))
    for name, kinds in model.layout.memories:
        laws = model.system.bearings[name].contact_laws
        for (remembers, count), law, memory in zip(kinds, laws, memories[name], strict=True):
            place += remembers
            if count:
                slip = tuple(slips[k, i] for i in range(count))
                closed, gap = (
                    law.friction.tractions(normal, memory.bristles, slip, slip_speed(slip))[1]
                    for normal in (1.0, 0.0)
                )
                for i in range(count):
                    entries[place + i] = amiss[k] * (closed[i] - gap[i])
            place, k = place + count, k + 1
    return jnp.stack([jnp.asarray(each, float) for each in entries])
