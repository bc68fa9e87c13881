"""Which integrator and which step for this problem, at an accuracy in its responses, and what it
costs.

A pilot (the first part of the problem, nominal and a few copies within the tolerances) is run with
every candidate, coarse to fine, and compared with a tight adaptive reference. Recommended is the
cheapest setting whose error, with its uncertainty, is below the accuracy and whose next finer
neighbour's is too. What is found holds for the pilot: errors that grow with time are larger at the
end of a longer run.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
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
from jaxclear.integrators import AbstractIntegrator, Adaptive, Outcome
from jaxclear.studies import verdict
from jaxclear.studies.advice.advice import Advice, checked_accuracy
from jaxclear.studies.advice.comparison import Comparison, check_means
from jaxclear.studies.advice.curve import PRESENT, REFERENCE, Curve
from jaxclear.studies.advice.pilot import (
    Pilot,
    PilotSettings,
    Trial,
    describe,
    measure,
    pilot_of,
    time_in_batch,
)
from jaxclear.studies.problem import Problem
from jaxclear.studies.verdict import Criterion
from jaxclear.studies.work_precision import (
    LOOSER,
    Candidates,
    check_candidates,
    default_candidates,
    loosened,
)

# A curve is followed until its error is this share of the accuracy: the figure shows how it falls.
FAR_BELOW = 0.1
# It is left where a finer setting would be this many times as dear as the reference, or as the
# cheapest that meets the accuracy already. In a batch costs change places: adaptive steps wait for
# the slowest sample, fixed ones do not.
DEARER_THAN_REFERENCE, TOO_DEAR, TOO_DEAR_IN_BATCH = 1.5, 4.0, 40.0
# A finer setting is taken to cost at most this much more than the last (2.5 is the widest gap
# between steps).
MOST_GROWTH = 2.5


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

    `accuracy`: largest error as a share of a response's root mean square over the copies, or of its
    size in `scales` (for a response about zero). `candidates`: integrators to try instead of all
    that jaxclear has, by method, coarse to fine; every method compiles once. `pilot`: the short
    runs that are made, their number and length. `means`: not every run must meet the accuracy but
    the mean over the copies, as a Monte Carlo study wants it. `batch`: samples run together as
    `monte_carlo` does; the recommended setting is then the cheapest there. Raises `ValueError` with
    a sentence for what cannot be asked and for a reference that fails.
    """
    check_double_precision()
    accuracy, scales = checked_accuracy(accuracy), {} if scales is None else scales
    settings = PilotSettings() if pilot is None else pilot
    _check(problem, settings, batch, scales)
    short = pilot_of(problem, settings)
    tried = (
        default_candidates(short.problem, settings.reference) if candidates is None else candidates
    )
    check_candidates(tried, (REFERENCE, PRESENT))
    check_flags("advise", means=means, progress_bar=progress_bar)
    if means:
        check_means(len(short.values))
    with tqdm(total=len(tried) + 2, desc="advice", disable=not progress_bar) as bar:
        short, known = _reference(short, settings.reference, scales)
        bar.update(1)
        curves = {PRESENT: Curve((measure(short, problem.integrator),), "")}
        bar.update(1)
        criteria = verdict.criteria(known.trials, problem.response_names, accuracy, scales, means)
        run = _once(short, (*known.trials, *curves[PRESENT].trials))
        for name, ordered in tried.items():
            most = (known.trials[-1].cost, _allowance(curves, criteria, batch))
            curves[name] = _follow(run, ordered, criteria, *most)
            bar.update(1)
    if batch is not None:
        for name, curve in curves.items():
            curves[name] = _timed_in_batch(short, curve, criteria, batch)
    names, followed = problem.response_names, {REFERENCE: known, **curves}
    compared = Comparison(accuracy, short, followed, dict(scales), names, means, batch)
    return Advice(problem, compared)


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


