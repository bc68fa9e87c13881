"""Which integrator and which step for this problem, at an accuracy in its responses, and what it
costs.

A pilot (the first part of the problem, nominal and a few copies within the tolerances) is run with
every candidate, coarse to fine, and compared with a tight adaptive reference. Recommended is the
cheapest setting whose error, with its uncertainty, is below the accuracy and whose next finer
neighbour's is too. That setting and those beside it are then run over the whole problem
(`confirmation`), because errors that grow with time are larger at the end of a longer run.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from tqdm import tqdm

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import (
    check_count,
    check_flags,
    check_known,
    check_number,
    expect,
)
from jaxclear.ground.precision import check_double_precision
from jaxclear.studies import verdict
from jaxclear.studies.advice.advice import Advice, checked_accuracy
from jaxclear.studies.advice.comparison import Comparison, check_means
from jaxclear.studies.advice.confirmation import confirmed
from jaxclear.studies.advice.curve import PRESENT, REFERENCE, Curve
from jaxclear.studies.advice.pilot import Pilot, PilotSettings, measure, pilot_of, time_in_batch
from jaxclear.studies.advice.trials import NothingToMeasure, follow, once, reference
from jaxclear.studies.problem import Problem
from jaxclear.studies.verdict import Criterion
from jaxclear.studies.work_precision import (
    Candidates,
    check_candidates,
    default_candidates,
)

# A method is left where a finer setting would be this many times as dear as the cheapest that meets
# the accuracy already. In a batch costs change places: adaptive steps wait for the slowest sample,
# fixed ones do not.
TOO_DEAR, TOO_DEAR_IN_BATCH = 4.0, 40.0


@answering
def advise(
    problem: Problem,
    accuracy: float = 0.01,
    *,
    candidates: Candidates | None = None,
    pilot: PilotSettings | None = None,
    scales: Mapping[str, float] | None = None,
    means: bool = False,
    batch: int | None = None,
    progress_bar: bool = False,
) -> Advice:
    """The cheapest integrator that meets `accuracy` in every response of a problem; see `Advice`.

    `accuracy` [1]: largest error beside a response's root mean square over the copies, or its size
    in `scales` (for a response about zero). `candidates`: integrators to try instead of all
    that jaxclear has, by method, coarse to fine; every method compiles once. `pilot`: the short
    runs that are made, their number and length. `means`: not every run must meet the accuracy but
    the mean over the copies, as a Monte Carlo study wants it. `batch`: samples run together as
    `monte_carlo` does; the recommended setting is then the cheapest there. Raises `ValueError` with
    a sentence for what cannot be asked and for a reference that fails.
    """
    check_double_precision()
    accuracy, scales = checked_accuracy(accuracy), {} if scales is None else scales
    settings = PilotSettings() if pilot is None else pilot
    _check(problem, settings, batch, scales, means)
    tried = default_candidates(problem, settings.reference) if candidates is None else candidates
    check_candidates(tried, (REFERENCE, PRESENT))
    check_flags("advise", progress_bar=progress_bar)
    with tqdm(total=len(tried) + 2, desc="advice", disable=not progress_bar) as bar:
        short, known = piloted(problem, settings, scales, means)
        bar.update(1)
        curves = {PRESENT: Curve((measure(short, problem.integrator),), "")}
        bar.update(1)
        first = Comparison(
            accuracy, short, {REFERENCE: known}, dict(scales), problem.response_names, means, batch
        )
        criteria = first.criteria
        run = once(short, (*known.trials, *curves[PRESENT].trials))
        for name, ordered in tried.items():
            most = (known.trials[-1].cost, _allowance(curves, criteria, batch))
            curves[name] = follow(run, ordered, criteria, *most)
            bar.update(1)
    if batch is not None:
        for name, curve in curves.items():
            curves[name] = _timed_in_batch(short, curve, criteria, batch)
    first = dataclasses.replace(first, curves=first.curves | curves)
    found, doubt = confirmed(first, problem, tried, settings)
    if found is None:
        return Advice(problem, first, None, doubt)
    return Advice(problem, found, first)


def piloted(
    problem: Problem, settings: PilotSettings, scales: Mapping[str, float], means: bool = False
) -> tuple[Pilot, Curve]:
    """The pilot and its reference. One whose duration nobody gave is doubled while a response is 0
    in it: a journal may not have touched yet.
    """
    asked, whole, longer = settings.duration is not None, float(problem.duration), None
    while True:
        short = pilot_of(problem, settings, longer, means)
        try:
            return reference(short, settings.reference, scales)
        except NothingToMeasure:
            if asked or short.duration >= whole:
                raise
            longer = min(2 * short.duration, whole)


def _allowance(
    curves: Mapping[str, Curve], criteria: dict[str, Criterion], batch: int | None
) -> float:
    """Largest cost worth a trial: some times that of what already meets the accuracy."""
    meeting = []
    for curve in curves.values():
        place = verdict.coarsest(curve.trials, criteria)
        if place is not None:
            meeting.append(curve.trials[place].cost)
    return (TOO_DEAR if batch is None else TOO_DEAR_IN_BATCH) * min(meeting, default=np.inf)


def _timed_in_batch(
    pilot: Pilot, curve: Curve, criteria: dict[str, Criterion], samples: int
) -> Curve:
    """The curve, the first of its settings that is good enough timed in a batch."""
    place = verdict.coarsest(curve.trials, criteria)
    if place is None:
        return curve
    timed = time_in_batch(pilot, curve.trials[place], samples)
    return Curve((*curve.trials[:place], timed, *curve.trials[place + 1 :]), curve.stopped)


def _check(
    problem: Any, pilot: PilotSettings, batch: int | None, scales: Mapping[str, float], means: bool
) -> None:
    check_flags("advise", means=means)
    expect(scales, Mapping, "scales of advise", "a dictionary: a size by response")
    expect(problem, Problem, "what advice is given on", "a jaxclear.Problem")
    expect(pilot, PilotSettings, "the pilot", "a jaxclear.PilotSettings")
    check_count("batch of advise", 1 if batch is None else batch)
    whole = float(problem.duration)
    if pilot.duration is not None and not 0 < pilot.duration <= whole:
        raise ValueError(
            f"the pilot's duration is {pilot.duration!r} s; it must be above 0 and at most the "
            f"problem's {whole:.6g} s."
        )
    for name, size in scales.items():
        check_known("response", name, problem.response_names, " in this problem")
        check_number(f'the scale of response "{name}" (in its own unit)', size, above=0)
    if means:
        check_means(len(pilot_of(problem, pilot).values))
