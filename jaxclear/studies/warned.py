"""Which runs of a study carry a warning, of what, and which responses that concerns.

A run whose own checks found a figure beyond its limit has reached its end, but not every number of
it is to be trusted. It is counted like a failed one; whether it counts for a response depends on
what the response is drawn from.
"""

from typing import Any

import numpy as np

from jaxclear.integrators import Check, Checks
from jaxclear.studies.base import AbstractProblem


def any_warning(checks: Checks, runs: int) -> np.ndarray:
    """Whether each run carries a warning, (runs,)."""
    return _any(checks, runs, lambda check: True)


def warned_of(problem: AbstractProblem, response: str, checks: Checks, runs: int) -> np.ndarray:
    """Whether each run carries a warning that concerns a response of the problem, (runs,)."""
    return _any(checks, runs, lambda check: problem.concerned(response, check.concerns))


def _any(checks: Checks, runs: int, counts: Any) -> np.ndarray:
    found = np.zeros(runs, bool)
    for check, beyond in checks.beyond().items():
        if counts(check):
            found |= np.asarray(beyond)
    return found


def concern(
    problem: AbstractProblem, response: str, checks: Checks, among: np.ndarray
) -> tuple[float, str]:
    """Share of the runs `among` (runs,) whose warnings concern a response, and a sentence that
    tells them; "" where there are none."""
    warned = warned_of(problem, response, checks, len(among)) & among
    if not warned.any():
        return 0.0, ""
    kinds = {
        check: count
        for check, count in counted(checks, warned).items()
        if problem.concerned(response, check.concerns)
    }
    text = f"{warned.sum()} of {among.sum()} runs warn ({in_words(kinds)})."
    return float(warned.sum() / among.sum()), text


def counted(checks: Checks, among: np.ndarray) -> dict[Check, int]:
    """How many of the runs `among` (runs,) warn of what, most frequent first."""
    found = {check: int(np.sum(beyond & among)) for check, beyond in checks.beyond().items()}
    order = sorted(found, key=lambda check: -found[check])
    return {check: found[check] for check in order if found[check]}


def in_words(counts: dict[Check, int]) -> str:
    """ "friction step in 12, loop drift in 3"."""
    return ", ".join(f"{check.label} in {count}" for check, count in counts.items())


def agreement(nominal: Checks, counts: dict[Check, int]) -> str:
    """How right the motion of a study's nominal sample is, where samples warn of their impacts'
    steps and a second look at it (its `nominal` figures) has found nothing to be off."""
    agreed = nominal.figures.get(Check.PLACE_IN_GAP)
    if agreed is None or nominal.warnings or Check.IMPACT_STEP not in counts:
        return ""
    return (
        "The nominal sample was gone through again with steps a quarter as long: its places in "
        f"gaps agree within {np.max(agreed.worst):.2g} of the clearance, so that its impacts are "
        "right, whatever their steps."
    )
