"""An answer from what records tell by their signals, and from several records by statistics: the
next record, between which and those measured every unknown may differ.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxclear.studies.identification.measurement import Measurement
from jaxclear.studies.identification.models import compared
from jaxclear.studies.identification.result import (
    IDENTIFIED,
    NOT,
    NOTHING,
    PARTLY,
    Identified,
    Unknown,
    end_reached,
    ends_in_words,
    prior_quantiles,
    unexplained,
    unknown_of,
    verdict_of,
)
from jaxclear.studies.identification.several_records import (
    FEWEST,
    NextRecord,
    interval_of,
    next_record,
)
from jaxclear.studies.identification.signal_fit import CredibleInterval, SignalFit
from jaxclear.studies.identification.signal_study import SignalFits, fit_signals
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_experiment import RunExperiment

# Windows of a record of runs in time, each twice as long as the one before.
WINDOWS = 4
# Draws that follow what the records leave.
DRAWS = 1024
# Scores whose posterior correlation [1] is beyond this are told better together.
TOGETHER = 0.8


def identify_by_signals(
    models: Mapping[str, Sequence[Problem]],
    records: Sequence[Measurement],
    draws: int,
    seed: int,
) -> Identified:
    """What records tell by their signals of the unknowns of each model.

    Args:
        models: for each name a problem for each record.
        records: measured signals.
        draws: runs that sample what follows for the responses.
        seed: of all random numbers.
    """
    pairs = {
        name: [compared(problem, record) for problem, record in zip(problems, records, strict=True)]
        for name, problems in models.items()
    }
    in_time = any(
        isinstance(problem.experiment, RunExperiment)
        for problems in models.values()
        for problem in problems
    )
    windows = WINDOWS if in_time else 1
    study = fit_signals(pairs, windows=windows, draws=draws, seed=seed)
    return of_signals(models, study, seed)


def of_signals(models: Mapping[str, Sequence[Problem]], study: SignalFits, seed: int) -> Identified:
    """The answer from fits of all models to all records.

    Args:
        models: for each name a problem for each record.
        study: fits and the models that were chosen.
        seed: of the posterior sample.
    """
    records = len(next(iter(study.fits.values())))
    runs = sum(fit.runs for fits in study.fits.values() for fit in fits)
    how = "by the signals themselves" + (f" of {records} records" if records >= FEWEST else "")
    first = study.choice.models[0] if study.choice.models else next(iter(models))
    problem: Any = models[first][0]
    if study.refusal:
        prior = [unknown_of(problem, name, NOTHING) for name in problem.names]
        shares = np.random.default_rng(seed).random((DRAWS, len(problem.names)))
        values = [prior_quantiles(problem, n, shares[:, i]) for i, n in enumerate(problem.names)]
        none = np.stack(values, axis=1)
        return Identified(problem, tuple(prior), none, runs, 0, how, refusal=study.refusal)
    intervals = study.by_model.get(first, {})
    unknowns = [
        _unknown(problem, name, study.unknowns.get(name) or intervals[name])
        for name in problem.names
        if name in study.unknowns or name in intervals
    ]
    drawn = _values(problem, study, np.random.default_rng(seed))
    remarks = [*_misfits(study, first), *ends_in_words(problem, unknowns), *_models(study)]
    remarks += _rest(study, first, models)
    remarks += _together(unknowns, study.fits[first][0]) if records < FEWEST else _drift(study)
    units = problem.units()
    remarks += _by_steps(study.fits[first])
    answers = tuple(_row(name, units[name], interval) for name, interval in study.answers.items())
    sentences = tuple(remarks)
    return Identified(problem, tuple(unknowns), drawn, runs, 0, how, sentences, answers=answers)


def _unknown(problem: Problem, name: str, interval: CredibleInterval) -> Unknown:
    row = _row(name, problem.variable_units[problem.names.index(name)], interval)
    prior = row.prior_high - row.prior_low
    at_end = end_reached(problem, name, row.low, row.high, prior) is not None
    return row._replace(verdict=PARTLY) if at_end and row.verdict == IDENTIFIED else row


def _row(name: str, unit: str, interval: CredibleInterval) -> Unknown:
    """An unknown, or a response; one that is not identified has its prior's interval."""
    verdict = verdict_of(interval.width)
    prior = float(interval.prior_low), float(interval.prior_high)
    value, low, high = float(interval.value), float(interval.low), float(interval.high)
    if verdict == NOT:
        value, low, high = 0.5 * (prior[0] + prior[1]), *prior
    return Unknown(name, unit, value, low, high, *prior, float(interval.width), verdict, "")


