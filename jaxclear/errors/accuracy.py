"""What is asked of the numbers of a run: how far each may be off. A share governs all standard
answers that do not hang on an instant; numbers in units govern those that are named, and others
that a user draws from a run.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxclear.errors.observables import Difference, Observables, differences, observed, safety_of
from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.ground.printing import in_a_line
from jaxclear.ground.quantity import is_traced, on_host
from jaxclear.ground.wording import described, public_name
from jaxclear.integrators.base import Promise
from jaxclear.results.response import unit_of
from jaxclear.results.trajectory import Trajectory

# What is promised of nothing.
NOTHING = Promise(None, None, None, None, None)
# The part of a promise that holds of an answer that a user draws.
DRAWN = "drawn"


class Observed(NamedTuple):
    """What is compared of a run: its standard answers, and what was drawn from it."""

    standard: Observables
    drawn: tuple[float, ...]


class Bounds(NamedTuple):
    """How far answers may be off: by the shares of a `promise`, or in `units` by the name of an
    answer, that of a standard one or of one of the `responses` that a user draws. `why`: what the
    integrator was chosen for, in a sentence."""

    promise: Promise
    units: tuple[tuple[str, float], ...] = ()
    responses: tuple[tuple[str, Callable], ...] = ()
    why: str = ""

    def observe(self, run: Trajectory) -> Observed:
        """What is compared of a run."""
        drawn = tuple(float(np.asarray(f(run))) for _, f in self.responses)
        return Observed(on_host(observed(run)), drawn)

    def differences(
        self, run: Trajectory, one: Observed, other: Observed, finest: Observed
    ) -> list[Difference]:
        """Differences of two runs, by answer.

        Args:
            run: the one that is judged, which names answers and units.
            one, other: what is observed of the two runs.
            finest: what is observed of the most accurate run, which scales the differences.

        Raises:
            ValueError: a bound names an answer that the run does not have.
        """
        rows = differences(run, one.standard, other.standard, finest.standard)
        drawn = zip(self.responses, one.drawn, other.drawn, finest.drawn, strict=True)
        for (name, response), x, y, last in drawn:
            row = name, DRAWN, "", unit_of(response, run.mechanism), x, abs(x - y), abs(last)
            rows.append(Difference(*row, safety_of(run, response)))
        names = {name for row in rows for name in (row.answer, row.name)}
        for name, _ in self.units:
            check_name("answer", name, sorted(names), " of this run")
        return rows

    def allowed(self, row: Difference) -> float | None:
        """By how much an answer may be off, in its unit; None: by any."""
        units = dict(self.units)
        most = units.get(row.name, units.get(row.answer))
        if most is not None:
            return most
        share = getattr(self.promise, row.part, None)
        return None if share is None else share * row.scale

    def tolerance(self, row: Difference) -> float | None:
        """The same as a share; None of what is 0 throughout, too."""
        most = self.allowed(row)
        return most / row.scale if most is not None and row.scale > 0 else None

    def compare(self, run: Trajectory, one: Observed, other: Observed) -> dict[str, float]:
        """Differences of two runs as multiples of what is allowed, by answer.

        Args:
            run: the one that is judged, which names answers and units.
            one, other: what is observed of the two runs.
        """
        rows = ((row, self.allowed(row)) for row in self.differences(run, one, other, other))
        return {
            row.name: ratio_to_allowed(row.safety * row.off, most)
            for row, most in rows
            if most is not None
        }


def ratio_to_allowed(off: float, allowed: float) -> float:
    """A difference beside what is allowed; of what may not differ at all 0 or endless."""
    if allowed > 0:
        return off / allowed
    return 0.0 if off == 0 else np.inf


def bounds_of_run(accuracy: Any) -> Bounds:
    """What `simulate(accuracy=)` asks: a share of all standard answers, or a mapping. Raises
    `ValueError` with a sentence."""
    accuracies = checked_accuracy(accuracy, "simulate")
    if not isinstance(accuracies, dict):
        return Bounds(Promise(accuracies, None, accuracies, None, accuracies))
    units = tuple((_name_of_answer(name), most) for name, most in accuracies.items())
    drawn = tuple((_name_of_answer(name), name) for name in accuracies if not isinstance(name, str))
    return Bounds(NOTHING, units, drawn)


def _name_of_answer(answer: Any) -> str:
    """The name of an answer: its own, or that of what draws it from a run."""
    if isinstance(answer, str):
        return answer
    expect(answer, Callable, "what accuracy names", "a standard answer's name, or a response")
    return in_a_line(answer) if isinstance(answer, eqx.Module) else public_name(answer)


def checked_accuracy(accuracy: Any, owner: str) -> float | dict[Any, float]:
    """A share, or numbers in units by name. Raises `ValueError` with a sentence for what is none,
    and for what is traced."""
    if is_traced(accuracy):
        raise ValueError(
            f"accuracy of {owner} is being traced (by jax.jit, vmap or grad): steps are chosen "
            "by runs, before anything is traced; give a number of Python."
        )
    if not isinstance(accuracy, Mapping):
        what = f"accuracy of {owner} (a share of each answer, 0.01 for 1 %)"
        check_number(what, accuracy, above=0, below=1)
        return float(accuracy)
    if not accuracy:
        raise ValueError(f"accuracy of {owner} is empty; name one answer at least.")
    for name, most in accuracy.items():
        check_number(f"accuracy of {described(name)}", most, above=0)
    return {name: float(most) for name, most in accuracy.items()}
