"""A question: which numbers vary and how, and what is done with a sample of them.

Studies see a `Problem`, never a joint. The path from varied numbers to responses is one function,
`evaluate`, which maps over samples and differentiates where its experiment is compiled.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any
from weakref import finalize

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground import array_functions as xp
from jaxclear.ground.arguments import expect
from jaxclear.ground.array_functions import on_host
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.printing import in_a_line, number_in_words
from jaxclear.ground.quantity import AbstractQuantified, on_device, with_quantities
from jaxclear.ground.wording import described, listed
from jaxclear.integrators import AbstractIntegrator
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.state_history import State
from jaxclear.studies.distribution import AbstractDistribution
from jaxclear.studies.experiment import (
    AbstractExperiment,
    AbstractVariable,
    Cost,
    Description,
    SampleResult,
    Setting,
    check_names_differ,
)
from jaxclear.studies.inputs import Inputs, correlation_matrix, joint
from jaxclear.studies.responses import by_name, checked_question
from jaxclear.studies.run_experiment import RunExperiment


class Problem(AbstractQuantified):
    """Numbers that vary, and an experiment that gives responses of them: by default a mechanism
    that runs in time. `PositionProblem`, `FunctionProblem` and `LifeProblem` make problems of other
    experiments, `Problem.of` one of your own. What an experiment has (`mechanism`, `integrator`,
    `duration`, ...) is read through its problem.

    Args:
        mechanism: the mechanism that runs.
        response: a function of a trajectory that returns a number, or several by name. Those of
            `jaxclear.response` have units; `FromFunction` gives one to a plain function.
        variables: the numbers that vary, `Variable` or `Condition` by name.
        duration: length of a run [s], > 0.
        integrator: an integrator; by default steps of a fixed length, because equal work for every
            sample is what batches and derivatives want: `FixedStep()`, or an `ImplicitStep` where
            friction would answer faster than such steps resolve, or `Adaptive` where ideal joints
            rub, and where contacts want more than 200 000 steps what `accuracy=0.02` chooses;
            `why_integrator` says so.
        accuracy: in place of an integrator, which is then chosen by runs of the nominal sample for
            the least work: share of each response there [1], or {"response": number in its unit}.
        save: saving times or a `Saving`, as in `simulate`; `shares` [1] are the times, as shares of
            the duration.
        state: the `State` at which runs begin, as in `simulate`.
        correlation: of the variables' normal scores [1]: {("first", "second"): 0.5}, or a matrix.

    Raises:
        ValueError: with a sentence for what cannot be asked.
    """

    experiment: AbstractExperiment
    # JAX sorts the keys of a dictionary; `variable_names` keeps the order in which things were
    # given, `names` that of their numbers, of which most variables have one.
    variables: dict[str, AbstractVariable]
    correlation: Float[Array, "variables variables"] | None
    names: tuple[str, ...] = eqx.field(static=True)
    variable_names: tuple[str, ...] = eqx.field(static=True)
    variable_units: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        mechanism: Mechanism,
        response: Callable | Mapping[str, Callable],
        variables: Mapping[str, AbstractVariable],
        *,
        duration: float,
        integrator: AbstractIntegrator | None = None,
        accuracy: Any = None,
        save: Any = 201,
        state: State | None = None,
        correlation: Any = None,
    ):
        check_double_precision()
        mechanism = with_quantities(mechanism)
        named, varied = checked_question(mechanism, response, variables, "Problem", "a trajectory")
        correlation = correlation_matrix(correlation, tuple(varied))
        run = RunExperiment(mechanism, named, duration, integrator, accuracy, save, state)
        for name, value in _make_fields(run, varied, correlation).items():
            setattr(self, name, value)

    @staticmethod
    def of(
        experiment: AbstractExperiment,
        variables: Mapping[str, AbstractVariable],
        correlation: Any = None,
    ) -> "Problem":
        """A problem of any experiment.

        Args:
            experiment: the `AbstractExperiment` that gives the responses.
            variables: the numbers that vary, by name.
            correlation: of the variables' normal scores [1], as in `Problem`.

        Raises:
            ValueError: with a sentence for what cannot be asked.
        """
        expect(experiment, AbstractExperiment, "experiment of a Problem", "an AbstractExperiment")
        varied = by_name("variables", variables)
        for name, variable in varied.items():
            expect(variable, AbstractVariable, f'variable "{name}"', "an AbstractVariable")
        matrix = correlation_matrix(correlation, tuple(varied))
        return _make_problem(_make_fields(experiment, varied, matrix))

    def __hash__(self) -> int:
        # By identity, not by its arrays: `jax.jit(problem.evaluate)` looks up its programs by it.
        return id(self)

    def __getattr__(self, name: str) -> Any:
        # Called for what the problem itself does not have.
        if name.startswith("_") or name in Problem.__annotations__:
            raise AttributeError(f"a Problem has no {name}")
        return getattr(self.experiment, name)

    def _summary(self):
        """How it is asked, the responses and the variables with their units."""
        description = self.description
        lines = [description.title, "responses"]
        lines += [f"  {name} [{info.unit}]" for name, info in description.responses.items()]
        lines += ["variables"] if self.names else []
        nominal = self.nominal()
        for name, columns in self.groups.items():
            spread, unit = in_a_line(self.variables[name].distribution), self.variable_units
            suffix = "" if unit[columns[0]] == "1" else f" {unit[columns[0]]}"
            values = ", ".join(number_in_words(nominal[i]) for i in columns)
            lines.append(f"  {name} {values}{suffix}, {spread}")
        return "\n".join(lines if self.correlation is None else [*lines, "correlated"])

    @property
    def inputs(self) -> Inputs:
        """The joint distribution of the variables: `values(normal)` from independent standard
        normal numbers, and `normal(values)`."""
        distributions = [self.variables[name].distribution for name in self.variable_names]
        return joint(self.names, distributions, self.nominal(), self.correlation)

    @property
    def marginals(self) -> dict[str, AbstractDistribution]:
        """Distribution of each number by itself, by `names`."""
        return dict(zip(self.names, self.inputs.distributions, strict=True))

    @property
    def groups(self) -> dict[str, range]:
        """The places in `names` of the numbers of each variable, by its name: one of most."""
        groups, first = {}, 0
        for name in self.variable_names:
            count = max(len(self.variables[name].parts), 1)
            groups[name] = range(first, first + count)
            first += count
        return groups

    @property
    def description(self) -> Description:
        """What is known before any sample is computed."""
        # Not kept in the problem, by whose form programs are found.
        if id(self) not in _DESCRIPTIONS:
            _DESCRIPTIONS[id(self)] = self.experiment.describe()
            finalize(self, _DESCRIPTIONS.pop, id(self), None)
        return _DESCRIPTIONS[id(self)]

    def units(self) -> dict[str, str]:
        """Unit of each response."""
        return {name: info.unit for name, info in self.description.responses.items()}

    def cost(self) -> Cost:
        """What a sample costs."""
        return self.experiment.cost()

    def nominal(self) -> Float[Array, " variables"]:
        """Nominal value of each variable."""
        subject = self.experiment.subject
        numbers = [self.variables[name].nominal_in(subject) for name in self.variable_names]
        if len(self.names) > len(numbers):
            return jnp.concatenate([jnp.atleast_1d(number) for number in numbers])
        return on_device(xp.stack(on_host(numbers))) if numbers else jnp.zeros(0)

    def setting(self, values: Any) -> Setting:
        """The variables at these values.

        Args:
            values: one number for each variable, in their order, (variables,) [their units].
        """
        variables = tuple(self.variables[name] for name in self.variable_names)
        return Setting(self.variable_names, variables, jnp.asarray(values))

    def with_values(self, values: Any) -> Any:
        """The mechanism, or the dictionary of numbers, with the variables at these values.

        Args:
            values: one number for each variable, in their order, (variables,) [their units].
        """
        return self.experiment.with_values(self.setting(values))

    def evaluate(
        self, values: Float[Array, " variables"], *, discrete_derivatives: bool = False
    ) -> SampleResult:
        """The responses for one set of values; pure where `cost().compiled`.

        JAX may map, compile and differentiate it. A derivative through contacts that open and close
        is not that of the motion, and raises `ValueError`. Other derivatives of runs are compared
        with those in steps of other lengths or at a tighter tolerance, and nan where these tell an
        error beyond a hundredth; `jaxclear.explain_nan` says why.

        Args:
            values: one number for each variable, in their order, (variables,) [their units].
            discrete_derivatives: whether the derivative of the steps of a run is passed on, as an
                option.
        """
        check_double_precision()
        self.check_values(values)
        setting = self.setting(values)
        return self.experiment.evaluate(setting, discrete_derivatives=discrete_derivatives)

    def refine(self, share: float = 0.5) -> "Problem | None":
        """The same question with all that discretises it refined; None where that cannot be.

        Args:
            share: of the length of steps [1], between 0 and 1.
        """
        finer = self.experiment.refine(share)
        return None if finer is None else self.with_experiment(finer)

    def detail(self, values: Any, index: int = 0, chunk: int = 1) -> Any:
        """All there is to be seen of a sample: its run, positions, life, or what a function gives,
        bit for bit as it was in a study.

        Args:
            values: one number for each variable, in their order, (variables,) [their units].
            index: of the sample in its study, an integer.
            chunk: samples that are computed together there, a count.
        """
        return self.experiment.detail(self.setting(values), index, chunk)

    def with_experiment(self, experiment: AbstractExperiment) -> "Problem":
        """The same variables in another experiment.

        Args:
            experiment: an `AbstractExperiment` of the same subject.
        """
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return _make_problem(fields | {"experiment": experiment})

    def with_integrator(self, integrator: AbstractIntegrator) -> "Problem":
        """The same question of runs by another integrator.

        Args:
            integrator: an integrator.
        """
        run: Any = self.experiment
        return self.with_experiment(run.with_integrator(integrator))

    def parts(self) -> dict[str, Any]:
        """All that tells this problem from another, by name, but for the distributions."""
        parts, subject = self.experiment.parts(), self.experiment.subject
        for name in self.variable_names:
            parts |= self.variables[name].identity(name, subject)
        return parts

    def check_values(self, values: Any) -> None:
        """Raises `ValueError` where these are not one number for each variable.

        Args:
            values: what may be values of the variables.
        """
        shape = getattr(values, "shape", None)
        if shape is None and isinstance(values, (list, tuple)):
            shape = (len(values),)
        if shape != (len(self.names),):
            names = f", {listed(self.names)}" if self.names else ""
            raise ValueError(
                f"evaluate takes an array of {len(self.names)} values, one for each variable in "
                f"order{names}; it is given {described(values)}."
            )


_DESCRIPTIONS: dict[int, Description] = {}


def _make_fields(
    experiment: AbstractExperiment, variables: dict[str, Any], correlation: Any
) -> dict[str, Any]:
    """The fields of a problem by name. Raises `ValueError` where two numbers have one name, or one
    of several is correlated with another variable."""
    columns = {
        name: [f"{name} {part}" for part in v.parts] or [name] for name, v in variables.items()
    }
    names = tuple(name for v in columns.values() for name in v)
    twice = [name for name in names if names.count(name) > 1 or len(columns.get(name, "")) > 1]
    if twice:
        raise ValueError(f'"{twice[0]}" is a variable and a part of one; give it another name.')
    check_names_differ(experiment.response_names, (*columns, *names))
    units = [v.unit_in(experiment.subject) for v in variables.values()]
    each = zip(units, columns.values(), strict=True)
    return {
        "experiment": experiment,
        "variables": variables,
        "correlation": _expand_correlation(correlation, columns),
        "names": names,
        "variable_names": tuple(variables),
        "variable_units": tuple(unit for unit, v in each for _ in v),
    }


def _expand_correlation(correlation: Any, columns: dict[str, list[str]]) -> Any:
    """The correlation of all numbers from that of the variables."""
    counts = [len(column) for column in columns.values()]
    if correlation is None or sum(counts) == len(counts):
        return correlation
    values = np.asarray(correlation)
    for name, count, row in zip(columns, counts, values - np.eye(len(counts)), strict=True):
        if count > 1 and row.any():
            raise ValueError(
                f'correlation of a Problem names "{name}", which has several numbers '
                f"({listed(columns[name])}); only variables of one number can be correlated."
            )
    matrix, first = np.eye(sum(counts)), np.cumsum([0, *counts[:-1]])
    matrix[np.ix_(first, first)] = values
    return jnp.asarray(matrix)


def _make_problem(fields: dict[str, Any]) -> Problem:
    """A problem of checked fields."""
    problem = object.__new__(Problem)
    for name, value in fields.items():
        object.__setattr__(problem, name, value)
    return problem
