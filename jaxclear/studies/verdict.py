"""How far an integrator's answers are from the reference's, and whether that is near enough.

Two runs of the reference, one ten times tighter than the other, tell how far it can be trusted.
Where they agree to half the accuracy asked, every copy is compared with itself and the worst
counts, with something to spare for copies that were not seen; shorter runs, in which impacts meet
the steps elsewhere, count with them. Where they do not, single runs are not reproducible (rattling
is chaotic), and means over the copies are compared, with the 95 % error of their difference; as
they are where only means are asked for. If the copies are too few to show the accuracy, the limit
is what they can show, and the answer must say so.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxclear.studies.advice.pilot import Trial
from jaxclear.studies.statistics.scrambled import student

# Share of the accuracy that the reference may use up before means are compared instead of runs.
TRUSTED = 0.5
# Means over fewer copies have no error worth the name.
FEWEST = 3
# Right answers scatter about a reference that scatters as much, and have their own error: together
# twice what the reference shows (means), three times for single runs, of which only one difference
# is known.
SLACK_OF_MEANS, SLACK_OF_RUNS = 2.0, 3.0
# Of n copies the worst must keep within n / (n + SPARED) of the accuracy: then another one exceeds
# it about once in a hundred where errors scatter normally, whatever n.
SPARED = 3.0


class Criterion(NamedTuple):
    """How one response is judged: the reference's answers (runs,), their size, whether means are
    compared, how far the reference can be trusted, the largest error that passes and the accuracy
    asked, these three as shares of the size."""

    reference: np.ndarray
    size: float
    by_means: bool
    trust: float
    limit: float
    accuracy: float


class MeasuredError(NamedTuple):
    """Error of one response as a share of its size, and how far off that may be."""

    error: float
    uncertainty: float


def difference(a: np.ndarray, b: np.ndarray, size: float, by_means: bool) -> MeasuredError:
    """Largest difference between runs, or difference of the means with its 95 % error."""
    gap = (a - b) / size
    if not by_means:
        return MeasuredError(float(np.max(np.abs(gap))), 0.0)
    width = student(len(gap)) * gap.std(ddof=1) / np.sqrt(len(gap))
    return MeasuredError(float(abs(gap.mean())), float(width))


def criterion(
    loose: np.ndarray,
    tight: np.ndarray,
    accuracy: float,
    size: float | None = None,
    means: bool = False,
    copies: int | None = None,
) -> Criterion:
    """What two runs of the reference demand of a response at this accuracy; its size is its root
    mean square over the `copies` unless given, which stand before the shorter runs (None: there are
    no others).
    """
    size = float(np.sqrt(np.mean(tight[:copies] ** 2))) if size is None else size
    trust = difference(loose, tight, size, False).error
    if trust <= TRUSTED * accuracy and not (means and len(tight[:copies]) >= FEWEST):
        return Criterion(tight, size, False, trust, _spare(len(tight)) * accuracy, accuracy)
    if len(tight[:copies]) < FEWEST:
        return Criterion(tight, size, False, trust, max(accuracy, SLACK_OF_RUNS * trust), accuracy)
    loose, tight = loose[:copies], tight[:copies]
    trust = sum(difference(loose, tight, size, True))
    return Criterion(
        0.5 * (loose + tight), size, True, trust, max(accuracy, SLACK_OF_MEANS * trust), accuracy
    )


def _spare(copies: int) -> float:
    """Share of the accuracy that the worst of so many copies may use up."""
    return copies / (copies + SPARED) if copies > 1 else 1.0


def criteria(
    reference: tuple[Trial, ...],
    names: tuple[str, ...],
    accuracy: float,
    sizes: Mapping[str, float],
    means: bool,
    copies: int | None = None,
) -> dict[str, Criterion]:
    """How each response is judged by the reference (looser, tight); `sizes` are those given by
    the user; `copies`: see `criterion`.
    """
    loose, tight = (trial.responses for trial in reference)
    return {
        name: criterion(loose[name], tight[name], accuracy, sizes.get(name), means, copies)
        for name in names
    }


def error_of(answers: np.ndarray, criterion: Criterion) -> MeasuredError:
    """Error of a response by its standard; nan where a run failed."""
    answers = answers[: len(criterion.reference)]
    if not np.all(np.isfinite(answers)):
        return MeasuredError(np.nan, np.nan)
    found = difference(answers, criterion.reference, criterion.size, criterion.by_means)
    return found if criterion.by_means else MeasuredError(found.error, criterion.trust)


def errors(trial: Trial, criteria: dict[str, Criterion]) -> dict[str, MeasuredError]:
    """Scores of all responses."""
    return {
        name: error_of(trial.responses[name], criterion) for name, criterion in criteria.items()
    }


def worst(trial: Trial, criteria: dict[str, Criterion]) -> tuple[str, float]:
    """The response nearest to or furthest beyond its limit, and its error with uncertainty as a
    multiple of that limit.
    """
    shares = {
        name: sum(found) / criteria[name].limit for name, found in errors(trial, criteria).items()
    }
    name = max(shares, key=lambda n: np.inf if np.isnan(shares[n]) else shares[n])
    return name, np.inf if np.isnan(shares[name]) else shares[name]


def passes(trial: Trial, criteria: dict[str, Criterion]) -> bool:
    """True where every response, its uncertainty added, is within its limit."""
    return worst(trial, criteria)[1] <= 1.0


def undecided(trial: Trial, criteria: dict[str, Criterion]) -> bool:
    """True where a trial does not pass only because the copies are too few to tell its means from
    the reference's.
    """
    found = errors(trial, criteria)
    return not passes(trial, criteria) and all(
        sum(one) <= criteria[name].limit
        or (criteria[name].by_means and one.error <= one.uncertainty)
        for name, one in found.items()
    )


def copies_to_decide(trial: Trial, criteria: dict[str, Criterion]) -> int:
    """Copies with which an undecided trial could pass: an uncertainty falls with the root of their
    number.
    """
    found = errors(trial, criteria)
    excess = max(
        sum(found[name]) / criterion.accuracy
        for name, criterion in criteria.items()
        if criterion.by_means
    )
    return int(np.ceil(len(trial.outcome) * excess**2))


def shown(trials: tuple[Trial, ...], criteria: dict[str, Criterion]) -> list[int]:
    """The trials of a method that pass and whose finer neighbour passes too: one that passes alone
    may do so by luck.
    """
    good = [passes(trial, criteria) for trial in trials]
    return [i for i in range(len(good) - 1) if good[i] and good[i + 1]]


def coarsest(trials: tuple[Trial, ...], criteria: dict[str, Criterion]) -> int | None:
    """The first trial of a method that is `shown`; None without one."""
    return next(iter(shown(trials, criteria)), None)
