"""What a campaign has found so far, read from its folder as it is asked for."""

import functools
import json
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxclear.ground.arguments import check_name
from jaxclear.ground.datasets import write_csv
from jaxclear.ground.printing import with_text_repr
from jaxclear.integrators.checks import Checks, Figure
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.infinite_responses import has_answer
from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.problem import Problem
from jaxclear.studies.statistics.limits import Limits, check_limits
from jaxclear.studies.statistics.summary import spread_in_words, summary_of, summary_row
from jaxclear.studies.store.batch import VALUES
from jaxclear.studies.store.dataset import dataset_of
from jaxclear.studies.store.digest import difference, first_difference, in_texts
from jaxclear.studies.store.samples import Samples


def _delegate_to_study(method: Callable) -> Any:
    """A method of `MonteCarlo`, asked of the whole study in memory."""
    return functools.wraps(method)(lambda self, *args, **how: method(self.sample, *args, **how))


def _delegate_by_response(method: Callable) -> Any:
    """A method of `MonteCarlo` that asks about a response, with that one in memory."""

    @functools.wraps(method)
    def call(self: "Campaign", response: str, *args: Any, **how: Any) -> Any:
        return method(self._reduced_study(response), response, *args, **how)

    return call


@with_text_repr
class Campaign:
    """The finished samples in a folder. Statistics are those of `MonteCarlo`, computed from one
    response at a time; `sample` is the whole study in memory, with all that it can be asked.

    `problem` is the one given, or what the folder remembers of it. Of an unfinished campaign these
    are the samples that are there, `finished` of `count`: of every scrambling as many, but for the
    chunks that others were still at.
    """

    def __init__(self, samples: Samples, problem: Problem, unreached: str = ""):
        self._samples, self.problem, self._unreached = samples, problem, unreached
        self.folder, self.plan = samples.folder, samples.plan
        self._chunks = samples.finished()

    @property
    def count(self) -> int:
        """Samples asked for."""
        return self.plan.samples

    @property
    def finished(self) -> int:
        """Samples that are in the folder."""
        return sum(at.stop - at.start for at in self._spans())

    @property
    def is_complete(self) -> bool:
        """Whether all samples are finished."""
        return self.finished == self.count

    @property
    def seed(self) -> int:
        """Of the sample."""
        return self.plan.seed

    @property
    def versions(self) -> tuple[dict[str, str], ...]:
        """Versions of jaxclear, JAX, Python and others that computed these samples."""
        return self._samples.versions()

    @cached_property
    def sample(self) -> MonteCarlo:
        """The finished samples as a Monte Carlo study, in memory; numbers of samples count them."""
        if not self._spans():
            raise self._empty_error()
        parts = [self._samples.result_of(at) for at in self._spans()]
        result = jax.tree.map(lambda *arrays: np.concatenate(arrays), *parts)
        values = np.concatenate([self._samples.read(at, VALUES)[VALUES] for at in self._spans()])
        return self._make_study(values, result)

    def sample_of(self, problem: Problem) -> MonteCarlo:
        """The finished samples in memory as a study of this problem. Raises `ValueError` with a
        sentence where they are of another one."""
        differs = first_difference(
            json.loads(self._samples.description["problem"]), in_texts(problem)
        )
        if differs:
            raise ValueError(
                f"the campaign in {self.folder} is of another problem: {differs}. Give a sample of "
                "this one, jaxclear.monte_carlo(problem), or how many samples to draw."
            )
        return Campaign(self._samples, problem, self._unreached).sample

    @property
    def values(self) -> np.ndarray:
        """Varied numbers (samples, variables)."""
        return self.sample.values

    @property
    def responses(self) -> dict[str, np.ndarray]:
        """Responses (samples,) by name; nan of samples that failed."""
        return self.sample.responses

    @property
    def failed(self) -> np.ndarray:
        """Indices of the samples that failed."""
        return self._reduced_study(self.problem.response_names[0]).failed

    @property
    def warned(self) -> np.ndarray:
        """Indices of the samples that did not fail and carry a warning."""
        return self._reduced_study(self.problem.response_names[0]).warned

    failures = _delegate_to_study(MonteCarlo.failures)
    warnings = _delegate_to_study(MonteCarlo.warnings)
    rerun = _delegate_to_study(MonteCarlo.rerun)
    table = _delegate_to_study(MonteCarlo.table)
    share_within = _delegate_to_study(MonteCarlo.share_within)
    error_budget = _delegate_to_study(MonteCarlo.error_budget)
    mean = _delegate_by_response(MonteCarlo.mean)
    numerical_error = _delegate_by_response(MonteCarlo.numerical_error)
    standard_deviation = _delegate_by_response(MonteCarlo.standard_deviation)
    quantile = _delegate_by_response(MonteCarlo.quantile)
    process_capability = _delegate_by_response(MonteCarlo.process_capability)
    tolerance_interval = _delegate_by_response(MonteCarlo.tolerance_interval)

    def summary(self, limits: Mapping[str, Limits] | None = None) -> Any:
        """The table of `MonteCarlo.summary`, one response at a time."""
        names = self.problem.response_names
        limits = {} if limits is None else limits
        check_limits(limits, names)
        return summary_of([summary_row(self._reduced_study(n), n, limits) for n in names])

    def to_dataset(self) -> Any:
        """All samples as an xarray Dataset that is read when it is used: variables and responses by
        name with units, outcomes, figures of the checks; what was computed and by what, as
        attributes. Samples that are not finished have outcome -1 and nan."""
        return dataset_of(self._samples)

    def to_csv(self, path: Any) -> Path:
        """Write a CSV file: a row for each sample, names with units, every digit.

        Args:
            path: name of the file.

        Returns:
            The path of the file.
        """
        return write_csv(self.to_dataset(), path)

    def sentence(self) -> str:
        """Mean and standard deviation of each response with their 95 % errors, and how many samples
        are finished, failed and warned, and of what."""
        if not self.finished:
            return f"None of {self.count} samples is finished yet."
        first, *others = self.problem.response_names
        counted = self._reduced_study(
            first, *filter(lambda name: self.problem.description.responses[name].infinite, others)
        )
        return " ".join([*spread_in_words(self.summary()), counted.count_sentence()])

    def __str__(self) -> str:
        return self.sentence()

    def _unfinished_sentence(self) -> str:
        if self.is_complete:
            return self._unreached
        return (
            f"The campaign is not complete: {self.finished} of {self.count} samples are there, and "
            "statistics are of these."
        )

    def _empty_error(self) -> ValueError:
        return ValueError(f"no sample of the campaign in {self.folder} is finished yet.")

    def _spans(self) -> list[slice]:
        return [slice(*self.plan.span(int(number))) for number in self._chunks]

    def _scramblings_of_samples(self) -> np.ndarray:
        """The scrambling of every finished sample."""
        every = self.plan.groups()
        return np.concatenate([every[at] for at in self._spans()] or [every[:0]])

    def _reduced_study(self, *names: str) -> MonteCarlo:
        """The study of one response, or of a few, without values; of every check whether it is
        beyond its limit."""
        for name in names:
            check_name("response", name, self.problem.response_names, " in this study")
        columns, outcomes, beyond = [], [], []
        for at in self._spans():
            result = self._samples.result_of(at)
            is_answered = has_answer(self.problem, result.responses)
            columns.append({n: np.where(is_answered, result.responses[n], np.nan) for n in names})
            outcomes.append(result.outcome.astype(np.int8))
            beyond.append({c: np.asarray(row) for c, row in result.checks.beyond().items()})
        if not columns:
            raise self._empty_error()
        checks = {
            check: _as_figure(np.concatenate([row[check] for row in beyond])) for check in beyond[0]
        }
        responses: Any = {n: np.concatenate([row[n] for row in columns]) for n in names}
        outcome: Any = np.concatenate(outcomes)
        ended: Any = np.zeros(len(outcome))
        reduced = SampleResult(responses, outcome, ended, Checks.of(checks))
        return self._make_study(np.zeros((len(outcome), 0)), reduced)

    def _make_study(self, values: np.ndarray, result: Any) -> MonteCarlo:
        names = [name for name in self.problem.response_names if name in result.responses]
        return MonteCarlo(
            self.problem,
            values,
            {name: result.responses[name] for name in names},
            result.outcome,
            result.ended,
            self.seed,
            self.plan.batch,
            result.checks,
            self._scramblings_of_samples(),
            self._unfinished_sentence(),
            self._samples.replicas(),
        )


def _as_figure(beyond: np.ndarray) -> Figure:
    """A figure that is infinite where it is beyond its limit (samples,)."""
    worst: Any = np.where(beyond, np.inf, 0.0).astype(np.float16)[:, None]
    return Figure(worst, np.zeros_like(worst), ("",))


GivenSample = MonteCarlo | Campaign


def sample_of(problem: Problem, sample: GivenSample) -> MonteCarlo:
    """The sample that a study is given instead of drawing one, in memory. Raises `ValueError` with
    a sentence for one of another problem."""
    if isinstance(sample, Campaign):
        return sample.sample_of(problem)
    differs = difference(sample.problem, problem)
    if differs:
        raise ValueError(
            f"the sample is of another problem ({differs}); give a sample of this one, "
            "jaxclear.monte_carlo(problem), or how many samples to draw."
        )
    return sample
