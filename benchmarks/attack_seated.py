"""Joints that are pressed into their bearings and stay there: do all rungs tell the same?

    python -m benchmarks.attack_seated [--quick] [--json FILE] [--only K ...] [--draws N]
        [--first N] [--case N]

The mechanisms are those of `benchmarks.attack` with clearance, started where their loads press them
(`jaxclear.resting_state`). Where every joint of a tight `Adaptive` carries a force at every instant
that it saves, nothing hangs on how impacts are resolved: rigid contact and joints that always touch
are models of the same mechanism, and every rung is judged by that one run, within the accuracy that
the book states for it. A case in which one opens is left to `benchmarks.attack`.
"""

import numpy as np

from benchmarks import attack
from benchmarks.attack import SAVES, Row
from benchmarks.attacks import bearings, rungs
from benchmarks.attacks.attempts import Asked, Attempt, judges
from benchmarks.attacks.structures import Structure

# A contact is open below this share of its reference's largest force.
OPEN = 1e-3


def which(structure: Structure) -> bool:
    """Whether a structure can be seated: what has no clearance, or is thrown, cannot."""
    return bool(structure.contact) and structure.build is not bearings.thrown_journal


def attack_seated(structure: Structure, draw: int) -> list[Row]:
    """All rungs of one case, if its joints stay closed."""
    case = attack.case_of(structure, draw)
    if case is None:
        return []
    case = case._replace(seated=True)
    known = judges(case, "compliant", None, Asked(SAVES, structure.balance))
    if not all(map(_stays_closed, known)):
        print(f"case {attack.number_of(structure, draw)} does not stay closed", flush=True)
        return []
    return attack.judged(structure, draw, case, rungs.RUNGS, lambda *_: known)


def _stays_closed(run: Attempt) -> bool:
    """Whether every joint carries a force at every saved instant."""
    if run.answers is None:
        return True  # which `find` tells
    forces = run.answers
    return bool(np.all(forces.least_force > OPEN * forces.peak_force))


if __name__ == "__main__":
    attack.main("benchmarks.attack_seated", __doc__, attack_seated, which)
