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

    def told(self, name, subject):
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


def of_json(told: dict[str, Any]) -> Problem:
    """The problem of which `in_json` wrote."""
    responses = {
        name: ResponseInfo(**own)._replace(
            depends_on=frozenset(own["depends_on"]),
            horizon=np.inf if own["horizon"] is None else own["horizon"],
        )
        for name, own in zip(told["response_names"], told["responses"], strict=True)
    }
    endings = dict(zip(Outcome, told["endings"], strict=True))
    description = Description(responses=responses, endings=endings, **told["description"])
    values, units = iter(told["nominal_values"]), iter(told["variable_units"])
    variables = {}
    for name, parts in told["variables"]:
        own = [(next(values), next(units)) for _ in parts or [name]]
        nominal = np.array([value for value, _ in own]) if parts else np.asarray(own[0][0])
        variables[name] = RecordedVariable(nominal, own[0][1], tuple(parts))
    experiment = RecordedExperiment(description, tuple(told["response_names"]))
    return Problem.of(experiment, variables)


def in_json(problem: Problem) -> dict[str, Any]:
    """What a folder remembers of a problem."""
    own = problem.description
    responses = [own.responses[name] for name in problem.response_names]
    whole = ("title", "discretised", "warnings", "remark")
    return {
        "names": problem.names,
        "variables": [[name, problem.variables[name].parts] for name in problem.variable_names],
        "variable_units": problem.variable_units,
        "nominal_values": [float(value) for value in problem.nominal()],
        "response_names": problem.response_names,
        "response_units": [known.unit for known in responses],
        "endings": [own.endings.get(code, how_it_ended(code)) for code in Outcome],
        "responses": [
            known._asdict()
            | {
                "depends_on": sorted(known.depends_on),
                "horizon": known.horizon if np.isfinite(known.horizon) else None,
            }
            for known in responses
        ],
        "description": {name: getattr(own, name) for name in whole},
    }
