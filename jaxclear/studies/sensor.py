"""What a sensor sees of a run, `jaxclear.sensor`: the signal itself, without noise, at the saving
times; and what the instrument makes of it, in the order in which signals pass: low-pass, delay,
gain, sampling, noise, resolution.

Each number of an instrument is known, or a `jaxclear.Dimension` that is drawn for each run of a
sample. The second step needs no run: signals that are kept can be sensed anew.
"""

import dataclasses
from abc import abstractmethod
from typing import TYPE_CHECKING, Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.body import Marker
from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.quantity import Scalar, count, quantity
from jaxclear.multibody.topology import coordinate_units
from jaxclear.results.response import AbstractSignal, coordinate_unit
from jaxclear.studies.distribution.joint import marginals_of
from jaxclear.studies.function_problem import Dimension

__all__ = [
    "AbstractSensor",
    "Accelerometer",
    "Displacement",
    "Encoder",
    "ForceGauge",
    "Gyroscope",
    "Series",
]
__getattr__, __dir__ = nothing_else("jaxclear.sensor", __all__)

# A number that is known, or drawn anew for each run.
if TYPE_CHECKING:
    Drawn: TypeAlias = Any
else:
    Drawn = Scalar | Dimension

AXES = ("x", "y", "z")


def as_marker(where: Any) -> Any:
    """A marker; a body's name stands for its frame."""
    return Marker(where) if isinstance(where, str) else where


class AbstractSensor(AbstractSignal):
    """An instrument: called with a run it gives the ideal signal; `sensed` gives its reading.

    Its numbers are known, or a `jaxclear.Dimension` each, which is drawn for each run of a sample.
    A signal passes low-pass, delay, gain, sampling, noise and resolution, in this order.

    Args:
        noise: standard deviation of white noise, in the signal's unit, >= 0; 0 by default.
        bandwidth: cut-off frequency of the first-order low-pass [Hz], > 0; None (default) for none.
        gain: factor of the signal [1]; 1 by default.
        delay: time by which the signal lags [s], >= 0; 0 by default.
        sampling: own sampling rate, values held in between [Hz], > 0; None (default) for that of
            the record.
    """

    noise: Drawn = quantity(0.0, "(its unit)", at_least=0, kw_only=True)
    bandwidth: Drawn | None = quantity(None, "Hz", above=0, kw_only=True)
    gain: Drawn = quantity(1.0, "1", kw_only=True)
    delay: Drawn = quantity(0.0, "s", at_least=0, kw_only=True)
    sampling: Drawn | None = quantity(None, "Hz", above=0, kw_only=True)

    @abstractmethod
    def unit_in(self, mechanism: Any) -> str:
        """Unit of the signal.

        Args:
            mechanism: the `Mechanism` whose runs are read.

        Returns:
            The unit as text.
        """

    def ideal(self) -> "AbstractSensor":
        """The same sensor without noise, low-pass, delay and sampling, and with a gain of 1."""
        nothing = {"noise": 0.0, "bandwidth": None, "gain": 1.0, "delay": 0.0, "sampling": None}
        return dataclasses.replace(self, **nothing)

    def rounded(self, signals: np.ndarray) -> np.ndarray:
        """Signals in steps of the resolution, if the sensor has any.

        Args:
            signals: an array in the signal's unit.

        Returns:
            An array of the same shape.
        """
        return signals

    def sensed(self, signals: Any, rate: float, rng: np.random.Generator) -> np.ndarray:
        """Readings of the sensor.

        Args:
            signals: ideal signals in their unit, an array (runs, samples).
            rate: sampling rate [Hz], > 0.
            rng: random number generator, a `numpy.random.Generator`, for noise and numbers that are
                not known.

        Returns:
            Readings, shape (runs, samples).
        """
        readings = np.atleast_2d(np.asarray(signals, float))
        runs, samples = readings.shape
        draw = lambda value: _draw_number(value, runs, rng)
        cut = None if self.bandwidth is None else draw(self.bandwidth)
        readings = _filter_each(readings, rate, cut, draw(self.delay), draw(self.gain))
        if self.sampling is not None:
            every = rate / draw(self.sampling)[:, None]
            at = np.arange(samples)
            readings = _read_each(readings, np.where(every > 1, np.floor(at / every) * every, at))
        readings, noise = np.asarray(readings), draw(self.noise)
        if np.any(noise > 0):
            readings = readings + noise[:, None] * rng.standard_normal(readings.shape)
        return self.rounded(readings)


