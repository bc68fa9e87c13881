"""A problem as a folder remembers it: its names, numbers and description, without what computes."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.studies.experiment import (
    AbstractExperiment,
    AbstractFreeVariable,
    Cost,
    Description,
    ResponseInfo,
    derived,
    how_it_ended,
)
from jaxclear.studies.problem import Problem


class RecordedVariable(AbstractFreeVariable):
    """The nominal value and the unit of a variable, whose distribution is not known."""

    nominal: Any
    unit: str = eqx.field(static=True)
    recorded_parts: tuple[str, ...] = eqx.field(static=True)
    distribution: Any = None

    @property
    def parts(self):
        return self.recorded_parts

    def identity(self, name, subject):
        return {}


class RecordedExperiment(AbstractExperiment):
    """What statistics and tables ask of an experiment, from a store. It computes nothing."""

    description: Any = derived()
    response_names: tuple[str, ...] = derived(static=True)

    def evaluate(self, setting, *, discrete_derivatives=False):
        raise ValueError(
            "this campaign was opened without its problem, and computes nothing; give the problem: "
            "jaxclear.open_campaign(folder, problem)."
        )

    def cost(self):
        return Cost(0, 1)

    def describe(self):
        return self.description


def of_json(record: dict[str, Any]) -> Problem:
    """The problem of which `in_json` wrote."""
    responses = {
        name: ResponseInfo(**info)._replace(
            depends_on=frozenset(info["depends_on"]),
            horizon=np.inf if info["horizon"] is None else info["horizon"],
        )
        for name, info in zip(record["response_names"], record["responses"], strict=True)
    }
    endings = dict(zip(Outcome, record["endings"], strict=True))
    description = Description(responses=responses, endings=endings, **record["description"])
    values, units = iter(record["nominal_values"]), iter(record["variable_units"])
    variables = {}
    for name, parts in record["variables"]:
        numbers = [(next(values), next(units)) for _ in parts or [name]]
        nominal = np.array([value for value, _ in numbers]) if parts else np.asarray(numbers[0][0])
        variables[name] = RecordedVariable(nominal, numbers[0][1], tuple(parts))
    experiment = RecordedExperiment(description, tuple(record["response_names"]))
    return Problem.of(experiment, variables)


def in_json(problem: Problem) -> dict[str, Any]:
    """What a folder remembers of a problem."""
    description = problem.description
    responses = [description.responses[name] for name in problem.response_names]
    keys = ("title", "discretised", "warnings", "remark")
    return {
        "names": problem.names,
        "variables": [[name, problem.variables[name].parts] for name in problem.variable_names],
        "variable_units": problem.variable_units,
        "nominal_values": [float(value) for value in problem.nominal()],
        "response_names": problem.response_names,
        "response_units": [info.unit for info in responses],
        "endings": [description.endings.get(code, how_it_ended(code)) for code in Outcome],
        "responses": [
            info._asdict()
            | {
                "depends_on": sorted(info.depends_on),
                "horizon": info.horizon if np.isfinite(info.horizon) else None,
            }
            for info in responses
        ],
        "description": {name: getattr(description, name) for name in keys},
    }
