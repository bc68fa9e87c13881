"""The answer of an advisor: the integrator to take, what it costs, what is doubtful, and why not
the others.

What is decided is decided in `comparison`; here it is put into words and tables.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.arguments import check_number
from jaxclear.ground.shown import AbstractShown
from jaxclear.integrators import AbstractIntegrator
from jaxclear.studies import verdict
from jaxclear.studies.advice.comparison import Comparison
from jaxclear.studies.advice.curve import PRESENT, REFERENCE, Choice
from jaxclear.studies.advice.pilot import describe
from jaxclear.studies.advice.shortcomings import in_percent, percent, shortcoming, worst_of
from jaxclear.studies.datasets import of_rows
from jaxclear.studies.problem import Problem


class Advice(AbstractShown):
    """What to take for the problem that was `asked` about. `recommended` is the integrator,
    `problem` the problem with it, `sentence()` the answer in words, `why_not()` what is wrong with
    the others, `table()` every trial; `jaxclear.plot.work_precision` draws it.

    `met`: whether the recommended setting was shown to meet the accuracy. `at(accuracy)` judges the
    same trials anew. What is recommended is founded on `comparison`: of the whole problem, where
    `first` is that of the pilot, or of the pilot alone; `unconfirmed`: why not of the whole.
    """

    asked: Problem
    comparison: Comparison
    first: Comparison | None = None
    unconfirmed: str = eqx.field(static=True, default="")

    @property
    def met(self) -> bool:
        """True where the recommended setting was shown to meet the accuracy, and not by luck."""
        return self.comparison.met and not self.unconfirmed

    @property
    def cost(self) -> float:
        """Wall seconds for a simulated second with the recommended integrator."""
        return self.comparison.cost

    @property
    def recommended(self) -> AbstractIntegrator:
        """The integrator to take."""
        return self.comparison.chosen.integrator

    @property
    def problem(self) -> Problem:
        """The problem with the recommended integrator."""
        return eqx.tree_at(lambda p: p.integrator, self.asked, self.recommended)

    def at(self, accuracy: float) -> "Advice":
        """The same trials judged at another accuracy. Finer than the one they were run for, they
        may not reach far enough; coarser, there may be cheaper ones.
        """
        asked = checked_accuracy(accuracy)
        return self._judged(lambda found: found.at(asked))

    def of_means(self) -> "Advice":
        """The same trials judged by means over the copies, not by single runs."""
        return self._judged(lambda found: found.of_means())

    def _judged(self, judge: Callable[[Comparison], Comparison]) -> "Advice":
        first = None if self.first is None else judge(self.first)
        return dataclasses.replace(self, comparison=judge(self.comparison), first=first)

    @property
    def stages(self) -> tuple[Comparison, ...]:
        """The comparisons that were made: of the pilot, and of the whole problem where that is
        another."""
        return (self.comparison,) if self.first is None else (self.first, self.comparison)

    def sentence(self) -> str:
        """The answer in plain words."""
        found = self.comparison
        parts = [*_recommended(found, self.met), *_doubts(found), *_warnings(found)]
        parts += [*_if_means_count(found), self.unconfirmed, _present(self.stages[0])]
        seen = " and on ".join(_seen(stage) for stage in self.stages)
        rest = "" if found.is_whole else f" of {found.pilot.whole:.3g} s"
        parts += [f"Seen on {seen}{rest}."]
        return " ".join(part for part in parts if part)

    def __str__(self) -> str:
        others = (f"Not {name}: {why}" for name, why in self.why_not().items())
        return "\n".join([self.sentence(), *others])

    def warnings(self) -> list[str]:
        """What the runs of the recommended setting and of the reference warn of, in sentences."""
        return list(_warnings(self.comparison))

    def why_not(self) -> dict[str, str]:
        """Why each other method is not the one recommended, in a sentence."""
        latest = {name: stage for stage in self.stages for name in stage.curves}
        beside = (self.comparison.choice.method, REFERENCE, PRESENT)
        return {
            name: _reason(stage, name, self.cost)
            for name, stage in latest.items()
            if name not in beside
        }

    def table(self) -> Any:
        """All trials as a pandas table. Errors are shares of the size of a response."""
        import pandas

        rows = [
            _row(stage, Choice(name, place), self.comparison)
            for stage in self.stages
            for name, curve in stage.curves.items()
            for place in range(len(curve.trials))
        ]
        return pandas.DataFrame(rows)

    def to_dataset(self) -> Any:
        """The table as an xarray Dataset over the trials, with provenance."""
        return of_rows("advice", "trial", self.table(), self.asked, result=self.sentence())


def checked_accuracy(accuracy: Any) -> float:
    """The accuracy as a number. Raises `ValueError` with a sentence for what is none."""
    check_number(
        "the accuracy (a share of each response, 0.01 for 1 %)", accuracy, above=0, below=1
    )
    return float(accuracy)


def _row(found: Comparison, choice: Choice, last: Comparison) -> dict[str, Any]:
    criteria, trial = found.criteria, found.trial(choice)
    errors, which = verdict.errors(trial, criteria), verdict.worst(trial, criteria)[0]
    row = {
        "method": choice.method,
        "setting": describe(trial.integrator),
        "worst response": which,
        "error": errors[which].error,
        "uncertainty": errors[which].uncertainty,
    }
    row |= {f"error in {response}": one.error for response, one in errors.items()}
    return row | {
        "wall s per simulated s": trial.cost,
        "in a batch": trial.cost_in_batch,
        "compile [s]": trial.compile,
        "meets": verdict.passes(trial, criteria),
        "recommended": found is last and found.choice == choice,
        "simulated [s]": found.pilot.duration,
        "remark": _remark(found, choice),
    }


def _remark(found: Comparison, choice: Choice) -> str:
    criteria, trial = found.criteria, found.trial(choice)
    if trial.failure:
        return trial.failure
    if verdict.undecided(trial, criteria):
        return f"undecided: some {verdict.copies_to_decide(trial, criteria)} copies would tell"
    if not verdict.passes(trial, criteria):
        near = all(
            sum(verdict.error_of(trial.responses[name], one)) <= one.accuracy
            for name, one in criteria.items()
        )
        return "leaves too little for copies that were not seen" if near else "too inaccurate"
    if choice.place < min(found.shown(choice.method), default=np.inf):
        return "unconfirmed: its finer neighbour is missing or fails"
    return trial.warnings


def _reason(found: Comparison, name: str, cost: float) -> str:
    """What is wrong with a method that is not recommended beside one of this cost [s/s]."""
    curve, criteria = found.curves[name], found.criteria
    meet = [Choice(name, place) for place in found.shown(name)]
    finished = [trial for trial in curve.trials if not trial.failure]
    if meet:
        best = min(meet, key=found.cost_of)
        ratio = found.cost_of(best) / cost
        text = f"{describe(found.trial(best).integrator)} meets it at {ratio:.2g} times the cost"
        if ratio < 1 and not found.is_whole:
            return f"expected to be dearer later on: {text} over the first part."
        return f"dearer: {text}."
    if not finished:
        return f"fails: {curve.trials[-1].failure} {curve.stopped}"
    return f"{shortcoming(finished, criteria)} {curve.stopped}"


def _recommended(found: Comparison, met: bool) -> Iterator[str]:
    criteria, trial = found.criteria, found.chosen
    which, error = worst_of(trial, criteria)
    named = f' (largest in "{which}")' if len(criteria) > 1 else ""
    text, asked = describe(trial.integrator), percent(found.accuracy)
    if met:
        yield f"{text} meets {asked}:"
    elif verdict.passes(trial, criteria):
        yield (
            f"No setting can be shown to meet {asked}; the cheapest that cannot be told from the "
            f"reference is {text}:"
        )
    else:
        yield f"No setting was shown to meet {asked}; the most accurate tried is {text}:"
    cost, reference = found.cost, found.curves[REFERENCE].trials[-1].cost
    where = "alone" if found.batch is None else f"a sample in batches of {found.batch}"
    longer = f"{reference / cost:.2g} times that" if reference > cost else "no longer"
    yield f"error {in_percent(error)}{named}, at {cost:.2g} s a simulated second {where},"
    yield (
        f"{cost * found.pilot.whole:.2g} s for the whole problem; the reference alone takes "
        f"{longer}."
    )


def _doubts(found: Comparison) -> Iterator[str]:
    criteria, copies = found.criteria, len(found.pilot.values)
    for name, criterion in criteria.items():
        loose, tight = (trial.responses[name] for trial in found.curves[REFERENCE].trials)
        apart = percent(verdict.difference(loose, tight, criterion.size, False).error)
        alone = verdict.criterion(loose, tight, found.accuracy, criterion.size, copies=copies)
        if criterion.by_means and alone.by_means:
            yield (
                f'Single runs do not converge in "{name}": two tight references differ by {apart} '
                f"(chaotic motion does). Means over the {copies} copies are compared instead, and "
                f"known to +-{percent(criterion.trust)}."
            )
            if criterion.limit > found.accuracy:
                needed = int(np.ceil(copies * (criterion.limit / found.accuracy) ** 2))
                yield f"To show {percent(found.accuracy)} there it takes some {needed} copies."
        elif criterion.limit > found.accuracy:
            yield (
                f'Two tight references differ by {apart} in "{name}", as chaotic motion does. To '
                f"compare means take at least {verdict.FEWEST} copies of a problem with variables."
            )
    sure = max((c.trust for c in criteria.values() if not c.by_means), default=0.0)
    if sure > 0 and all(c.limit <= found.accuracy for c in criteria.values()):
        yield f"Errors below {percent(sure)} are within what the reference itself is known to."


def _warnings(found: Comparison) -> Iterator[str]:
    """What the runs of the recommended setting and of the reference warn of."""
    for whose, trial in (
        ("the recommended setting", found.chosen),
        ("the reference", found.curves[REFERENCE].trials[-1]),
    ):
        if trial.warnings:
            yield f"With {whose} {trial.warnings}"


def _if_means_count(found: Comparison) -> Iterator[str]:
    if found.means:
        yield "Judged are means over the copies, not single runs."
    if found.means or len(found.pilot.values) < verdict.FEWEST:
        return
    other = found.of_means()
    if other.met and other.cost < found.cost:
        _, error = worst_of(other.chosen, other.criteria)
        yield (
            f"If only means over the tolerances count, {describe(other.chosen.integrator)} is "
            f"enough: {in_percent(error)} at {other.cost:.2g} s."
        )


def _present(found: Comparison) -> str:
    (trial,) = found.curves[PRESENT].trials
    text = f"The problem's own {describe(trial.integrator)}"
    if trial.failure:
        return f"{text} fails: {trial.failure}"
    _, error = worst_of(trial, found.criteria)
    verb = "keeps" if verdict.passes(trial, found.criteria) else "does not keep"
    return (
        f"{text} {verb} within that: {in_percent(error)} at {trial.cost:.2g} s a simulated "
        "second alone."
    )


def _seen(found: Comparison) -> str:
    copies, duration = len(found.pilot.values), found.pilot.duration
    many = "one run" if copies == 1 else f"{copies} copies"
    many += f", {found.pilot.runs - copies} shorter runs," if found.pilot.runs > copies else ""
    return f"{many} over {'all of' if found.is_whole else 'the first'} {duration:.3g} s"
