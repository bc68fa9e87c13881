"""Which integrator and which step for this problem, at an accuracy in its responses, and what it
costs.

A pilot (the first part of the problem, nominal and a few copies within the tolerances) is run on
every rung of the ladder of integrators, coarse to fine, and compared with a tight adaptive
reference. Recommended is the cheapest setting whose error, with its uncertainty, is below the
accuracy and whose next finer neighbour's is too. What is found holds for the pilot: errors that
grow with time are larger at the end of a longer run.
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import numpy as np
from tqdm import tqdm

from jaxclear.integrators import Adaptive, Outcome
from jaxclear.studies import verdict
from jaxclear.studies.advice.advice import (
    PRESENT,
    REFERENCE,
    Advice,
    Climb,
    check_means,
    checked_accuracy,
)
from jaxclear.studies.advice.pilot import Pilot, Trial, describe, measure, pilot_of, time_in_batch
from jaxclear.studies.problem import Problem
from jaxclear.studies.verdict import Standard
from jaxclear.studies.work_precision import LOOSER, Ladder, check_ladder, default_ladder, loosened
from jaxclear.studies.work_precision import reference as default_reference

# A rung is climbed until its error is this share of the accuracy: the figure shows how it falls.
FAR_BELOW = 0.1
# It is left where a finer setting would be this many times as dear as the reference, or as the
# cheapest that meets the accuracy already. In a batch costs change places: adaptive steps wait for
# the slowest sample, fixed ones do not.
DEARER_THAN_REFERENCE, TOO_DEAR, TOO_DEAR_IN_BATCH = 1.5, 4.0, 40.0
# A finer setting is taken to cost at most this much more than the last (2.5 is the widest gap
# between steps).
MOST_GROWTH = 2.5


def advise(
    problem: Problem,
    accuracy: float = 0.01,
    *,
    copies: int = 8,
    pilot: float | None = None,
    means: bool = False,
    batch: int | None = None,
    reference: Adaptive | None = None,
    ladder: Ladder | None = None,
    scales: Mapping[str, float] | None = None,
    seed: int = 0,
    progress_bar: bool = False,
) -> Advice:
    """The cheapest integrator that meets `accuracy` in every response of a problem; see `Advice`.

    `accuracy`: largest error as a share of a response's root mean square over the copies, or of its
    size in `scales` (for a response about zero). `copies`: nominal and perturbed runs; more of them
    where the answer says that motion is chaotic. `pilot`: duration [s], a quarter of the problem's
    by default. `means`: not every run must meet the accuracy but the mean over the copies, as a
    Monte Carlo study wants it. `batch`: samples run together as `monte_carlo` does; the recommended
    setting is then the cheapest there. `reference`: an `Adaptive` trusted as the truth, checked
    against itself at ten times its tolerances. `ladder`: integrators to try instead of all that
    jaxclear has, by rung, coarse to fine. Every rung compiles once. Raises `ValueError` with a
    sentence for what cannot be asked and for a reference that fails.
    """
    accuracy = checked_accuracy(accuracy)
    tight = default_reference() if reference is None else reference
    scales = dict(scales or {})
    _check(problem, copies, pilot, batch, tight, scales)
    piece = pilot_of(problem, int(copies), pilot, seed)
    rungs = default_ladder(piece.problem, tight) if ladder is None else ladder
    check_ladder(rungs, (REFERENCE, PRESENT))
    if means:
        check_means(len(piece.values))
    with tqdm(total=len(rungs) + 2, desc="advice", disable=not progress_bar) as bar:
        piece, known = _reference(piece, tight, scales)
        bar.update(1)
        climbs = {PRESENT: Climb((measure(piece, problem.integrator),), "")}
        bar.update(1)
        rules = verdict.standards(known.trials, problem.response_names, accuracy, scales, means)
        run = _once(piece, (*known.trials, *climbs[PRESENT].trials))
        for name, settings in rungs.items():
            climbs[name] = _climb(
                run, settings, rules, known.trials[-1].cost, _allowance(climbs, rules, batch)
            )
            bar.update(1)
    if batch is not None:
        climbs = {
            name: _timed_in_batch(piece, climb, rules, batch) for name, climb in climbs.items()
        }
    return Advice(problem, accuracy, piece, {REFERENCE: known} | climbs, scales, means, batch)


def _allowance(climbs: Mapping[str, Climb], rules: dict[str, Standard], batch: int | None) -> float:
    """Largest cost worth a trial: some times that of what already meets the accuracy."""
    places = {name: verdict.coarsest(climb.trials, rules) for name, climb in climbs.items()}
    meeting = [
        climbs[name].trials[place].cost for name, place in places.items() if place is not None
    ]
    return (TOO_DEAR if batch is None else TOO_DEAR_IN_BATCH) * min(meeting, default=np.inf)


def _once(pilot: Pilot, known: tuple[Trial, ...]) -> Callable:
    """Measures an integrator, unless it is among the trials that are known."""

    def run(integrator):
        same = [trial for trial in known if eqx.tree_equal(trial.integrator, integrator)]
        return same[0] if same else measure(pilot, integrator)

    return run


def _climb(
    run: Callable,
    settings: Any,
    rules: dict[str, Standard],
    reference_cost: float,
    allowance: float,
) -> Climb:
    """Trials of one rung until they are good enough or too dear."""
    trials: list[Trial] = []
    for integrator in settings:
        expected = _expected_cost(trials)
        if expected > DEARER_THAN_REFERENCE * reference_cost:
            return Climb(tuple(trials), "Finer settings would cost more than the reference.")
        if expected > allowance:
            return Climb(
                tuple(trials),
                "Finer settings would cost several times what meets the accuracy already.",
            )
        trials.append(run(integrator))
        if verdict.coarsest(tuple(trials), rules) is not None and _is_far_below(trials[-1], rules):
            return Climb(tuple(trials), "")
    return Climb(tuple(trials), "The rung has no finer settings.")


def _expected_cost(trials: list[Trial]) -> float:
    """What the next finer setting will cost, from the last two."""
    costs = [trial.cost for trial in trials if np.isfinite(trial.cost)]
    if len(costs) < 2:
        return 0.0
    return costs[-1] * float(np.clip(costs[-1] / costs[-2], 1.0, MOST_GROWTH))


def _is_far_below(trial: Trial, rules: dict[str, Standard]) -> bool:
    found = verdict.scores(trial, rules)
    return all(
        one.error <= max(FAR_BELOW * rules[name].limit, one.uncertainty)
        for name, one in found.items()
    )


def _timed_in_batch(pilot: Pilot, climb: Climb, rules: dict[str, Standard], samples: int) -> Climb:
    """The climb, the first of its settings that is good enough timed in a batch."""
    place = verdict.coarsest(climb.trials, rules)
    if place is None:
        return climb
    timed = time_in_batch(pilot, climb.trials[place], samples)
    return Climb((*climb.trials[:place], timed, *climb.trials[place + 1 :]), climb.stopped)


def _reference(
    pilot: Pilot, integrator: Adaptive, scales: Mapping[str, float]
) -> tuple[Pilot, Climb]:
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
                "which gives an error no measure: "
                "take a longer pilot, or give its size in `scales`."
            )
    return pilot, Climb((loose, tight), "")


def _why_no_reference(pilot, trial):
    text = (
        f"the reference {describe(trial.integrator)} fails on the pilot, so there is nothing to "
        f"compare with: {trial.failure}"
    )
    if pilot.duration < pilot.whole:
        text += f" If a response needs the whole run, give pilot={pilot.whole:.6g}."
    return (
        text + " If the mechanism is stiff, give an Adaptive with an implicit diffrax solver as "
        "reference."
    )


def _check(problem, copies, pilot, batch, reference, scales):
    if not isinstance(problem, Problem):
        raise ValueError(f"advice is given on a jaxclear.Problem, not on {problem!r}.")
    for name, count in (("copies", copies), ("batch", 1 if batch is None else batch)):
        if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
            raise ValueError(f"{name} is {count!r}; it must be a whole number, at least 1.")
    whole = float(problem.duration)
    if pilot is not None and not 0 < pilot <= whole:
        raise ValueError(
            f"the pilot is {pilot!r} s; it must be above 0 and at most the problem's {whole:.6g} s."
        )
    if not isinstance(reference, Adaptive):
        raise ValueError(
            f"the reference is {reference!r}; it must be an integrator.Adaptive, whose tolerances "
            "can be varied."
        )
    for name, size in scales.items():
        if name not in problem.response_names:
            raise ValueError(
                f'no response "{name}" in this problem; there are '
                f"{', '.join(map(repr, problem.response_names))}."
            )
        if not 0 < size < np.inf:
            raise ValueError(
                f'the scale of response "{name}" is {size!r}; it must be positive and finite, in '
                "its own unit."
            )
