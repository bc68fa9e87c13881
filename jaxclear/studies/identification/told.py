"""An answer from what records tell by their signals, and from several records by statistics: the
next record, between which and those measured every unknown may differ.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxclear.studies.identification.by_signal import BySignal, by_signal
from jaxclear.studies.identification.measurement import Measurement
from jaxclear.studies.identification.models import compared
from jaxclear.studies.identification.posterior import equally_weighted
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
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_experiment import RunExperiment

# Searches that begin at different places of the priors, and windows of a record of runs in time,
# each twice as long as the one before.
STARTS, WINDOWS = 8, 4
# Draws that follow what the records leave.
DRAWS = 1024
# Scores whose posterior correlation [1] is beyond this are told better together.
TOGETHER = 0.8


def told_by_signals(
    models: Mapping[str, Sequence[Problem]],
    records: Sequence[Measurement],
    draws: int,
    seed: int,
) -> Identified:
    """What records tell by their signals of each model's unknowns; `draws` a round."""
    pairs = {
        name: [compared(own, record) for own, record in zip(problems, records, strict=True)]
        for name, problems in models.items()
    }
    in_time = any(
        isinstance(own.experiment, RunExperiment)
        for problems in models.values()
        for own in problems
    )
    windows = WINDOWS if in_time else 1
    found = by_signal(pairs, starts=STARTS, windows=windows, draws=draws, seed=seed)
    return of_signals(models, found, seed)


def of_signals(problems: Mapping[str, Sequence[Problem]], found: BySignal, seed: int) -> Identified:
    """The answer of models and records."""
    records = len(next(iter(found.fits.values())))
    runs = sum(fit.runs for own in found.fits.values() for fit in own)
    how = "by the signals themselves" + (f" of {records} records" if records >= FEWEST else "")
    first = found.kept.models[0] if found.kept.models else next(iter(problems))
    problem: Any = problems[first][0]
    if found.refusal:
        prior = [unknown_of(problem, name, NOTHING) for name in problem.names]
        shares = np.random.default_rng(seed).random((DRAWS, len(problem.names)))
        values = [prior_quantiles(problem, n, shares[:, i]) for i, n in enumerate(problem.names)]
        none = np.stack(values, axis=1)
        return Identified(problem, tuple(prior), none, runs, 0, how, refusal=found.refusal)
    own = found.own.get(first, {})
    unknowns = [
        _unknown(problem, name, found.unknowns.get(name) or own[name])
        for name in problem.names
        if name in found.unknowns or name in own
    ]
    drawn = _values(problem, found, np.random.default_rng(seed))
    remarks = [*_misfits(found, first), *ends_in_words(problem, unknowns), *_models(found)]
    remarks += _rest(found, first, problems)
    remarks += _together(unknowns, found.fits[first][0]) if records < FEWEST else _drift(found)
    units = problem.units()
    answers = tuple(_row(name, units[name], own) for name, own in found.answers.items())
    said = tuple(remarks)
    return Identified(problem, tuple(unknowns), drawn, runs, 0, how, said, answers=answers)


def _unknown(problem: Problem, name: str, own: CredibleInterval) -> Unknown:
    found = _row(name, problem.variable_units[problem.names.index(name)], own)
    prior = found.prior_high - found.prior_low
    at_end = end_reached(problem, name, found.low, found.high, prior) is not None
    return found._replace(verdict=PARTLY) if at_end and found.verdict == IDENTIFIED else found


def _row(name: str, unit: str, own: CredibleInterval) -> Unknown:
    """An unknown, or a response; one that is not identified has its prior's interval."""
    verdict = verdict_of(own.width)
    prior = float(own.prior_low), float(own.prior_high)
    value, low, high = float(own.value), float(own.low), float(own.high)
    if verdict == NOT:
        value, low, high = 0.5 * (prior[0] + prior[1]), *prior
    return Unknown(name, unit, value, low, high, *prior, float(own.width), verdict, "")


