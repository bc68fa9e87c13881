"""Every trial of a pilot, how each response is judged, and which trial is the one to take.

Nothing is run here: the same trials can be judged at any accuracy, by single runs or by means.
"""

import dataclasses

import equinox as eqx
import numpy as np

from jaxclear.studies import verdict
from jaxclear.studies.advice.curve import REFERENCE, Choice, Curve
from jaxclear.studies.advice.pilot import Pilot, Trial
from jaxclear.studies.verdict import Criterion


class Comparison(eqx.Module):
    """The work-precision curves of a pilot beside the `accuracy` [1] asked for. `names` are those
    of the responses, `sizes` what the user gave for their size; `means`: whether means over the
    copies are judged; `batch`: samples run together where a batch was asked for.
    """

    accuracy: float
    pilot: Pilot
    curves: dict[str, Curve]
    sizes: dict[str, float]
    names: tuple[str, ...] = eqx.field(static=True)
    means: bool = eqx.field(static=True)
    batch: int | None = eqx.field(static=True)

    @property
    def criteria(self) -> dict[str, Criterion]:
        """How each response is judged."""
        trials = self.curves[REFERENCE].trials
        copies = len(self.pilot.values)
        return verdict.criteria(trials, self.names, self.accuracy, self.sizes, self.means, copies)

    @property
    def is_whole(self) -> bool:
        """Whether the runs are as long as the problem."""
        return self.pilot.duration >= self.pilot.whole

    @property
    def choice(self) -> Choice:
        """The recommended trial; the most accurate one where none passes."""
        criteria = self.criteria
        # Not the coarsest of each method: longer steps that are rejected may cost more.
        passing = [Choice(name, place) for name in self.curves for place in self.shown(name)]
        if passing:
            timed = [choice for choice in passing if self.batch is None or self.gain(choice)]
            return min(timed or passing, key=self.cost_of)
        finished = [choice for choice in self._candidates() if not self.trial(choice).failure]
        return min(
            finished or [Choice(REFERENCE, 0)],
            key=lambda choice: verdict.worst(self.trial(choice), criteria)[1],
        )

    def shown(self, name: str) -> list[int]:
        """The trials of a method that meet the accuracy, and not by luck; of the reference the
        tight one too, as its looser run has shown."""
        trials, criteria = self.curves[name].trials, self.criteria
        places = verdict.shown(trials, criteria)
        tight = name == REFERENCE and verdict.passes(trials[-1], criteria)
        return [*places, len(trials) - 1] if tight else places

    def _candidates(self) -> list[Choice]:
        return [
            Choice(name, place)
            for name, curve in self.curves.items()
            for place in range(len(curve.trials))
            if name != REFERENCE
        ]

    def trial(self, choice: Choice) -> Trial:
        """The trial of a choice."""
        return self.curves[choice.method].trials[choice.place]

    @property
    def chosen(self) -> Trial:
        """The recommended trial."""
        return self.trial(self.choice)

    def cost_of(self, choice: Choice) -> float:
        """Wall seconds for a simulated second: of one run alone, or of a sample of a batch where a
        batch was asked for (what a method's one timed setting gains there, its others are taken to
        gain)."""
        cost = self.trial(choice).cost
        return cost if self.batch is None else cost * (self.gain(choice) or 1.0)

    def gain(self, choice: Choice) -> float | None:
        """Cost of a sample in a batch as a share of that alone; None where no setting of the method
        was timed.
        """
        for trial in self.curves[choice.method].trials:
            if np.isfinite(trial.cost_in_batch):
                return trial.cost_in_batch / trial.cost
        return None

    @property
    def met(self) -> bool:
        """True where the recommended setting was shown to meet the accuracy, and not by luck."""
        choice = self.choice
        known = all(criterion.limit <= self.accuracy for criterion in self.criteria.values())
        return known and choice.place in self.shown(choice.method)

    @property
    def cost(self) -> float:
        """Wall seconds for a simulated second with the recommended integrator."""
        return self.cost_of(self.choice)

    def at(self, accuracy: float) -> "Comparison":
        """The same trials judged at another accuracy."""
        return dataclasses.replace(self, accuracy=accuracy)

    def of_means(self) -> "Comparison":
        """The same trials judged by means over the copies, not by single runs."""
        check_means(len(self.pilot.values))
        return dataclasses.replace(self, means=True)


def check_means(copies: int) -> None:
    """Raises `ValueError` with a sentence where copies are too few for means."""
    if copies < verdict.FEWEST:
        raise ValueError(
            f"means need at least {verdict.FEWEST} copies of a problem with variables; there are "
            f"{copies}."
        )
