"""Whether a design keeps its limits, by runs that had no part in finding it.

Each verification draws anew. Where a surface was used, runs and surface are taken at the same new
points: their difference corrects the large sample of the surface (a control variate). The error is
that between independent scramblings, each left out once.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.studies.design.limit import SAME, AbstractLimit, Sample
from jaxclear.studies.design.population import AbstractModel, Points, points
from jaxclear.studies.design.question import Question
from jaxclear.studies.design.runs import Runs
from jaxclear.studies.infinite_responses import refuse_infinite, replace_infinite
from jaxclear.studies.statistics.scrambled import student
from jaxclear.studies.surface.control_variate import with_difference

# Independent scramblings.
GROUPS = 8
# What limits infinite responses, as lives may be.
INSTEAD = "take limit.Quantile or limit.Probability"


class Check(NamedTuple):
    """Limited numbers (limits,) and their 95 % errors, excesses (limits,) [1] and theirs, how many
    runs told them and how many of these failed; `failed_at` (variables,): the values of the first
    of these, if any; `codes` (those that did not,): of what they warn (`studies.run_warnings`)."""

    numbers: np.ndarray
    errors: np.ndarray
    excess: np.ndarray
    excess_errors: np.ndarray
    runs: int
    failed: int
    failed_at: np.ndarray | None
    codes: np.ndarray

    def holds(self, allowed: float) -> np.ndarray:
        """Whether each limit is kept (limits,) but for an excess that is `allowed` [1]. Where its
        error is larger than that, it must not cross the bound."""
        sure = self.excess_errors <= allowed
        return self.excess + np.where(sure, 0.0, self.excess_errors) <= allowed


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
        before = self.runs.count
        responses = self.runs.ask(values, "verification")
        good = ~np.isnan(responses).any(axis=1)
        by_group = np.repeat(np.arange(GROUPS), len(values) // GROUPS)
        estimates = []
        for limit in self.question.limits:
            sample, largest = self._sampler(limit, place, model, values, responses)
            rows = []
            for omitted_group in (-1, *range(GROUPS)):
                group_weights = np.where(good & (by_group != omitted_group), weights, 0.0)
                number, excess = (float(one) for one in _measured(limit, sample(group_weights)))
                # A number that stands for infinite ones is none to be told.
                rows.append([np.inf if number > largest else number, excess])
            estimates.append(rows)
        return self._make_check(np.array(estimates), values, good, self.runs.warned(before))

    def _make_check(
        self, rows: np.ndarray, values: np.ndarray, good: np.ndarray, codes: np.ndarray
    ) -> Check:
        """`rows` (limits, 1 + groups, 2): numbers and excesses, of all groups and without each;
        `values` (runs, variables), of which those did not fail that are `good` (runs,)."""
        failed = values[~good]
        factor = student(GROUPS)
        finite = np.where(np.isfinite(rows), rows, np.nan)
        errors = factor * np.sqrt((GROUPS - 1) * finite[:, 1:].var(axis=1))
        # Nothing bounds a number that is infinite without one of the groups.
        errors = np.where(np.isinf(rows[:, 1:]).any(axis=1), np.inf, errors)
        sizes = self.question.sizes
        return Check(
            rows[:, 0, 0],
            errors[:, 0],
            rows[:, 0, 1] / sizes,
            errors[:, 1] / sizes,
            len(values),
            len(failed),
            failed[0] if len(failed) else None,
            codes,
        )

    def _sampler(self, limit: AbstractLimit, place: Any, model: Any, values: Any, responses: Any):
        """What a limit sees of runs with weights, of which some may be 0; and the largest number
        that is told, where some are infinite."""
        question, names = self.question, self.runs.problem.response_names
        if limit.extreme():
            corner, by_name = question.corner(limit, place, model)[None], {}
            if limit.response in names:
                by_name = dict(zip(names, self.runs.ask(corner, "worst case").T, strict=True))
            data, largest = _finite(limit, np.asarray(question.of(limit, corner, by_name)))
            ends = jnp.tile(jnp.asarray(data), 2)
            return lambda weights: Sample(jnp.zeros(1), jnp.ones(1), ends), largest
        data = np.asarray(question.of(limit, values, dict(zip(names, responses.T, strict=True))))
        if limit.by_moments():
            refuse_infinite(self.runs.problem, {limit.response: data}, "mean or deviation", INSTEAD)
        data, largest = _finite(limit, np.where(np.isnan(data), 0.0, data))
        if not (self.corrected and limit.response in names):
            alone = Sample(jnp.asarray(data), jnp.zeros(0), jnp.zeros(2))
            return lambda weights: alone._replace(weights=_shares(weights)), largest
        wide = question.values(jnp.asarray(place), self.wide.normal)
        large = Sample(
            jnp.asarray(question.of(limit, wide, model(wide))),
            jnp.asarray(self.wide.weights),
            jnp.zeros(2),
        )
        here = jnp.asarray(question.of(limit, values, model(jnp.asarray(values))))

        value_array = jnp.asarray(data)
        return lambda weights: with_difference(large, value_array, here, _shares(weights)), largest


def _shares(weights: np.ndarray) -> Any:
    total = weights.sum()
    # Where no run succeeds nothing is known.
    return jnp.asarray(weights / total if total > 0 else np.full_like(weights, np.nan))


def _finite(limit: AbstractLimit, values: np.ndarray) -> tuple[np.ndarray, float]:
    """What a limit is about, finite, and the largest number of it that is told: of values beyond
    all that decides it is enough to know on which side they lie."""
    if not np.isinf(values).any():
        return values, np.inf
    levels = [float(level) for level in limit.levels()]
    finite = [*values[np.isfinite(values)].tolist(), *levels]
    # A number in another unit, such as a share, is not one of the values.
    same_unit = limit.unit(SAME) == SAME
    return replace_infinite(values, *levels), max(finite, default=-np.inf) if same_unit else np.inf


@eqx.filter_jit
def _measured(limit: AbstractLimit, sample: Sample) -> Any:
    """The limited number and the excess."""
    return limit.number(sample), limit.excess(sample)
