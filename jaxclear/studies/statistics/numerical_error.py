"""How far a statistic is off by what discretises its runs, as pairs of runs of the same samples
tell it, and whether they are enough.

Source: multilevel Monte Carlo: Giles 2008, Oper. Res. 56, 607, doi:10.1287/opre.1070.0496.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxclear.ground.shown import shown_in_words
from jaxclear.studies.statistics.scrambled import student

__all__ = ["NumericalError", "bias_of"]


@shown_in_words
class NumericalError(NamedTuple):
    """How far a statistic is off by what discretises its runs, in its unit: told by so many
    `replicas`, it is too large by `bias`, known to ± `uncertainty` (95 %); `sampling` is half of
    the statistic's own 95 % interval, which chance leaves."""

    bias: float
    uncertainty: float
    sampling: float
    replicas: int

    @property
    def error(self) -> float:
        """The largest that it may be."""
        return abs(self.bias) + self.uncertainty

    @property
    def is_resolved(self) -> bool:
        """Whether replicas tell the bias: as well as samples tell the statistic, or from none."""
        return self.uncertainty <= max(self.sampling, abs(self.bias))

    @property
    def whole(self) -> float:
        """Half of the one interval that holds both, sampling and steps; nan where replicas do not
        resolve the bias: two figures then, side by side."""
        return self.sampling + self.error if self.is_resolved else np.nan

    @property
    def wanted(self) -> float:
        """How many replicas would resolve it, about."""
        if self.is_resolved:
            return self.replicas
        if not np.isfinite(self.uncertainty) or self.sampling <= 0:
            return np.inf
        return float(np.ceil(self.replicas * (self.uncertainty / self.sampling) ** 2))

    def __str__(self) -> str:
        if self.is_resolved:
            return f"± {self.whole:.2g} (samples {self.sampling:.2g}, steps {self.error:.2g})"
        return f"± {self.sampling:.2g} (samples). {self.unresolved}"

    @property
    def unresolved(self) -> str:
        """A sentence for a bias that replicas do not resolve."""
        told = f"Steps put it off by {self.bias:.2g} ± {self.uncertainty:.2g}, as far as"
        few = f"{told} {self.replicas} replicas tell"
        return f"{few}; about {self.wanted:.0f} would." if np.isfinite(self.wanted) else f"{few}."


def bias_of(
    own: np.ndarray,
    finer: np.ndarray,
    share: float,
    statistic: Callable[[np.ndarray], float] = np.mean,
) -> tuple[float, float]:
    """By how much a statistic is too large, and half of the 95 % interval of that: of what samples
    (pairs,) gave, and `finer` runs of theirs with steps of a `share` [1]. The interval is that of
    leaving out one pair after the other; of a mean that is Student's of the differences."""
    count = len(own)
    apart = lambda kept: (statistic(own[kept]) - statistic(finer[kept])) / (1 - share)
    whole = float(apart(np.ones(count, bool))) if count else np.nan
    if count < 2:
        return whole, np.inf
    without = np.array([apart(kept) for kept in ~np.eye(count, dtype=bool)])
    half = student(count) * float(without.std(ddof=1)) * (count - 1) / math.sqrt(count)
    return whole, half if np.isfinite(half) else np.inf
