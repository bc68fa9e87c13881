"""The trials of an advice: one method from coarse to fine until it is good enough or too dear, and
the reference that judges them.
"""

from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import numpy as np

from jaxclear.integrators import AbstractIntegrator, Adaptive, Outcome
from jaxclear.studies import verdict
from jaxclear.studies.advice.curve import Curve
from jaxclear.studies.advice.pilot import Pilot, Trial, describe, measure
from jaxclear.studies.verdict import Criterion
from jaxclear.studies.work_precision import LOOSER, loosened

# A curve is followed until its error is this share of the accuracy: the figure shows how it falls.
FAR_BELOW = 0.1
# It is left where a finer setting would be this many times as dear as the reference.
DEARER_THAN_REFERENCE = 2.0
# A finer setting is taken to cost at most this much more than the last (2.5 is the widest gap
# between steps).
MOST_GROWTH = 2.5
# Why a curve has no finer settings.
TOO_DEAR = "Finer settings would cost more than the reference."
MUCH_DEARER = "Finer settings would cost several times what meets the accuracy already."
NO_FINER = "The method has no finer settings."


class NothingToMeasure(ValueError):
    """A response is 0 in every copy, which gives an error no measure."""


def once(pilot: Pilot, known: tuple[Trial, ...]) -> Callable[[AbstractIntegrator], Trial]:
    """Measures an integrator, unless it is among the trials that are known."""

    def run(integrator):
        same = [trial for trial in known if eqx.tree_equal(trial.integrator, integrator)]
        return same[0] if same else measure(pilot, integrator)

    return run


def follow(
    run: Callable[[AbstractIntegrator], Trial],
    ordered: Sequence[AbstractIntegrator],
    criteria: dict[str, Criterion],
    reference_cost: float,
    allowance: float,
) -> Curve:
    """Trials of one method, coarse to fine, until they are good enough or too dear."""
    trials: list[Trial] = []
    for integrator in ordered:
        expected = expected_cost(trials)
        if expected > DEARER_THAN_REFERENCE * reference_cost:
            return Curve(tuple(trials), TOO_DEAR)
        if expected > allowance:
            return Curve(tuple(trials), MUCH_DEARER)
        trials.append(run(integrator))
        good = verdict.coarsest(tuple(trials), criteria) is not None
        if good and _is_far_below(trials[-1], criteria):
            return Curve(tuple(trials), "")
    return Curve(tuple(trials), NO_FINER)


def expected_cost(trials: list[Trial]) -> float:
    """What the next finer setting will cost: more than the last two as costs have grown on the
    mean, since single times are too long on a busy machine."""
    costs = [trial.cost for trial in trials if np.isfinite(trial.cost)]
    if len(costs) < 2:
        return 0.0
    growth = (costs[-1] / costs[0]) ** (1 / (len(costs) - 1))
    growth = float(np.clip(growth, 1.0, MOST_GROWTH))
    return growth * min(costs[-1], growth * costs[-2])


def _is_far_below(trial: Trial, criteria: dict[str, Criterion]) -> bool:
    found = verdict.errors(trial, criteria)
    return all(
        one.error <= max(FAR_BELOW * criteria[name].limit, one.uncertainty)
        for name, one in found.items()
    )


def reference(
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
            raise NothingToMeasure(
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
