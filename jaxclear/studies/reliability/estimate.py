"""A probability of failing as an answer: a number, its error, and what it cost."""

from typing import NamedTuple

import numpy as np

from jaxclear.ground.shown import shown_in_words
from jaxclear.studies.statistics.scrambled import student


@shown_in_words
class Probability(NamedTuple):
    """Probability of failing [1] by one method. `variation` is its coefficient of variation, the
    standard error over the value; nan where a method does not know its own error. It is that of
    `blocks` independent estimates, which cost `runs`; `failed` of these did not reach their end and
    count as failing, with a share `unknown` [1] of the probability. `refusal` says why a method has
    no answer."""

    value: float
    variation: float = np.nan
    runs: int = 0
    failed: int = 0
    unknown: float = 0.0
    blocks: int = 0
    refusal: str = ""

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, (low, high); nan where the error is not known."""
        if not np.isfinite(self.variation) or self.blocks < 2:
            return np.nan, np.nan
        width = student(self.blocks) * self.variation * self.value
        return max(self.value - width, 0.0), min(self.value + width, 1.0)

    def __str__(self) -> str:
        if self.refusal:
            return f"no answer: {self.refusal}"
        low, high = self.interval
        known = f", 95 %: {low:.3g} to {high:.3g}" if np.isfinite(low) else ", its error not known"
        return f"{self.value:.3g} ({self.runs} runs{known})"


def refused(why: str, runs: int = 0, failed: int = 0) -> Probability:
    """No answer, and the sentence that says why."""
    return Probability(np.nan, runs=runs, failed=failed, refusal=why)
