"""Whether a run's answers are right, said to be doubtful, undecidable, or silently wrong.

A rung that says nothing is held to what its integrator promises (`jaxclear.integrators.base`);
the book's page on accuracy shows this table. It is that of the model the rung has.
"""

from enum import StrEnum
from typing import Any

import numpy as np

from jaxclear.integrators import base
from jaxclear.integrators.checks import Check
from jaxclear.integrators.base import Promise
from jaxclear.results.response import REACHES


# Of every rung: the limit beyond which a run warns of it.
DRIFT = Check.LOOP_DRIFT.limit
# Which part of a promise holds of each response.
PARTS = {
    "place": "places",
    "offset": "gaps",
    "mean force": "mean_force",
    "peak force": "peak_force",
    "friction loss": "losses",
    "worn volume": "losses",
    "worn depth": "losses",
}
# Of every kind of rung, as the book names it.
PROMISES = {
    "Adaptive": base.REFERENCE,
    "Adaptive, loose": base.LOOSE,
    "default of studies": base.STUDIES,
    "FixedStep rk4": base.RUNGE_KUTTA,
    "FixedStep order 1": base.FIRST_ORDER,
    "ImplicitStep": base.IMPLICIT,
    "MoreauJean": base.RIGID,
    "NonColliding": base.PERMANENT,
}


def accuracy(promised: Promise) -> dict[str, float | None]:
    """Largest error of a run that reached its end and says nothing: shares by response, as
    `answers` takes them. None: not promised."""
    return {name: getattr(promised, part) for name, part in PARTS.items()} | {"drift": DRIFT}


def stated() -> list[dict[str, str]]:
    """The table as the book shows it."""
    return [
        {"rung": kind}
        | {
            name: "–" if limit is None else f"{100 * limit:g} %"
            for name, limit in accuracy(promised).items()
        }
        for kind, promised in PROMISES.items()
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


# What speaks of laws, loads and cells, which references share; and of a model beside others, which
# those of another model judge.
OF_ALL_MODELS = {Check.INDENTATION, Check.WEAR_BY_CELLS}
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
    promised: Promise,
    warned: frozenset[str],
) -> dict[str, Verdict]:
    """Verdict on each response by its error.

    `doubts`: how far the two references are apart; `spread`: how far an answer moves with numbers
    in the fifth digit (or with the instants that are saved), which excuses an error but does not
    make a right answer doubtful; `warned`: the responses that the run's warnings concern.
    """
    found: dict[str, Verdict] = {}
    limits = accuracy(promised)
    for name, error in errors.items():
        limit = limits[name]
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


def concerned(
    run: Any, told: dict[str, float], promised: Promise, shared: set[Check] = OF_THE_MODEL
) -> frozenset[str]:
    """The responses that a run warns of: those whose `told` errors are beyond what its integrator
    has `promised` (all, where its replicas failed), and those that its checks concern, those
    `shared` with its references aside."""
    limits = accuracy(promised)
    off = {name for name, error in told.items() if _beyond(error, limits[name])}
    failed = {name for name, part in PARTS.items() if part in run.verification.beyond}
    return of_checks(run.invariants, shared) | (off if told else failed)


def _beyond(error: float, limit: float | None) -> bool:
    return limit is not None and not error <= limit


def of_checks(checks: Any, shared: set[Check] = OF_THE_MODEL) -> frozenset[str]:
    """The responses that figures beyond their limits concern; those that are `shared` judge no
    rung."""
    beyond = {check for check, flag in checks.beyond().items() if np.any(flag)} - shared
    reached = {part for check in beyond for part in REACHES[check.concerns]}
    return frozenset(name for name, part in DRAWN_FROM.items() if part in reached)