def _draw_number(value: Any, runs: int, rng: np.random.Generator) -> np.ndarray:
    """A number for each run."""
    if not isinstance(value, Dimension):
        return np.full(runs, float(value))
    shares, marginal = jnp.asarray(rng.random(runs)), marginals_of(value.distribution)[0]
    return np.asarray(value.nominal_in(None) + marginal.quantile(shares))


def filter_signal(signal: Array, rate: Scalar, bandwidth: Any, delay: Any, gain: Any) -> Array:
    """Reading of an instrument for a signal, without noise.

    Its first-order low-pass is exact for signals that are constant between samples, and starts
    settled.

    Args:
        signal: shape (n,).
        rate: of its samples [Hz].
        bandwidth: of the low-pass [Hz]; None: without.
        delay: of the reading [s].
        gain: factor of the reading [1].
    """
    if bandwidth is not None:
        decay = jnp.exp(-2 * jnp.pi * bandwidth / rate)

        def mixed(before, now):
            after = decay * before + (1 - decay) * now
            return after, after

        signal = jax.lax.scan(mixed, signal[0], signal)[1]
    return gain * _interpolate_signal(signal, jnp.arange(len(signal)) - delay * rate)


def _interpolate_signal(signal: Array, at: Array) -> Array:
    """A signal at fractions of its samples, along straight lines between these."""
    at = jnp.clip(at, 0, len(signal) - 1)
    first = jnp.floor(at).astype(int)
    share = at - first
    # Where a sample is met, its neighbour is not asked: it may not be finite.
    second = jnp.where(share > 0, first + 1, first)
    return (1 - share) * signal[first] + share * signal[second]


_filter_each = jax.jit(jax.vmap(filter_signal, (0, None, 0, 0, 0)))
_read_each = jax.jit(jax.vmap(_interpolate_signal))


class Accelerometer(AbstractSensor):
    """Specific force along an axis of a marker [m/s^2]: acceleration minus gravity.

    At rest it reads g upwards. Each sample is the mean since the sample before, from the velocities
    at both, so impacts between two samples count in full. For instants use
    `Trajectory.marker(...).specific_force`. Further arguments are those of `AbstractSensor`.

    Args:
        marker: a `Marker`, or the name of a body, whose frame it then is.
        axis: name of the marker's axis, "x" (default), "y" or "z".
    """

    marker: Marker = eqx.field(converter=as_marker)
    axis: str = eqx.field(static=True, default="x")

    def __check_init__(self):
        _check_axis(self)

    def unit_in(self, mechanism):
        return "m/s^2"

    def __call__(self, run):
        motion = run.marker(self.marker)
        change = jnp.diff(motion.velocity, axis=0) / jnp.diff(run.time)[:, None]
        along = motion.rotation[:, :, AXES.index(self.axis)]
        gravity = jnp.stack([jnp.asarray(x, float) for x in run.history.model().system.gravity])
        felt = jnp.sum((change - gravity) * 0.5 * (along[1:] + along[:-1]), axis=1)
        return jnp.concatenate([felt[:1], felt])


class Gyroscope(AbstractSensor):
    """Angular velocity about an axis of a marker [rad/s].

    Further arguments are those of `AbstractSensor`.

    Args:
        marker: a `Marker`, or the name of a body, whose frame it then is.
        axis: name of the marker's axis, "x", "y" or "z" (default).
    """

    marker: Marker = eqx.field(converter=as_marker)
    axis: str = eqx.field(static=True, default="z")

    def __check_init__(self):
        _check_axis(self)

    def unit_in(self, mechanism):
        return "rad/s"

    def __call__(self, run):
        motion = run.marker(self.marker)
        along = motion.rotation[:, :, AXES.index(self.axis)]
        return jnp.sum(motion.body.spin * along, axis=1)


