"""A problem as a folder remembers it: its names, units and sentences, without what computes."""

from typing import Any, NoReturn

import equinox as eqx
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.integrators.checks import Check
from jaxclear.studies.base import AbstractProblem

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
    # As `in_json` wrote it; of folders of earlier versions some is not known.
    told: dict[str, Any] = eqx.field(static=True)
    variables: dict[str, Any] = eqx.field(default_factory=dict)
    correlation: Any = None

    @classmethod
    def of_json(cls, told: dict[str, Any]) -> "RecordedProblem":
        """As `in_json` wrote it."""
        named = (tuple(told[own]) for own in ("names", "response_names", "variable_units"))
        return cls(*named, told)

    def _of(self, what: str, response: str, unknown: Any = None) -> Any:
        """What is told of a response."""
        known = dict(zip(self.response_names, self.told.get(what, ()), strict=False))
        return known.get(response, unknown)

    def nominal(self):
        return np.asarray(self.told["nominal_values"])

    def units(self):
        return dict(zip(self.response_names, self.told["response_units"], strict=True))

    def evaluate(self, values, *, discrete_derivatives=False):
        _refuse()

    def endless(self, response):
        return self._of("endless_words", response, "")

    def told_up_to(self, response):
        most = self._of("most_told", response)
        return np.inf if most is None else most

    def discretised(self):
        return self.told.get("by_steps", False)

    def promised(self, response, size):
        own = self._of("promises", response)
        return None if own is None else max(own[0], own[1] * size)

    def doubts(self):
        return tuple(self.told.get("known_doubts", ()))

    def sample_memory(self):
        return 0

    def most_together(self):
        return 1

    def rerun(self, values, index, chunk):
        _refuse()

    def ending(self, outcome, ended):
        return self.told["endings"][outcome].replace(ENDED, f"{ended:.6g}")

    def remark(self):
        return self.told["why"]

    def remedy(self, response):
        return self._of("remedies", response, "refine its steps")

    def concerned(self, response, concerns):
        return concerns in self._of("concerns", response)

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
