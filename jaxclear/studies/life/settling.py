"""Cycles, one after the other on the same surfaces, until one ends as it began; and means over
cycles where none does. Where a motion is known not to settle, several lanes of cycles go on side by
side, each by itself; then their means tell how far the mean of all is known.

Surfaces are put back after every cycle: what wears in one is far below what moves a journal, and so
the motion has a state to settle in.
"""

from collections.abc import Callable, Sequence
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
# Lanes go in file where their cycles differ by less than this share of what independent ones would:
# of seven pairs of those, two in a thousand.
IN_FILE = 0.35
# Of a volume [m3] that is none.
TINY = np.finfo(float).tiny

# Errors are told as those of normal variables, of which 95 % lie within this many.
NORMAL = 1.96

Runner = Callable[[SavedMotion, Worn], Cycle]
Runners = Callable[[Sequence[SavedMotion], Worn], list[Cycle]]


class Patience(NamedTuple):
    """When settling ends: ends of a cycle `within` of each other [1] (`Cycle`), the mean of
    the volume lost known to `noise` (1: as large as itself; of lanes: what is worn everywhere), or
    after `most` cycles."""

    within: float
    noise: float
    most: int


class Settling(NamedTuple):
    """The cycles of one settling, whether the last is periodic, and how many of the last ones are
    to be taken as the motion: those of one lane after those of the other, where there are
    several."""

    cycles: tuple[Cycle, ...]
    periodic: bool
    measured: int
    lanes: int = 1

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
        return _means([c.wore for c in self.taken])

    @property
    def noise(self) -> Worn:
        """Standard error of `wear` [m]; 0 where the motion is periodic."""
        return self._errors([c.wore for c in self.taken])

    @property
    def by_saves(self) -> Worn:
        """By how much `wear` would be another one with every fourth of the saving times [m]."""
        return _means(
            [jax.tree.map(lambda a, b: a - b, c.wore_by_fourths, c.wore) for c in self.taken]
        )

    @property
    def lost(self) -> Worn:
        """Volume [m3] that a cycle takes, by joint and surface."""
        return _means([c.lost for c in self.taken])

    @property
    def noise_of_lost(self) -> Worn:
        """Standard error of `lost` [m3]."""
        return self._errors([c.lost for c in self.taken])

    @property
    def ends(self) -> tuple[Cycle, ...]:
        """The last cycle of each lane."""
        return self.taken[:: -(self.measured // self.lanes)][::-1]

    def _errors(self, of_cycles: list[Worn]) -> Worn:
        """Standard errors of means over the cycles taken: those of one lane are alike as their
        volumes are, lanes are independent."""
        if self.lanes > 1:
            return jax.tree.map(lambda *all: self._between_lanes(np.stack(all)), *of_cycles)
        factor = correlation_factor([total(c) for c in self.taken])
        return jax.tree.map(lambda *all: factor * standard_error(np.stack(all)), *of_cycles)

    def _between_lanes(self, values: np.ndarray) -> np.ndarray:
        """Standard error of a mean over the cycles taken, from the means of the lanes; larger by
        Student's factor, as lanes are few."""
        import scipy.stats

        means = values.reshape(self.lanes, -1, *values.shape[1:]).mean(axis=1)
        return float(scipy.stats.t.ppf(0.975, self.lanes - 1)) / NORMAL * standard_error(means)

    @property
    def relative_noise(self) -> float:
        """Standard error of the volume that a cycle takes beside it, of the worst surface."""
        shares = jax.tree.map(lambda e, v: e / max(v, TINY), self.noise_of_lost, self.lost)
        return float(max(jax.tree.leaves(shares), default=0.0))

    def responses(self) -> dict[str, tuple[float, float]]:
        """Mean of each response over the cycles taken, and its standard error."""
        found = {}
        for name in self.last.responses:
            own = np.array([c.responses[name] for c in self.taken])
            if self.lanes > 1:
                error = float(self._between_lanes(own))
            else:
                error = correlation_factor(own) * float(standard_error(own))
            found[name] = float(own.mean()), error
        return found


def _means(of_cycles: list[Worn]) -> Worn:
    return jax.tree.map(lambda *all: np.mean(all, axis=0), *of_cycles)


def total(cycle: Cycle) -> float:
    """Volume [m3] lost in a cycle by all surfaces."""
    return float(sum(jax.tree.leaves(cycle.lost)))


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
    apart = np.asarray(values) - np.mean(values)
    spread = float(np.sum(apart * apart))
    if len(apart) < 2 or spread == 0:
        return 1.0
    alike = min(max(float(np.sum(apart[1:] * apart[:-1])) / spread, 0.0), MOST_CORRELATED)
    return float(np.sqrt((1 + alike) / (1 - alike)))


def settle(
    run: Runner,
    begin: SavedMotion,
    worn: Worn,
    patience: Patience,
    ready: Callable = lambda c: True,
    least: int = 1,
) -> Settling:
    """At `least` so many cycles from a state until one is periodic and `ready`, until their mean
    is known well enough, or until patience ends. Then all but the first are taken where a mean was
    wanted, otherwise the later half. A cycle that fails is the last."""
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
        found = Settling(tuple(cycles), False, len(cycles) - 1)
        known = found.measured >= FEWEST and found.relative_noise <= patience.noise
        if known and patience.noise < 1 and ready(one):
            return found
    wanted = len(cycles) - 1 if patience.noise < 1 else len(cycles) // 2
    return Settling(tuple(cycles), False, max(1, wanted))


def settle_side_by_side(
    run: Runners,
    begins: Sequence[SavedMotion],
    worn: Worn,
    patience: Patience,
    known: Callable[[Settling], bool],
) -> Settling | None:
    """Lanes of cycles from several states of a motion that does not settle, until their means are
    `known` well enough or patience ends. The first of each lane falls into its place and is not
    taken, nor are those with which lanes go in file: they do not tell how far a mean is known. A
    cycle that fails is the last. None where lanes go in file until patience ends."""
    rounds: list[list[Cycle]] = []
    first = 1
    while True:
        rounds.append(run(begins, worn))
        fault = next((one for one in rounds[-1] if one.fault), None)
        if fault is not None:
            return Settling((fault,), False, 1)
        begins = [one.end for one in rounds[-1]]
        if len(rounds) > 1 and _in_file(*rounds[-2:]):
            first = len(rounds)
        ends = (len(rounds) + 1) * len(begins) > patience.most
        if first < len(rounds):
            by_lane = [one for lane in zip(*rounds[first:], strict=True) for one in lane]
            before = [one for lanes in rounds[:first] for one in lanes]
            found = Settling((*before, *by_lane), False, len(by_lane), len(begins))
            if ends or known(found):
                return found
        elif ends and len(rounds) > 1:
            return None


def _in_file(before: list[Cycle], now: list[Cycle]) -> bool:
    """Whether each lane goes the way of the next one a cycle later: as they do that have begun one
    after the other on one path, until neighbouring paths have parted."""
    lost = np.array([[total(one) for one in lanes] for lanes in (before, now)])
    apart = lost[1, :-1] - lost[0, 1:]
    return bool(np.mean(apart * apart) < 2 * IN_FILE**2 * np.var(lost))