class Displacement(AbstractSensor):
    """Position of a marker along an axis of the ground [m].

    Further arguments are those of `AbstractSensor`.

    Args:
        marker: a `Marker`, or the name of a body, whose frame it then is.
        axis: name of the ground's axis, "x" (default), "y" or "z".
    """

    marker: Marker = eqx.field(converter=as_marker)
    axis: str = eqx.field(static=True, default="x")

    def __check_init__(self):
        _check_axis(self)

    def unit_in(self, mechanism):
        return "m"

    def __call__(self, run):
        return run.marker(self.marker).position[:, AXES.index(self.axis)]


class ForceGauge(AbstractSensor):
    """Force in a joint on its child along an axis of the ground [N], at the saving times.

    Further arguments are those of `AbstractSensor`.

    Args:
        joint: name of the joint; with `axis=""` of a coupling or driven joint.
        axis: name of the ground's axis, "x" (default), "y" or "z"; "" for what a coupling or driven
            joint transmits [N, N m].
    """

    joint: str = eqx.field(static=True)
    axis: str = eqx.field(static=True, default="x")

    def __check_init__(self):
        if self.axis:
            _check_axis(self)

    def unit_in(self, mechanism):
        return "N"

    def __call__(self, run):
        if not self.axis:
            return run.transmitted(self.joint)
        return run.reaction(self.joint).force[:, AXES.index(self.axis)]


class Encoder(AbstractSensor):
    """Coordinate of a joint [rad, m].

    Further arguments are those of `AbstractSensor`.

    Args:
        joint: name of the joint.
        index: number of the coordinate, >= 0; 0 by default.
        resolution: step of the reading, in the coordinate's unit [rad, m], > 0; None (default) for
            none.
    """

    joint: str = eqx.field(static=True)
    index: int = count(0, at_least=0)
    resolution: Scalar | None = quantity(None, "(its unit)", above=0, kw_only=True)

    def unit_in(self, mechanism):
        return coordinate_unit(mechanism, self.joint, self.index)

    def rounded(self, signals):
        if self.resolution is None:
            return signals
        step = float(self.resolution)
        return step * np.round(signals / step)

    def __call__(self, run):
        angle: Float[Array, "time ..."] = run.coordinate(self.joint)
        return angle if angle.ndim == 1 else angle[:, self.index]


class Series(AbstractSensor):
    """A series that the function of a `jaxclear.FunctionProblem` returns, in its own unit.

    Further arguments are those of `AbstractSensor`.

    Args:
        name: name of the series.
        is_input: whether it is an input of the machine, such as the motion of a drive, used by
            functions that make a problem of a record and not compared; False by default.
    """

    name: str = eqx.field(static=True)
    is_input: bool = eqx.field(static=True, default=False)

    def unit_in(self, mechanism):
        return "1"

    def __call__(self, run):
        return run[self.name]


def _check_axis(sensor: Any) -> None:
    check_name("axis", sensor.axis, AXES, f" of sensor.{type(sensor).__name__}")


def check_sensor(name: str, sensor: Any, mechanism: Any) -> None:
    """Raises `ValueError` for a signal without a sensor, or one of what the mechanism lacks.

    Args:
        name: of the signal.
        sensor: to be checked.
        mechanism: with bodies and joints.
    """
    expected = 'one of jaxclear.sensor, such as Accelerometer("slider", axis="x")'
    expect(sensor, AbstractSensor, f'the sensor of signal "{name}"', expected)
    if isinstance(sensor, Series):
        raise ValueError(
            f'signal "{name}" has a Series as its sensor, which is of a FunctionProblem; of a '
            f"mechanism it must be {expected}."
        )
    if isinstance(sensor, Encoder):
        coordinate_units(mechanism, sensor.joint)
    elif isinstance(sensor, ForceGauge):
        names = [*mechanism.connections, *mechanism.couplings]
        check_name("joint", sensor.joint, names, f' for the sensor of signal "{name}"')
    else:
        bodies = list(mechanism.bodies)
        check_name("body", sensor.marker.body, bodies, f' for the sensor of signal "{name}"')