def _values(problem: Problem, found: BySignal, rng: np.random.Generator) -> np.ndarray:
    """Draws (draws, unknowns) of a record yet to come, from all kept models alike."""
    names, models = problem.names, found.kept.models
    of_model = {}
    for model in models:
        fits = found.fits[model]
        own = list(fits[0].unknowns)
        each = DRAWS if model == models[0] else DRAWS // len(models)
        if len(fits) < FEWEST:
            drawn = fits[0].values[equally_weighted(fits[0].weights, each, rng)]
        else:
            nexts = [found.between[model][name] for name in own]
            drawn = next_values(nexts, _correlation(fits), each, rng)
        of_model[model] = dict(zip(own, drawn.T, strict=True))
    values = np.stack([of_model[models[0]][name] for name in names], axis=1)
    for number, model in enumerate(models[1:], 1):
        rows = slice((number - 1) * (DRAWS // len(models)), number * (DRAWS // len(models)))
        for i, name in enumerate(names):
            if name in of_model[model]:
                values[rows, i] = of_model[model][name]
    ends = [prior_quantiles(problem, name, np.array([0.0, 1.0])) for name in names]
    return np.clip(values, *np.array(ends).T)


def next_values(
    told: Sequence[NextRecord], correlation: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Values (count, unknowns) in records yet to come, correlated as what each record tells."""
    freedom = told[0].freedom
    normal = rng.multivariate_normal(np.zeros(len(told)), correlation, count)
    heavy = np.sqrt(freedom / rng.chisquare(freedom, (count, 1)))
    scale, middle = [own.scale for own in told], [own.value for own in told]
    return np.array(middle) + np.array(scale) * heavy * normal


def _correlation(fits: Sequence[SignalFit]) -> np.ndarray:
    """Mean correlation (unknowns, unknowns) of what records tell of each unknown."""
    own = [np.cov(fit.values.T, aweights=fit.weights) for fit in fits]
    matrices = []
    for each in own:
        size = np.sqrt(np.diag(np.atleast_2d(each)))
        matrices.append(np.atleast_2d(each) / np.outer(size, size))
    return np.mean(matrices, axis=0)


def _misfits(found: BySignal, first: str) -> list[str]:
    """What the nearest model leaves of the records."""
    said = []
    for name in found.fits[first][0].misfits:
        own = [fit.misfits[name] for fit in found.fits[first]]
        left, time = (max(getattr(one, part) for one in own) for part in ("share", "time"))
        said.append(
            f'{100 * left:.3g} % of signal "{name}" are left, alike over {time:.2g} samples, which '
            "count as one."
            if time > 1.5
            else f'{100 * left:.3g} % of signal "{name}" are left.'
        )
    return said


def _models(found: BySignal) -> list[str]:
    """Which models remain, and what speaks against others."""
    said = []
    if len(found.kept.models) > 1:
        names = ", ".join(f'"{name}"' for name in found.kept.models)
        said.append(f"The records do not speak against any of {names}: intervals hold all of them.")
    return said + [f'"{name}" is left out: {why}' for name, why in found.kept.against.items()]


def _rest(found: BySignal, first: str, problems: Any) -> list[str]:
    """What only other models than the nearest have."""
    said = []
    for model, own in found.own.items():
        if model == first:
            continue
        for name, interval in own.items():
            told = _unknown(problems[model][0], name, interval)
            said.append(f'Of "{model}" alone: {told.sentence()}')
    return said


def _together(unknowns: Sequence[Unknown], fit: SignalFit) -> list[str]:
    """Unknowns that a record tells together better than each alone."""
    vague = {own.name for own in unknowns if own.verdict != IDENTIFIED}
    return [
        f'"{one}" and "{other}" are told together better than each alone: their correlation is '
        f"{correlation:.2f}."
        for (one, other), correlation in fit.together.items()
        if abs(correlation) > TOGETHER and vague & {one, other}
    ]


def _drift(found: BySignal) -> list[str]:
    """How records differ beside what each tells of itself."""
    own = found.between[found.kept.models[0]]
    names = [name for name, told in own.items() if told.between > told.within]
    said = "Intervals are those of the next record, by Student's t of the differences between them"
    if not names:
        return [f"{said}, which are no more than each record leaves open."]
    listed = ", ".join(f'"{name}"' for name in names)
    return [f"{said}; {listed} differ by more than each record by itself tells."]


def of_records(problem: Any, every: Sequence[Identified], seed: int) -> Identified:
    """One answer from what several records tell by statistics, of the next record."""
    nexts, unknowns = [], []
    for i, name in enumerate(problem.names):
        told = []
        for own in every:
            row, values = own.unknowns[i], own.posterior_values[:, i]
            prior = row.prior_low, row.prior_high
            told.append(
                CredibleInterval(row.estimate, row.low, row.high, float(values.std()), *prior)
            )
        nexts.append(next_record(told))
        unknowns.append(_unknown(problem, name, interval_of(told)))
    drawn = [np.corrcoef(own.posterior_values.T) for own in every]
    correlation = np.atleast_2d(np.mean(drawn, axis=0))
    values = next_values(nexts, correlation, DRAWS, np.random.default_rng(seed))
    ends = np.array([prior_quantiles(problem, n, np.array([0.0, 1.0])) for n in problem.names])
    remarks = dict.fromkeys(text for own in every for text in own.remarks)
    explained = [own.explained for own in every if own.explained is not None]
    if any(own.explains is False for own in every):
        unknowns = list(unexplained(unknowns))
    return Identified(
        problem,
        tuple(unknowns),
        np.clip(values, *ends.T),
        max(own.runs for own in every),
        max(own.failed for own in every),
        f"{every[0].how} of each of {len(every)} records; intervals are those of the next record",
        tuple(remarks),
        min(explained) if explained else None,
        every[0].evidence,
    )
