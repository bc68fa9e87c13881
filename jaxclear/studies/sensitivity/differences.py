"""Derivatives of statistics by differences: between runs of the same samples with one variable
moved a little.

The same samples are run with one variable moved up and down, by two steps, and extrapolated to none
(Richardson). It owes nothing to a polynomial or a density, so it confirms what `regression` finds;
it is dear, so it begins with few samples and doubles them while these confirm nothing.

Where a distribution is cut off, the share of parts beyond a limit bends as its end passes the
limit: by as much as its density there, at the most, which is part of the error.
"""

import itertools
from typing import NamedTuple

import jax
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.studies.distribution.base import END_SCORE
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import FEW_WARNED, concern
from jaxclear.studies.sensitivity.derivative import Estimate, from_parts, refused
from jaxclear.studies.sensitivity.estimand import FEWEST_DECIDING, Direction, Functional
from jaxclear.studies.statistics.scrambled import half_width, pseudo_values, student
from jaxclear.studies.store.batch import chunk_size, evaluate_all

# Shares of a step by which the variable is moved.
SHIFTS = np.array([-1.0, -0.5, 0.5, 1.0])
# Fewer differences have no error worth the name.
FEWEST = 8
# Where the two steps differ by more than chance, what a third would still move the answer: the
# extrapolation gains a factor of 4 a halving at least.
REMAINDER = 0.25
# Samples that differences begin with: 64 runs, a quarter of what a regression takes.
FIRST = 16


