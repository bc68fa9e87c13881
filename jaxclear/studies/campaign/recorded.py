"""A problem as a folder remembers it: its names, units and sentences, without what computes."""

from typing import Any, NoReturn

import equinox as eqx
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.integrators.checks import Check
from jaxclear.studies.base import AbstractProblem

__all__ = ["RecordedProblem", "in_json"]

# The outcomes that a sentence tells of without what was computed.
ENDED = "{ended:.6g}"
# A size of responses beside which what is promised at least is nothing.
LARGE = 1e100
# A time [s] that no run ends at and no sentence holds otherwise.
SOME_TIME = 987654.0


class RecordedProblem(AbstractProblem):
    """What statistics and tables ask of a problem, from a store. It computes nothing."""

    names: tuple[str, ...] = eqx.field(static=True)
    response_names: tuple[str, ...] = eqx.field(static=True)
    variable_units: tuple[str, ...] = eqx.field(static=True)
    response_units: tuple[str, ...] = eqx.field(static=True)
    nominal_values: tuple[float, ...] = eqx.field(static=True)
    endings: tuple[str, ...] = eqx.field(static=True)
    concerns: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    why: str = eqx.field(static=True)
    variables: dict[str, Any] = eqx.field(default_factory=dict)
    correlation: Any = None
    # Of each response, where a folder tells: why it is infinite, and up to where it is told.
    endless_words: tuple[str, ...] = eqx.field(static=True, default=())
    most_told: tuple[float | None, ...] = eqx.field(static=True, default=())
    # Whether its numbers are off by steps, what is off in all samples, and of each response what
    # is promised of its mean: at least, and as a share of its size (None: nothing).
    by_steps: bool = eqx.field(static=True, default=False)
    known_doubts: tuple[str, ...] = eqx.field(static=True, default=())
    promises: tuple[tuple[float, float] | None, ...] = eqx.field(static=True, default=())
    remedies: tuple[str, ...] = eqx.field(static=True, default=())

    @classmethod
    def of_json(cls, told: dict[str, Any]) -> "RecordedProblem":
        """As `in_json` wrote it."""
        tuples = {key: tuple(own) if isinstance(own, list) else own for key, own in told.items()}
        tuples["concerns"] = tuple(map(tuple, told["concerns"]))
        tuples["promises"] = tuple(own and tuple(own) for own in told.get("promises", ()))
        return cls(**tuples)

    def nominal(self):
        return np.asarray(self.nominal_values)

    def units(self):
        return dict(zip(self.response_names, self.response_units, strict=True))

    def evaluate(self, values, *, discrete_derivatives=False):
        _refuse()

    def endless(self, response):
        return dict(zip(self.response_names, self.endless_words, strict=False)).get(response, "")

    def told_up_to(self, response):
        most = dict(zip(self.response_names, self.most_told, strict=False)).get(response)
        return np.inf if most is None else most

    def discretised(self):
        return self.by_steps

    def promised(self, response, size):
        own = dict(zip(self.response_names, self.promises, strict=False)).get(response)
        return None if own is None else max(own[0], own[1] * size)

    def doubts(self):
        return self.known_doubts

    def sample_memory(self):
        return 0

    def most_together(self):
        return 1

    def rerun(self, values, index, chunk):
        _refuse()

    def ending(self, outcome, ended):
        return self.endings[outcome].replace(ENDED, f"{ended:.6g}")

    def remark(self):
        return self.why

    def remedy(self, response):
        own = dict(zip(self.response_names, self.remedies, strict=False))
        return own.get(response, "refine its steps")

    def concerned(self, response, concerns):
        return concerns in self.concerns[self.response_names.index(response)]

    def parts(self):
        return {}


def _refuse() -> NoReturn:
    raise ValueError(
        "this campaign was opened without its problem, and computes nothing; give the problem: "
        "jaxclear.open_campaign(folder, problem)."
    )


def in_json(problem: AbstractProblem) -> dict[str, Any]:
    """What a folder remembers of a problem."""
    parts = sorted({check.concerns for check in Check})
    some = f"{SOME_TIME:.6g}"
    units = problem.units()
    most = [float(problem.told_up_to(name)) for name in problem.response_names]
    return {
        "names": problem.names,
        "response_names": problem.response_names,
        "variable_units": problem.variable_units,
        "response_units": [units[name] for name in problem.response_names],
        "nominal_values": [float(value) for value in problem.nominal()],
        "endings": [problem.ending(code, SOME_TIME).replace(some, ENDED) for code in Outcome],
        "concerns": [
            [part for part in parts if problem.concerned(name, part)]
            for name in problem.response_names
        ],
        "why": problem.remark(),
        "endless_words": [problem.endless(name) for name in problem.response_names],
        "most_told": [own if np.isfinite(own) else None for own in most],
        "by_steps": problem.discretised(),
        "known_doubts": problem.doubts(),
        "promises": [_promise(problem, name) for name in problem.response_names],
        "remedies": [problem.remedy(name) for name in problem.response_names],
    }


def _promise(problem: AbstractProblem, response: str) -> tuple[float, float] | None:
    """What is promised of the mean of a response at least, and as a share of its size."""
    least, large = (problem.promised(response, size) for size in (0.0, LARGE))
    return None if least is None or large is None else (least, large / LARGE)
