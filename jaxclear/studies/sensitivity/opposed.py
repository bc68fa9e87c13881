"""Differences between two distributions: what the derivative of a distribution is.

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

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.integrators import Outcome
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.distribution.base import END_SCORE
from jaxclear.studies.ledger.batch import chunk_size, evaluate_all
from jaxclear.studies.sensitivity.derivative import Estimate, from_parts
from jaxclear.studies.sensitivity.differences import FEWEST, FIRST, SHIFTS, rarity
from jaxclear.studies.sensitivity.direction import Direction, flow
from jaxclear.studies.sensitivity.functional import FEWEST_DECIDING, Functional
from jaxclear.studies.sensitivity.outer import UNSEEN
from jaxclear.studies.sensitivity.regression import normal_scores_of, pseudo_values, refusal
from jaxclear.studies.warned import concern

# Cells of standard normal scores in which what is gained and lost is told.
CELLS = 4000
# Singular values below this share are none.
RANK = 1e-9
# What is missed far out counts above this share of the standard error.
SMALL = 0.3


class Opposed(NamedTuple):
    """What a distribution gains and loses: at `scores` (knots,) the shares `gained` and `lost`
    below, from 0 to 1; `size` [1/unit of the direction] is how much of it in all."""

    scores: np.ndarray
    gained: np.ndarray
    lost: np.ndarray
    size: float

    def pairs(self, shares: np.ndarray) -> np.ndarray:
        """Scores (2, samples) that gain and lose, as near each other as may be, from shares
        (samples,)."""
        return np.stack([np.interp(shares, own, self.scores) for own in (self.gained, self.lost)])


def opposed_of(problem: AbstractProblem, direction: Direction) -> Opposed | None:
    """What the variable's distribution gains and loses along a direction; None where that is not
    known: single sizes, correlated variables, densities without bound."""
    if refusal(problem, direction) or not problem.inputs.independent:
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
    below = [np.concatenate([[0.0], np.cumsum(part) / part.sum()]) for part in (gain, loss)]
    return Opposed(scores, below[0], below[1], size)


class Pairs(NamedTuple):
    """Runs of pairs of values, one that gains and one that loses: what was found (pairs after each
    other), scramblings (samples,), derivatives (samples, 2) of the variable's mean and mean square
    about its nominal value by each pair and what they are in the mean, `known` (2,), and the `size`
    by which differences count."""

    found: SampleResult
    group: np.ndarray
    terms: np.ndarray
    known: np.ndarray
    size: float

    def and_also(self, other: "Pairs") -> "Pairs":
        """Both samples as one."""
        found = jax.tree.map(lambda *own: np.concatenate(own), self.found, other.found)
        group = np.concatenate([self.group, other.group])
        terms = np.concatenate([self.terms, other.terms])
        return self._replace(found=found, group=group, terms=terms)


def paired(
    problem: AbstractProblem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    between: Opposed,
    *,
    progress_bar: bool = False,
) -> Pairs:
    """The runs of a sample, values (samples, variables) and their scramblings (samples,), with the
    variable in question where its distribution gains and loses."""
    values, group = sample
    i, inputs = direction.variable, problem.inputs
    own, nominal = inputs.distributions[i], float(problem.nominal()[i])
    shares = scipy.stats.norm.cdf(np.asarray(normal_scores_of(inputs, jnp.asarray(values)))[:, i])
    away = np.asarray(own.of_score(jnp.asarray(between.pairs(shares))))
    both = np.repeat(values, 2, axis=0)
    both[:, i] = nominal + away.T.ravel()
    # The program of the differences.
    chunk = None if problem.at_once() else chunk_size(problem, len(SHIFTS) * FIRST)
    found = evaluate_all(
        problem, jnp.asarray(both), chunk=chunk, progress_bar=progress_bar, label="differences"
    )
    powers = np.stack([away, away**2], axis=2)
    terms = between.size * (powers[0] - powers[1])
    return Pairs(found, group, terms, _known(problem, direction), between.size)


def _known(problem: AbstractProblem, direction: Direction) -> np.ndarray:
    """Derivatives (2,) of the variable's mean and mean square about its nominal value along a
    direction."""
    edges = np.linspace(-END_SCORE, END_SCORE, CELLS + 1)
    own = problem.inputs.distributions[direction.variable]
    away = np.asarray(own.of_score(jnp.asarray(edges)))
    weights = scipy.stats.norm.pdf(edges)
    first, second = (float(np.average(away**power, weights=weights)) for power in (1, 2))
    if direction.number is None:
        return np.array([1.0, 2.0 * first])
    return np.array([first, 2.0 * second]) / direction.number


def between_distributions(
    problem: AbstractProblem, pairs: Pairs, wanted: list[Functional]
) -> dict[str, Estimate]:
    """Derivatives by differences between two distributions, by label of the statistics, which are
    means of functions of the response; of those only that enough pairs decide."""
    reached = np.asarray(pairs.found.outcome) == Outcome.REACHED
    good = np.all(reached.reshape(-1, 2), axis=1)
    among, group = np.repeat(good, 2), pairs.group[good]
    line, square = (pairs.terms[good] - pairs.known).T
    terms = np.column_stack([np.ones(len(group)), line])
    answers = {}
    for one in wanted:
        rows = np.asarray(pairs.found.responses[one.response]).reshape(-1, 2)[good].T
        # All that gain may lie beyond a limit and all that lose below: the clearest case there is.
        deciding = one.deciding(rows.ravel())
        if len(group) < FEWEST or deciding < FEWEST_DECIDING or one.unbounded(*rows):
            continue
        rows = one.bounded(rows)
        of = one.influence(rows.ravel())
        differences = pairs.size * (of(rows[0]) - of(rows[1]))

        def slope(kept, differences=differences):
            return np.linalg.lstsq(terms[kept], differences[kept], rcond=RANK)[0][0]

        told = concern(problem, one.response, pairs.found.checks, among)
        rare = sum(one.deciding(row) < FEWEST_DECIDING for row in rows)
        # With their scatter the bound for none holds for up to three seen, too.
        unseen = pairs.size * UNSEEN / len(group) * np.sqrt(rare)
        parts, missed = pseudo_values(slope, group), _missed(differences, terms, square)
        few = missed <= SMALL * parts.std() / np.sqrt(len(parts))
        answer = from_parts(parts, float(unseen if few else np.hypot(unseen, missed)))
        answers[one.label] = answer._replace(
            error=answer.error * rarity(deciding, len(parts)),
            warned=told[0],
            warnings=told[1],
            runs=len(reached),
        )
    return {label: answer for label, answer in answers.items() if not answer.refusal}


def _missed(differences: np.ndarray, terms: np.ndarray, square: np.ndarray) -> float:
    """How far the derivative of the variable's own mean square, which is known, is off by these
    pairs, as much of it as is in the differences: what few values far out decide, whose scatter no
    few pairs show."""
    off = np.linalg.lstsq(terms, square, rcond=RANK)[0][0]
    beside = np.column_stack([terms, square])
    return float(abs(np.linalg.lstsq(beside, differences, rcond=RANK)[0][2] * off))