class Runs(NamedTuple):
    """Several runs of each of a sample's values, after each other: what was found, and the
    scramblings (samples,)."""

    result: SampleResult
    group: np.ndarray

    def and_also(self, other: "Runs") -> "Runs":
        """Both samples as one."""
        return jax.tree.map(lambda *arrays: np.concatenate(arrays), self, other)

    def good(self) -> np.ndarray:
        """Whether all runs of a sample reached their end, (samples,)."""
        reached = np.asarray(self.result.outcome) == Outcome.REACHED
        return np.all(reached.reshape(len(self.group), -1), axis=1)

    def responses(self, name: str) -> np.ndarray:
        """Of the good samples, by which run of each: (runs of each, samples)."""
        rows = np.asarray(self.result.responses[name]).reshape(len(self.group), -1)
        return rows[self.good()].T

    def answer(self, problem: Problem, one: Functional, estimate: Estimate) -> Estimate:
        """An estimate with its runs, their warnings, and a doubt where samples fail in part.

        Samples of which some runs fail and others do not lie at an edge of what can be run, where
        slopes may be any.

        Args:
            problem: says what concerns the response.
            one: statistic that is differentiated.
            estimate: without these.
        """
        count, good = len(self.result.outcome), self.good()
        among = np.repeat(good, count // len(self.group))
        warned, warnings = concern(problem, one.response, self.result.checks, among)
        reached = np.asarray(self.result.outcome) == Outcome.REACHED
        edge = int(np.sum(reached.reshape(len(self.group), -1).any(axis=1) & ~good))
        if edge:
            out = f"{edge} of {len(good)} samples, which fail where they are moved, are left out"
            doubt = out if edge > FEW_WARNED * len(good) else ""
            estimate = estimate._replace(doubt=doubt)
            warnings = f"{warnings} {out}.".strip()
        return estimate._replace(warned=warned, warnings=warnings, runs=count)


def looks(group: np.ndarray) -> list[np.ndarray]:
    """The samples (samples,) of each look, as masks: the first points of every scrambling, and so
    many more that each look doubles what is there."""
    order, place = np.argsort(group, kind="stable"), np.zeros(len(group), int)
    place[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
    most, ends = place.max() + 1, [0, max(FIRST // len(np.unique(group)), 1)]
    while ends[-1] < most:
        # Less than twice as many more are no look of their own.
        ends.append(2 * ends[-1] if 4 * ends[-1] <= most else most)
    return [(place >= low) & (place < high) for low, high in itertools.pairwise(ends)]


def moved(
    problem: Problem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    *,
    progress_bar: bool = False,
) -> Runs:
    """Runs of a sample with one variable moved: four shifts of each sample, one after the other.

    Args:
        problem: with the variables.
        sample: values (samples, variables) and scramblings (samples,).
        direction: variable and number that is differentiated by.
        progress_bar: whether one is shown.
    """
    values, group = sample
    speed = direction.velocities(problem, values)
    axis = np.eye(values.shape[1])[direction.variable]
    shifts = SHIFTS * direction.step(problem)
    each = np.stack([values + shift * speed[:, None] * axis for shift in shifts], axis=1)
    # Where it takes long to compile, and these are enough, by the program of the first look.
    one = len(values) >= FIRST and not problem.cost().cheap
    chunk = chunk_size(problem, len(SHIFTS) * FIRST) if one else None
    flat = each.reshape(-1, each.shape[2])
    rows = evaluate_all(problem, flat, chunk=chunk, progress_bar=progress_bar, label="differences")
    return Runs(rows, group)


def differences(
    problem: Problem, runs: Runs, direction: Direction, functionals: list[Functional]
) -> dict[str, Estimate]:
    """Central differences over common random numbers, extrapolated from two steps, by label.

    Args:
        problem: with the variables.
        runs: shifted runs (`moved`).
        direction: variable, number and step.
        functionals: statistics that are differentiated.
    """
    step, good = direction.step(problem), runs.good()
    group, answers = runs.group[good], {}
    for one in functionals:
        if good.sum() < FEWEST:
            answers[one.label] = refused(
                f"only {good.sum()} of {len(good)} samples ran at all four widths."
            )
            continue
        rows = runs.responses(one.response)
        few = one.undecided(*rows, by="difference_samples") or one.unbounded(*rows)
        if few:
            answers[one.label] = refused(few)
            continue
        rows = one.bounded(rows)

        def slopes(mask, rows=rows, one=one):
            far_down, down, up, far_up = (one.value(row[mask]) for row in rows)
            wide, narrow = (far_up - far_down) / (2 * step), (up - down) / step
            return np.array([wide, narrow, (4 * narrow - wide) / 3])

        parts = pseudo_values(slopes, group).reshape(-1, 3)
        if not one.smooth:
            # What a jackknife would correct is less than the noise that it would bring.
            parts += slopes(np.ones(int(good.sum()), bool)) - parts.mean(axis=0)
        gap = parts[:, 2] - parts[:, 1]
        half = half_width(gap) if len(gap) > 1 else np.inf
        # A gap within its own noise is no sign of curvature.
        bias = REMAINDER * max(abs(gap.mean()) - half, 0.0)
        bias = np.hypot(bias, _bend(problem, direction, one, rows))
        answer = from_parts(parts[:, 2], bias)
        error = answer.error * rarity(one.deciding(*rows), len(parts))
        answers[one.label] = runs.answer(problem, one, answer._replace(error=error))
    return answers


def _bend(problem: Problem, direction: Direction, one: Functional, rows: np.ndarray) -> float:
    """By how much the derivative of a share may change within a step: where one of the shifted
    samples, rows (shifts, samples), hardly passes the limit, an end of the distribution has passed
    it."""
    if one.kind not in ("above", "below") or one.deciding(*rows) < FEWEST_DECIDING:
        return 0.0
    if min(one.deciding(row) for row in rows) >= FEWEST_DECIDING:
        return 0.0
    distribution = problem.inputs.distributions[direction.variable]
    densities = np.array(distribution.end_densities())
    if not densities.any():
        return 0.0
    ends = np.asarray(distribution.of_score(np.array([-END_SCORE, END_SCORE])))
    speeds = np.ones(2) if direction.number is None else ends / direction.number
    return float(np.max(np.abs(speeds) * densities))


def rarity(deciding: float, scramblings: int) -> float:
    """By how much an interval is wider where fewer samples decide than there are scramblings: their
    differences have no more degrees of freedom than these and one more. Of 128 samples the slope of
    a 96.5 % quantile is then held in 96 to 99 % of cases, without it in 93 to 96 %."""
    return max(student(2.0 + deciding) / student(scramblings), 1.0)


def no_differences(problem: Problem, direction: Direction) -> str:
    """Why differences do not tell a derivative; "" where they do."""
    distribution = problem.inputs.distributions[direction.variable]
    if not distribution.is_continuous() and direction.number:
        return "the variable comes in single sizes; its width has no meaning by itself."
    return ""
