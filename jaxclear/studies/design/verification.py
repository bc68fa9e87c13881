"""Whether a design keeps its limits, by runs that had no part in finding it.

Each verification draws anew. Where a surface was used, runs and surface are taken at the same new
points: their difference corrects the large sample of the surface (a control variate). The error is
that between independent scramblings, each left out once.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.studies.design.abstract_limit import AbstractLimit, Sample
from jaxclear.studies.design.model import AbstractModel
from jaxclear.studies.design.population import Points, points
from jaxclear.studies.design.question import Question
from jaxclear.studies.design.runs import Runs
from jaxclear.studies.statistics.scrambled import student

# Independent scramblings.
GROUPS = 8


class Check(NamedTuple):
    """Limited numbers (limits,) and their 95 % errors, excesses (limits,) [1] and theirs, how many
    runs told them and how many of these failed."""

    numbers: np.ndarray
    errors: np.ndarray
    excess: np.ndarray
    excess_errors: np.ndarray
    runs: int
    failed: int


class Verifier(NamedTuple):
    """What verifies: `wide` is the large sample that a model is taken at, `corrected` whether it is
    corrected by runs (a surface), or runs stand alone."""

    question: Question
    runs: Runs
    wide: Points
    corrected: bool

    def check(
        self, place: np.ndarray, model: AbstractModel, samples: int, seed: int, shifts: tuple
    ) -> Check:
        """The limits at a place, by at least `samples` new parts; `shifts` as in `points`."""
        each = -(-samples // (GROUPS * (1 + len(shifts))))
        count = len(self.question.freedom.names)
        sets = [points(count, each, seed * GROUPS + group, shifts) for group in range(GROUPS)]
        normal = np.concatenate([one.normal for one in sets])
        weights = np.concatenate([one.weights for one in sets]) / GROUPS
        values = np.asarray(self.question.values(jnp.asarray(place), normal))
        responses = self.runs.ask(values, "verification")
        good = np.isfinite(responses).all(axis=1)
        by_group = np.repeat(np.arange(GROUPS), len(values) // GROUPS)
        found = []
        for limit in self.question.limits:
            sample = self._sampler(limit, place, model, values, responses)
            rows = []
            for left_out in (-1, *range(GROUPS)):
                kept = np.where(good & (by_group != left_out), weights, 0.0)
                rows.append([float(one) for one in _measured(limit, sample(kept))])
            found.append(rows)
        return self._told(np.array(found), len(values), int((~good).sum()))

    def _told(self, found: np.ndarray, runs: int, failed: int) -> Check:
        """`found` (limits, 1 + groups, 2): numbers and excesses, of all groups and without each."""
        factor = student(GROUPS)
        errors = factor * np.sqrt((GROUPS - 1) * found[:, 1:].var(axis=1))
        sizes = self.question.sizes
        return Check(
            found[:, 0, 0],
            errors[:, 0],
            found[:, 0, 1] / sizes,
            errors[:, 1] / sizes,
            runs,
            failed,
        )

    def _sampler(self, limit: AbstractLimit, place: Any, model: Any, values: Any, responses: Any):
        """What a limit sees of runs with weights, of which some may be 0."""
        question, names = self.question, self.runs.problem.response_names
        if limit.extreme():
            corner, told = question.corner(limit, place, model)[None], {}
            if limit.response in names:
                told = dict(zip(names, self.runs.ask(corner, "worst case").T, strict=True))
            ends = jnp.tile(jnp.asarray(question.of(limit, corner, told)), 2)
            return lambda weights: Sample(jnp.zeros(1), jnp.ones(1), ends)
        own = np.asarray(question.of(limit, values, dict(zip(names, responses.T, strict=True))))
        own = np.where(np.isfinite(own), own, 0.0)
        parts, before = [own], []
        corrected = self.corrected and limit.response in names
        if corrected:
            large = question.values(jnp.asarray(place), self.wide.normal)
            surface = question.of(limit, large, model(large))
            here = question.of(limit, values, model(jnp.asarray(values)))
            parts, before = [surface, own, here], [np.asarray(self.wide.weights)]
        joined = jnp.concatenate([jnp.asarray(part) for part in parts])

        def seen(weights):
            share = weights / weights.sum()
            scale = [*before, share, -share] if corrected else [share]
            return Sample(joined, jnp.asarray(np.concatenate(scale)), jnp.zeros(2))

        return seen


@eqx.filter_jit
def _measured(limit: AbstractLimit, sample: Sample) -> Any:
    """The limited number and the excess."""
    return limit.number(sample), limit.excess(sample)
