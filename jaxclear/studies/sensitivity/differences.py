"""Derivatives of statistics by differences over common random numbers.

The same samples are run with one variable moved up and down, by two steps, and extrapolated to none
(Richardson). It owes nothing to a polynomial or a density, so it confirms what `regression` finds;
it is dear, so it begins with few samples. Where these confirm nothing, differences between two
distributions go on (`opposed`), or small steps over more samples where these are not known.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.ledger.batch import chunk_size, evaluate_all
from jaxclear.studies.sensitivity.derivative import Estimate, from_parts, refused
from jaxclear.studies.sensitivity.direction import Direction
from jaxclear.studies.sensitivity.functional import Functional
from jaxclear.studies.sensitivity.regression import pseudo_values
from jaxclear.studies.statistics.scrambled import student
from jaxclear.studies.warned import concern

# Shares of a step by which the variable is moved.
SHIFTS = np.array([-1.0, -0.5, 0.5, 1.0])
# Fewer differences have no error worth the name.
FEWEST = 8
# Where the two steps differ by more than chance, what a third would still move the answer: the
# extrapolation gains a factor of 4 a halving at least.
REMAINDER = 0.25
# Samples that differences begin with: 64 runs, a quarter of what a regression takes.
FIRST = 16


class Moved(NamedTuple):
    """Runs of a sample with one variable moved: what was found (four shifts after each other for
    each sample) and the scramblings (samples,)."""

    found: SampleResult
    group: np.ndarray

    def and_also(self, other: "Moved") -> "Moved":
        """Both samples as one."""
        both = jax.tree.map(lambda *own: np.concatenate(own), self.found, other.found)
        return Moved(both, np.concatenate([self.group, other.group]))


def looks(group: np.ndarray) -> list[np.ndarray]:
    """The samples (samples,) of each look, as masks: the first points of every scrambling, and all
    others; one look where the sample is hardly larger."""
    count, scramblings = len(group), len(np.unique(group))
    if count < 2 * FIRST:
        return [np.ones(count, bool)]
    first = _places(group) < max(FIRST // scramblings, 1)
    return [first, ~first]


def doubling(group: np.ndarray) -> list[np.ndarray]:
    """The samples (samples,) in parts, as masks: the last eighth of the points of every scrambling,
    the eighth and the quarter before, and the first half, so that each part doubles what is
    there."""
    place, each = _places(group), len(group) // len(np.unique(group))
    edges = [each, each - each // 8, each - each // 4, each // 2, 0]
    parts = [(place >= low) & (place < high) for high, low in itertools.pairwise(edges)]
    # Scramblings may differ by a point.
    parts[0] |= place >= each
    return [part for part in parts if part.any()]


def _places(group: np.ndarray) -> np.ndarray:
    """Numbers (samples,) of samples within their scramblings."""
    order, place = np.argsort(group, kind="stable"), np.zeros(len(group), int)
    place[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
    return place


def moved(
    problem: AbstractProblem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    *,
    progress_bar: bool = False,
) -> Moved:
    """The runs of a sample, values (samples, variables) and their scramblings (samples,)."""
    values, group = sample
    speed = direction.velocities(problem, values)
    axis = np.eye(values.shape[1])[direction.variable]
    shifts = SHIFTS * direction.step(problem)
    each = [values + shift * speed[:, None] * axis for shift in shifts]
    flat = np.stack(each, axis=1).reshape(-1, values.shape[1])
    # All looks run the program of the first, where it takes long to compile.
    one = not problem.at_once() and len(values) >= FIRST
    chunk = chunk_size(problem, len(SHIFTS) * FIRST) if one else None
    found = evaluate_all(
        problem, jnp.asarray(flat), chunk=chunk, progress_bar=progress_bar, label="differences"
    )
    return Moved(found, group)


def differences(
    problem: AbstractProblem, runs: Moved, direction: Direction, wanted: list[Functional]
) -> dict[str, Estimate]:
    """Central differences over common random numbers by one step of the direction and half of it,
    extrapolated; by label of the statistics."""
    step, found = direction.step(problem), runs.found
    reached = np.asarray(found.outcome) == Outcome.REACHED
    good = np.all(reached.reshape(-1, len(SHIFTS)), axis=1)
    among, group, count = np.repeat(good, len(SHIFTS)), runs.group[good], len(reached)
    answers = {}
    for one in wanted:
        if good.sum() < FEWEST:
            answers[one.label] = refused(
                f"only {good.sum()} of {len(good)} samples ran at all four widths."
            )
            continue
        rows = np.asarray(found.responses[one.response]).reshape(-1, len(SHIFTS))[good].T
        few = one.undecided(*rows, by="difference_samples") or one.unbounded(*rows)
        if few:
            answers[one.label] = refused(few)
            continue
        rows = one.bounded(rows)

        def slopes(kept, rows=rows, one=one):
            far_down, down, up, far_up = (one.value(row[kept]) for row in rows)
            wide, narrow = (far_up - far_down) / (2 * step), (up - down) / step
            return np.array([wide, narrow, (4 * narrow - wide) / 3])

        parts = pseudo_values(slopes, group).reshape(-1, 3)
        if not one.smooth:
            # What a jackknife would correct is less than the noise that it would bring.
            parts += slopes(np.ones(int(good.sum()), bool)) - parts.mean(axis=0)
        gap = parts[:, 2] - parts[:, 1]
        half = student(len(gap)) * gap.std(ddof=1) / np.sqrt(len(gap)) if len(gap) > 1 else np.inf
        # A gap within its own noise is no sign of curvature.
        bias = REMAINDER * max(abs(gap.mean()) - half, 0.0)
        told = concern(problem, one.response, found.checks, among)
        answer = from_parts(parts[:, 2], bias)
        error = answer.error * rarity(one.deciding(*rows), len(parts))
        answers[one.label] = answer._replace(
            error=error, warned=told[0], warnings=told[1], runs=count
        )
    return answers


def rarity(deciding: float, scramblings: int) -> float:
    """By how much an interval is wider where fewer samples decide than there are scramblings: their
    differences have no more degrees of freedom than these and one more. Of 128 samples the slope of
    a 96.5 % quantile is then held in 96 to 99 % of cases, without it in 93 to 96 %."""
    return max(student(2.0 + deciding) / student(scramblings), 1.0)


def refusal(problem: AbstractProblem, direction: Direction) -> str:
    """Why differences do not tell a derivative; "" where they do."""
    own = problem.inputs.distributions[direction.variable]
    if not own.is_continuous() and direction.number:
        return "the variable comes in single sizes; its width has no meaning by itself."
    return ""