def _values(problem: Problem, study: SignalFits, rng: np.random.Generator) -> np.ndarray:
    """Draws (draws, unknowns) of a record yet to come, from all kept models alike."""
    names, models = problem.names, study.choice.models
    of_model = {}
    for model in models:
        fits = study.fits[model]
        fitted_names = list(fits[0].unknowns)
        each = DRAWS if model == models[0] else DRAWS // len(models)
        if len(fits) < FEWEST:
            drawn = rng.permutation(fits[0].values)[:each]
        else:
            nexts = [study.between[model][name] for name in fitted_names]
            # Of what records tell of each unknown, in the mean.
            alike = np.mean([np.atleast_2d(np.corrcoef(fit.values.T)) for fit in fits], axis=0)
            drawn = next_values(nexts, alike, each, rng)
        of_model[model] = dict(zip(fitted_names, drawn.T, strict=True))
    values = np.stack([of_model[models[0]][name] for name in names], axis=1)
    for number, model in enumerate(models[1:], 1):
        rows = slice((number - 1) * (DRAWS // len(models)), number * (DRAWS // len(models)))
        for i, name in enumerate(names):
            if name in of_model[model]:
                values[rows, i] = of_model[model][name]
    ends = [prior_quantiles(problem, name, np.array([0.0, 1.0])) for name in names]
    return np.clip(values, *np.array(ends).T)


def next_values(
    estimates: Sequence[NextRecord], correlation: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Values (count, unknowns) in future records, by Student's distribution.

    Args:
        estimates: of each unknown in the next record.
        correlation: of the unknowns within a record.
        count: number of values.
        rng: random generator.
    """
    freedom = estimates[0].freedom
    normal = rng.multivariate_normal(np.zeros(len(estimates)), correlation, count)
    heavy = np.sqrt(freedom / rng.chisquare(freedom, (count, 1)))
    scale, middle = [e.scale for e in estimates], [e.value for e in estimates]
    return np.array(middle) + np.array(scale) * heavy * normal


def _misfits(study: SignalFits, first: str) -> list[str]:
    """What the nearest model leaves of the records."""
    sentences = []
    for name in study.fits[first][0].misfits:
        misfits = [fit.misfits[name] for fit in study.fits[first]]
        share, time = (max(getattr(one, part) for one in misfits) for part in ("share", "time"))
        sentences.append(
            f'{100 * share:.3g} % of signal "{name}" are left, alike over {time:.2g} samples, '
            "which count as one."
            if time > 1.5
            else f'{100 * share:.3g} % of signal "{name}" are left.'
        )
    return sentences


def _models(study: SignalFits) -> list[str]:
    """Which models remain, and what speaks against others."""
    text = []
    if len(study.choice.models) > 1:
        names = ", ".join(f'"{name}"' for name in study.choice.models)
        text.append(f"The records do not speak against any of {names}: intervals hold all of them.")
    return text + [f'"{name}" is left out: {why}' for name, why in study.choice.against.items()]


def _rest(study: SignalFits, first: str, problems: Any) -> list[str]:
    """What only other models than the nearest have."""
    sentences = []
    for model, intervals in study.by_model.items():
        if model == first:
            continue
        for name, interval in intervals.items():
            unknown = _unknown(problems[model][0], name, interval)
            sentences.append(f'Of "{model}" alone: {unknown.sentence()}')
    return sentences


def _by_steps(fits: Sequence[SignalFit]) -> list[str]:
    """Unknowns that the steps of runs move by more than what the record leaves open."""
    most: dict[str, float] = {}
    for name, moves in [pair for fit in fits for pair in (fit.by_steps or {}).items()]:
        most[name] = max(most.get(name, 0.0), abs(moves))
    return [
        f'By the steps of the runs "{name}" is off by about {moves:.2g} of its standard '
        "deviations, which its interval does not hold: take shorter steps."
        for name, moves in most.items()
        if moves > 1
    ]


def _together(unknowns: Sequence[Unknown], fit: SignalFit) -> list[str]:
    """Unknowns that a record tells together better than each alone."""
    vague = {unknown.name for unknown in unknowns if unknown.verdict != IDENTIFIED}
    return [
        f'"{one}" and "{other}" are told together better than each alone: their correlation is '
        f"{correlation:.2f}."
        for (one, other), correlation in fit.together.items()
        if abs(correlation) > TOGETHER and vague & {one, other}
    ]


def _drift(study: SignalFits) -> list[str]:
    """How records differ beside what each tells of itself."""
    spreads = study.between[study.choice.models[0]]
    names = [name for name, spread in spreads.items() if spread.between > spread.within]
    text = "Intervals are those of the next record, by Student's t of the differences between them"
    if not names:
        return [f"{text}, which are no more than each record leaves open."]
    listed = ", ".join(f'"{name}"' for name in names)
    return [f"{text}; {listed} differ by more than each record by itself tells."]


def of_records(problem: Any, every: Sequence[Identified], seed: int) -> Identified:
    """One answer, for the next record, from those of several records by statistics.

    Args:
        problem: with the unknowns as variables.
        every: answer of each record.
        seed: of the posterior sample.
    """
    nexts, unknowns = [], []
    for i, name in enumerate(problem.names):
        estimates = []
        for identified in every:
            row, values = identified.unknowns[i], identified.posterior_values[:, i]
            prior = row.prior_low, row.prior_high
            estimates.append(
                CredibleInterval(row.estimate, row.low, row.high, float(values.std()), *prior)
            )
        nexts.append(next_record(estimates))
        unknowns.append(_unknown(problem, name, interval_of(estimates)))
    drawn = [np.corrcoef(identified.posterior_values.T) for identified in every]
    correlation = np.atleast_2d(np.mean(drawn, axis=0))
    values = next_values(nexts, correlation, DRAWS, np.random.default_rng(seed))
    ends = np.array([prior_quantiles(problem, n, np.array([0.0, 1.0])) for n in problem.names])
    remarks = dict.fromkeys(text for identified in every for text in identified.remarks)
    explained = [identified.explained for identified in every if identified.explained is not None]
    if any(identified.explains is False for identified in every):
        unknowns = list(unexplained(unknowns))
    return Identified(
        problem,
        tuple(unknowns),
        np.clip(values, *ends.T),
        max(identified.runs for identified in every),
        max(identified.failed for identified in every),
        f"{every[0].how} of each of {len(every)} records; intervals are those of the next record",
        tuple(remarks),
        min(explained) if explained else None,
        every[0].evidence,
    )
