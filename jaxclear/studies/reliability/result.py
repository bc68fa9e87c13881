"""What is known of how often a limit is broken: by each method, and which answer stands."""

from typing import Any

import equinox as eqx
import numpy as np
import scipy

from jaxclear.ground.table import as_table
from jaxclear.studies.answer import VARIABLE, AbstractAnswer, Column, Stated
from jaxclear.studies.limit_state import AbstractLimitState
from jaxclear.studies.problem import Problem
from jaxclear.studies.reliability.design_point import DesignPoint
from jaxclear.studies.reliability.models import Probability
from jaxclear.studies.surface.response_surface import ResponseSurface

# Methods that know their own error.
SAMPLED = ("importance", "subset")
# Methods in a sentence.
NAMES = {
    "form": "FORM",
    "breitung": "SORM (Breitung)",
    "tvedt": "SORM (Tvedt)",
    "importance": "importance sampling",
    "subset": "subset simulation",
}
# A small share of a probability, of which nothing is said.
SMALL = 1e-3


class Reliability(AbstractAnswer):
    """Probability of failing by several methods.

    `estimates` are the methods' own answers by name. `points` are the design points, likeliest
    first: the likeliest parts that fail. `surface` is what they were found on, None where it was
    the runs themselves. `runs` and `failed` count all runs, those of the search and the surface
    too, and those of them that did not reach their end; `asked_variation` is the coefficient of
    variation that was asked for; `notes` are sentences, as are `warnings`, of what the runs warn.
    """

    problem: Problem
    limit: AbstractLimitState
    estimates: dict[str, Probability]
    points: tuple[DesignPoint, ...]
    surface: ResponseSurface | None
    runs: int = eqx.field(static=True)
    failed: int = eqx.field(static=True)
    asked_variation: float = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def method(self) -> str:
        """The method whose answer stands: of those that sample the most certain one, but the larger
        one where they contradict each other, for what a method does not find is missing from its
        answer; without one the last that has an answer, "none" without any."""
        sampled = [name for name in SAMPLED if self._answers(name)]
        if len(sampled) == 2 and not _overlap(*(self.estimates[name] for name in sampled)):
            return max(sampled, key=lambda name: self.estimates[name].value)
        if sampled:
            return min(sampled, key=lambda name: self.estimates[name].variation)
        return next((name for name in reversed(self.estimates) if self._answers(name)), "none")

    @property
    def probability(self) -> float:
        """Probability of failing [1] by the method whose answer stands; nan without one."""
        return self.estimates[self.method].value if self.method != "none" else np.nan

    @property
    def variation(self) -> float:
        """Coefficient of variation [1] of `probability`; nan where no method knows its error."""
        return self.estimates[self.method].variation if self.method != "none" else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of `probability`; nan where no method knows its error."""
        return self.estimates[self.method].interval if self.method != "none" else (np.nan, np.nan)

    @property
    def beta(self) -> float:
        """Reliability index [1]: the probability as standard deviations of a normal number."""
        return float(-scipy.special.ndtri(self.probability))

    def importance(self) -> dict[str, float]:
        """Share of each variable in the distance of the likeliest design point [1]; they add up to
        one. Of correlated variables those of their own scores. Empty without a design point."""
        if not self.points:
            return {}
        shares = _shares(self.problem, self.points[0])
        return {name: float(shares[list(at)].sum()) for name, at in self.problem.groups.items()}

    def design_point(self, index: int = 0) -> dict[str, float]:
        """Values of the variables of a design point, by name, in their units."""
        values = self.problem.inputs.values(self.points[index].normal)
        return {name: float(v) for name, v in zip(self.problem.names, values, strict=True)}

    def _stated(self):
        over, every = ("method",), self.estimates.items()
        read = lambda part: {name: part(e) for name, e in every}
        count, names = len(self.points), list(self.problem.names)
        places = [[self.design_point(i)[name] for name in names] for i in range(count)]
        columns = {
            "probability": Column(over, read(lambda e: e.value), "1"),
            "coefficient of variation": Column(over, read(lambda e: e.variation), "1"),
            "95 % low": Column(over, read(lambda e: e.interval[0]), "1"),
            "95 % high": Column(over, read(lambda e: e.interval[1]), "1"),
            "runs": Column(over, read(lambda e: e.runs)),
            "failed": Column(over, read(lambda e: e.failed)),
            "refusal": Column(over, read(lambda e: e.refusal)),
            "beta": Column(("point",), [point.beta for point in self.points], "1"),
            "design point": Column(
                ("point", VARIABLE),
                np.reshape(places, (count, len(names))),
                meaning="likeliest part that fails",
            ),
            "variable unit": Column((VARIABLE,), list(self.problem.variable_units)),
            "importance": Column(
                (VARIABLE,),
                list(_shares(self.problem, self.points[0])) if count else [np.nan] * len(names),
                "1",
                "of the likeliest design point",
            ),
        }
        numbers = {"limit": self.limit.words(), "runs": self.runs, "stands": self.method}
        return Stated("reliability", columns, self.problem, self.warnings, numbers)

    def design_points(self) -> Any:
        """A pandas table: one row a design point; beta, values, and importance [1] by variable."""
        rows = []
        for i, point in enumerate(self.points):
            shares = _shares(self.problem, point)
            row = {"beta": point.beta} | self.design_point(i)
            groups = self.problem.groups.items()
            row |= {f"importance of {n}": shares[list(group)].sum() for n, group in groups}
            rows.append(row)
        units = dict(zip(self.problem.names, self.problem.variable_units, strict=True))
        return as_table(rows, units=units)

    def sentence(self) -> str:
        """The answer with its error and cost, where FORM and sampling disagree, and what is to be
        known of it."""
        if self.method == "none":
            whys = {e.refusal for e in self.estimates.values()}
            parts = ["No method has an answer.", *self._refusals()]
            if len(whys) == 1:
                parts = [f"No method has an answer: {whys.pop()}"]
            return " ".join([*parts, *self.notes, *self.warnings])
        best = self.estimates[self.method]
        text = f"P({self.limit.words()}) = {best.value:.3g}"
        if np.isfinite(best.variation):
            low, high = best.interval
            text += (
                f", coefficient of variation {best.variation:.1%} (95 %: {low:.3g} to {high:.3g})"
            )
            text += f", by {NAMES[self.method]}"
            if self.method == "importance":
                text += f" about {len(self.points)} design point{'s' * (len(self.points) != 1)}"
            if best.variation > self.asked_variation:
                needed = best.runs * (best.variation / self.asked_variation) ** 2
                text += f"; {self.asked_variation:.0%} takes about {needed:.1g} runs (most_runs)"
        else:
            text += f" by {NAMES[self.method]}, whose error is not known: sample to know it"
        parts = [f"{text}; {self.runs} runs in all.", *self._comparison(best), *self._failure(best)]
        return " ".join([*parts, *self._refusals(), *self.notes, *self.warnings])

    def _summary(self):
        return self.sentence()

    def _answers(self, name: str) -> bool:
        return name in self.estimates and np.isfinite(self.estimates[name].value)

    def _comparison(self, e: Probability) -> list[str]:
        """Where methods contradict the answer."""
        sentences = []
        for name, other in self.estimates.items():
            if name == self.method or not self._answers(name) or not np.isfinite(e.variation):
                continue
            if name in SAMPLED:
                if not _overlap(e, other):
                    sentences.append(
                        f"{NAMES[name].capitalize()} says {other.value:.3g} and contradicts it: "
                        "one of the two does not find all that fails."
                    )
            elif not e.interval[0] <= other.value <= e.interval[1]:
                ratio = other.value / e.value
                if abs(ratio - 1) <= 2 * self.asked_variation:
                    continue
                times = f"{ratio:.2g} times as much" if ratio >= 1 else f"1/{1 / ratio:.2g} of it"
                sentences.append(
                    f"{NAMES[name]} says {other.value:.3g}, {times}: the limit is not "
                    f"{'a plane' if name == 'form' else 'a paraboloid'} where parts fail."
                )
        return sentences

    def _failure(self, result: Probability) -> list[str]:
        if not self.failed:
            return []
        share = f"{result.unknown:.1%}" if result.unknown > SMALL else "next to nothing"
        text = f"{self.failed} runs did not reach their end; they count as failing"
        return [f"{text}, with {share} of the probability."]

    def _refusals(self) -> list[str]:
        methods: dict[str, list[str]] = {}
        for name, estimate in self.estimates.items():
            if estimate.refusal:
                methods.setdefault(estimate.refusal, []).append(NAMES[name])
        return [f"{' and '.join(names)}: {why}" for why, names in methods.items()]


def _overlap(one: Probability, other: Probability) -> bool:
    return one.interval[0] <= other.interval[1] and other.interval[0] <= one.interval[1]


def _shares(problem: Problem, point: DesignPoint) -> np.ndarray:
    """Importance of the variables, (variables,) [1]."""
    root = problem.inputs.inverse_root
    if root is None:
        return point.importance
    # Slope of the distance by each variable's own score.
    direction = np.asarray(root).T @ (point.normal / np.linalg.norm(point.normal))
    return direction**2 / np.sum(direction**2)
