"""How far the numbers of a study are off by what discretises its runs: the first few samples are
run once more with all of that refined, by the same values. The mean of what changes is the bias of
the study's means, and its scatter the interval (the coupled levels of multilevel Monte Carlo).

What a sample is off by is what a finer run changes, and what is left of it there: of order 1 in the
share of the steps, and less above. What reads worn depths has as many replicas on cells twice as
wide: what these change tells what cells leave. Where paths part, as after many impacts, single
changes are as large as the scatter of samples, and few replicas do not resolve what becomes of a
mean.

Source: Giles 2008, Oper. Res. 56, 607, doi:10.1287/opre.1070.0496; Roache 1994, J. Fluids Eng. 116,
405, doi:10.1115/1.2910291.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.statistics.accuracy import NumericalError, bias_of
from jaxclear.studies.store.batch import chunk_size, evaluate_all

# So many of a study's samples, its first, have replicas.
MOST_REPLICAS = 16


class Replicas(eqx.Module):
    """The first samples of a study once more, with steps of a `share` [1]: `responses` (replicas,)
    by name, and those of the samples (`coarse`), nan where a run failed; how each replica ended,
    and when [s]."""

    coarse: dict[str, np.ndarray]
    responses: dict[str, np.ndarray]
    outcome: np.ndarray
    ended: np.ndarray
    share: float = eqx.field(static=True, default=0.5)

    @property
    def count(self) -> int:
        """Number of replicas."""
        return len(self.outcome)

    @property
    def failed(self) -> np.ndarray:
        """Indices of the samples whose replica failed, and they did not."""
        fine = np.all([np.isfinite(values) for values in self.coarse.values()], axis=0)
        return np.flatnonzero(fine & (self.outcome != Outcome.REACHED))

    def differences(self, response: str) -> np.ndarray:
        """By how much each sample's response is too large, (replicas,), in its unit; nan where a
        run failed."""
        return (self.coarse[response] - self.responses[response]) / (1 - self.share)

    def errors(self, response: str) -> np.ndarray:
        """The told numerical error of each sample's response, (replicas,)."""
        return np.abs(self.differences(response))

    def pairs(self, response: str) -> tuple[np.ndarray, np.ndarray]:
        """A response of samples and replicas of which neither failed."""
        good = np.isfinite(self.coarse[response]) & np.isfinite(self.responses[response])
        return self.coarse[response][good], self.responses[response][good]

    def bias(
        self, response: str, statistic: Callable[[np.ndarray], float] = np.mean
    ) -> tuple[float, float]:
        """By how much a statistic, a smooth function of a sample, is too large, and half of the
        95 % interval of that."""
        return bias_of(*self.pairs(response), self.share, statistic)

    def accuracy_warnings(self, problem: Problem, *responses: str) -> tuple[str, ...]:
        """A sentence for each of these responses whose mean is off by more than is promised, and
        one for replicas that failed."""
        doubts = [_bias_sentence(problem, self, name) for name in responses]
        return tuple(filter(None, [*doubts, _failure_sentence(problem, self)]))


def replicas_of(
    problem: Problem,
    values: np.ndarray,
    result: SampleResult,
    chunk: int,
    progress_bar: bool = False,
) -> Replicas | None:
    """Replicas of the first samples of a study; None where the problem cannot be refined.

    Args:
        problem: of the study.
        values: of the variables, shape (samples, variables).
        result: of these samples.
        chunk: samples of a chunk.
        progress_bar: whether one is shown.
    """
    count = min(MOST_REPLICAS, len(values))
    finer = finer_runs(problem, values[:count], chunk, progress_bar)
    if finer is None:
        return None
    return together_with(problem.response_names, result, finer, count)


