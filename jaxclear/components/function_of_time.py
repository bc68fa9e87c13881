r"""What a load or a drive asks of a function of time: it takes a time [s], traced by JAX, and
returns so many numbers. Looked at once, when the load or drive is built.

A function of time as a table: pieces of polynomials through given numbers.

Between two times :math:`t_i` it is :math:`\sum_k c_k (t - t_i)^k`, with coefficients of scipy's
interpolators, worked out once when the table is built.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_name
from jaxclear.ground.columns import columns_of
from jaxclear.ground.quantity import (
    AbstractQuantified,
    Scalar,
    as_number,
    as_vector,
    is_traced,
    quantity,
    with_numbers_alone,
)
from jaxclear.ground.warning import call_user, shape_of
from jaxclear.ground.wording import described, public_name


class AbstractFunctionOfTime(AbstractQuantified):
    """A function of time [s] that is defined by numbers, so that a file can hold it."""

    @abstractmethod
    def __call__(self, time: Scalar) -> Any:
        """Its value, or several, at a time [s]."""

    def integral(self, time: Scalar) -> Any:
        """Integral of the function from 0 to a time.

        Args:
            time: time [s].

        Returns:
            the integral [unit of the function times s]; None, as unless overridden, where it is not
            available.
        """
        return None

    def knots(self, start: Scalar, most: int) -> Any:
        """Times at which one piece of it ends and the next begins; none unless overridden.

        Args:
            start: time from which they count where the pieces come again and again [s].
            most: largest number of them.

        Returns:
            the first of them [s], an array.
        """
        return jnp.zeros(0)

    def check_motion(self) -> None:
        """Raises `ValueError` with a sentence where it is no position of a drive because its speed
        jumps; nothing is refused unless overridden."""


def check_function_of_time(part: Any, field: str, counts: tuple[int, ...] = (1,)) -> None:
    """Raises `ValueError` for a function of time that fails or returns a wrong number of numbers.

    Args:
        part: load or drive that has the function.
        field: name of its field; a value that is no function passes.
        counts: allowed numbers of results.
    """
    function = getattr(part, field)
    if not callable(function):
        return
    number = " or ".join(map(str, counts))
    rule = f"must take a time [s] and return {number} number{'s' if counts != (1,) else ''}"
    owner = f"{public_name(type(part))} has {field} = {described(function)}"
    answers = lambda at: jax.tree.map(jnp.asarray, function(at))
    value = shape_of(
        lambda at: call_user(f"{owner}, which", answers, at, requirement=f"It {rule}."),
        jax.ShapeDtypeStruct((), jnp.float64),
    )
    shapes = [leaf.shape for leaf in jax.tree.leaves(value)]
    plain = all(shape == () for shape in shapes) or (len(shapes) == 1 and len(shapes[0]) == 1)
    alone = counts == (1,) and shapes != [()]
    if not plain or alone or sum(map(math.prod, shapes)) not in counts:
        returned = f"{len(shapes)} numbers" if plain and len(shapes) > 1 else str(shapes)
        raise ValueError(f"{owner}, which returns {returned}; it {rule}.")


class _Opened(eqx.Module):
    """A function of time whose numbers that are being traced are leaves of its own."""

    function: Callable

    def __call__(self, time: Scalar) -> Any:
        return self.function(jnp.asarray(time, float))


def opened(function: Callable) -> Callable:
    """A function of time; if it encloses numbers that are being traced, with these as leaves, so
    that batches and derivatives see them wherever it is handed to."""
    if isinstance(function, eqx.Module) or not is_traced(function):
        return function
    # By a function that encloses it: of others Equinox takes it that they hang on nothing.
    at = lambda time: function(time)
    try:
        closure = eqx.filter_closure_convert(at, jax.ShapeDtypeStruct((), jnp.float64))
        return _Opened(with_numbers_alone(closure))
    except Exception:
        # What fails is told of in a sentence (`check_function_of_time`).
        return function


def vector_or_function(value: Any) -> Any:
    """Several numbers, or the function that gives them."""
    return opened(value) if callable(value) else as_vector(value)


def one_or_more_or_function(value: Any) -> Any:
    """One number or several, or the function that gives them."""
    one = np.ndim(value) == 0 and not isinstance(value, (str, dict)) and value is not None
    return opened(value) if callable(value) else as_vector((value,) if one else value)


def number_or_function(value: Any) -> Any:
    """One number, or the function that gives it."""
    return opened(value) if callable(value) else as_number(value)


def value_at(value: Any, time: Any) -> Any:
    """A number, or what its function gives at a time [s]."""
    return value(time) if callable(value) else value


INTERPOLATIONS = ("cubic", "monotone", "linear")
BEYOND = ("held", "straight", "repeated")
# A speed [1/s of the largest value over the whole time] that counts as rest at an end.
REST = 1e-6


class TimeTable(AbstractFunctionOfTime):
    """A function of time through a table of numbers, for a drive or a load.

    Args:
        times: times [s], increasing, an array (n,) with n >= 2.
        values: values at these times [unit of what the table serves], an array (n,) or (n,
            columns).
        interpolation: "cubic" (a spline, two continuous derivatives), "monotone" (PCHIP: no
            overshoot, one continuous derivative) or "linear", a text.
        beyond: a text: before the first and after the last time the function is "held" there, goes
            "straight" on, or is "repeated".
        factor: factor of all values [1].
    """

    times: Float[Array, " n"]
    values: Float[Array, "n ..."]
    coefficients: Float[Array, "4 pieces ..."]
    areas: Float[Array, "n ..."]
    factor: Scalar = quantity(1.0, "1")
    interpolation: str = eqx.field(static=True, default="cubic")
    beyond: str = eqx.field(static=True, default="held")

    def __init__(
        self,
        times: Any,
        values: Any,
        interpolation: str = "cubic",
        *,
        beyond: str = "held",
        factor: Any = 1.0,
    ):
        check_name("interpolation of a TimeTable", interpolation, INTERPOLATIONS)
        check_name("way beyond a TimeTable", beyond, BEYOND)
        instants = _as_times(times)
        values = _check_values(values, instants, beyond)
        self.times, self.values, self.factor = jnp.asarray(instants), values, factor
        self.interpolation, self.beyond = interpolation, beyond
        self.coefficients = _fit_pieces(instants, values, interpolation, beyond)
        steps = _align_with_columns(np.diff(instants), values)
        gained = sum(c * steps ** (k + 1) / (k + 1) for k, c in enumerate(self.coefficients))
        self.areas = jnp.concatenate([jnp.zeros_like(values[:1]), jnp.cumsum(gained, axis=0)])

    @classmethod
    def sampled(
        cls,
        function: Callable[[Any], Any],
        times: Any,
        interpolation: str = "cubic",
        **further: Any,
    ) -> "TimeTable":
        """Make a table of a function of time, so that it becomes data.

        Args:
            function: function of a time [s] that returns a number or an array.
            times: times of the table [s], an array (n,).
            interpolation: as of `TimeTable`, a text.
            **further: `beyond` and `factor`, options of `TimeTable`.

        Returns:
            the table, a `TimeTable`.
        """
        at = jnp.asarray(_as_times(times))
        values = jax.vmap(lambda time: jnp.asarray(function(time), float))(at)
        return cls(at, values, interpolation, **further)

    @classmethod
    def from_csv(
        cls, path: Any, time: str, values: Any, interpolation: str = "cubic", **further: Any
    ) -> "TimeTable":
        """Read a table from columns of a CSV file whose first line has their names.

        Args:
            path: path of the file.
            time: name of the column of times [s].
            values: name of the column of values, or a list of names.
            interpolation: as of `TimeTable`, a text.
            **further: `beyond` and `factor`, options of `TimeTable`.

        Returns:
            the table, a `TimeTable`.

        Raises:
            ValueError: if the file or a column of it cannot be read.
        """
        names = [values] if isinstance(values, str) else list(values)
        columns = columns_of(path, [time, *names])
        values_read = np.stack(columns[1:], axis=-1) if not isinstance(values, str) else columns[1]
        return cls(columns[0], values_read, interpolation, **further)

    def __call__(self, time: Scalar) -> Any:
        time, periods, _ = self._time_in_table(time)
        index, s = self._find_piece(periods)
        a, b, c, d = (self.coefficients[k, index] for k in range(4))
        value = a + s * (b + s * (c + s * d))
        if self.beyond == "straight":
            value = value + (time - periods) * (b + s * (2 * c + 3 * s * d))
        return self.factor * value

    def integral(self, time):
        def area(at):
            at, periods, turns = self._time_in_table(at)
            index, s = self._find_piece(periods)
            a, b, c, d = (self.coefficients[k, index] for k in range(4))
            area = self.areas[index] + s * (a + s * (b / 2 + s * (c / 3 + s * d / 4)))
            if self.beyond == "repeated":
                return area + turns * self.areas[-1]
            past, end = at - periods, a + s * (b + s * (c + s * d))
            area = area + past * end
            if self.beyond == "held":
                return area
            return area + 0.5 * past * past * (b + s * (2 * c + 3 * s * d))

        return self.factor * (area(time) - area(0.0))

    def knots(self, start, most):
        if self.beyond != "repeated":
            return self.times[:most]
        first, period = self.times[0], self.times[-1] - self.times[0]
        turns = jnp.floor((start - first) / period) + np.arange(-(-most // len(self.times)))
        return jnp.ravel(self.times + period * turns[:, None])[:most]

    def check_motion(self):
        if self.interpolation == "linear":
            raise ValueError(
                'a drive is given a TimeTable that is "linear": its speed jumps at every time of '
                'the table; take interpolation="cubic" or "monotone".'
            )
        if self.beyond == "straight" or isinstance(self.coefficients, jax.core.Tracer):
            return
        scale = float(jnp.max(jnp.abs(self.values)) / (self.times[-1] - self.times[0]))
        first, last = (float(speed) for speed in self._end_rates())
        if self.beyond == "repeated" and abs(first - last) > REST * scale:
            raise ValueError(
                "a drive is given a TimeTable that is repeated, and its speeds at both ends "
                'differ; take interpolation="cubic", which makes them one.'
            )
        if self.beyond == "held" and max(abs(first), abs(last)) > REST * scale:
            raise ValueError(
                "a drive is given a TimeTable that is held beyond its ends, where it moves: its "
                'speed would jump. Take beyond="straight" or "repeated", or let the table end at '
                "rest."
            )

    def _end_rates(self) -> tuple[Any, Any]:
        """Rates at the first and the last time."""
        _, b, c, d = self.coefficients
        step = self.times[-1] - self.times[-2]
        return b[0], b[-1] + step * (2 * c[-1] + 3 * step * d[-1])

    def _time_in_table(self, time: Any) -> tuple[Any, Any, Any]:
        """A time, the one within the table that it is read at, and the whole turns between."""
        time = jnp.asarray(time, float)
        first, last = self.times[0], self.times[-1]
        if self.beyond != "repeated":
            return time, jnp.clip(time, first, last), 0.0
        turns = jnp.floor((time - first) / (last - first))
        return time, time - turns * (last - first), turns

    def _find_piece(self, time: Any) -> tuple[Any, Any]:
        """The piece in which a time lies, and how far [s]."""
        last = len(self.times) - 2
        index = jnp.zeros((), int)
        # Bisection, one number of the table at a time: kernels read long arrays so.
        for power in reversed(range(last.bit_length())):
            further = jnp.minimum(index + (1 << power), last)
            index = jnp.where(self.times[further] <= time, further, index)
        return index, time - self.times[index]


def _align_with_columns(steps: np.ndarray, values: Any) -> Any:
    """Numbers of the pieces beside those of the columns."""
    return jnp.asarray(steps).reshape(-1, *[1] * (values.ndim - 1))


def _as_times(times: Any) -> np.ndarray:
    try:
        instants = np.array(times, float)
    except (TypeError, ValueError, jax.errors.TracerArrayConversionError):
        instants = np.zeros(0)
    if instants.ndim != 1 or len(instants) < 2 or not np.all(np.isfinite(instants)):
        raise ValueError(
            f"times of a TimeTable are {described(times)}; they must be two or more finite numbers "
            "[s]."
        )
    if np.any(np.diff(instants) <= 0):
        raise ValueError("times of a TimeTable must rise, each above the one before.")
    return instants


def _check_values(values: Any, times: np.ndarray, beyond: str) -> Array:
    """The values as an array, one row for each time."""
    try:
        # Not shared with an array that its owner may change.
        array = jnp.array(values, float)
    except (TypeError, ValueError):
        array = jnp.zeros(())
    if array.ndim not in (1, 2) or len(array) != len(times):
        raise ValueError(
            f"values of a TimeTable are {described(values)}; there must be one, or one row, for "
            f"each of its {len(times)} times."
        )
    if isinstance(array, jax.core.Tracer):
        return array
    if not np.all(np.isfinite(array)):
        raise ValueError("values of a TimeTable must be finite.")
    if beyond == "repeated" and not np.allclose(array[0], array[-1], rtol=1e-9, atol=0.0):
        raise ValueError(
            "a TimeTable that is repeated must end with the value with which it begins."
        )
    return array


def _fit_pieces(times: np.ndarray, values: Array, interpolation: str, beyond: str) -> Array:
    """Coefficients of the pieces (4, pieces, ...), rising powers."""
    from scipy import interpolate

    if interpolation == "linear":
        slopes = jnp.diff(values, axis=0) / _align_with_columns(np.diff(times), values)
        return jnp.stack([values[:-1], slopes, jnp.zeros_like(slopes), jnp.zeros_like(slopes)])
    traced = isinstance(values, jax.core.Tracer)
    if interpolation == "monotone":
        if traced:
            raise ValueError(
                "a monotone TimeTable is not differentiated by its values; take a cubic one."
            )
        return jnp.asarray(interpolate.PchipInterpolator(times, np.asarray(values)).c[::-1])
    ends = "periodic" if beyond == "repeated" else "not-a-knot"
    if not traced:
        numbers = np.array(values)
        if beyond == "repeated":
            numbers[-1] = numbers[0]
        return jnp.asarray(interpolate.CubicSpline(times, numbers, bc_type=ends).c[::-1])
    # Splines are linear in their values: those of the unit vectors.
    unit = np.eye(len(times))
    if beyond == "repeated":
        unit[-1] = unit[0]
    per_value = jnp.asarray(interpolate.CubicSpline(times, unit, bc_type=ends).c[::-1])
    return jnp.tensordot(per_value, values, axes=1)
