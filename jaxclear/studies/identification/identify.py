"""From a record to the numbers of a machine: `jaxclear.identify`.

Signals of machines with clearance are not reproducible over more than a few impacts, and not those
of another law at all; statistics of signals are. A sample of the problem is run, the record's
sensors see it, and each unknown is regressed on the statistics of what they see.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_known, expect
from jaxclear.ground.wording import described
from jaxclear.results.signal import usual_statistics
from jaxclear.studies.identification.by_signal import by_signal
from jaxclear.studies.identification.laws import Ensemble
from jaxclear.studies.identification.measurement import Measurement
from jaxclear.studies.identification.models import WINDOWS, Model, compared, models_of
from jaxclear.studies.identification.regression import ONE_LENGTH, regression, told
from jaxclear.studies.identification.result import (
    ONE_RECORD,
    Evidence,
    Identified,
    prior_quantiles,
    prior_shares,
    together,
    unknown_of,
)
from jaxclear.studies.identification.sample import (
    Sample,
    as_signals,
    check_identifiable,
    cut_of,
    sampled,
    sensed,
    statistics_of,
)
from jaxclear.studies.identification.told import of_records, of_signals
from jaxclear.studies.problem import Problem
from jaxclear.studies.sampling import check_sampled

WAYS = ("statistics", "signal")
# Searches that begin at different places of the priors.
STARTS = 8
# Runs below which residuals say nothing of an interval of 95 %.
LEAST_RUNS = 64
# A kind of statistics tells an unknown where its left-out residuals are below this share of the
# prior's deviation.
TELLS = 0.9


@answering
def identify(
    problem: Model | Mapping[str, Model],
    data: Measurement | Sequence[Measurement],
    runs: int = 256,
    *,
    how: str = "statistics",
    statistics: Mapping[str, Callable] | None = None,
    laws: Sequence[type] | None = None,
    seed: int = 0,
    progress_bar: bool = False,
) -> Identified:
    """What a record tells of the variables of a problem, whose distributions are the priors.

    `problem`: a `Problem`; or a function that makes it for a `Measurement`, as where the motion of
    a drive was recorded. It shows at its end what was measured: what its runs last longer lets the
    motion settle.
    `data`: a `Measurement`, or several; of several each tells its own, and intervals are those of
    the next record, by Student's t of the differences between them.
    `runs`: of the sample, 64 at the least; 256 serve one loose joint, 512 three.
    `how`: "statistics", a regression of each unknown on statistics of the signals, with intervals
    of 95 % from runs that it did not see; or "signal", least squares by Levenberg and Marquardt
    from several starts, and the posterior by weighted draws, `runs` a round. The problem may then
    be a `FunctionProblem`, whose series a `sensor.Series` names, or a dictionary of several models
    of the machine: intervals hold those of all that the record does not speak against. Where a
    sensor's noise is 0 what is left stands for it; one that is known must explain what is left, or
    nothing is told. What is left and alike over many samples counts as one of them.
    `statistics`: functions of a `jaxclear.signal.Signal` that return arrays (signals, numbers), by
    name; by default `signal.usual_statistics`.
    `laws`: classes of dissipation factors and friction laws, one of which acts in each run at the
    joint's own restitution and kinetic coefficient; by default LankaraniNikravesh, Flores and
    HuntCrossley, Ambrosio and CoulombTanh, with the joint's own among them; (): the joint's own
    alone.
    `seed`: of the sample and the draws; `progress_bar`: of the runs.

    An unknown whose interval is wider than 0.8 of the prior's is not identified, and has the
    prior's interval; one below 0.5 is identified. Raises `ValueError` with a sentence for what
    cannot be asked.
    """
    records = _records(data)
    check_count("runs of identify", runs, at_least=LEAST_RUNS)
    check_known("way", how, WAYS, " of identify")
    check_flags("identify", progress_bar=progress_bar)
    models = models_of(problem, records)
    for own in next(iter(models.values())):
        check_sampled(own, runs, seed)
    if how == "signal":
        if statistics is not None or laws is not None:
            raise ValueError(
                'how="signal" takes neither statistics nor laws; for several laws give several '
                'problems by name, {"Flores": ..., "Hunt-Crossley": ...}.'
            )
        return _by_signal(models, records, runs, seed)
    if len(models) > 1:
        raise ValueError(
            'how="statistics" takes one problem; what laws may act, laws says: several models by '
            'name are for how="signal".'
        )
    (problems,) = models.values()
    found: list[Identified] = []
    known: list[tuple[Any, Measurement, Sample]] = []
    for own, record in zip(problems, records, strict=True):
        check_identifiable(own, record)
        asked = _statistics(statistics, record)
        same = [s for p, r, s in known if p is own and _alike(r, record)]
        sample = same[0] if same else sampled(own, record, runs, laws, seed, progress_bar)
        known.append((own, record, sample))
        found.append(identified(own, record, sample, asked, seed))
    return found[0] if len(found) == 1 else of_records(problems[0], found, seed)


def _records(data: Any) -> list[Measurement]:
    """One record or several, in a list."""
    several = isinstance(data, Sequence) and not isinstance(data, str)
    records = list(data) if several else [data]
    for record in records:
        expect(record, Measurement, "data of identify", "a jaxclear.Measurement, or several")
    if not records:
        raise ValueError("data of identify holds no record; it must hold a jaxclear.Measurement.")
    return records


def _alike(one: Measurement, other: Measurement) -> bool:
    """Whether the same sample serves two records."""
    return (
        one.sensors.keys() == other.sensors.keys()
        and one.rate == other.rate
        and all(bool(eqx.tree_equal(own, other.sensors[name])) for name, own in one.sensors.items())
    )


def _by_signal(models: Any, records: Sequence[Measurement], runs: int, seed: int) -> Identified:
    pairs = {
        name: [compared(own, record) for own, record in zip(problems, records, strict=True)]
        for name, problems in models.items()
    }
    in_time = any(isinstance(own, Problem) for problems in models.values() for own in problems)
    windows = WINDOWS if in_time else 1
    found = by_signal(pairs, starts=STARTS, windows=windows, draws=runs, seed=seed)
    return of_signals(models, found, seed)


def _statistics(given: Any, record: Measurement) -> dict[str, Callable]:
    """Statistics by name."""
    if given is None:
        return usual_statistics(record.turn is not None)
    expect(given, Mapping, "statistics of identify", "a dictionary from names to functions")
    for name, function in given.items():
        if not callable(function):
            raise ValueError(
                f'statistic "{name}" is {described(function)}; it must be a function of a '
                "jaxclear.signal.Signal that returns an array (signals, numbers)."
            )
    if not given:
        raise ValueError("statistics of identify is empty; it must hold at least one.")
    return dict(given)


def identified(
    problem: Problem,
    record: Measurement,
    sample: Sample,
    statistics: dict[str, Callable],
    seed: int = 0,
) -> Identified:
    """What a record tells beside a sample that has run."""
    if len(sample.values) < LEAST_RUNS:
        raise ValueError(
            f"{sample.failed} runs of the sample failed and {len(sample.values)} are left, fewer "
            f"than {LEAST_RUNS}: look at one by jaxclear.monte_carlo of the same problem."
        )
    cut = cut_of(record, sample)
    runs = statistics_of(as_signals(sensed(sample, record, seed), record, cut), statistics)
    own = {name: values[None] for name, values in record.signals.items()}
    shown = statistics_of(as_signals(own, record, cut), statistics)
    kinds = {what: (values, shown[what][0]) for what, values in runs.items()}
    every = np.concatenate(list(runs.values()), axis=1)
    here = np.concatenate([one[0] for one in shown.values()])
    shares = prior_shares(problem, sample.values)
    fitted = regression(every, shares)
    rows = told(fitted, here)
    tellers = _tellers(kinds, shares, problem.names)
    unknowns = tuple(
        unknown_of(problem, name, (row.estimate, row.low, row.high), tellers[name])
        for name, row in zip(problem.names, rows, strict=True)
    )
    joint = _joint(fitted, here)
    verdicts = [own.verdict for own in unknowns]
    remarks = (
        *together(problem.names, fitted, verdicts),
        *_laws_in_words(sample.laws),
        ONE_RECORD,
    )
    values = [prior_quantiles(problem, n, joint[:, i]) for i, n in enumerate(problem.names)]
    return Identified(
        problem,
        unknowns,
        np.stack(values, axis=1),
        len(sample.values),
        sample.failed,
        f"by {every.shape[1]} statistics of {len(record.signals)} signals",
        remarks,
        fitted.distance(here),
        Evidence(fitted, kinds, joint),
    )


def _tellers(
    kinds: dict[str, tuple[np.ndarray, np.ndarray]], shares: np.ndarray, names: Sequence[str]
) -> dict[str, str]:
    """By unknown the kind of statistics that tells it best by itself."""
    scatter = {
        what: regression(own, shares, ONE_LENGTH).scatter for what, (own, _) in kinds.items()
    }
    found = {}
    for k, name in enumerate(names):
        best = min(scatter, key=lambda what: float(scatter[what][k]))
        found[name] = best if scatter[best][k] < TELLS else ""
    return found


def _joint(fitted: Any, here: np.ndarray) -> np.ndarray:
    """Shares (samples, unknowns) that the unknowns may have together: the estimates and what is
    missed of the runs nearest by all of these."""
    at = fitted.estimates(here)[0]
    apart = np.sum((fitted.left_out - at) ** 2, axis=1)
    count = min(max(60, len(apart) // 5), len(apart))
    near = np.argsort(apart, kind="stable")[:count]
    return np.clip(at + fitted.residuals[near], 0.0, 1.0)


def _laws_in_words(laws: Ensemble) -> tuple[str, ...]:
    """Which laws acted in the sample."""
    return tuple(
        f"The {what} was one of {', '.join(names[:-1])} and {names[-1]}."
        for what, names in laws.names.items()
    )
