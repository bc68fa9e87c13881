"""Monte Carlo over the toleranced numbers of a problem: how responses spread, with the error of
every statistic, and which sample failed and why.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_name, check_number
from jaxclear.ground.quantity import on_device
from jaxclear.integrators.checks import Checks
from jaxclear.studies.answer import (
    DATASET,
    RESPONSE,
    TABLE,
    VARIABLE,
    AbstractAnswer,
    Column,
    Stated,
)
from jaxclear.studies.infinite_responses import (
    check_within_horizon,
    infinite_messages,
    refuse_infinite,
    successes,
)
from jaxclear.studies.problem import Problem
from jaxclear.studies.replicas import Replicas, numerical_error, replicas_of, unverified
from jaxclear.studies.run_warnings import any_warning, counted, in_words, warns_about
from jaxclear.studies.sampling import Drawing, check_sampled, checked_scramblings, groups
from jaxclear.studies.sequential import FIRST_SAMPLES, Grown, first_of, until_accurate
from jaxclear.studies.statistics.accuracy import NumericalError, parse_accuracy
from jaxclear.studies.statistics.limits import (
    SIDES,
    Limits,
    ToleranceInterval,
    check_limits,
    free_interval,
    normal_interval,
    yield_of,
)
from jaxclear.studies.statistics.scrambled import (
    Statistic,
    capability,
    deviation,
    error_budget,
    jackknifed,
    quantile,
)
from jaxclear.studies.statistics.summary import (
    doubtful_of,
    ends_of,
    failure,
    remarks_of,
    spread_in_words,
    spread_of,
    summary_of,
    summary_row,
    warnings_of,
)
from jaxclear.studies.store.batch import chunk_size, evaluate_all
from jaxclear.studies.store.store import stored

# What responses of replicas are, which are those of the first samples.
FINER = "of a finer run of the same sample"


def finer_name(response: str) -> str:
    """What the responses of replicas are called."""
    return f"finer {response}"


class MonteCarlo(AbstractAnswer):
    """Samples and their responses. Failed samples keep their row, with `nan` and a sentence; those
    that reached their end with warnings are counted beside them.

    `values` (samples, variables) are the varied numbers, `responses` (samples,) by name, `checks`
    what each run found out about itself, `scrambling` (samples,) the independent part of the sample
    that each belongs to: errors of statistics come from the differences between these. `replicas`
    are finer runs of the first samples, which tell numerical errors (None: not verified).
    """

    problem: Problem
    values: np.ndarray
    responses: dict[str, np.ndarray]
    outcome: np.ndarray
    ended: np.ndarray
    seed: int = eqx.field(static=True)
    chunk: int = eqx.field(static=True)
    checks: Checks = eqx.field(default_factory=Checks)
    scrambling: np.ndarray = eqx.field(default_factory=lambda: np.zeros(0, int))
    # What was asked of the means (half of 95 % intervals, by response) and not reached.
    unreached: str = eqx.field(static=True, default="")
    replicas: Replicas | None = None

    @property
    def failed(self) -> np.ndarray:
        """Indices of the samples that failed."""
        return np.flatnonzero(~successes(self.problem, self.outcome, self.responses)[0])

    def failures(self) -> dict[int, str]:
        """Why each failed sample failed, by its index."""
        return {int(i): failure(self, i) for i in self.failed}

    @property
    def warned(self) -> np.ndarray:
        """Indices of the samples that did not fail and carry a warning."""
        return np.setdiff1d(np.flatnonzero(any_warning(self.checks, self.count)), self.failed)

    def warnings(self) -> dict[int, tuple[str, ...]]:
        """What each of those warns of, by its index."""
        return {int(i): self.checks.of_sample(int(i)).warnings for i in self.warned}

    def affected_samples(self, response: str) -> np.ndarray:
        """Indices of the samples that carry a warning which concerns this response (peak forces
        that the steps do not resolve concern no position)."""
        check_name("response", response, self.responses, " in this study")
        codes = warns_about(self.problem, response, self.checks, self.count)
        return np.setdiff1d(np.flatnonzero(codes), self.failed)

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(self.values)

    @property
    def accuracy_warnings(self) -> tuple[str, ...]:
        """A sentence for each response whose mean is off by more than is promised, as replicas
        tell; for replicas that failed; and for what is off in all samples alike."""
        return self.accuracy_warnings_of(*self.problem.response_names)

    def accuracy_warnings_of(self, *responses: str) -> tuple[str, ...]:
        """The `accuracy_warnings` that concern these responses."""
        replicas = self.replicas
        messages = () if replicas is None else replicas.accuracy_warnings(self.problem, *responses)
        return (*messages, *self.problem.description.warnings)

    def numerical_error(
        self, response: str, statistic: Callable[[np.ndarray], float] = np.mean
    ) -> NumericalError:
        """How far the mean, or another smooth function of a sample (samples,), is off by what
        discretises runs, beside what chance leaves. Raises `ValueError` without replicas."""
        check_name("response", response, self.responses, " in this study")
        return numerical_error(self, response, statistic)

    def rerun(self, index: int) -> Any:
        """One sample alone, to look at one that failed or warned: a mechanism's run, bit for bit
        that of the study; of a function what it gives, by name."""
        return self.problem.detail(self.values[index], index, self.chunk)

    def sentence(self) -> str:
        """Mean and standard deviation of each response with their 95 % errors, and what
        `count_sentence` says."""
        return " ".join([*spread_in_words(self.summary()), self.count_sentence()])

    def count_sentence(self) -> str:
        """How many samples there are, failed and warned, and of what; and why the integrator is
        what it is, where it is not the usual one."""
        text = f"{self.count} samples, {len(self.failed)} failed, {len(self.warned)} with warnings"
        counts = counted(self.checks, np.isin(np.arange(self.count), self.warned))
        text = f"{text} ({in_words(counts)})." if counts else f"{text}."
        sentences = (
            text,
            *self.accuracy_warnings,
            unverified(self.problem, self.replicas),
            *infinite_messages(self.problem, self.responses),
            self.unreached,
            self.problem.description.remark,
        )
        return " ".join(filter(None, sentences))

    def _summary(self):
        failures = [f"The first that failed: {failure(self, int(i))}" for i in self.failed[:1]]
        summary = self.summary()
        return self.count_sentence(), *failures, *spread_of(summary), *remarks_of(self, summary)

    def _stated(self):
        problem, over = self.problem, ("sample",)
        units = problem.units()
        columns = {
            name: Column(over, self.values[:, i], problem.variable_units[i], kind=VARIABLE)
            for i, name in enumerate(problem.names)
        }
        columns |= {n: Column(over, r, units[n], kind=RESPONSE) for n, r in self.responses.items()}
        columns |= {
            "result": Column(over, lambda: ends_of(self), only=TABLE),
            "warnings": Column(over, lambda: warnings_of(self), only=TABLE),
            "in doubt": Column(over, lambda: doubtful_of(self), only=TABLE),
        }
        data = {
            "outcome": Column(over, self.outcome, "1", "how a sample ended; 0 is success"),
            "ended": Column(over, self.ended, "s", "when it ended"),
            "scrambling": Column(over, self.scrambling, "1", "independent part of the sample"),
        }
        for check, figure in self.checks.figures.items():
            worst = np.asarray(figure.worst).reshape(self.count, -1).max(axis=1)
            meaning = f"worst figure of this check, whose limit is {check.limit:g}"
            data[f"check {check.name.lower()}"] = Column(over, worst, "1", meaning)
        columns |= {name: column._replace(only=DATASET) for name, column in data.items()}
        if self.replicas is not None:
            for n, values in self.replicas.responses.items():
                columns[finer_name(n)] = Column(("replica",), values, units[n], FINER)
        numbers = {"seed": self.seed, "chunk": self.chunk}
        return Stated(
            "Monte Carlo", columns, problem, lambda: remarks_of(self, self.summary()), numbers
        )

    def good(self, response: str) -> tuple[np.ndarray, np.ndarray]:
        """A response of the samples that did not fail, and their scramblings."""
        check_name("response", response, self.responses, " in this study")
        indices = np.setdiff1d(np.arange(self.count), self.failed)
        return self.responses[response][indices], self.scrambling[indices]

    def statistic(self, function: Callable[[np.ndarray], float], response: str) -> Statistic:
        """Any smooth function of a sample (samples,), such as `scipy.stats.skew`, with its error.
        Raises `ValueError` where the response has infinite values, as lives may."""
        return self._jackknifed(function, response, None, False)

    def _jackknifed(
        self,
        function: Callable[..., float],
        response: str,
        contributions: Callable[[np.ndarray], np.ndarray] | None,
        grouped: bool = True,
    ) -> Statistic:
        values, group = self.good(response)
        refuse_infinite(self.problem, {response: values}, "mean or deviation")
        of_samples = contributions(values) if contributions and len(values) else None
        return jackknifed(function, values, group, of_samples, grouped)

    def mean(self, response: str) -> Statistic:
        """Mean of a response."""
        return self.statistic(np.mean, response).in_unit(self._unit(response))

    def standard_deviation(self, response: str) -> Statistic:
        """Standard deviation of a response."""
        squares = lambda values: (values - values.mean()) ** 2
        return self._jackknifed(deviation, response, squares).in_unit(self._unit(response))

    def _unit(self, response: str) -> str:
        return self.problem.units()[response]

    def quantile(self, response: str, share: float) -> Statistic:
        """The value that a `share` [1] of the samples does not exceed, on a straight line between
        the two samples next to it: definition 7 of Hyndman & Fan 1996, Am. Stat. 50, 361,
        doi:10.2307/2684934, as NumPy takes."""
        check_number("share of quantile", share, above=0, below=1)
        return quantile(*self.good(response), share).in_unit(self._unit(response))

    def share_within(self, limits: Mapping[str, Limits]) -> Statistic:
        """The yield [1]: the share of samples all of whose responses keep their `limits`, {name:
        (low, high)} with None for no limit. Samples that failed are in the interval alone: outside
        at its lower end, inside at its upper."""
        check_limits(limits, self.responses)
        for name, pair in limits.items():
            check_within_horizon(self.problem, name, *pair)
        return yield_of(self.responses, limits, self.failed, self.scrambling)

    def process_capability(self, response: str, limits: Limits) -> Statistic:
        """Cpk [1] between limits (low, high), None for no limit: distance of the mean from the
        nearer one, in three standard deviations."""
        check_limits({response: limits}, self.responses)
        return self._jackknifed(capability(*limits), response, None)

    def tolerance_interval(
        self,
        response: str,
        content: float = 0.99,
        confidence: float = 0.95,
        *,
        side: str = "both",
        normal: bool = False,
    ) -> ToleranceInterval:
        """Limits within which at least a share of all parts lies, with a confidence.

        The confidence is that of as many independent samples; quasi-random ones deserve more.

        Args:
            response: name of the response.
            content: share of all parts within the limits [1], > 0 and < 1; 0.99 by default.
            confidence: probability that it is at least that share [1], > 0 and < 1; 0.95 by
                default.
            side: "both", "lower" (all parts above a limit) or "upper", a text.
            normal: whether the response is normal, so that limits are its mean and a factor of
                its standard
                deviation; otherwise they are two samples, whatever the distribution.

        Raises:
            ValueError: the samples are too few, with how many are needed.
        """
        check_number("content of tolerance_interval", content, above=0, below=1)
        check_number("confidence of tolerance_interval", confidence, above=0, below=1)
        check_name("side of tolerance_interval", side, SIDES)
        check_flags("tolerance_interval", normal=normal)
        kind, (values, group) = normal_interval if normal else free_interval, self.good(response)
        if normal:
            refuse_infinite(self.problem, {response: values}, "normal distribution")
        return kind(values, group, content, confidence, side).in_unit(self._unit(response))

    def error_budget(self, response: str) -> dict[str, Statistic]:
        """What each variable contributes to the variance of a response [its unit squared], and the
        remainder that is not linear in them; the parts sum to the variance."""
        responses, group = self.good(response)
        refuse_infinite(self.problem, {response: responses}, "variance")
        values = np.delete(self.values, self.failed, axis=0)
        unit = self._unit(response)
        squared = f"{unit if unit.isalnum() else f'({unit})'}^2" if unit != "1" else unit
        parts = error_budget(values, responses, group, self.problem.groups)
        return {name: part.in_unit(squared) for name, part in parts.items()}

    def summary(self, limits: Mapping[str, Limits] | None = None) -> Any:
        """Mean, standard deviation and percentiles of each response as a pandas table, each with
        its error: half of its 95 % interval, from the differences between the scramblings (or the
        farther end of the interval). With `limits`, {name: (low, high)}, also yield and Cpk.

        "warned" counts the samples with a warning that concerns the response; the last two columns
        leave them out, all others take them in.
        """
        limits = {} if limits is None else limits
        check_limits(limits, self.responses)
        return summary_of([summary_row(self, name, limits) for name in self.responses])


@answering
@stored("a Monte Carlo study")
def monte_carlo(
    problem: Problem,
    samples: int = 1024,
    *,
    seed: int = 0,
    sampling: str = "sobol",
    scramblings: int | None = None,
    accuracy: float | Mapping[str, float] | None = None,
    chunk: int | None = None,
    verify: bool = True,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> MonteCarlo:
    """Run a problem for a random sample of its variables.

    A failed sample does not stop the study; it is counted and keeps the reason of its failure.
    Samples whose run gives warnings are counted too.

    Args:
        problem: the problem.
        samples: number of samples; with `accuracy` the largest number. 1024 by default.
        seed: seed of the random numbers; 0 by default.
        sampling: name of the method, "sobol" (scrambled Sobol' points, default) or "random".
        scramblings: number of independent subsets of the sample, whose differences give the error
            of each statistic; by default about the square root of `samples`, at most 8.
        accuracy: required half width of the 95 % interval of each mean, as a factor of the
            response's root mean square [1], or a dictionary by response in its unit; the sample is
            doubled until it is reached. None by default.
        chunk: number of samples that run together; None (default) for what fits the memory.
        verify: whether to repeat the first 16 samples with finer steps, which gives the numerical
            error of each statistic; True by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `MonteCarlo`.

    Raises:
        ValueError: if an argument is wrong.
    """
    check_sampled(problem, samples, seed, sampling)
    check_flags("monte_carlo", verify=verify, progress_bar=progress_bar)
    if chunk is not None:
        check_count("chunk of monte_carlo", chunk)
    request = parse_accuracy(accuracy, problem.response_names)
    first = samples if request is None else min(samples, FIRST_SAMPLES)
    parts = checked_scramblings("monte_carlo", first, scramblings)
    chunk = chunk_size(problem, first, chunk)
    run = lambda values: evaluate_all(
        problem, on_device(values), chunk=chunk, progress_bar=progress_bar, label="Monte Carlo"
    )
    drawing = Drawing(problem, seed, sampling, parts)
    sample, short = Grown(drawing, run, chunk), ""
    if request is None:
        sample.to(samples)
    else:

        def grown(count):
            sample.to(count)
            return [(sample.result.reached_responses(), groups(count, parts))]

        short = until_accurate(problem, first_of(first, parts), samples, request, grown)
    result, values, reached = sample.result, sample.values, sample.result.reached_responses()
    ends = (np.asarray(result.outcome), np.asarray(result.ended))
    arguments = (
        {name: reached[name] for name in problem.response_names},
        *ends,
        seed,
        chunk,
        result.checks,
        groups(len(values), parts),
    )
    replicas = replicas_of(problem, values, result, chunk, progress_bar) if verify else None
    return MonteCarlo(problem, values, *arguments, short, replicas)
