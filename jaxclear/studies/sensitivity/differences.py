"""Derivatives of statistics by differences: between runs of the same samples with one variable
moved a little, and between two distributions.

The same samples are run with one variable moved up and down, by two steps, and extrapolated to none
(Richardson). It owes nothing to a polynomial or a density, so it confirms what `regression` finds;
it is dear, so it begins with few samples. Where these confirm nothing, differences between two
distributions go on, or small steps over more samples where these are not known.

Where a variable's distribution moves or widens, some values become likelier and others less so. The
derivative of a mean is a number times the difference of two means, one over the values that gain,
one over those that lose, each a distribution of its own; ends of parts that are cut off gain or
lose as single values. Nothing is divided by a small step, so responses that jump or rattle are
differentiated as well as their scatter lets them be; it owes nothing to a score function. A line of
the variable, whose derivative is known, takes up what it explains; higher powers would hang on the
few values that lie far out, and no pairs would tell how far their sum is off.

Source: measure-valued derivatives: Pflug 1996, Optimization of Stochastic Models, Kluwer; Mohamed,
Rosca, Figurnov & Mnih 2020, J. Mach. Learn. Res. 21 (132), doi:10.48550/arXiv.1906.10652, section
6.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.integrators import Outcome
from jaxclear.studies.distribution.base import END_SCORE
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.sensitivity.derivative import Estimate, from_parts, refused
from jaxclear.studies.sensitivity.estimand import FEWEST_DECIDING, Direction, Functional, flow
from jaxclear.studies.sensitivity.regression import UNSEEN, no_score_function, normal_scores_of
from jaxclear.studies.statistics.scrambled import half_width, pseudo_values, student
from jaxclear.studies.store.batch import chunk_size, evaluate_all
from jaxclear.studies.warned import FEW_WARNED, concern

# Shares of a step by which the variable is moved.
SHIFTS = np.array([-1.0, -0.5, 0.5, 1.0])
# Fewer differences have no error worth the name.
FEWEST = 8
# Where the two steps differ by more than chance, what a third would still move the answer: the
# extrapolation gains a factor of 4 a halving at least.
REMAINDER = 0.25
# Samples that differences begin with: 64 runs, a quarter of what a regression takes.
FIRST = 16
# Cells of standard normal scores in which what is gained and lost is told.
CELLS = 4000
# Singular values below this share are none.
RANK = 1e-9
# What is missed far out counts above this share of the standard error.
SMALL = 0.3


class Runs(NamedTuple):
    """Several runs of each of a sample's values, after each other: what was found, the scramblings
    (samples,), and what is known of each sample, `terms` (samples, any number)."""

    found: SampleResult
    group: np.ndarray
    terms: np.ndarray

    def and_also(self, other: "Runs") -> "Runs":
        """Both samples as one."""
        return jax.tree.map(lambda *own: np.concatenate(own), self, other)

    def good(self) -> np.ndarray:
        """Whether all runs of a sample reached their end, (samples,)."""
        reached = np.asarray(self.found.outcome) == Outcome.REACHED
        return np.all(reached.reshape(len(self.group), -1), axis=1)

    def responses(self, name: str) -> np.ndarray:
        """Of the good samples, by which run of each: (runs of each, samples)."""
        rows = np.asarray(self.found.responses[name]).reshape(len(self.group), -1)
        return rows[self.good()].T

    def answer(self, problem: Problem, one: Functional, own: Estimate) -> Estimate:
        """An estimate with the runs that it took, those that warn, and what it leaves out: samples
        of which some runs fail and others do not lie at an edge of what can be run, where slopes
        may be any."""
        count, good = len(self.found.outcome), self.good()
        among = np.repeat(good, count // len(self.group))
        warned, warnings = concern(problem, one.response, self.found.checks, among)
        reached = np.asarray(self.found.outcome) == Outcome.REACHED
        edge = int(np.sum(reached.reshape(len(self.group), -1).any(axis=1) & ~good))
        if edge:
            out = f"{edge} of {len(good)} samples, which fail where they are moved, are left out"
            doubt = out if edge > FEW_WARNED * len(good) else ""
            own = own._replace(doubt=doubt)
            warnings = f"{warnings} {out}.".strip()
        return own._replace(warned=warned, warnings=warnings, runs=count)


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
    problem: Problem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    *,
    progress_bar: bool = False,
) -> Runs:
    """The runs of a sample, values (samples, variables) and their scramblings (samples,), with one
    variable moved: four shifts after each other for each sample."""
    values, group = sample
    speed = direction.velocities(problem, values)
    axis = np.eye(values.shape[1])[direction.variable]
    shifts = SHIFTS * direction.step(problem)
    each = np.stack([values + shift * speed[:, None] * axis for shift in shifts], axis=1)
    found = _found(problem, each, len(values) >= FIRST, progress_bar)
    return Runs(found, group, np.zeros((len(group), 0)))


def _found(problem: Problem, each: np.ndarray, padded: bool, bar: bool) -> SampleResult:
    """Runs of values (samples, runs of each, variables); where it takes long to compile, and these
    are enough, by the program of the first look."""
    one = padded and not problem.cost().cheap
    chunk = chunk_size(problem, len(SHIFTS) * FIRST) if one else None
    flat = jnp.asarray(each.reshape(-1, each.shape[2]))
    return evaluate_all(problem, flat, chunk=chunk, progress_bar=bar, label="differences")


def differences(
    problem: Problem, runs: Runs, direction: Direction, wanted: list[Functional]
) -> dict[str, Estimate]:
    """Central differences over common random numbers by one step of the direction and half of it,
    extrapolated; by label of the statistics."""
    step, good = direction.step(problem), runs.good()
    group, answers = runs.group[good], {}
    for one in wanted:
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

        def slopes(kept, rows=rows, one=one):
            far_down, down, up, far_up = (one.value(row[kept]) for row in rows)
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
        answer = from_parts(parts[:, 2], bias)
        error = answer.error * rarity(one.deciding(*rows), len(parts))
        answers[one.label] = runs.answer(problem, one, answer._replace(error=error))
    return answers


def rarity(deciding: float, scramblings: int) -> float:
    """By how much an interval is wider where fewer samples decide than there are scramblings: their
    differences have no more degrees of freedom than these and one more. Of 128 samples the slope of
    a 96.5 % quantile is then held in 96 to 99 % of cases, without it in 93 to 96 %."""
    return max(student(2.0 + deciding) / student(scramblings), 1.0)


def no_differences(problem: Problem, direction: Direction) -> str:
    """Why differences do not tell a derivative; "" where they do."""
    own = problem.inputs.distributions[direction.variable]
    if not own.is_continuous() and direction.number:
        return "the variable comes in single sizes; its width has no meaning by itself."
    return ""


class Opposed(NamedTuple):
    """What a distribution gains and loses along a direction: at `scores` (knots,) the shares
    `gained` and `lost` below, from 0 to 1; `size` [1/unit of the direction] is how much of it in
    all; `known` (2,) are the derivatives of the variable's mean and mean square about its nominal
    value."""

    scores: np.ndarray
    gained: np.ndarray
    lost: np.ndarray
    size: float
    known: np.ndarray

    def pairs(self, shares: np.ndarray) -> np.ndarray:
        """Scores (2, samples) that gain and lose, as near each other as may be, from shares
        (samples,)."""
        return np.stack([np.interp(shares, own, self.scores) for own in (self.gained, self.lost)])


def opposed_of(problem: Problem, direction: Direction) -> Opposed | None:
    """What the variable's distribution gains and loses along a direction; None where that is not
    known: single sizes, correlated variables, densities without bound."""
    if no_score_function(problem, direction) or not problem.inputs.independent:
        return None
    edges = np.linspace(-END_SCORE, END_SCORE, CELLS + 1)
    passing = flow(problem, direction, edges)
    own = problem.inputs.distributions[direction.variable]
    # Where there is no end, nothing passes it.
    passing[[0, -1]] *= np.array(own.end_densities()) > 0
    change = -np.diff(np.concatenate([[0.0], passing, [0.0]]))
    gain, loss = np.maximum(change, 0.0), np.maximum(-change, 0.0)
    size = float(gain.sum())
    if not size > 0:
        return None
    scores = np.concatenate([edges[:1], edges, edges[-1:]])
    gained, lost = (np.concatenate([[0.0], np.cumsum(p) / p.sum()]) for p in (gain, loss))
    away, density = np.asarray(own.of_score(jnp.asarray(edges))), scipy.stats.norm.pdf(edges)
    first, second = (float(np.average(away**power, weights=density)) for power in (1, 2))
    nominal = direction.number is None
    known = [1.0, 2.0 * first] if nominal else np.array([first, 2.0 * second]) / direction.number
    return Opposed(scores, gained, lost, size, np.array(known))


def paired(
    problem: Problem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    between: Opposed,
    *,
    progress_bar: bool = False,
) -> Runs:
    """The runs of a sample, values (samples, variables) and their scramblings (samples,), with the
    variable where its distribution gains and where it loses, after each other; `terms` are the
    derivatives of the variable's mean and mean square about its nominal value by each pair."""
    values, group = sample
    i, inputs = direction.variable, problem.inputs
    own, nominal = inputs.distributions[i], float(problem.nominal()[i])
    shares = scipy.stats.norm.cdf(np.asarray(normal_scores_of(inputs, jnp.asarray(values)))[:, i])
    away = np.asarray(own.of_score(jnp.asarray(between.pairs(shares))))
    both = np.stack([values, values], axis=1)
    both[:, :, i] = nominal + away.T
    powers = np.stack([away, away**2], axis=2)
    terms = between.size * (powers[0] - powers[1])
    return Runs(_found(problem, both, True, progress_bar), group, terms)


