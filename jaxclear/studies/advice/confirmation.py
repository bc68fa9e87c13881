"""Whether what a pilot found holds over the whole problem.

The settings between which the pilot decided are run to the end on its copies, beside a reference of
their own: finer ones until two neighbours are right, coarser ones and cheaper methods that the
pilot found nearly right. Errors that grow with time, or come late, are seen here; so are hard first
instants that count little in the end.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from jaxclear.integrators import AbstractIntegrator
from jaxclear.studies import verdict
from jaxclear.studies.advice.comparison import Comparison
from jaxclear.studies.advice.curve import PRESENT, REFERENCE, Choice, Curve
from jaxclear.studies.advice.pilot import PilotSettings, Trial
from jaxclear.studies.advice.trials import MUCH_DEARER, NO_FINER, TOO_DEAR, once, reference
from jaxclear.studies.problem import Problem
from jaxclear.studies.verdict import Criterion

# A setting is worth a run over the whole where the pilot's error is at most this many times what
# passes, and a method where it might save this share.
NEARLY, WORTH = 4.0, 0.15
# A method that the pilot gave up as too dear is worth one where the reference is so many times as
# dear over the whole: a flap's contacts, of rates of 1e9 1/s, all closed just after the pilot, and
# explicit steps took 400 times as long as there, implicit ones as long.
GIVEN_UP = 4.0
# A method is left where one of its settings is this many times as dear as what is right already, or
# as the looser reference: finer ones are dearer still.
DEARER = 1.5
NOT_CHEAPER = "Finer settings would cost more than what meets the accuracy, or the reference."


def confirmed(
    first: Comparison,
    problem: Problem,
    ladders: Mapping[str, Sequence[AbstractIntegrator]],
    settings: PilotSettings,
) -> tuple[Comparison | None, str]:
    """The comparison over the whole problem; None where none was asked for, or with a sentence
    where none can be had."""
    if not settings.whole or first.is_whole:
        return None, ""
    whole = dataclasses.replace(first.pilot, problem=problem)
    try:
        whole, known = reference(whole, settings.reference, first.sizes)
    except ValueError as error:
        return None, f"Over the whole {whole.whole:.3g} s nothing is shown: {error}"
    criteria = dataclasses.replace(first, pilot=whole, curves={REFERENCE: known}).criteria
    run = once(whole, known.trials)
    curves, best = {REFERENCE: known}, known.trials[0].cost
    dearer = best / first.curves[REFERENCE].trials[0].cost
    for name, coarsest, start in _promising(first, dearer):
        gain = first.gain(Choice(name, coarsest)) or 1.0
        if _cost_over_whole(first, Choice(name, coarsest), dearer) > (1 - WORTH) * best:
            continue
        found = _walk(run, ladders[name], (coarsest, start), criteria, DEARER * best / gain)
        curves[name] = _as_in_batch(first, name, found)
        right = verdict.coarsest(found.trials, criteria)
        if right is not None:
            best = min(best, gain * found.trials[right].cost)
    return dataclasses.replace(first, pilot=whole, curves=curves), ""


def _cost_over_whole(first: Comparison, choice: Choice, dearer: float) -> float:
    """What a simulated second will cost over the whole [s/s], where one of the reference is so many
    times `dearer` than in the pilot, since there is more contact: as many times for steps that find
    their length, as many times as they grow shorter in contact for others, and the same for steps
    of one length."""
    integrator = first.trial(choice).integrator
    step, counted = integrator.asked_step(), integrator.steps_between_saves is not None
    most = 1.0 if counted else np.inf
    if step is not None:
        most = float(step / integrator.shortest_step())
    return float(np.clip(dearer, 1 / most, most)) * first.cost_of(choice)


def _promising(first: Comparison, dearer: float) -> list[tuple[str, int, int]]:
    """Methods with the coarsest setting that the pilot found nearly right and the one to begin
    with (where it gave the method up, the last one), cheapest over the whole first; see
    `_cost_over_whole`."""
    criteria, found = first.criteria, []
    for name, curve in first.curves.items():
        near = [
            place
            for place, trial in enumerate(curve.trials)
            if verdict.worst(trial, criteria)[1] <= NEARLY
        ]
        if not near and curve.stopped in (TOO_DEAR, MUCH_DEARER) and dearer > GIVEN_UP:
            near = [len(curve.trials) - 1]
        if near and name not in (REFERENCE, PRESENT):
            right = verdict.coarsest(curve.trials, criteria)
            found.append((name, near[0], near[-1] if right is None else right))
    return sorted(found, key=lambda one: _cost_over_whole(first, Choice(one[0], one[2]), dearer))


def _walk(
    run: Callable[[AbstractIntegrator], Trial],
    ladder: Sequence[AbstractIntegrator],
    places: tuple[int, int],
    criteria: dict[str, Criterion],
    most: float,
) -> Curve:
    """Trials of neighbours on a ladder.

    From the second of `places` to finer ones until two are right, or one that is not or stands
    alone is dearer than `most` [s/s], then to coarser ones, down to the first of `places`, while
    these are right.
    """
    coarsest, start = places
    trials: list[Trial] = []
    why = NO_FINER
    for integrator in ladder[start:]:
        trials.append(run(integrator))
        if verdict.coarsest(tuple(trials), criteria) is not None:
            why = ""
            break
        if trials[-1].cost > most:
            why = NOT_CHEAPER
            break
    place = start
    while place > coarsest and verdict.passes(trials[0], criteria):
        place -= 1
        trials.insert(0, run(ladder[place]))
    return Curve(tuple(trials), why)


def _as_in_batch(first: Comparison, name: str, found: Curve) -> Curve:
    """The curve with the costs in a batch that the pilot tells."""
    gain = first.gain(Choice(name, 0))
    if gain is None:
        return found
    timed = (dataclasses.replace(one, cost_in_batch=gain * one.cost) for one in found.trials)
    return Curve(tuple(timed), found.stopped)
