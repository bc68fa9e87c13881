r"""The speed with which a contact closes: taken at the touch itself, held while the contact lasts.

Laws that divide by the impact speed :math:`\dot\delta^{(-)}` ask for the approach speed at first
touch. No rate of a state tells it without a lag, so steps take it: a step sees indentation and rate
at both its ends, and where it begins apart and ends in contact, the speed at the crossing follows
from both. A contact that parts forgets, and the next touch is a new impact. Between a touch and the
end of the step in which it falls the law takes the rate of the moment for the impact speed: at
first they are the same.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar

PerContact = Float[Array, " contacts"]
# The least speed that is remembered [m/s]: 0 says that the contact is apart.
LEAST_SPEED = 1e-30


class ContactMotion(NamedTuple):
    """Indentation [m] and its rate [m/s] of every possible contact at an instant."""

    depths: PerContact
    rates: PerContact


def remembered(
    speed: PerContact, before: ContactMotion, after: ContactMotion, length: Scalar
) -> PerContact:
    """Impact speeds [m/s] at the end of a step of `length` [s] from those at its start: 0 where
    apart, of a contact that has closed the approach speed at its touch, of others as they were.
    """
    touched = jnp.where(speed > 0, speed, at_touch(before, after, length))
    return jnp.where(after.depths < 0, 0.0, touched)


def at_touch(before: ContactMotion, after: ContactMotion, length: Scalar) -> PerContact:
    r"""Speed [m/s] > 0 with which an indentation passes through 0 in a step of `length` [s].

    The square of a rate is linear in the place where the acceleration is constant; what
    :math:`\delta_1 - \delta_0` departs from the trapezoidal rule by tells the next term. Exact to
    the third power of the step, as is the slope of Hermite's cubic, without a root to find. Where
    the rate changes its sign (the journal has turned, or passed the middle of its bearing, where
    the normal turns) the first term alone. Where the indentation does not pass through 0 the speed
    of the nearer end.
    """
    way = after.depths - before.depths
    share = jnp.clip(safe_divide(-before.depths, way), 0.0, 1.0)
    early, late = before.rates * before.rates, after.rates * after.rates
    mean = (1.0 / length) * way
    curved = 12 * mean * (mean - 0.5 * (before.rates + after.rates)) * share * (1 - share)
    curved = jnp.where(before.rates > 0, curved, 0.0)
    return jnp.maximum(safe_sqrt(early + share * (late - early) + curved), LEAST_SPEED)


def turns_beyond(
    before: ContactMotion, after: ContactMotion, length: Scalar, least: Scalar
) -> Bool[Array, " contacts"]:
    """Whether an indentation with one sign at both ends of a step has had the other between, by
    more than `least` [m]: a touch or a parting that no end of a step has seen.

    The way to the turning point from either end is that of a constant acceleration.
    """
    turned = before.rates * after.rates < 0
    swing = 0.5 * length * safe_divide(1.0, jnp.abs(before.rates) + jnp.abs(after.rates))
    first = before.depths + swing * before.rates * jnp.abs(before.rates)
    second = after.depths - swing * after.rates * jnp.abs(after.rates)
    rising = before.rates > 0
    touched = (jnp.maximum(first, second) > least) & rising
    parted = (jnp.minimum(first, second) < -least) & ~rising
    apart, closed = (
        (before.depths < 0) & (after.depths < 0),
        (before.depths >= 0) & (after.depths >= 0),
    )
    return turned & ((apart & touched) | (closed & parted))


class Flight(NamedTuple):
    """A contact over an implicit step: its indentation [m] at the start and in the middle to which
    the start's speeds lead, and there the rate [m/s] of the start's speeds and what half a step
    without contact adds to it."""

    depth: Scalar
    middle: Scalar
    approach: Scalar
    gain: Scalar


def taken_in_flight(speed: Scalar, flight: Flight, length: Scalar) -> Scalar:
    """Impact speed [m/s] for an implicit step of `length` [s]: as it was in contact; of a contact
    that is apart, the speed with which it would touch within the step unhindered.

    From the rate in the middle with the acceleration along the normal: that of the speeds, and that
    by which the path in between is curved.
    """
    depth, middle, approach, gain = flight
    mean = approach + gain
    share = jnp.clip(safe_divide(-depth, length * mean), 0.0, 1.0)
    curved = 4 * (depth - middle + 0.5 * length * approach) / length
    touch = mean + (2 * share - 1) * (gain + curved)
    return jnp.where(depth < 0, jnp.maximum(touch, LEAST_SPEED), speed)
