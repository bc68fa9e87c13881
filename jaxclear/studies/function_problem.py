"""A question about any function of dimensions: a stack of parts, a fit, a model of the user's own.

The function takes the dimensions by name and returns a number, or several by name. It is traced
once at the nominal values, so that what JAX cannot trace is refused with a sentence before anything
is sampled.
"""

import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import Scalar, as_number, as_vector, is_one_number, quantity
from jaxclear.ground.warning import call_user, shape_of
from jaxclear.ground.wording import described, listed
from jaxclear.integrators import Outcome
from jaxclear.studies.distribution import AbstractDistribution, AbstractJointDistribution
from jaxclear.studies.experiment import (
    AbstractExperiment,
    AbstractVariable,
    Cost,
    Description,
    ResponseInfo,
    SampleResult,
    Setting,
    check_names_differ,
    derived,
    one_distribution,
    sample_of_chunk,
)
from jaxclear.studies.inputs import correlation_matrix
from jaxclear.studies.problem import Problem

ALONE = "response"
# Functions take few operations a sample; above about this many the numbers of a chunk leave the
# cache (measured by benchmarks/claims/positions.py).
LARGEST_CHUNK = 4096


def _numbers(value: Any) -> Any:
    """One number, or several in a row."""
    return as_vector(value) if isinstance(value, (tuple, list)) else as_number(value)


class Dimension(AbstractVariable):
    """A number of a drawing, with its distribution; or several numbers under one name.

    Args:
        nominal: nominal value, a number in `unit`; with a distribution of several numbers as many.
        distribution: distribution of the deviation from the nominal value, one of
            `jaxclear.distribution`, or of several numbers, such as `jaxclear.distribution.Ball`,
            which the function takes as an array; in its place `tolerance`.
        tolerance: half width t of the tolerance, a number in `unit`, > 0: a normal distribution
            with a standard deviation of t/3, cut off at +-t.
        unit: unit, a text; "m" by default.

    Raises:
        ValueError: if neither or both of distribution and tolerance are given, or an argument is of
            another kind.
    """

    nominal: Scalar | tuple = quantity(
        unit="(its unit)",
        meaning="nominal value",
        converter=_numbers,
        wanted="one number, or several in a tuple",
    )
    distribution: AbstractDistribution | AbstractJointDistribution
    unit: str = eqx.field(static=True)

    def __init__(
        self,
        nominal: Any,
        distribution: AbstractDistribution | AbstractJointDistribution | None = None,
        *,
        tolerance: float | None = None,
        unit: str = "m",
    ):
        if tolerance is not None:
            check_number("tolerance of a Dimension", tolerance, above=0)
        expect(unit, str, "unit of a Dimension", 'a text, such as "m"')
        self.nominal = nominal
        self.distribution = one_distribution("Dimension", distribution, tolerance)
        self.unit = unit
        count = len(nominal) if isinstance(nominal, (tuple, list)) else 0
        if count != len(self.parts):
            raise ValueError(
                f"a Dimension has {count or 'one'} nominal value{'s' * (count > 1)}, and its "
                f"distribution is of {listed(self.parts) or 'one number'}; give a nominal value to "
                "each number."
            )

    def nominal_in(self, subject):
        return jnp.stack(self.nominal) if self.parts else self.nominal

    def unit_in(self, subject):
        return self.unit

    def put(self, name, subject, value):
        return subject | {name: value}

    def identity(self, name, subject):
        return {f'"{name}"': (self.nominal, self.unit)}


class FunctionExperiment(AbstractExperiment):
    """A function of named dimensions (`FunctionProblem`)."""

    function: Callable[..., Any]
    response_units: tuple[str, ...] = eqx.field(static=True)
    response_names: tuple[str, ...] = derived(static=True)
    series_names: tuple[str, ...] = derived(static=True)
    memory: int = derived(static=True)
    undifferentiated: str = derived(static=True)

    def __init__(self, function: Callable[..., Any], variables: dict[str, Dimension], units: Any):
        self.function = function
        at = {name: variable.nominal_in(None) for name, variable in variables.items()}
        shapes = _trace_function(function, at)
        self.response_names = tuple(name for name, shape in shapes.items() if not shape.shape)
        self.series_names = tuple(name for name, shape in shapes.items() if shape.shape)
        every = (*self.response_names, *self.series_names)
        check_names_differ(every, variables)
        of_variables = tuple(variable.unit for variable in variables.values())
        self.response_units = _units(units, every, of_variables)
        self.memory = _memory_of(function, at)
        self.undifferentiated = _why_no_derivative(function, at)

    def evaluate(self, setting, *, discrete_derivatives=False):
        answers = self.answers(setting)
        finite = jnp.all(jnp.isfinite(jnp.concatenate([jnp.ravel(x) for x in answers.values()])))
        outcome = jnp.where(finite, Outcome.REACHED, Outcome.NOT_FINITE)
        numbers = {name: answers[name] for name in self.response_names}
        return SampleResult(numbers, outcome, jnp.zeros(()))

    def answers(self, setting: Setting) -> dict[str, Array]:
        """What the function gives for one setting, numbers and series by name; pure."""
        return _by_name(self.function(**setting({})))

    def cost(self):
        return Cost(self.memory, LARGEST_CHUNK, cheap=True)

    def detail(self, setting, index, chunk) -> dict[str, Array]:
        """Numbers and series of one sample, by name.

        Args:
            setting: values of the sample.
            index: of the sample in its study.
            chunk: samples of a chunk of the study.
        """
        return sample_of_chunk(self.answers, setting, index, chunk)

    def describe(self):
        every = (*self.response_names, *self.series_names)
        pairs = zip(every, map(ResponseInfo, self.response_units), strict=True)
        endings = {
            Outcome.REACHED: "the function gave its numbers.",
            Outcome.NOT_FINITE: "a number that the function gives is not finite.",
        }
        title = f"FunctionProblem of {described(self.function)}"
        derivative = self.undifferentiated, ""
        return Description(title, dict(pairs), endings, derivative=derivative)


