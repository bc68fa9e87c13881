"""Whether what a run says stands where no short window can tell: a run in doubt is gone through
once more with steps a quarter as long, and what both end with is compared.

What an impact is off by grows until the next, and every one adds its own: after a dozen a journal
may be elsewhere in its gap though each was nearly right, and how fast that grows is the motion's
own affair. So the run itself is asked, where `doubts` tells to: wherever it takes next to no time,
and else in doubt. Runs of many steps are not gone through again; of a study, whose samples share
doubts, the nominal one is.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.quantity import is_traced
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.checks import Check
from jaxclear.integrators.figures import Checks, Figure
from jaxclear.integrators.stepping import SLIVER
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.doubts import doubted, in_doubt, is_brief, meets_stops, swings_on
from jaxclear.simulation.friction_steps import rubbing
from jaxclear.simulation.rarer_updates import moved, where_kept
from jaxclear.simulation.rebound import RESOLVED
from jaxclear.simulation.slip_reversals import shortest_crossing
from jaxclear.simulation.two_runs import (
    Apart,
    apart_by_check,
    deepest_apart,
    friction_loss,
    impulses,
    largest_loss,
    opens,
    share_of_largest,
)

# Length of the steps beside those of the run; of another run where paths have parted and mean
# forces agree: two that part agree by chance (of a spatial four-bar in sixteen lengths of steps
# seven had one mean force and nine another, 2.5 % apart).
FINER, OTHER = 0.25, 0.4
# From which difference of the places of bodies on steps of a given length tell of it; `Adaptive`
# promises more.
PLACES_OF_STEPS = 0.004
# What wear may change that is put on later. Surfaces are updated at saving times, each loss up to
# an interval late: after 18 bouncy impacts a journal was 0.6 of its clearance elsewhere where its
# surface, worn by 7e-8 m, was updated a hundred times as often. Steps and surfaces that wear slower
# told 0.02 where a journal thrown up and down, worn by 5e-8 m, was 0.2 elsewhere; updates half as
# often 0.11.
BY_WEAR = (Check.PLACE_IN_GAP, Check.BODY_PLACES, Check.PARTED_FORCE)
# What a second look may find.
FINDINGS = (
    Check.PLACE_IN_GAP,
    Check.MEAN_FORCE,
    Check.PARTED_FORCE,
    Check.FRICTION_LOSS,
    Check.BRISTLE_LOSS,
    Check.HALVED_WEAR,
    Check.HALVED_MOTION,
    Check.BODY_PLACES,
    Check.DEEPEST,
    Check.PEAK_FORCE,
)
# Those of friction and wear: of a creeping journal's wear implicit steps of 28 and 6 us told 0.84
# and 0.83, those of 12 us between them 0.80.
LOSSES = {Check.FRICTION_LOSS, Check.BRISTLE_LOSS, Check.HALVED_WEAR}
# Those of peaks.
OF_PEAKS = (Check.DEEPEST, Check.PEAK_FORCE)
# What speaks of steps too long for a contact, and is dropped where a run with steps a quarter as
# long is within its limit and finds nothing off.
OF_CONTACT_STEPS = (Check.CONTACT_STEP, Check.CREEP_STEP, Check.REBOUND_STEP)
# What a contact may vibrate there in a step [rad], damping included: at 0.44 both runs were off by
# 70 % in what was worn, and differed by 4 %.
RESOLVED_CREEP = 0.3
# What short windows say of forces, and is dropped where forces, wear and friction of the whole run
# are the same, as long as the shorter steps are within its limit.
OF_WINDOWS = (Check.HALVED_MEAN_FORCES, Check.HALVED_CONTACT_FORCES, Check.HALVED_FORCES)
# Not where bodies may drift, of which nothing else tells.
DRIFTING = {Check.HALVED_MOTION: 0.005}
# By how much, beside themselves, mean forces, what friction takes and what is worn may change there
# (twice that left worn depths 13 % off), and the deepest indentations: peaks of forces by a tenth.
LITTLE, DEEPEST = 0.02, Check.DEEPEST.limit
# Change of the deepest indentation up to which impacts are right, where indentations rise by no
# more than `RESOLVED` and what is worn is right: at twice that, a peak of forces was a tenth off.
SAME_DEPTH = 0.01
# Steps of a run beyond which it is not gone through again: seconds in any mechanism.
MOST_STEPS = 100_000


def looked_at_again(
    run: Trajectory, integrator: AbstractIntegrator, again: Callable[..., Trajectory]
) -> Trajectory:
    """The run with what a second look at it tells, where it is in doubt; `again`: the same run with
    another integrator, surfaces that wear so many times as fast, and other saving times [s]. Its
    numbers stay as they are."""
    if is_traced((run.outcome, run.states)) or not run.succeeded:
        return run
    if _in_steps(run, integrator, FINER) is None or int(run.accepted_steps) > MOST_STEPS:
        return run
    share, turns = _close_enough(run, integrator)
    finer = _in_steps(run, integrator, share)
    untold = turns or meets_stops(run, integrator) or swings_on(run, integrator)
    if not (untold or is_brief(run, integrator) or in_doubt(run, integrator)):
        return run
    other = again(finer)
    if not other.succeeded:
        return run
    figures = dict(run.checks.figures)
    doubts = untold or bool(doubted(run.checks))
    apart = apart_by_check(run, other, _places_count(integrator), doubts, _left(integrator, share))
    apart = _larger(apart, _apart_by_wear(run, integrator, again))
    apart = _larger(apart, _apart_by_chance(apart, run, integrator, again))
    for check, (found, places) in apart.items():
        figure = Figure(jnp.asarray(found), jnp.full(len(places), run.ended), places)
        figures[check] = _worse(figure, figures.get(check))
    worst = {check: found.max() for check, (found, _) in apart.items()}
    if _impacts_are_right(run, other, worst):
        del figures[Check.IMPACT_STEP]
    right = _right_joints(run, other, worst)
    for check in OF_CONTACT_STEPS:
        if right and check in figures:
            left = _accused(figures.pop(check), check, other, right)
            figures |= {} if left is None else {check: left}
    if right and right >= set(figures[Check.INDENTATION].places) and _within(run, DRIFTING):
        for check in OF_WINDOWS:
            if _within(other, {check: check.limit}):
                figures.pop(check, None)
    return dataclasses.replace(run, checks=Checks.of(figures))


def _apart_by_wear(
    run: Trajectory, integrator: AbstractIntegrator, again: Callable[..., Trajectory]
) -> Apart:
    """What wear changes that is put on later: where impacts hand on what they are off by, how often
    surfaces are updated decides where parts are."""
    gaps = _places_count(integrator)
    if gaps is None or not (run.worn and opens(run)):
        return {}
    other = again(_in_steps(run, integrator, 1.0), 1 / (1 + largest_loss(run)), moved(run.time))
    if not other.succeeded:
        return {}
    found = apart_by_check(where_kept(run), where_kept(other), gaps, True)
    return {check: found[check] for check in BY_WEAR if check in found}


def _apart_by_chance(
    apart: Apart,
    run: Trajectory,
    integrator: AbstractIntegrator,
    again: Callable[..., Trajectory],
) -> Apart:
    """What other steps change of what agrees so far, maybe by chance: mean forces of parted paths,
    and losses where contacts vibrate faster than the steps follow."""
    creeps = bool(np.any(run.checks.beyond().get(Check.CREEP_STEP, False)))
    chancy = {Check.PARTED_FORCE} | (LOSSES if creeps else set())
    within = lambda check: np.max(apart[check][0]) <= check.limit
    agreed = {check: apart[check] for check in chancy & set(apart) if within(check)}
    other = again(_in_steps(run, integrator, OTHER)) if agreed else None
    if other is None or not other.succeeded:
        return {}
    found = apart_by_check(run, other, _places_count(integrator), True)
    return {check: found.get(check, known) for check, known in agreed.items()}


def _larger(one: Apart, other: Apart) -> Apart:
    """The larger figures of both."""
    larger = {
        check: (np.maximum(found, one.get(check, (found,))[0]), places)
        for check, (found, places) in other.items()
    }
    return one | larger


def _close_enough(run: Trajectory, integrator: AbstractIntegrator) -> tuple[float, bool]:
    """(length of the steps of another run beside this one's; whether slip turns round within one of
    these): as short as it takes slip to turn round, of no more than `MOST_STEPS`."""
    lasts = float(run.time[-1] - run.time[0])
    step = _step_taken(run, integrator)
    crossing = shortest_crossing(run)
    least = lasts / (MOST_STEPS * step)
    return float(min(FINER, max(crossing / step, least))), crossing < step


def _left(integrator: AbstractIntegrator, share: float) -> float:
    """Share of what is wrong that is in a run with steps that share as long as well: of low order
    as much, of others next to nothing."""
    low_order = integrator.asked_step() is not None and not integrator.follows_impacts
    return share if low_order else 0.0


def _places_count(integrator: AbstractIntegrator) -> float | None:
    """From which difference on places of bodies count; None where they do not."""
    if not integrator.places_in_gaps:
        return None
    return PLACES_OF_STEPS if integrator.asked_step() is not None else 0.0


def _in_steps(
    run: Trajectory, integrator: AbstractIntegrator, share: float
) -> AbstractIntegrator | None:
    """The integrator with steps that share as long as those that were taken: these end at saving
    times, and may be far shorter than the step that was asked for. None where it has none such."""
    asked = integrator.asked_step()
    if asked is None:
        return integrator if share == 1 else integrator.with_finer_steps(max(share, FINER))
    taken = _step_taken(run, integrator)
    if run.time[-1] - run.time[0] > taken * MOST_STEPS:
        return None
    return integrator.with_finer_steps(share * taken / asked)


def _step_taken(run: Trajectory, integrator: AbstractIntegrator) -> float:
    """The shortest step [s] of those that were taken, where their length was asked for: where
    intervals differ, none is compared with itself. Else their mean."""
    asked, intervals = integrator.asked_step(), np.diff(run.time)
    if asked is None:
        return float(np.sum(intervals)) / max(int(run.accepted_steps), 1)
    return float(np.min(intervals / np.ceil(intervals / asked * (1 - SLIVER))))


def found_in_one(integrator: AbstractIntegrator, again: Callable[..., Trajectory]) -> Checks:
    """What a second look at one run of a study finds to be off; where nothing is and its impacts
    are right, how well places in gaps agree. `again`: that run, as of `looked_at_again`."""
    if integrator.with_finer_steps(FINER) is None:
        return Checks()
    run = again(integrator)
    found = looked_at_again(run, integrator, again).checks
    beyond = {check for check, over in found.beyond().items() if over} & set(FINDINGS)
    cleared = Check.IMPACT_STEP in set(run.checks.figures) - set(found.figures)
    told = beyond or ({Check.PLACE_IN_GAP} if cleared else set())
    return Checks.of({check: found.figures[check] for check in FINDINGS if check in told})


def _impacts_are_right(run: Trajectory, other: Trajectory, worst: dict[Check, float]) -> bool:
    """Whether what explicit steps may do to impacts has been measured, and is little: then that
    says more than by how much indentations rise."""
    rises = run.checks.figures.get(Check.IMPACT_STEP)
    if rises is None or Check.PLACE_IN_GAP not in worst:
        return False
    little = worst[Check.PLACE_IN_GAP] <= Check.PLACE_IN_GAP.limit
    little = little and worst.get(Check.HALVED_WEAR, 0.0) <= LITTLE
    little = little and deepest_apart(run, other) <= SAME_DEPTH
    return bool(little and np.max(rises.worst) <= RESOLVED)


def _accused(figure: Figure, check: Check, other: Trajectory, right: set[str]) -> Figure | None:
    """What is left of a figure of steps too long for contacts, without those of joints that are
    right and that the steps of the other run resolve."""
    finer = other.checks.figures.get(check)
    if finer is None:
        return figure
    limit = RESOLVED_CREEP if check == Check.CREEP_STEP else check.limit
    resolved = np.asarray(finer.worst) <= limit
    known = {place for place, within in zip(finer.places, resolved, strict=True) if not within}
    left = [k for k, place in enumerate(figure.places) if place in known or place not in right]
    if not left:
        return None
    places = tuple(figure.places[k] for k in left)
    kept = np.array(left)
    return Figure(figure.worst[kept], figure.time[kept], places)


def _within(run: Trajectory, limits: dict[Check, float]) -> bool:
    """Whether figures of a run are known and within these limits."""
    known = run.checks.figures
    return all(
        check in known and bool(np.all(np.asarray(known[check].worst) <= limit))
        for check, limit in limits.items()
    )


def _right_joints(run: Trajectory, other: Trajectory, worst: dict[Check, float]) -> set[str]:
    """The joints whose mean and peak forces, wear and friction are as in the other run, where
    nothing in the run is beyond its limit; not where nothing tells of a joint's friction."""
    if Check.MEAN_FORCE not in worst or Check.INDENTATION not in run.checks.figures:
        return set()
    if any(found > check.limit for check, found in worst.items() if check not in OF_PEAKS):
        return set()
    if max(worst[Check.MEAN_FORCE], worst.get(Check.HALVED_WEAR, 0.0)) > LITTLE:
        return set()
    balanced = run.history.balanced
    if balanced and share_of_largest(*(friction_loss(one) for one in (run, other))) > LITTLE:
        return set()
    unknown = set() if balanced else rubbing(run.history.model()) - set(run.worn)
    joints = tuple(dict.fromkeys(run.checks.figures[Check.INDENTATION].places))
    return {
        name
        for name in set(joints) - unknown
        if share_of_largest(*(impulses(one, (name,)) for one in (run, other))) <= LITTLE
        and deepest_apart(run, other, name) <= DEEPEST
    }


def _worse(figure: Figure, known: Figure | None) -> Figure:
    """The one with the larger worst; a second look tells of fewer places than a run's windows."""
    if known is None or np.asarray(figure.worst).max() > np.asarray(known.worst).max():
        return figure
    return known
