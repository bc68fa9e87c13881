r"""A servo: a controller of position, and the torque that it asks of its motor.

Everything is told on the side of the joint, in its coordinate: gains, limit, feedforward. A motor
behind a gear of ratio i is given 1/i of the torque, and its encoder tells its angle by i.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.components.function_of_time import (
    check_function_of_time,
    number_or_function,
    value_at,
)
from jaxclear.components.load_base import AbstractStateLoad, CoordinateEffect, LoadState, MotorEnd
from jaxclear.ground.arguments import check_name
from jaxclear.ground.outcome import Unknown
from jaxclear.ground.quantity import Scalar, count, quantity
from jaxclear.ground.tangents import derived, moved

ENCODERS = ("motor", "load")


class Servo(AbstractStateLoad):
    r"""A controller that brings the coordinate q of a joint to a reference r.

    .. math:: \tau = k_p e + k_i \int e\,dt + k_d \dot e + \tau_0(t), \qquad e = r - q,

    on the motor of the joint where a coupling drives it by one that twists or has play, and on the
    joint itself elsewhere. The integral stands still while the torque is at its limit and the error
    drives it further (conditional integration), so that it does not wind up. Derivatives of runs
    that have been there are nan, except with a `period`.

    With a `period` T it is a digital controller: it samples the joint at 0, T, 2 T ..., gives a
    torque that is constant from one instant to the next, and sums errors by the rectangle rule.
    Steps end at its instants.

    Args:
        joint: name of the joint.
        reference: wanted coordinate [rad; m for a sliding joint], a number or a function of time
            [s].
        kp: gain k_p of the error [N m/rad; N/m for a sliding joint], >= 0.
        ki: gain k_i of its integral [N m/rad/s; N/m/s for a sliding joint], >= 0; none by default.
        kd: gain k_d of its rate [N m s/rad; N s/m for a sliding joint], >= 0; none by default.
        encoder: where q is read, a text: "motor", as the motor's angle by the ratio (what lies
            between is not seen), or "load", the joint; None: at the motor where there is one.
        torque_limit: largest torque to both sides, at the joint [N m; N for a sliding joint], > 0;
            no limit by default.
        feedforward: torque that is added [N m; N for a sliding joint], a number or a function of
            time [s]; none by default.
        period: sampling period [s], > 0; None: a continuous controller.
        delay: sampling periods from reading to acting, a count, >= 0; needs a period.

    Raises:
        ValueError: for an unknown encoder, or for a delay without a period.

    Source: Åström & Hägglund 2006, Advanced PID Control, chapter 3 ("Integrator windup");
    Franklin, Powell & Workman 1998, Digital Control of Dynamic Systems, 3rd ed., chapter 3.
    """

    joint: str = eqx.field(static=True)
    reference: Scalar | Callable = quantity(unit="rad", sliding="m", converter=number_or_function)
    kp: Scalar = quantity(unit="N m/rad", sliding="N/m", at_least=0)
    ki: Scalar | None = quantity(None, "N m/rad/s", sliding="N/m/s", at_least=0, kw_only=True)
    kd: Scalar | None = quantity(None, "N m s/rad", sliding="N s/m", at_least=0, kw_only=True)
    encoder: str | None = eqx.field(static=True, default=None, kw_only=True)
    torque_limit: Scalar | None = quantity(None, "N m", sliding="N", above=0, kw_only=True)
    feedforward: Scalar | Callable | None = quantity(
        None, "N m", sliding="N", converter=number_or_function, kw_only=True
    )
    period: Scalar | None = quantity(None, "s", above=0, kw_only=True)
    delay: int = count(0, at_least=0, kw_only=True)

    def __check_init__(self):
        check_function_of_time(self, "reference")
        check_function_of_time(self, "feedforward")
        if self.encoder is not None:
            check_name("encoder of a Servo", self.encoder, ENCODERS)
        if self.delay and self.period is None:
            raise ValueError(
                "load.Servo has a delay without a period; it is counted in periods: give one."
            )

    def coordinates(self):
        return (self.joint,)

    def states(self):
        integral = () if self.ki is None else (LoadState("integral", "rad s"),)
        if self.period is None:
            return integral
        queue = (f"torque{i}" for i in range(self.delay + 1))
        return integral + tuple(LoadState(name, "N m") for name in queue)

    def effect(self, time, positions, speeds, states):
        torque, rates = self.acting(time, positions[0], speeds[0], states)
        return CoordinateEffect((torque,), rates, 0, 0, torque * speeds[0])

    def sampled_every(self):
        return self.period

    def sampled(self, time, positions, speeds, states):
        torque, error = self._torque_and_integral_rate(time, positions[0], speeds[0], states)
        integral = () if self.ki is None else (states[0] + self.period * error,)
        return (*integral, *states[len(integral) :][1:], torque)

    def motor_of(self):
        return self.joint

    def needs_motor(self):
        return self.encoder == "motor"

    def behind(self, motors):
        end = motors.get(self.joint)
        return self if end is None else _ServoOnMotor(self, end)

    def acting(self, time: Scalar, position: Any, speed: Any, states: tuple) -> tuple[Any, tuple]:
        """Torque and rates of the states at an instant.

        Args:
            time: time [s].
            position: coordinate that the encoder reads [rad; m for a sliding joint].
            speed: its speed [rad/s; m/s for a sliding joint].
            states: values of the states, a tuple.

        Returns:
            torque at the joint [N m; N for a sliding joint], and the rates of the states, a tuple.
        """
        if self.period is not None:
            return states[len(states) - 1 - self.delay], (0.0,) * len(states)
        torque, error = self._torque_and_integral_rate(time, position, speed, states)
        return torque, () if self.ki is None else (error,)

    def _torque_and_integral_rate(self, time, position, speed, states):
        """The torque [N m] that the controller asks for, and the rate of its integral [rad]."""
        target, rate = _reference_motion(self.reference, time)
        error = target - position
        torque = self.kp * error
        if self.kd is not None:
            torque = torque + self.kd * (rate - speed)
        if self.ki is not None:
            torque = torque + self.ki * states[0]
        if self.feedforward is not None:
            torque = torque + value_at(self.feedforward, time)
        if self.torque_limit is None:
            return torque, error
        limited = jnp.clip(torque, -self.torque_limit, self.torque_limit)
        winding = (limited != torque) & (error * torque > 0)
        still = jnp.zeros_like(error) if self.period is not None else _standing(error, torque)
        return limited, jnp.where(winding, still, error)


class _ServoOnMotor(AbstractStateLoad):
    """A `servo` on the motor behind its joint: what it becomes in a mechanism that has one."""

    servo: Servo
    end: MotorEnd

    def coordinates(self):
        end = (self.end.coordinate,)
        return (self.servo.joint, *end) if self.servo.encoder == "load" else end

    def states(self):
        return self.servo.states()

    def effect(self, time, positions, speeds, states):
        torque, rates = self.servo.acting(time, *self._read_encoder(positions, speeds), states)
        force = torque / self.end.ratio
        others = (0,) * (len(positions) - 1)
        return CoordinateEffect((*others, force), rates, 0, 0, force * speeds[-1])

    def sampled_every(self):
        return self.servo.period

    def sampled(self, time, positions, speeds, states):
        position, speed = self._read_encoder(positions, speeds)
        return self.servo.sampled(time, (position,), (speed,), states)

    def _read_encoder(self, positions: tuple, speeds: tuple) -> tuple[Any, Any]:
        """What the encoder tells of the joint."""
        if self.servo.encoder == "load":
            return positions[0], speeds[0]
        offset = 0 if self.end.offset is None else self.end.offset
        return (positions[0] - offset) / self.end.ratio, speeds[0] / self.end.ratio


def _nan_derivative(numbers: tuple, tangents: tuple) -> Any:
    """The derivative of a rate that has changed at once, at an instant which moves with a torque:
    it knows nothing of that."""
    return jnp.where(moved(tangents[1]) != 0, Unknown.AT_LIMIT.number, 0.0)


# The rate of an integral (of the kind of an error) where the torque asked for is at its limit.
_standing = derived(lambda error, torque: jnp.zeros_like(error), _nan_derivative)


def _reference_motion(reference: Any, time: Any) -> tuple[Any, Any]:
    """Where a number or a function of time [s] wants to be, and how fast."""
    if not callable(reference):
        return reference, 0
    time = jnp.asarray(time, float)
    number = lambda at: jnp.asarray(reference(at), float)
    return jax.jvp(number, (time,), (jnp.ones_like(time),))
