"""A Monte Carlo sample that grows until its means are known as accurately as asked."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.sampling import draw, extended, groups
from jaxclear.studies.statistics.accuracy import Asked, told, unreached


class Plan(NamedTuple):
    """What is sampled, at most how often, and how."""

    problem: AbstractProblem
    most: int
    seed: int
    sampling: str
    scramblings: int


def until_accurate(plan: Plan, first: int, asked: Asked, run: Callable) -> tuple:
    """Values, scramblings and outcomes of as many samples as the accuracy takes, and a sentence
    where it takes more than the most."""
    problem, parts = plan.problem, plan.scramblings
    # All scramblings are of one length, a power of two, so that they can be doubled.
    first = parts * 2 ** int(np.log2(first // parts))
    values, group = draw(problem, first, plan.seed, plan.sampling, parts), groups(first, parts)
    found = run(values)
    while True:
        short = told(asked, responses_of(problem, found), group)
        if not short or 2 * len(values) > plan.most:
            return values, group, found, unreached(short)
        more = extended(problem, len(values) // parts, parts, plan.seed, plan.sampling)
        values = np.concatenate([values, more])
        group = np.concatenate([group, groups(len(more), parts)])
        found = jax.tree.map(lambda *both: np.concatenate(both), found, run(more))


def responses_of(problem: AbstractProblem, found: SampleResult) -> dict[str, np.ndarray]:
    """Responses of the samples, nan of those that failed."""
    good = found.outcome == Outcome.REACHED
    return {name: np.where(good, found.responses[name], np.nan) for name in problem.response_names}
