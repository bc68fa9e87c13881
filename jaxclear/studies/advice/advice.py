"""What an advisor found: every trial of the pilot, the one to take, and the answer in words.

Nothing is run here: the same trials can be judged at any accuracy.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxclear.integrators import AbstractIntegrator
from jaxclear.studies import verdict
from jaxclear.studies.advice.pilot import Pilot, Trial, describe
from jaxclear.studies.problem import Problem
from jaxclear.studies.verdict import Standard

# Rungs beside those of the ladder.
REFERENCE, PRESENT = "reference", "the problem's own"


class Climb(NamedTuple):
    """The trials of one rung, coarse to fine, and why there are no finer ones."""

    trials: tuple[Trial, ...]
    stopped: str


class Choice(NamedTuple):
    """A trial by rung and place."""

    rung: str
    place: int


class Advice(eqx.Module):
    """What the pilot showed. `recommended` is the integrator to take, `problem` the problem with
    it, `sentence()` the answer in words, `why_not()` what is wrong with the others, `table()` every
    trial; `jaxclear.plot.work_precision` draws it.

    `met`: whether the recommended setting was shown to meet the accuracy. `at(accuracy)` judges the
    same trials anew.
    """

    asked: Problem
    accuracy: float
    pilot: Pilot
    climbs: dict[str, Climb]
    sizes: dict[str, float]
    means: bool = eqx.field(static=True)
    batch: int | None = eqx.field(static=True)

    @property
    def standards(self) -> dict[str, Standard]:
        """How each response is judged."""
        trials, names = self.climbs[REFERENCE].trials, self.asked.response_names
        return verdict.standards(trials, names, self.accuracy, self.sizes, self.means)

    @property
    def choice(self) -> Choice:
        """The recommended trial; the most accurate one where none passes."""
        rules = self.standards
        found = {name: verdict.coarsest(climb.trials, rules) for name, climb in self.climbs.items()}
        passing = [Choice(name, place) for name, place in found.items() if place is not None]
        if passing:
            timed = [choice for choice in passing if self.batch is None or self._gain(choice.rung)]
            return min(timed or passing, key=self.cost_of)
        every = [
            Choice(name, i)
            for name, climb in self.climbs.items()
            if name != REFERENCE
            for i in range(len(climb.trials))
        ]
        finished = [choice for choice in every if not self.trial(choice).failure] or [
            Choice(REFERENCE, 0)
        ]
        return min(finished, key=lambda choice: verdict.worst(self.trial(choice), rules)[1])

    def trial(self, choice: Choice) -> Trial:
        """The trial of a choice."""
        return self.climbs[choice.rung].trials[choice.place]

    def cost_of(self, choice: Choice) -> float:
        """Wall seconds for a simulated second: of one run alone, or of a sample of a batch where a
        batch was asked for (what a rung's one timed setting gains there, its others are taken to
        gain)."""
        cost = self.trial(choice).cost
        return cost if self.batch is None else cost * (self._gain(choice.rung) or 1.0)

    def _gain(self, rung):
        """Cost of a sample in a batch as a share of that alone; None where no setting of the rung
        was timed.
        """
        return next(
            (
                t.cost_in_batch / t.cost
                for t in self.climbs[rung].trials
                if np.isfinite(t.cost_in_batch)
            ),
            None,
        )

    @property
    def met(self) -> bool:
        """True where the recommended setting was shown to meet the accuracy, and not by luck."""
        rules = self.standards
        choice = self.choice
        sure = verdict.coarsest(self.climbs[choice.rung].trials[choice.place :], rules) == 0
        return sure and all(rule.limit <= self.accuracy for rule in rules.values())

    @property
    def recommended(self) -> AbstractIntegrator:
        """The integrator to take."""
        return self.trial(self.choice).integrator

    @property
    def problem(self) -> Problem:
        """The problem with the recommended integrator."""
        return eqx.tree_at(lambda p: p.integrator, self.asked, self.recommended)

    @property
    def cost(self) -> float:
        """Wall seconds for a simulated second with the recommended integrator."""
        return self.cost_of(self.choice)

    def at(self, accuracy: float) -> "Advice":
        """The same trials judged at another accuracy. Finer than the one they were run for, they
        may not reach far enough.
        """
        return dataclasses.replace(self, accuracy=checked_accuracy(accuracy))

    def of_means(self) -> "Advice":
        """The same trials judged by means over the copies, not by single runs."""
        check_means(len(self.pilot.values))
        return dataclasses.replace(self, means=True)

    def table(self) -> Any:
        """All trials as a pandas table. Errors are shares of the size of a response."""
        import pandas

        rules, chosen, rows = self.standards, self.choice, []
        for name, climb in self.climbs.items():
            first = verdict.coarsest(climb.trials, rules)
            for place, trial in enumerate(climb.trials):
                found = verdict.scores(trial, rules)
                which = verdict.worst(trial, rules)[0]
                row = {"rung": name, "setting": describe(trial.integrator), "worst response": which}
                row |= {"error": found[which].error, "uncertainty": found[which].uncertainty}
                row |= {f"error in {response}": one.error for response, one in found.items()}
                row |= {
                    "wall s per simulated s": trial.cost,
                    "in a batch": trial.cost_in_batch,
                    "compile [s]": trial.compile,
                }
                row |= {
                    "meets": verdict.passes(trial, rules),
                    "recommended": chosen == (name, place),
                }
                rows.append(row | {"remark": self._remark(trial, rules, first, place)})
        return pandas.DataFrame(rows)

    def _remark(self, trial, rules, first, place):
        if trial.failure:
            return trial.failure
        if verdict.undecided(trial, rules):
            return f"undecided: some {verdict.copies_to_decide(trial, rules)} copies would tell"
        if not verdict.passes(trial, rules):
            return "too inaccurate"
        return (
            "unconfirmed: its finer neighbour is missing or fails"
            if first is None or place < first
            else ""
        )

    def sentence(self) -> str:
        """The answer in plain words."""
        return " ".join(
            part
            for part in (
                *self._answer(),
                *self._doubts(),
                *self._means(),
                self._present(),
                self._pilot(),
            )
            if part
        )

    def _answer(self):
        chosen, rules = self.choice, self.standards
        trial = self.trial(chosen)
        which = verdict.worst(trial, rules)[0]
        error, uncertainty = verdict.score(trial.responses[which], rules[which])
        named = f' (largest in "{which}")' if len(rules) > 1 else ""
        text, asked = describe(trial.integrator), _percent(self.accuracy)
        if self.met:
            yield f"{text} meets {asked}:"
        elif verdict.passes(trial, rules):
            yield (
                f"No setting can be shown to meet {asked}; the cheapest that cannot be told from "
                f"the reference is {text}:"
            )
        else:
            yield f"No setting was shown to meet {asked}; the most accurate tried is {text}:"
        cost, reference = self.cost_of(chosen), self.climbs[REFERENCE].trials[-1].cost
        where = "alone" if self.batch is None else f"a sample in batches of {self.batch}"
        longer = f"{reference / cost:.2g} times that" if reference > cost else "no longer"
        yield (
            f"error {_percent(error)} +- {_percent(uncertainty)}{named}, at {cost:.2g} s a "
            f"simulated second {where},"
        )
        yield (
            f"{cost * self.pilot.whole:.2g} s for the whole problem; the reference alone takes "
            f"{longer}."
        )

    def _doubts(self):
        rules, copies = self.standards, len(self.pilot.values)
        for name, rule in rules.items():
            loose, tight = (trial.responses[name] for trial in self.climbs[REFERENCE].trials)
            apart = _percent(verdict.difference(loose, tight, rule.size, False).error)
            if rule.by_means and verdict.standard(loose, tight, self.accuracy, rule.size).by_means:
                yield (
                    f'Single runs do not converge in "{name}": two tight references differ by '
                    f"{apart} (chaotic motion does)."
                )
                yield (
                    f"Means over the {copies} copies are compared instead, and known to "
                    f"+-{_percent(rule.trust)}."
                )
                if rule.limit > self.accuracy:
                    needed = int(np.ceil(copies * (rule.limit / self.accuracy) ** 2))
                    yield f"To show {_percent(self.accuracy)} there it takes some {needed} copies."
            elif rule.limit > self.accuracy:
                yield (
                    f'Two tight references differ by {apart} in "{name}", as chaotic motion '
                    "does. To compare means take"
                )
                yield f"at least {verdict.FEWEST} copies of a problem with variables."
        sure = max((rule.trust for rule in rules.values() if not rule.by_means), default=0.0)
        if sure > 0 and all(rule.limit <= self.accuracy for rule in rules.values()):
            yield f"Errors below {_percent(sure)} are within what the reference itself is known to."

    def _means(self):
        if self.means:
            yield "Judged are means over the copies, not single runs."
        if self.means or len(self.pilot.values) < verdict.FEWEST:
            return
        other = self.of_means()
        if other.met and other.cost < self.cost:
            found = verdict.scores(other.trial(other.choice), other.standards)
            error, uncertainty = found[verdict.worst(other.trial(other.choice), other.standards)[0]]
            yield (
                f"If only means over the tolerances count, {describe(other.recommended)} is enough:"
            )
            yield f"{_percent(error)} +- {_percent(uncertainty)} at {other.cost:.2g} s."

    def _present(self):
        (trial,) = self.climbs[PRESENT].trials
        text = f"The problem's own {describe(trial.integrator)}"
        if trial.failure:
            return f"{text} fails: {trial.failure}"
        rules = self.standards
        which = verdict.worst(trial, rules)[0]
        found = verdict.score(trial.responses[which], rules[which])
        verb = "keeps" if verdict.passes(trial, rules) else "does not keep"
        error = f"{_percent(found.error)} +- {_percent(found.uncertainty)}"
        return f"{text} {verb} within that: {error} at {trial.cost:.2g} s a simulated second alone."

    def _pilot(self):
        copies = len(self.pilot.values)
        many = "one run" if copies == 1 else f"{copies} copies"
        part = (
            f"the first {self.pilot.duration:.3g} s of"
            if self.pilot.duration < self.pilot.whole
            else "all of"
        )
        return f"Seen on {many} over {part} {self.pilot.whole:.3g} s."

    def why_not(self) -> dict[str, str]:
        """Why each other rung is not the one recommended, in a sentence."""
        rules, chosen = self.standards, self.choice
        reasons = {}
        for name, climb in self.climbs.items():
            if name in (chosen.rung, REFERENCE, PRESENT):
                continue
            place = verdict.coarsest(climb.trials, rules)
            finished = [trial for trial in climb.trials if not trial.failure]
            if place is not None:
                ratio = self.cost_of(Choice(name, place)) / self.cost
                reasons[name] = (
                    f"dearer: {describe(climb.trials[place].integrator)} meets it at {ratio:.2g} "
                    "times the cost."
                )
            elif not finished:
                reasons[name] = f"fails: {climb.trials[-1].failure} {climb.stopped}"
            else:
                reasons[name] = f"{self._shortcoming(finished, rules)} {climb.stopped}"
        return reasons

    def _shortcoming(self, finished, rules):
        open_ones = [trial for trial in finished if verdict.undecided(trial, rules)]
        best = min(open_ones or finished, key=lambda trial: verdict.worst(trial, rules)[1])
        which = verdict.worst(best, rules)[0]
        error, uncertainty = verdict.score(best.responses[which], rules[which])
        text = (
            f'{_percent(error)} +- {_percent(uncertainty)} in "{which}" with '
            f"{describe(best.integrator)}"
        )
        if open_ones:
            return (
                f"undecided: {text}; some {verdict.copies_to_decide(best, rules)} copies would "
                "tell."
            )
        return f"too inaccurate: {text}."


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.3g} %"


def check_means(copies: int) -> None:
    """Raises `ValueError` with a sentence where copies are too few for means."""
    if copies < verdict.FEWEST:
        raise ValueError(
            f"means need at least {verdict.FEWEST} copies of a problem with variables; there are "
            f"{copies}."
        )


def checked_accuracy(accuracy: Any) -> float:
    """The accuracy as a number. Raises `ValueError` with a sentence for what is none."""
    if isinstance(accuracy, (bool, str)) or not np.isscalar(accuracy) or not 0 < accuracy < 1:
        raise ValueError(
            f"the accuracy is {accuracy!r}; it is a share of each response, above 0 and below 1 "
            "(0.01 for 1 %)."
        )
    return float(accuracy)
