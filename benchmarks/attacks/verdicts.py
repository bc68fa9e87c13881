"""Whether a run's answers are right, said to be doubtful, undecidable, or silently wrong.

The accuracy a rung is held to when it says nothing stands in `ACCURACY`; the book's page on
accuracy shows this table. It is that of the model the rung has.
"""

from enum import StrEnum
from typing import Any

import numpy as np

from benchmarks.attacks.answers import RESPONSES
from jaxclear.integrators.checks import Check
from jaxclear.results.abstract_response import REACHES


def _accuracy(
    place: float, offset: float | None, mean: float, peak: float | None, loss: float, drift: float
) -> dict[str, float | None]:
    """One row of the table: losses are those of friction and wear."""
    values = (place, offset, mean, peak, loss, loss, loss, drift)
    return dict(zip(RESPONSES, values, strict=True))


# Of every rung: the limit beyond which a run warns of it.
DRIFT = Check.LOOP_DRIFT.limit
# A journal that may be anywhere in its gap is off by two clearances, of the hundred by which places
# are measured at least.
GAP = 0.02
# Largest error of a run that reached its end and says nothing: shares, as `answers` takes them.
# None: not promised.
ACCURACY: dict[str, dict[str, float | None]] = {
    "Adaptive": _accuracy(0.001, 0.02, 0.02, 0.05, 0.02, DRIFT),
    "Adaptive, loose": _accuracy(0.005, 0.1, 0.1, 0.2, 0.1, DRIFT),
    "default of studies": _accuracy(0.005, 0.05, 0.02, 0.1, 0.02, DRIFT),
    "FixedStep rk4": _accuracy(0.005, 0.05, 0.05, 0.2, 0.05, DRIFT),
    "FixedStep order 1": _accuracy(GAP, None, 0.1, 0.3, 0.1, DRIFT),
    "ImplicitStep": _accuracy(GAP, None, 0.1, 0.5, 0.1, DRIFT),
    "MoreauJean": _accuracy(GAP, None, 0.1, None, 0.1, DRIFT),
    "NonColliding": _accuracy(GAP, None, 0.05, None, 0.05, DRIFT),
}


def stated() -> list[dict[str, str]]:
    """The table as the book shows it."""
    return [
        {"rung": kind}
        | {name: "–" if limit is None else f"{100 * limit:g} %" for name, limit in row.items()}
        for kind, row in ACCURACY.items()
    ]


# Share of the accuracy by which two references may differ where they decide.
DECISIVE = 1 / 3
# An error of this many times the doubt is an error all the same.
FAR = 3.0


class Verdict(StrEnum):
    """What a run, or one response of it, turned out to be; worse ones come later."""

    RIGHT = "right"
    REFUSED = "refused"
    SAID = "said so"
    NO_REFERENCE = "no reference"
    UNDECIDABLE = "undecidable, said so"
    UNSAID = "undecidable, not said"
    WRONG = "silently wrong"
    RAW = "raw error"


# What a run's word turns a verdict into.
SAID = {Verdict.WRONG: Verdict.SAID, Verdict.UNSAID: Verdict.UNDECIDABLE}
# What of a run each response is drawn from, as `jaxclear.response` says it.
DRAWN_FROM: dict[str, str] = {
    "place": "motion",
    "offset": "places in gaps",
    "mean force": "forces",
    "peak force": "peak forces",
    "friction loss": "wear",
    "worn volume": "wear",
    "worn depth": "worn depth",
    "drift": "motion",
}


# What speaks of laws and loads, which references share; and of a model beside others, which those
# of another model judge.
OF_ALL_MODELS = {Check.INDENTATION}
OF_THE_MODEL = OF_ALL_MODELS | {
    Check.COULOMB_FRICTION,
    Check.COLLAR_FORCE,
    Check.UNHELD_FORCE,
    Check.INDETERMINATE_FORCE,
    Check.GAP_MOTION,
}


def judged(
    errors: dict[str, float],
    doubts: dict[str, float],
    spread: dict[str, float],
    kind: str,
    warned: frozenset[str],
) -> dict[str, Verdict]:
    """Verdict on each response by its error.

    `doubts`: how far the two references are apart; `spread`: how far an answer moves with numbers
    in the fifth digit (or with the instants that are saved), which excuses an error but does not
    make a right answer doubtful; `warned`: the responses that the run's warnings concern.
    """
    found: dict[str, Verdict] = {}
    for name, error in errors.items():
        limit = ACCURACY[kind][name]
        if limit is None or (np.isnan(error) and np.isnan(doubts[name])):
            continue
        # Drift is measured on the run itself.
        doubt, moved = (0.0, 0.0) if name == "drift" else (doubts[name], spread[name])
        verdict = _alone(error, limit, doubt, moved)
        found[name] = SAID.get(verdict, verdict) if name in warned else verdict
    return found


def _alone(error: float, limit: float, doubt: float, moved: float) -> Verdict:
    if error + doubt <= limit or (doubt <= DECISIVE * limit and error <= limit + doubt):
        return Verdict.RIGHT
    unsure = max(doubt, moved)
    # A reference that is sure to a tenth still tells an error of ten times.
    if unsure > DECISIVE * limit and error <= limit + FAR * unsure:
        return Verdict.UNSAID
    return Verdict.WRONG


def worst(verdicts: Any) -> Verdict:
    """The worst of several."""
    order = list(Verdict)
    return max(verdicts, key=order.index, default=Verdict.RIGHT)


def concerned(run: Any, shared: set[Check] = OF_THE_MODEL) -> frozenset[str]:
    """The responses that a run's warnings concern, those `shared` with its references aside. Where
    there are no contacts the mean force is that of reactions at the saved instants."""
    touches = bool(run.formulation.contact_joints(run.mechanism))
    return of_checks(run.checks, {} if touches else {"mean force": "peak forces"}, shared)


def of_checks(
    checks: Any, drawn: dict[str, str] | None = None, shared: set[Check] = OF_THE_MODEL
) -> frozenset[str]:
    """The responses that figures beyond their limits concern; those that are `shared` judge no
    rung. `drawn`: what of a run some of them are drawn from, where not as usual."""
    beyond = {check for check, flag in checks.beyond().items() if np.any(flag)} - shared
    reached = {part for check in beyond for part in REACHES[check.concerns]}
    return frozenset(name for name, part in (DRAWN_FROM | (drawn or {})).items() if part in reached)