def finer_runs(
    problem: Problem, values: np.ndarray, chunk: int, progress_bar: bool = False
) -> SampleResult | None:
    """Results of samples in finer runs; None where the problem cannot be refined.

    They are run by the study's own program where shapes allow.

    Args:
        problem: of the study.
        values: of the variables, shape (samples, variables).
        chunk: samples of a chunk of the study.
        progress_bar: whether one is shown.
    """
    replica = problem.refine()
    if replica is None:
        return None
    result = _run_replicas(problem, replica, values, chunk, progress_bar)
    wider = replica.experiment.on_wider_cells()
    if wider is None:
        return result
    # What cells leave counts as if the steps left it: half of that is changed by half of these.
    coarse = _run_replicas(problem, problem.with_experiment(wider), values, chunk, progress_bar)
    errors = replica.experiment.errors_of_cells(result, coarse)
    changed = {name: result.responses[name] - 0.5 * error for name, error in errors.items()}
    return dataclasses.replace(result, responses=result.responses | changed)


def _run_replicas(
    problem: Problem, replica: Problem, values: np.ndarray, chunk: int, progress_bar: bool
) -> SampleResult:
    numbers = [eqx.filter(tree, eqx.is_array) for tree in (problem, replica)]
    shapes = [[jnp.shape(leaf) for leaf in jax.tree.leaves(tree)] for tree in numbers]
    count = len(values)
    together = chunk if shapes[0] == shapes[1] else chunk_size(replica, count)
    if replica.cost().compiled:
        # Filled up with copies: else a chunk would be as small as the samples are few.
        values = np.concatenate([values, np.repeat(values[-1:], -count % together, axis=0)])
    finer = evaluate_all(
        replica, values, chunk=together, progress_bar=progress_bar, label="replicas"
    )
    return jax.tree.map(lambda array: array[:count], finer)


def together_with(
    names: Sequence[str], result: SampleResult, finer: SampleResult, count: int
) -> Replicas:
    """The replicas of the first samples.

    Args:
        names: of the responses.
        result: of the study.
        finer: of the finer runs.
        count: number of samples that have finer runs.
    """
    base, other = (
        {name: reached[name][:count] for name in names}
        for reached in (result.reached_responses(), finer.reached_responses())
    )
    return Replicas(base, other, np.asarray(finer.outcome[:count]), np.asarray(finer.ended[:count]))


def numerical_error(
    study: Any, response: str, statistic: Callable[[np.ndarray], float]
) -> NumericalError:
    """Error of a statistic by the discretisation of its runs.

    Args:
        study: a `MonteCarlo` with replicas.
        response: its name.
        statistic: function of values (samples,).

    Raises:
        ValueError: the study has no replicas.
    """
    if study.replicas is None:
        raise ValueError(
            "this study has no replicas, which tell numerical errors: it was asked not to verify, "
            "or nothing that discretises its problem can be refined."
        )
    sampling = study.statistic(statistic, response).error
    pairs = len(study.replicas.pairs(response)[0])
    bias, uncertainty = study.replicas.bias(response, statistic)
    return NumericalError(bias, uncertainty, sampling, pairs)


def unverified(problem: Problem, replicas: Replicas | None) -> str:
    """A sentence for numbers whose numerical error nothing tells; "" for others."""
    if replicas is not None or not problem.description.discretised:
        return ""
    return "Not verified: there are no companion runs, so the error by the steps is not known."


def _bias_sentence(problem: Problem, replicas: Replicas, response: str) -> str:
    bias, uncertainty = replicas.bias(response)
    values, _ = replicas.pairs(response)
    size = float(np.sqrt(np.mean(values**2))) if len(values) else np.nan
    info = problem.description.responses[response]
    promised = info.tolerance(size)
    if promised is None or not abs(bias) > max(promised, uncertainty):
        return ""
    unit = "" if info.unit == "1" else f" {info.unit}"
    return (
        f'"{response}": the steps change its mean by {bias:+.2g}{unit}, more than the tolerance of '
        f"{promised:.2g}{unit}; {info.remedy}."
    )


def _failure_sentence(problem: Problem, replicas: Replicas) -> str:
    failed = replicas.failed
    if not len(failed):
        return ""
    first = int(failed[0])
    ending = problem.description.ending(replicas.outcome[first], replicas.ended[first])
    count = f"{len(failed)} of {replicas.count} replicas failed and tell nothing"
    return f"{count}; of that of sample {first}, {ending}"
