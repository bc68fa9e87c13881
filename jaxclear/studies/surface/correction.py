"""Statistics by a surface that runs correct: `jaxclear.corrected_statistics`.

The surface takes up what it explains, as a control variate: its own mean is known from as many
evaluations as wanted, and runs are spent on what it leaves. The answer has no bias whatever the
surface, because its runs are fresh ones; a bad surface only costs, and one that is not trusted
gets the weight 0. Errors are those of independent scramblings.

Source: Nelson 1990, Oper. Res. 38, 974, doi:10.1287/opre.38.6.974 (control variates).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, expect
from jaxclear.ground.printing import with_error, with_text_repr
from jaxclear.studies.answer import RESPONSE, AbstractAnswer, Column, Stated, means_and_deviations
from jaxclear.studies.infinite_responses import refuse_infinite, successes
from jaxclear.studies.limit_state import AbstractLimitState, check_limit, system_margin
from jaxclear.studies.run_warnings import sentences_among
from jaxclear.studies.sampling import all_values
from jaxclear.studies.statistics.scrambled import deviation_of_moments, student
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.store.store import open_store
from jaxclear.studies.surface.control_variate import Mean, normal_blocks, regressed
from jaxclear.studies.surface.response_surface import ResponseSurface

# Evaluations of the surface: so many scramblings of so many points, so many at once.
SURFACE_SCRAMBLINGS, SURFACE_POINTS, TOGETHER = 16, 8192, 1024
# Fewer scramblings have no error worth the name.
FEWEST = 4


@with_text_repr
class CorrectedStatistic(NamedTuple):
    """A number and half the width of its 95 % interval, in one unit; `gain` [1] says how many times
    its variance is below that of the same runs without the surface."""

    value: float
    error: float
    gain: float

    def __str__(self) -> str:
        return with_error(self.value, self.error)


class CorrectedStatistics(AbstractAnswer):
    """Means, standard deviations and probabilities of failing from a surface and fresh runs.

    `means` and `deviations` are by response, `probabilities` by the names of the limits. `failed`
    of the `runs` did not reach their end: means and deviations are those of the others, in
    probabilities they count as failing. `warnings` say of what the fresh runs warn.
    """

    surface: ResponseSurface
    means: dict[str, CorrectedStatistic]
    deviations: dict[str, CorrectedStatistic]
    probabilities: dict[str, CorrectedStatistic]
    runs: int
    failed: int
    scramblings: int
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def sentence(self) -> str:
        """How many runs, how many failed, the probabilities of the limits, and which responses got
        nothing from the surface."""
        text = f"From {self.runs} runs in {self.scramblings} independent scramblings and the "
        text += f"{len(self.surface.values)} runs of the surface; {self.failed} failed."
        for name, probability in self.probabilities.items():
            text += f' P("{name}") = {probability}.'
        rough = [n for n in self.means if not self.surface.trusted(n)]
        for name in rough:
            text += f' "{name}": the surface has a leave-one-out R2 of '
            text += f"{self.surface.quality[name]:.2f} and is not used; its numbers are sampled."
        return text

    def _stated(self):
        over, names = (RESPONSE,), list(self.means)
        problem, limits = self.surface.problem, self.probabilities
        units, quality = problem.units(), self.surface.quality
        columns = {"unit": Column(over, {name: units[name] for name in names})}
        columns |= means_and_deviations(self.means, self.deviations)
        columns["gain"] = Column(over, {n: mean.gain for n, mean in self.means.items()}, "1")
        columns["leave-one-out R2"] = Column(over, {n: quality[n] for n in names}, "1")
        read = lambda part: [getattr(one, part) for one in limits.values()]
        columns |= {
            "probability": Column(("limit",), read("value"), "1", error=read("error")),
            "probability gain": Column(("limit",), read("gain"), "1"),
            "limit": Column(("limit",), list(limits)),
        }
        numbers = {"runs": self.runs, "failed": self.failed}
        return Stated("corrected statistics", columns, problem, self.warnings, numbers)


@answering
def corrected_statistics(
    surface: ResponseSurface,
    samples: int = 32,
    *,
    scramblings: int = 16,
    limits: Mapping[str, AbstractLimitState] | None = None,
    seed: int = 1,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> CorrectedStatistics:
    """Statistics of a problem from its surface and new runs that remove the surface's bias.

    Args:
        surface: the `ResponseSurface`.
        samples: number of runs in each scrambling; 32 by default.
        scramblings: number of independent scramblings of Sobol' points; 16 by default.
        limits: limit states by name, whose probabilities are computed (for rare ones use
            `jaxclear.reliability`); None (default) for none.
        seed: seed of the random numbers; 1 by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `CorrectedStatistics`.

    Raises:
        ValueError: if an argument is wrong.
    """
    expect(surface, ResponseSurface, "what is corrected", "what jaxclear.surface gives")
    check_count("samples of corrected_statistics", samples)
    check_count("scramblings of corrected_statistics", scramblings, at_least=FEWEST)
    check_count("seed of corrected_statistics", seed, at_least=0)
    check_flags("corrected_statistics", progress_bar=progress_bar)
    problem, limits = surface.problem, dict(limits or {})
    for limit in limits.values():
        check_limit(limit, problem.response_names, "corrected_statistics")
    normal = normal_blocks(scramblings, samples, len(problem.names), (seed, 0))
    values = jnp.asarray(all_values(problem, normal))
    with open_store(store, "a corrected surface", problem):
        result = evaluate_all(problem, values, progress_bar=progress_bar, label="corrected")
    responses = {name: np.asarray(result.responses[name], float) for name in problem.response_names}
    refuse_infinite(problem, responses, "mean or deviation", "jaxclear.monte_carlo serves")
    good, _ = successes(problem, result.outcome, responses)
    many = normal_blocks(SURFACE_SCRAMBLINGS, SURFACE_POINTS, len(problem.names), (seed, 1))
    there, free = _evaluated(surface, np.asarray(values)), _of_normal(surface, many)
    means, deviations, probabilities = {}, {}, {}
    for name in problem.response_names:
        weights = _weights(surface, name)
        sampled = (responses[name], there[name], good, scramblings)
        middle = float(np.mean(free[name]))
        means[name], deviations[name] = _moments(*sampled, free[name], middle, weights)
    for name, limit in limits.items():
        weight = float(all(surface.trusted(part.response) for part in limit.limits()))
        fails = np.where(good, _fails(limit, responses), 1.0)
        parts = (fails, _fails(limit, there), np.ones_like(good), scramblings)
        # As if one run more had differed: that none did says little of what is rare.
        unseen = 1.0 / len(values)
        probabilities[name] = _mean(*parts, _fails(limit, free), weight, unseen)
    statistics = means, deviations, probabilities
    counts = len(values), int((~good).sum()), scramblings
    return CorrectedStatistics(
        surface, *statistics, *counts, sentences_among(problem, result.checks, good)
    )


@eqx.filter_jit
def _surface_values(surface, values):
    return jax.lax.map(surface, values, batch_size=TOGETHER)


@eqx.filter_jit
def _surface_normal(surface, normal):
    at = lambda z: surface(surface.problem.inputs.values(z))
    return jax.lax.map(at, normal, batch_size=TOGETHER)


def _evaluated(surface: ResponseSurface, values: np.ndarray) -> dict[str, np.ndarray]:
    """The surface at `values` (samples, variables)."""
    return jax.tree.map(np.asarray, _surface_values(surface.bare(), jnp.asarray(values)))


def _of_normal(surface: ResponseSurface, normal: np.ndarray) -> dict[str, np.ndarray]:
    """The surface at standard normal numbers (samples, variables)."""
    return jax.tree.map(np.asarray, _surface_normal(surface.bare(), jnp.asarray(normal)))


def _fails(limit: AbstractLimitState, responses: dict[str, np.ndarray]) -> np.ndarray:
    """1 where a sample fails, else 0, (samples,)."""
    margins = np.stack([np.asarray(part.margin(responses)) for part in limit.limits()], axis=1)
    return (system_margin(margins, limit.cut_sets()) < 0).astype(float)


def _weights(surface: ResponseSurface, name: str) -> tuple[float, float]:
    """How much of the surface's first and second moment about its mean explains those of runs,
    from runs that it has not seen; 0 where it is not trusted."""
    if not surface.trusted(name):
        return 0.0, 0.0
    runs, fitted = surface.responses[name], surface.predictions[name]
    away = [np.stack([y - fitted.mean(), (y - fitted.mean()) ** 2], axis=1) for y in (runs, fitted)]
    first, second = regressed(*away)
    return float(first), float(second)


def _block_means(numbers: np.ndarray, good: np.ndarray, blocks: int) -> np.ndarray:
    """Means (blocks,) of the good numbers of each block."""
    valid = np.where(good, numbers, 0.0).reshape(blocks, -1).sum(axis=1)
    return valid / np.maximum(good.reshape(blocks, -1).sum(axis=1), 1)


def _residuals(numbers, there, good, blocks, free, weight):
    """What the surface leaves, block by block, with and without it; its own mean added, and the
    variance of that."""
    plain = _block_means(numbers, good, blocks)
    control = Mean.of(free, SURFACE_SCRAMBLINGS).times(weight)
    residual = plain - weight * _block_means(there, good, blocks)
    return plain, residual + control.value, control.variance


def _mean(numbers, there, good, blocks, free, weight, unseen=0.0) -> CorrectedStatistic:
    plain, residual, control_variance = _residuals(numbers, there, good, blocks, free, weight)
    variance = residual.var(ddof=1) / blocks + control_variance + unseen**2
    gain = (plain.var(ddof=1) / blocks + unseen**2) / variance if variance > 0 else np.inf
    width = student(blocks) * np.sqrt(variance)
    return CorrectedStatistic(float(residual.mean()), float(width), float(gain if weight else 1.0))


def _moments(
    numbers, there, good, blocks, free, middle, weights
) -> tuple[CorrectedStatistic, CorrectedStatistic]:
    """Mean and standard deviation."""
    mean = _mean(numbers, there, good, blocks, free, weights[0])
    first = _residuals(numbers - middle, there - middle, good, blocks, free - middle, weights[0])
    second = _residuals(
        (numbers - middle) ** 2, (there - middle) ** 2, good, blocks, (free - middle) ** 2,
        weights[1],
    )  # fmt: skip

    value, half = deviation_of_moments(first[1], second[1], second[2])
    plain = deviation_of_moments(first[0], second[0])[1]
    gain = float((plain / half) ** 2) if weights[1] and half > 0 else 1.0
    return mean, CorrectedStatistic(value, half, gain)
