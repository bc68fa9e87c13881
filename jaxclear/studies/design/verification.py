"""Whether a design keeps its limits, by runs that had no part in finding it.

Each verification draws anew. Where a surface was used, runs and surface are taken at the same new
points: their differences correct a large new sample of the surface (a control variate). The error
is that between independent scramblings, each left out once with its runs and its part of the large
sample, and counts how skewed what they contribute is.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.studies.design.limit import SAME, AbstractLimit, Sample
from jaxclear.studies.design.population import GROUPS, AbstractModel, in_groups
from jaxclear.studies.design.question import Question
from jaxclear.studies.design.runs import Runs
from jaxclear.studies.infinite_responses import refuse_infinite, replace_infinite
from jaxclear.studies.statistics.scrambled import half_widths
from jaxclear.studies.statistics.summary import remark_on_tails
from jaxclear.studies.surface.control_variate import corrected_values

# Of more new runs than this share that failed a design is not seen to hold.
FEW_FAILED = 0.01
# What limits infinite responses, as lives may be.
INSTEAD = "take limit.Quantile or limit.Probability"


class Check(NamedTuple):
    """Limited numbers (limits,) and their 95 % errors, excesses (limits,) [1] and theirs, how many
    runs told them and how many of these failed; `failed_at` (variables,): the values of the first
    of these, if any; `codes` (those that did not,): of what they warn (`studies.run_warnings`);
    `remarks`: sentences on errors of deviations that so many runs do not bear."""

    numbers: np.ndarray
    errors: np.ndarray
    excess: np.ndarray
    excess_errors: np.ndarray
    runs: int
    failed: int
    failed_at: np.ndarray | None
    codes: np.ndarray
    remarks: tuple[str, ...]

    def holds(self, allowed: float) -> np.ndarray:
        """Whether each limit is kept (limits,) but for an excess that is `allowed` [1]. Where its
        error is larger than that, it must not cross the bound."""
        sure = self.excess_errors <= allowed
        return self.excess + np.where(sure, 0.0, self.excess_errors) <= allowed

    def too_many_failed(self, question: Question) -> bool:
        """Whether so many runs failed that those which did not may not stand for the parts: more
        than 1 %, or than the share that the rarest limit of the question speaks of."""
        rarest = min(limit.rarest() for limit in question.limits)
        return self.failed > min(FEW_FAILED, rarest) * self.runs


class Verifier(NamedTuple):
    """What verifies: `wide` is how many points a surface is taken at, which runs correct; 0 where
    runs stand alone."""

    question: Question
    runs: Runs
    wide: int

    def check(
        self, place: np.ndarray, model: AbstractModel, samples: int, seed: int, shifts: tuple
    ) -> Check:
        """The limits of a candidate, by runs of new parts.

        Args:
            place: the candidate, shape (free,).
            model: surface that the runs correct.
            samples: smallest number of parts.
            seed: of the parts.
            shifts: centres of rare regions (`points`).
        """
        draw = lambda least: in_groups(self.question.freedom.names, least, seed, shifts)
        normal, weights, group = draw(samples)
        values = np.asarray(self.question.values(jnp.asarray(place), normal))
        before = self.runs.count
        responses = self.runs.ask(values, "verification")
        good = ~np.isnan(responses).any(axis=1)
        shares = _shares(np.where(good, weights, 0.0), group)
        # The same scramblings go on: where runs are, the surface is taken too.
        large = draw(max(self.wide, samples)) if self.wide else None
        estimates, contributions = [], []
        for limit in self.question.limits:
            seen, largest = self._samples(limit, place, model, values, responses, shares, large)
            rows = np.array([_measured(limit, sample) for sample in seen], float)
            # A number that stands for infinite ones is none to be told.
            rows[rows[:, 0] > largest, 0] = np.inf
            estimates.append(rows)
            contributions.append(np.asarray(_contributions(limit, seen[0])))
        by_name = dict(zip(self.runs.problem.response_names, responses[good].T, strict=True))
        moments = [one.response for one in self.question.limits if one.by_moments()]
        limited = [name for name in dict.fromkeys(moments) if name in by_name]
        remarks = tuple(filter(None, [remark_on_tails(name, by_name[name]) for name in limited]))
        check = self._make_check(np.array(estimates), contributions, values, good)
        return check._replace(codes=self.runs.warned(before), remarks=remarks)

    def _make_check(
        self,
        rows: np.ndarray,
        contributions: list[np.ndarray],
        values: np.ndarray,
        good: np.ndarray,
    ) -> Check:
        """`rows` (limits, 1 + groups, 2): numbers and excesses, of all groups and without each;
        `contributions` of each limit's sample to its excess; `values` (runs, variables), of which
        those did not fail that are `good` (runs,)."""
        failed = values[~good]
        finite = np.where(np.isfinite(rows), rows, np.nan)
        parts = GROUPS * finite[:, :1] - (GROUPS - 1) * finite[:, 1:]
        errors = np.zeros((len(rows), 2))
        for i, each in enumerate(contributions):
            # Runs that correct a surface are fewer than the sample that contributes.
            errors[i] = [max(*half_widths(part), *half_widths(part, each)) for part in parts[i].T]
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
            np.zeros(0, np.int64),
            (),
        )

    def _samples(self, limit, place, model, values, responses, shares, large):
        """What a limit sees of all runs and without each of the groups, by the `shares` of runs and
        a `large` sample; and the largest number that is told, where some are infinite."""
        question, names = self.question, self.runs.problem.response_names
        if limit.extreme():
            side = 1.0 if limit.upper() else -1.0
            corner = np.asarray(question.corner(limit, jnp.asarray(place), model, side))[None]
            by_name: dict[str, np.ndarray] = {}
            if limit.response in names:
                by_name = dict(zip(names, self.runs.ask(corner, "worst case").T, strict=True))
            data, largest = _finite(limit, np.asarray(question.of(limit, corner, by_name)))
            ends = jnp.tile(jnp.asarray(data), 2)
            return [Sample(jnp.zeros(1), jnp.ones(1), ends)] * len(shares), largest
        data = np.asarray(question.of(limit, values, dict(zip(names, responses.T, strict=True))))
        if limit.by_moments():
            refuse_infinite(self.runs.problem, {limit.response: data}, "mean or deviation", INSTEAD)
        data, largest = _finite(limit, np.where(np.isnan(data), 0.0, data))
        if large is None or limit.response not in names:
            return [Sample(data, row, np.zeros(2)) for row in shares], largest
        normal, weights, group = large
        wide = question.values(jnp.asarray(place), normal)
        stand_in = np.asarray(question.of(limit, wide, model(wide)))
        there = np.asarray(question.of(limit, values, model(jnp.asarray(values))))
        # Where no run succeeds nothing is known: shares are nan.
        kept = _shares(weights, group) * shares.sum(axis=1, keepdims=True)
        pairs = zip(kept, shares, strict=True)
        moved = lambda row, share: corrected_values(stand_in, row, data, there, share)
        return [Sample(moved(row, share), row, np.zeros(2)) for row, share in pairs], largest


def _shares(weights: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Weights (samples,) that add up to 1, of all groups and without each, (1 + groups, samples);
    nan where there are none."""
    kept = np.where(group != np.arange(-1, GROUPS)[:, None], weights, 0.0)
    total = kept.sum(axis=1, keepdims=True)
    return kept / np.where(total > 0, total, np.nan)


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


@eqx.filter_jit
def _contributions(limit: AbstractLimit, sample: Sample) -> Any:
    """Contributions (samples,) of parts to the excess."""
    slope = jax.grad(lambda weights: limit.excess(sample._replace(weights=weights)))(sample.weights)
    return (slope - jnp.sum(slope * sample.weights)) * sample.weights
