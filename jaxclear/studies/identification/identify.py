"""From a record to the numbers of a machine: `jaxclear.identify`.

Signals of machines with clearance are not reproducible over more than a few impacts, and not those
of another law at all; statistics of signals are. A sample of the problem is run, the record's
sensors see it, and each unknown is regressed on the statistics of what they see.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_name
from jaxclear.results.signal import usual_statistics
from jaxclear.studies.identification.laws import DISSIPATION, FRICTION, Ensemble, ensemble
from jaxclear.studies.identification.measurement import Measurement, checked_records
from jaxclear.studies.identification.models import (
    Model,
    compared_records,
    models_of,
    only_one,
    same_sensing,
)
from jaxclear.studies.identification.regression import (
    Regression,
    predict,
    regression,
    residuals_alone,
)
from jaxclear.studies.identification.result import (
    NOT,
    NOTHING,
    ONE_RECORD,
    STRANGE,
    Evidence,
    Identified,
    ends_in_words,
    prior_quantiles,
    prior_shares,
    together,
    unexplained,
    unknown_of,
)
from jaxclear.studies.identification.sample import (
    Cut,
    Sample,
    as_signals,
    check_identifiable,
    check_window,
    cut_of,
    sampled,
    sensed,
    statistics_of,
    watched,
)
from jaxclear.studies.identification.signal_answers import identify_by_signals, of_records
from jaxclear.studies.problem import Problem
from jaxclear.studies.sampling import check_sampled
from jaxclear.studies.store.store import open_store

METHODS = ("statistics", "signal")
# What a folder is told to hold.
WHAT = "the sample of an identification"
# Runs below which residuals say nothing of an interval of 95 %.
LEAST_RUNS = 64
# Statistics tell an unknown where their left-out residuals are below this share of the prior's
# deviation; beyond it, an interval that is narrower at some estimate is so by chance.
LARGEST_RESIDUAL = 0.9


@answering
def identify(
    problem: Model | Mapping[str, Model],
    data: Measurement | Sequence[Measurement],
    runs: int = 256,
    *,
    how: str = "statistics",
    seed: int = 0,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> Identified:
    """Estimate the variables of a problem from records of sensors.

    The distributions of the variables are the priors. An unknown whose interval is wider than 0.8
    of the prior's is not identified and keeps the prior's interval; below 0.5 it is identified.

    Args:
        problem: the `Problem`, or a function that makes it for a `Measurement` (for a recorded
            motion of a drive); the record belongs to the end of its run, and a longer run lets the
            motion settle. With `how="signal"` also a `FunctionProblem`, or a dictionary of several
            models of the machine, whose intervals cover all that the record does not contradict.
        data: a `Measurement`, or a sequence; intervals are then those of a next record, by
            Student's t of their differences.
        runs: number of runs of the sample (with "signal" that tell what follows of responses), >=
            64; 256 (default) suffice for one loose joint, 512 for three.
        how: name of the method: "statistics" (default), a regression of each unknown on statistics
            of the signals (`signal.usual_statistics`), with 95 % intervals from runs that it did
            not see, each by one of several laws of dissipation and of friction; "signal", least
            squares by Levenberg and Marquardt from several starts, with Laplace's intervals in the
            unknowns' normal scores. Where a sensor's noise is 0 the residual takes its place; a
            known noise must explain the residual. Correlated residuals count as fewer samples.
        seed: seed of the sample and the draws; 0 by default.
        store: folder that keeps the sample's signals without noise, which serve other instruments
            and records of the same sampling; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `Identified`.

    Raises:
        ValueError: if an argument is wrong.
    """
    records = checked_records(data)
    check_count("runs of identify", runs, at_least=LEAST_RUNS)
    check_name("way", how, METHODS, " of identify")
    check_flags("identify", progress_bar=progress_bar)
    models = models_of(problem, records)
    records = compared_records(problem, records)
    for model in [model for every in models.values() for model in every]:
        if model.response_names:
            check_sampled(model, runs, seed)
    if how == "signal":
        if store is not None:
            raise ValueError('how="signal" takes no store, which is for how="statistics".')
        return identify_by_signals(models, records, runs, seed)
    results: list[Identified] = []
    fitted: list[tuple[Any, Measurement, RegressedStatistics]] = []
    for model, record in zip(only_one(models), records, strict=True):
        check_identifiable(model, record)
        check_window(model, record)
        same = [fit for one, other, fit in fitted if one is model and same_sensing(other, record)]
        if not same:
            candidates = ensemble(model.mechanism)
            runs_of = watched(model, record, candidates)
            with open_store(store, WHAT, runs_of):
                sample = sampled(model, record, runs_of, candidates, runs, seed, progress_bar)
            same = [fit(model, record, sample, seed)]
            fitted.append((model, record, same[0]))
        results.append(answered(same[0], record))
    return results[0] if len(results) == 1 else of_records(results[0].problem, results, seed)


class RegressedStatistics(NamedTuple):
    """A sample of a problem, regressed on the `statistics` of what a record's sensors see of it:
    what any record of the same sensors and sampling is compared with. `signals` are those of the
    sample as they were sensed, `cut` into turns; `kinds` their statistics (runs, numbers) by kind,
    `tellers` by unknown the kind that tells it best by itself."""

    problem: Problem
    sample: Sample
    statistics: dict[str, Callable]
    cut: Cut
    kinds: dict[str, np.ndarray]
    regressed: Regression
    tellers: dict[str, str]


def fit(
    problem: Problem,
    record: Measurement,
    sample: Sample,
    seed: int = 0,
) -> RegressedStatistics:
    """The sample as a record's sensors see it, and the regression of unknowns on its statistics.

    Args:
        problem: with the unknowns as variables.
        record: whose sensors, rate and turns are used.
        sample: runs over the priors.
        seed: of the sensors' noise.
    """
    if len(sample.values) < LEAST_RUNS:
        raise ValueError(
            f"{sample.failed} runs of the sample failed and {len(sample.values)} are left, fewer "
            f"than {LEAST_RUNS}: look at one by jaxclear.monte_carlo of the same problem."
        )
    cut, statistics = cut_of(record, sample), usual_statistics(record.turn is not None)
    kinds = statistics_of(as_signals(sensed(sample, record, seed), record, cut), statistics)
    shares = prior_shares(problem, sample.values)
    # A machine's law is none of the sample's: those of one are left out together.
    groups = next(iter(sample.choices.values()), None)
    regressed = regression(np.concatenate(list(kinds.values()), axis=1), shares, groups)
    tellers = _best_statistics(kinds, shares, problem.names)
    return RegressedStatistics(problem, sample, statistics, cut, kinds, regressed, tellers)


def answered(context: RegressedStatistics, record: Measurement) -> Identified:
    """What a record tells beside a sample that is fitted."""
    problem, sample, fitted = context.problem, context.sample, context.regressed
    signals = {name: values[None] for name, values in record.signals.items()}
    stats = statistics_of(as_signals(signals, record, context.cut), context.statistics)
    here = np.concatenate([one[0] for one in stats.values()])
    rows = [
        (row.estimate, row.low, row.high) if scatter < LARGEST_RESIDUAL else NOTHING
        for row, scatter in zip(predict(fitted, here), fitted.scatter, strict=True)
    ]
    unknowns = tuple(
        unknown_of(problem, name, row, context.tellers[name])
        for name, row in zip(problem.names, rows, strict=True)
    )
    explained, signal_count = fitted.distance(here), len(stats) // len(context.statistics)
    if explained <= STRANGE and not _too_few(len(sample.values)):
        unknowns = unexplained(unknowns)
    joint = _draw_jointly(fitted, here, [unknown.verdict == NOT for unknown in unknowns])
    values = [prior_quantiles(problem, n, joint[:, i]) for i, n in enumerate(problem.names)]
    remarks = (
        *together(problem.names, fitted, [unknown.verdict for unknown in unknowns]),
        *ends_in_words(problem, unknowns),
        *_laws_in_words(sample.laws),
        *_too_few(len(sample.values)),
        ONE_RECORD,
    )
    return Identified(
        problem,
        unknowns,
        np.stack(values, axis=1),
        len(sample.values),
        sample.failed,
        f"by {len(here)} statistics of {signal_count} signal{'s' * (signal_count != 1)}",
        remarks,
        explained,
        Evidence(fitted, {n: (runs, stats[n][0]) for n, runs in context.kinds.items()}, joint),
    )


def _best_statistics(
    kinds: dict[str, np.ndarray], shares: np.ndarray, names: Sequence[str]
) -> dict[str, str]:
    """By unknown the kind of statistics that tells it best by itself."""
    missed = {what: residuals_alone(kind, shares) for what, kind in kinds.items()}
    tellers = {}
    for k, name in enumerate(names):
        best = min(missed, key=lambda what: float(missed[what][k]))
        tellers[name] = best if missed[best][k] < LARGEST_RESIDUAL else ""
    return tellers


def _draw_jointly(fitted: Regression, here: np.ndarray, open_: list[bool]) -> np.ndarray:
    """Shares (runs, unknowns) that the unknowns may have together: the estimates and what they
    miss, run by run; of unknowns that are not identified, their own."""
    at = np.clip(fitted.estimates(here)[0], 0.0, 1.0)
    shares = np.clip(at + fitted.missed(at), 0.0, 1.0)
    return np.where(open_, fitted.unknowns, shares)


def _too_few(runs: int) -> tuple[str, ...]:
    """That so many runs cannot say that no law of theirs explains a record."""
    if 1 / (runs + 1) <= STRANGE:
        return ()
    enough = round(1 / STRANGE)
    return (
        f"Of {runs} runs one in {runs + 1} lies as far from the others as the record by chance: "
        f"whether their laws explain it takes {enough} runs or more.",
    )


def _laws_in_words(laws: Ensemble) -> tuple[str, ...]:
    """Which laws acted in the sample, and what intervals suppose of them."""
    acted = [
        f"The {what} was one of {', '.join(names[:-1])} and {names[-1]}."
        for what, names in laws.names.items()
    ]
    alone = [what for what in (DISSIPATION, FRICTION) if what not in laws.names]
    suffix = f", and the mechanism's own {' and '.join(alone)}" if alone else ""
    return (
        *acted,
        "Intervals suppose the restitution, the slip speeds and the stiffness of the mechanism, "
        f"where these are no unknowns{suffix}: of a machine with others they need not hold.",
    )