def _once(pilot: Pilot, known: tuple[Trial, ...]) -> Callable[[AbstractIntegrator], Trial]:
    """Measures an integrator, unless it is among the trials that are known."""

    def run(integrator):
        same = [trial for trial in known if eqx.tree_equal(trial.integrator, integrator)]
        return same[0] if same else measure(pilot, integrator)

    return run


def _follow(
    run: Callable[[AbstractIntegrator], Trial],
    ordered: Sequence[AbstractIntegrator],
    criteria: dict[str, Criterion],
    reference_cost: float,
    allowance: float,
) -> Curve:
    """Trials of one method, coarse to fine, until they are good enough or too dear."""
    trials: list[Trial] = []
    for integrator in ordered:
        expected = _expected_cost(trials)
        if expected > DEARER_THAN_REFERENCE * reference_cost:
            return Curve(tuple(trials), "Finer settings would cost more than the reference.")
        if expected > allowance:
            return Curve(
                tuple(trials),
                "Finer settings would cost several times what meets the accuracy already.",
            )
        trials.append(run(integrator))
        good = verdict.coarsest(tuple(trials), criteria) is not None
        if good and _is_far_below(trials[-1], criteria):
            return Curve(tuple(trials), "")
    return Curve(tuple(trials), "The method has no finer settings.")


def _expected_cost(trials: list[Trial]) -> float:
    """What the next finer setting will cost, from the last two."""
    costs = [trial.cost for trial in trials if np.isfinite(trial.cost)]
    if len(costs) < 2:
        return 0.0
    return costs[-1] * float(np.clip(costs[-1] / costs[-2], 1.0, MOST_GROWTH))


def _is_far_below(trial: Trial, criteria: dict[str, Criterion]) -> bool:
    found = verdict.errors(trial, criteria)
    return all(
        one.error <= max(FAR_BELOW * criteria[name].limit, one.uncertainty)
        for name, one in found.items()
    )


def _timed_in_batch(
    pilot: Pilot, curve: Curve, criteria: dict[str, Criterion], samples: int
) -> Curve:
    """The curve, the first of its settings that is good enough timed in a batch."""
    place = verdict.coarsest(curve.trials, criteria)
    if place is None:
        return curve
    timed = time_in_batch(pilot, curve.trials[place], samples)
    return Curve((*curve.trials[:place], timed, *curve.trials[place + 1 :]), curve.stopped)


def _reference(
    pilot: Pilot, integrator: Adaptive, scales: Mapping[str, float]
) -> tuple[Pilot, Curve]:
    """The reference, looser and tight, and the pilot without copies that no integrator could
    run."""
    tight = measure(pilot, integrator)
    lost = (tight.outcome == Outcome.UNASSEMBLED) | (tight.outcome == Outcome.OUT_OF_RANGE)
    if np.any(lost) and not lost[0]:
        pilot = pilot.with_copies(~lost)
        tight = measure(pilot, integrator)
    loose = measure(pilot, loosened(integrator, LOOSER))
    for trial in (tight, loose):
        if trial.failure:
            raise ValueError(_why_no_reference(pilot, trial))
    for name, answers in tight.responses.items():
        if not np.any(answers) and name not in scales:
            raise ValueError(
                f'response "{name}" is 0 in every copy of the pilot ({pilot.duration:.3g} s), '
                "which gives an error no measure: take a longer pilot, or give its size in "
                "`scales`."
            )
    return pilot, Curve((loose, tight), "")


def _why_no_reference(pilot: Pilot, trial: Trial) -> str:
    text = (
        f"the reference {describe(trial.integrator)} fails on the pilot, so there is nothing to "
        f"compare with: {trial.failure}"
    )
    if pilot.duration < pilot.whole:
        text += (
            " If a response needs the whole run, give "
            f"pilot=jaxclear.PilotSettings(duration={pilot.whole:.6g})."
        )
    return (
        text + " If the mechanism is stiff, give an Adaptive with an implicit diffrax solver as "
        "reference."
    )


def _check(
    problem: Any, pilot: PilotSettings, batch: int | None, scales: Mapping[str, float]
) -> None:
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
