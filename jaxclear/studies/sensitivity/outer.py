"""Runs further out than the sample: what parts do that it has hardly seen.

A kink or jump far out lies in few samples, or in none, and a sample that lacks it tells nothing of
its weight. So some runs are drawn from wider distributions. They join the sample with the weights
of a mixture, which leaves means without bias and bounds every weight; what a polynomial misses
among them tells how much parts that no run has seen may add.

Source: Hesterberg 1995, Technometrics 37, 185, doi:10.1080/00401706.1995.10484303 (defensive
importance sampling); Owen & Zhou 2000, J. Am. Stat. Assoc. 95, 135,
doi:10.1080/01621459.2000.10473909.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.integrators import Outcome
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.distribution.base import END_SCORE
from jaxclear.studies.ledger.batch import evaluate_all
from jaxclear.studies.scrambling import scrambled_shares
from jaxclear.studies.statistics.scrambled import student

# Standard deviations of the runs in those of the sample, in turn: what the sample reaches, up to
# twice and a half as far.
SCALES = np.array([1.25, 1.6, 2.0, 2.5])
# One run for so many of the sample, and the most.
SHARE, MOST = 4, 128
# The 95 % bound of Poisson's distribution, for none seen.
UNSEEN = 3.0


class Outer(NamedTuple):
    """Runs further out: independent standard normal numbers and values (runs, variables), responses
    by name (runs,), and the scrambling of each (runs,)."""

    normal: np.ndarray
    values: np.ndarray
    responses: dict[str, np.ndarray]
    scrambling: np.ndarray


def runs_outside(
    problem: AbstractProblem, scramblings: np.ndarray, seed: int, progress_bar: bool
) -> Outer:
    """Runs that belong to a sample of these scramblings (samples,)."""
    names, count = np.unique(scramblings), len(problem.names)
    each = min(len(scramblings) // SHARE, MOST) // len(names)
    numbers = [
        scrambled_shares(each, count, np.random.default_rng((seed, i))) for i in range(len(names))
    ]
    shares = np.concatenate(numbers) if each else np.zeros((0, count))
    # Points in a row fill the space, each fourth of them a corner of it.
    own = SCALES[np.arange(each) * len(SCALES) // max(each, 1)]
    scales = np.tile(own, len(names))[:, None]
    # Within the scores at which distributions are asked.
    inside = scipy.special.ndtr(-END_SCORE / scales)
    normal = scales * scipy.special.ndtri(inside + (1.0 - 2.0 * inside) * shares)
    values = np.asarray(problem.inputs.values(jnp.asarray(normal)))
    group = np.repeat(names, each)
    if not len(shares):
        return Outer(normal, values, {n: np.zeros(0) for n in problem.response_names}, group)
    found = evaluate_all(
        problem, jnp.asarray(values), progress_bar=progress_bar, label="further out"
    )
    reached = np.asarray(found.outcome) == Outcome.REACHED
    responses = {name: np.where(reached, own, np.nan) for name, own in found.responses.items()}
    return Outer(normal, values, responses, group)


def mixture_weights(normal: np.ndarray, inside: int) -> np.ndarray:
    """Density of the variables over that of the mixture of `inside` samples and runs further out,
    (samples and runs,), at independent standard normal numbers (samples and runs, variables)."""
    count, variables = normal.shape
    square = np.sum(normal**2, axis=1)
    wider = np.zeros(count)
    for scale in SCALES:
        kept = 1.0 - 2.0 * scipy.special.ndtr(-END_SCORE / scale)
        density = np.exp(0.5 * square * (1.0 - scale**-2.0)) / (scale * kept) ** variables
        wider += density / len(SCALES)
    return count / (inside + (count - inside) * wider)


def widened(
    error: float, weighed: np.ndarray, outside: np.ndarray, count: int, parts: int
) -> float:
    """Half of a 95 % interval that the scatter of `parts` scramblings tells, with what it does not:
    that few samples decide, and what none of `count` has seen.

    `weighed` (samples and runs,): what each leaves beside the polynomial in the estimate's mean;
    `outside` (runs,): the same of the runs further out without their weights. Where as many samples
    decide as there are scramblings, their scatter tells all.
    """
    squares = weighed**2
    total = float(squares.sum())
    if total == 0.0:
        return error
    deciding = total**2 / float((squares**2).sum())
    freedom = np.clip(deciding, 2.0, parts)
    known = error * student(float(freedom)) / student(parts)
    rms = float(np.sqrt(np.mean(outside**2))) if len(outside) else 0.0
    return float(np.hypot(known, UNSEEN / count * rms * min(1.0, parts / deciding)))
