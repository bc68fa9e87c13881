r"""A servo: a controller of position and the torque that it asks of its motor.

Everything is told on the side of the joint, in its coordinate: gains, limit, feedforward. A motor
behind a gear of ratio i gets 1/i of the torque, and its encoder is read as its angle by i.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.components.function_of_time import (
    check_function_of_time,
    number_or_function,
    value_at,
)
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity


class Command(NamedTuple):
    """What a controller asks for: a `torque` [N m, N], and the `rate` of its integral [rad, m]."""

    torque: Any
    rate: Any


def reference_at(reference: Any, time: Any) -> tuple[Any, Any]:
    """Where a number or a function of time [s] wants to be, and how fast."""
    if not callable(reference):
        return reference, 0
    time = jnp.asarray(time, float)
    number = lambda at: jnp.asarray(reference(at), float)
    return jax.jvp(number, (time,), (jnp.ones_like(time),))


def commanded(servo: Any, time: Any, position: Any, speed: Any, integral: Any) -> Command:
    """What the controller of a `servo` asks for where its encoder reads a position and a speed."""
    wanted, rate = reference_at(servo.reference, time)
    error = wanted - position
    torque = servo.kp * error
    if servo.kd is not None:
        torque = torque + servo.kd * (rate - speed)
    if servo.ki is not None:
        torque = torque + servo.ki * integral
    if servo.feedforward is not None:
        torque = torque + value_at(servo.feedforward, time)
    if servo.torque_limit is None:
        return Command(torque, error)
    limited = jnp.clip(torque, -servo.torque_limit, servo.torque_limit)
    winding = (limited != torque) & (error * torque > 0)
    return Command(limited, jnp.where(winding, 0.0, error))
