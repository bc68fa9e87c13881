"""Unknowns from the signals themselves, `jaxclear.identify(..., how="signal")`: each model of the
machine on each record, the next record from the differences between records, and what all models
say that the records do not speak against.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from jaxclear.studies.identification.alternatives import ModelChoice, choose_models, hull
from jaxclear.studies.identification.forward import Forward, Record
from jaxclear.studies.identification.several_records import (
    FEWEST,
    NextRecord,
    interval_of,
    next_record,
)
from jaxclear.studies.identification.signal_fit import CredibleInterval, SignalFit, fit_signal
from jaxclear.studies.problem import Problem


class SignalFits(NamedTuple):
    """What records tell. `fits`: of each model each record; `choice`: the models that remain, and
    sentences against the others; `unknowns` and `answers`: intervals that hold those of all
    remaining models, for what all have (of several records, of the next one); `by_model`: what only
    some models have, by model; `between`: the differences between records, by model and name."""

    fits: dict[str, tuple[SignalFit, ...]]
    choice: ModelChoice
    unknowns: dict[str, CredibleInterval]
    answers: dict[str, CredibleInterval]
    by_model: dict[str, dict[str, CredibleInterval]]
    between: dict[str, dict[str, NextRecord]]

    @property
    def refusal(self) -> str:
        """Why nothing is told; "" where something is."""
        if self.choice.models:
            return ""
        if len(self.fits) == 1:
            return next(iter(self.choice.against.values()))
        return " ".join(f"{name}: {why}" for name, why in self.choice.against.items())


def fit_signals(
    models: Mapping[str, Sequence[tuple[Forward, Record]]],
    *,
    windows: int = 1,
    draws: int = 512,
    seed: int = 0,
) -> SignalFits:
    """Fits of all models of a machine to all records, and intervals for the next record.

    Args:
        models: for each name a (forward model, record) for each record.
        windows, draws, seed: as of `fit_signal`.
    """
    how = {"windows": windows, "draws": draws, "seed": seed}
    fits = {
        name: tuple(fit_signal(model, record, **how) for model, record in every)
        for name, every in models.items()
    }
    retained = choose_models(fits)
    unknowns: dict[str, dict[str, CredibleInterval]] = {}
    answers: dict[str, dict[str, CredibleInterval]] = {}
    between: dict[str, dict[str, NextRecord]] = {}
    for name in retained.models:
        chosen, problem = fits[name], models[name][0][0].problem
        rows = [{**fit.unknowns, **fit.answers} for fit in chosen]
        intervals = {key: interval_of([each[key] for each in rows]) for key in rows[0]}
        unknowns[name] = {key: _within(problem, key, intervals[key]) for key in chosen[0].unknowns}
        answers[name] = {key: intervals[key] for key in chosen[0].answers}
        if len(chosen) >= FEWEST:
            between[name] = {key: next_record([each[key] for each in rows]) for key in rows[0]}
    shared, rest = _join_models(unknowns)
    return SignalFits(fits, retained, shared, _join_models(answers)[0], rest, between)


def _within(problem: Problem, name: str, interval: CredibleInterval) -> CredibleInterval:
    """An interval of an unknown within the ends of its prior."""
    place = problem.names.index(name)
    distribution, nominal = problem.inputs.distributions[place], float(problem.nominal()[place])
    low, high = (nominal + float(distribution.quantile(end)) for end in (0.0, 1.0))
    return interval._replace(low=max(interval.low, low), high=min(interval.high, high))


def _join_models(
    every: dict[str, dict[str, CredibleInterval]],
) -> tuple[dict[str, CredibleInterval], dict[str, dict[str, CredibleInterval]]]:
    """What all models tell of, together; and what only some do, by model."""
    rows = list(every.values())
    names = [n for n in rows[0] if all(n in row for row in rows)] if rows else []
    shared = {name: hull([row[name] for row in rows]) for name in names}
    rest = {model: {n: x for n, x in row.items() if n not in names} for model, row in every.items()}
    return shared, {model: row for model, row in rest.items() if row}
