"""Cycles, one after the other on the same surfaces, until one ends as it began; and means over
cycles where none does.

Surfaces are put back after every cycle: what wears in one is far below what moves a journal, and so
the motion has a state to settle in.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxclear.results.state_history import SavedMotion
from jaxclear.simulation.wear import Worn
from jaxclear.studies.life.cycle import Cycle

# A mean over fewer cycles has no error worth the name.
FEWEST = 4
# A correlation of neighbours above this is told from a trend by no few cycles.
MOST_CORRELATED = 0.9
# Of a volume [m3] that is none.
TINY = np.finfo(float).tiny

Runner = Callable[[SavedMotion, Worn], Cycle]


class Patience(NamedTuple):
    """When settling ends: ends of a cycle `within` of each other [1] (`Cycle`), the mean of
    the volume lost known to `noise` (1: as large as itself), or after `most` cycles."""

    within: float
    noise: float
    most: int


class Settling(NamedTuple):
    """The cycles of one settling, whether the last is periodic, and how many of the last ones are
    to be taken as the motion."""

    cycles: tuple[Cycle, ...]
    periodic: bool
    measured: int

    @property
    def taken(self) -> tuple[Cycle, ...]:
        """The cycles that are taken as the motion."""
        return self.cycles[-self.measured :]

    @property
    def last(self) -> Cycle:
        return self.cycles[-1]

    @property
    def wear(self) -> Worn:
        """Depth [m] that a cycle wears, by joint and surface."""
        return _mean_over_cycles([c.wore for c in self.taken])

    @property
    def noise(self) -> Worn:
        """Standard error of `wear` [m]; 0 where the motion is periodic."""
        return self._errors([c.wore for c in self.taken])

    @property
    def by_saves(self) -> Worn:
        """By how much `wear` would be another one if surfaces were updated at every fourth of the
        saving times alone [m]."""
        return _mean_over_cycles(
            [jax.tree.map(lambda a, b: a - b, c.wore_by_fourths, c.wore) for c in self.taken]
        )

    @property
    def volumes(self) -> Worn:
        """Volume [m3] that a cycle takes, by joint and surface."""
        return _mean_over_cycles([c.volumes for c in self.taken])

    @property
    def volume_noise(self) -> Worn:
        """Standard error of `volumes` [m3]."""
        return self._errors([c.volumes for c in self.taken])

    def _errors(self, of_cycles: list[Worn]) -> Worn:
        """Standard errors of means over the cycles taken, which are alike as their volumes are."""
        factor = correlation_factor([total(c) for c in self.taken])
        return jax.tree.map(lambda *all: factor * standard_error(np.stack(all)), *of_cycles)

    @property
    def relative_noise(self) -> float:
        """Standard error of the volume that a cycle takes beside it, of the worst surface."""
        shares = jax.tree.map(lambda e, v: e / max(v, TINY), self.volume_noise, self.volumes)
        return float(max(jax.tree.leaves(shares), default=0.0))

    def responses(self) -> dict[str, tuple[float, float]]:
        """Mean of each response over the cycles taken, and its standard error."""
        means = {}
        for name in self.last.responses:
            values = np.array([c.responses[name] for c in self.taken])
            error = correlation_factor(values) * float(standard_error(values))
            means[name] = float(values.mean()), error
        return means


def _mean_over_cycles(of_cycles: list[Worn]) -> Worn:
    return jax.tree.map(lambda *all: np.mean(all, axis=0), *of_cycles)


def total(cycle: Cycle) -> float:
    """Volume [m3] lost in a cycle by all surfaces."""
    return float(sum(jax.tree.leaves(cycle.volumes)))


def standard_error(values: np.ndarray) -> np.ndarray:
    """Of the mean over the first axis, as if the values were independent."""
    if len(values) < 2:
        return np.zeros(values.shape[1:])
    return values.std(axis=0, ddof=1) / np.sqrt(len(values))


def correlation_factor(values: Any) -> float:
    """By how much a standard error is larger because neighbours are alike: that of a series whose
    correlation falls geometrically, from its first correlation.

    Source: Box, Jenkins & Reinsel 2008, Time Series Analysis, 4th ed., chapter 2.
    """
    deviations = np.asarray(values) - np.mean(values)
    spread = float(np.sum(deviations * deviations))
    if len(deviations) < 2 or spread == 0:
        return 1.0
    rho = min(max(float(np.sum(deviations[1:] * deviations[:-1])) / spread, 0.0), MOST_CORRELATED)
    return float(np.sqrt((1 + rho) / (1 - rho)))


def settle(
    run: Runner,
    begin: SavedMotion,
    worn: Worn,
    patience: Patience,
    ready: Callable = lambda c: True,
    least: int = 1,
) -> Settling:
    """Cycles from a state until one is periodic, or their mean is accurate, or patience ends.

    Without a periodic one, all but the first count where a mean was wanted, otherwise the later
    half. A cycle that fails is the last.

    Args:
        run: function of a motion and worn surfaces: a cycle.
        begin: motion at the first.
        worn: depth maps [m] by joint and surface.
        patience: largest number of cycles, distance of a periodic one, noise of a mean.
        ready: further condition on the last cycle.
        least: smallest number of cycles.
    """
    cycles: list[Cycle] = []
    while len(cycles) < patience.most:
        one = run(begin, worn)
        cycles.append(one)
        if one.fault:
            return Settling(tuple(cycles), False, 1)
        begin = one.end
        if len(cycles) >= least and one.distance <= patience.within and ready(one):
            return Settling(tuple(cycles), True, 1)
        # The first one falls into its place.
        settling = Settling(tuple(cycles), False, len(cycles) - 1)
        is_measured = settling.measured >= FEWEST and settling.relative_noise <= patience.noise
        if is_measured and patience.noise < 1 and ready(one):
            return settling
    mean_count = len(cycles) - 1 if patience.noise < 1 else len(cycles) // 2
    return Settling(tuple(cycles), False, max(1, mean_count))