@answering
def FunctionProblem(
    function: Callable[..., Any],
    variables: Mapping[str, Dimension],
    *,
    units: str | Mapping[str, str] | None = None,
    correlation: Any = None,
) -> Problem:
    """A problem of a function of named dimensions. A sample whose response is not finite has
    failed.

    Args:
        function: takes the variables by name and returns a number, or a dictionary of several by
            name; a number alone is called "response". It must be made of operations that JAX can
            trace and differentiate (`jax.numpy` instead of `math` and `numpy`). What it returns
            with a length, (n,), is a series, such as a force over time: `Problem.detail` gives it,
            `identify` compares it with a measurement, and other studies see the numbers.
        variables: a `jaxclear.Dimension` each, by name.
        units: of what is returned, one text or a dictionary by name; by default that of the
            variables where they share one, else "1".
        correlation: of the variables' normal scores [1], as in `Problem`.

    Raises:
        ValueError: with a sentence for what cannot be asked.
    """
    check_double_precision()
    if not callable(function) or isinstance(function, type):
        raise ValueError(
            f"function of a FunctionProblem is {described(function)}; it must be a function of "
            "the variables by name."
        )
    expect(variables, Mapping, "variables of a FunctionProblem", "a dictionary from names")
    for name, variable in variables.items():
        expect(name, str, "a name in variables of a FunctionProblem", "a text")
        expect(variable, Dimension, f'variable "{name}"', "a jaxclear.Dimension")
    by_name = dict(variables)
    correlation = correlation_matrix(correlation, tuple(by_name))
    _check_names(function, tuple(by_name))
    return Problem.of(FunctionExperiment(function, by_name, units), by_name, correlation)


def _check_names(function: Callable[..., Any], names: tuple[str, ...]) -> None:
    """Raises `ValueError` where a function does not take the variables by name."""
    try:
        signature = inspect.signature(function)
    except ValueError:
        return
    try:
        signature.bind(**dict.fromkeys(names))
    except TypeError as error:
        takes = listed(signature.parameters)
        raise ValueError(
            f"the function of a FunctionProblem takes {takes or 'nothing'}, and the variables are "
            f"{listed(names) or 'none'}; give it each variable by its name."
        ) from error


def _by_name(values: Any) -> dict[str, Array]:
    """What a function returns, as numbers by name."""
    mapping = values if isinstance(values, Mapping) else {ALONE: values}
    if not mapping:
        raise ValueError("the function of a FunctionProblem returns no number; it must return one.")
    for name, value in mapping.items():
        expect(name, str, "a name in what the function of a FunctionProblem returns", "a text")
        if not is_one_number(value) and not _is_series(value):
            hint = " It returns nothing: is a `return` missing?" if value is None else ""
            what = "returns" if name == ALONE else f'returns for "{name}"'
            raise ValueError(
                f"the function of a FunctionProblem {what} {described(value)}; it must be one "
                f"number, or a dictionary of numbers (or series of them, one axis) by name.{hint}"
            )
    return {name: jnp.asarray(value, float) for name, value in mapping.items()}


def _is_series(value: Any) -> bool:
    """Whether something is an array of real numbers in a row."""
    row = isinstance(value, (np.ndarray, jax.Array)) and np.ndim(value) == 1 and len(value) > 0
    return bool(row and jnp.isrealobj(value))


def _trace_function(function: Callable[..., Any], at: dict[str, Any]) -> dict[str, Any]:
    """The shapes of what a function returns, in its order; a sentence where JAX cannot trace it."""
    order: list[str] = []

    def in_order(at):
        mapping = _by_name(call_user("the function of a FunctionProblem", lambda: function(**at)))
        order.extend(mapping)
        return mapping

    shapes = shape_of(in_order, at)
    return {name: shapes[name] for name in order}


def _units(units: Any, responses: tuple[str, ...], variables: tuple[str, ...]) -> tuple[str, ...]:
    """Unit of each response."""
    if units is None:
        return (variables[0] if len(set(variables)) == 1 else "1",) * len(responses)
    if isinstance(units, str):
        return (units,) * len(responses)
    expect(units, Mapping, "units of a FunctionProblem", "a text, or a dictionary from responses")
    for name, unit in units.items():
        check_name("response", name, responses, " in what the function returns")
        expect(unit, str, f'unit of response "{name}"', 'a text, such as "m"')
    return tuple(units.get(name, "1") for name in responses)


def _memory_of(function: Callable[..., Any], at: dict[str, Any]) -> int:
    """All numbers that a function computes on its way [bytes]."""
    lines = jax.make_jaxpr(lambda at: _by_name(function(**at)))(at).jaxpr.eqns
    sizes = (math.prod(getattr(v.aval, "shape", ())) for line in lines for v in line.outvars)
    return 8 * (len(at) + sum(sizes))


def _why_no_derivative(function: Callable[..., Any], at: dict[str, Any]) -> str:
    """Why JAX has no derivative of a function; "" where it has one."""
    try:
        jax.eval_shape(lambda at: jax.jvp(lambda at: _by_name(function(**at)), (at,), (at,)), at)
    except (ValueError, TypeError, NotImplementedError) as error:
        return f"JAX has no derivative of the function ({str(error).splitlines()[0]})"
    return ""