def between_distributions(
    problem: Problem, pairs: Runs, between: Opposed, wanted: list[Functional]
) -> dict[str, Estimate]:
    """Derivatives by differences between two distributions, by label of the statistics, which are
    means of functions of the response; of those only that enough pairs decide."""
    good = pairs.good()
    group = pairs.group[good]
    line, square = (pairs.terms[good] - between.known).T
    terms = np.column_stack([np.ones(len(group)), line])
    answers = {}
    for one in wanted:
        rows = pairs.responses(one.response)
        # All that gain may lie beyond a limit and all that lose below: the clearest case there is.
        deciding = one.deciding(rows.ravel())
        if len(group) < FEWEST or deciding < FEWEST_DECIDING or one.unbounded(*rows):
            continue
        rows = one.bounded(rows)
        of = one.influence(rows.ravel())
        apart = between.size * (of(rows[0]) - of(rows[1]))

        def slope(kept, apart=apart):
            return np.linalg.lstsq(terms[kept], apart[kept], rcond=RANK)[0][0]

        rare = sum(one.deciding(row) < FEWEST_DECIDING for row in rows)
        # With their scatter the bound for none holds for up to three seen, too.
        unseen = between.size * UNSEEN / len(group) * np.sqrt(rare)
        parts, missed = pseudo_values(slope, group), _missed(apart, terms, square)
        few = missed <= SMALL * parts.std() / np.sqrt(len(parts))
        answer = from_parts(parts, float(unseen if few else np.hypot(unseen, missed)))
        error = answer.error * rarity(deciding, len(parts))
        answers[one.label] = pairs.answer(problem, one, answer._replace(error=error))
    return {label: answer for label, answer in answers.items() if not answer.refusal}


def _missed(apart: np.ndarray, terms: np.ndarray, square: np.ndarray) -> float:
    """How far the derivative of the variable's own mean square, which is known, is off by these
    pairs, as much of it as is in the differences: what few values far out decide, whose scatter no
    few pairs show."""
    off = np.linalg.lstsq(terms, square, rcond=RANK)[0][0]
    beside = np.column_stack([terms, square])
    return float(abs(np.linalg.lstsq(beside, apart, rcond=RANK)[0][2] * off))
