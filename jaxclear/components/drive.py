"""Prescribed motions of one coordinate. A driven coordinate is a function of time and leaves the
equations of motion.

A drive returns position, speed and acceleration at a time: `motion(time) -> (q, dq/dt, d2q/dt2)`,
in rad or m.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.function_of_time import (
    AbstractFunctionOfTime,
    check_function_of_time,
    opened,
)
from jaxclear.ground.argument_errors import defined_names, nothing_else
from jaxclear.ground.numerics import smooth_step
from jaxclear.ground.quantity import AbstractQuantified, Scalar, count, quantity


class AbstractDrive(AbstractQuantified):
    """A coordinate as a function of time [s]: an angle [rad] or a displacement [m]."""

    @abstractmethod
    def motion(self, time: Scalar) -> tuple[Any, Any, Any]:
        """The prescribed motion at an instant.

        Args:
            time: time [s].

        Returns:
            position [rad; m for a sliding joint], speed and acceleration [per s, per s^2], a tuple.
        """


class ConstantSpeed(AbstractDrive):
    """A constant speed from time zero on: q = start + speed t.

    Args:
        speed: constant speed [rad/s; m/s for a sliding joint].
        start: position at time zero [rad; m for a sliding joint].
    """

    speed: Scalar = quantity(unit="rad/s", sliding="m/s")
    start: Scalar = quantity(0.0, "rad", sliding="m")

    def motion(self, time: Scalar) -> tuple[Any, Any, Any]:
        return self.start + self.speed * time, self.speed, 0


class ConstantPosition(AbstractDrive):
    """A coordinate that does not move: q = position.

    Args:
        position: the coordinate [rad; m for a sliding joint].
    """

    position: Scalar = quantity(unit="rad", sliding="m")

    def motion(self, time: Scalar) -> tuple[Any, Any, Any]:
        return self.position, 0, 0


class Harmonic(AbstractDrive):
    """q = offset + amplitude sin(2 pi frequency t + phase).

    Args:
        amplitude: amplitude [rad; m for a sliding joint].
        frequency: frequency [Hz], >= 0.
        phase: phase at time zero [rad].
        offset: mean position [rad; m for a sliding joint].
    """

    amplitude: Scalar = quantity(unit="rad", sliding="m")
    frequency: Scalar = quantity(unit="Hz", at_least=0)
    phase: Scalar = quantity(0.0, "rad")
    offset: Scalar = quantity(0.0, "rad", sliding="m")

    def motion(self, time: Scalar) -> tuple[Any, Any, Any]:
        omega = 2 * jnp.pi * self.frequency
        sine = self.amplitude * jnp.sin(omega * time + self.phase)
        cosine = self.amplitude * jnp.cos(omega * time + self.phase)
        return self.offset + sine, omega * cosine, -omega * omega * sine


class RampUp(AbstractDrive):
    """A speed that grows from 0 to a constant along a cubic step in time; `ConstantSpeed` has no
    ramp.

    Args:
        speed: final speed [rad/s; m/s for a sliding joint].
        duration: time until the final speed is reached [s], > 0.
        start: position at time zero [rad; m for a sliding joint].
    """

    speed: Scalar = quantity(unit="rad/s", sliding="m/s")
    duration: Scalar = quantity(unit="s", above=0)
    start: Scalar = quantity(0.0, "rad", sliding="m")

    def motion(self, time: Scalar) -> tuple[Any, Any, Any]:
        s = jnp.clip(time / self.duration, 0.0, 1.0)
        position = self.duration * (s**3 - 0.5 * s**4) + jnp.maximum(time - self.duration, 0.0)
        return (
            self.start + self.speed * position,
            self.speed * smooth_step(time, 0.0, self.duration),
            self.speed * 6.0 * s * (1.0 - s) / self.duration,
        )


class Position(AbstractDrive):
    """A position as a function of time: q = function(t).

    Args:
        function: JAX function (or module with numbers of its own) of a time [s], twice
            differentiable, that returns the position [rad; m for a sliding joint]; or a
            `TimeTable`.

    Raises:
        ValueError: if the function fails at a time, returns something else, or is a table whose
            speed jumps.
    """

    function: Callable = eqx.field(converter=opened)

    def __check_init__(self):
        check_function_of_time(self, "function")
        if isinstance(self.function, AbstractFunctionOfTime):
            self.function.check_motion()

    def motion(self, time: Scalar) -> tuple[Any, Any, Any]:
        def rate(at):
            return jax.jvp(_with_array_value(self.function), (at,), (jnp.ones_like(at),))

        time = jnp.asarray(time, float)
        (position, speed), (_, acceleration) = jax.jvp(rate, (time,), (jnp.ones_like(time),))
        return position, speed, acceleration


class Speed(AbstractDrive):
    """A speed as a function of time; the position is its integral from time zero.

    The integral is taken by Gauss-Legendre quadrature over [0, t], so that the drive stays a pure
    function of time; error below 1e-12 relative where the speed is smooth on the scale t / pieces.
    That of a `TimeTable` is exact.

    Args:
        function: JAX function of a time [s] that returns the speed [rad/s; m/s for a sliding
            joint]; or a `TimeTable`.
        start: position at time zero [rad; m for a sliding joint].
        pieces: pieces of the quadrature, a count, >= 1.
    """

    function: Callable = eqx.field(converter=opened)
    start: Scalar = quantity(0.0, "rad", sliding="m")
    pieces: int = count(16)

    def __check_init__(self):
        check_function_of_time(self, "function")

    def motion(self, time: Scalar) -> tuple[Any, Any, Any]:
        function = _with_array_value(self.function)
        time = jnp.asarray(time, float)
        speed, acceleration = jax.jvp(function, (time,), (jnp.ones_like(time),))
        source: Any = self.function
        exact = source.integral(time) if isinstance(source, AbstractFunctionOfTime) else None
        travelled = self._integrate_speed(time, function) if exact is None else exact
        return self.start + travelled, speed, acceleration

    def _integrate_speed(self, time: Scalar, function: Callable) -> Any:
        """The integral by quadrature."""
        nodes, weights = np.polynomial.legendre.leggauss(8)
        edges = np.arange(self.pieces)[:, None]
        shares = ((edges + 0.5 * (nodes + 1.0)) / self.pieces).ravel()
        weights = np.tile(0.5 * weights / self.pieces, self.pieces)
        return time * jnp.sum(jnp.asarray(weights) * jax.vmap(function)(time * jnp.asarray(shares)))


def _with_array_value(function: Callable) -> Callable[[Scalar], Scalar]:
    """The function of time with its value as an array: one that is constant may return 3.0."""
    return lambda time: jnp.asarray(function(time), float)


__all__ = defined_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.drive", __all__)
