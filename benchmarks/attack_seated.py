"""Joints that are pressed into their bearings and stay there: do all rungs tell the same?

    python -m benchmarks.attack_seated [--quick] [--json FILE] [--only K ...] [--draws N]
        [--first N] [--kept FILE] [--case N]

The mechanisms are those of `benchmarks.attack` with clearance, started where their loads press them
(`jaxclear.seated`). Where every joint of a tight `Adaptive` carries a force at every instant that
it saves, nothing hangs on how impacts are resolved: rigid contact and joints that always touch are
models of the same mechanism, and every rung is judged by that one run, within the accuracy that the
book states for it. A case in which one opens is left to `benchmarks.attack`.
"""

import time

import numpy as np

from benchmarks import attack
from benchmarks.attack import SAVES, Row
from benchmarks.attacks import bearings, rungs
from benchmarks.attacks.attempts import Asked, Attempt, attempt, find, judges
from benchmarks.attacks.numbers import Draw
from benchmarks.attacks.structures import NUMBERS, ROOM, Structure, structures
from jaxclear.studies.advice.pilot import describe

# A contact is open below this share of its reference's largest force.
OPEN = 1e-3
WITH_CLEARANCE = {one.number for one in structures() if one.contact}


def which(structure: Structure) -> bool:
    """Whether a structure can be seated: what is thrown cannot."""
    return structure.number in WITH_CLEARANCE and structure.build is not bearings.thrown_journal


def attack_seated(structure: Structure, draw: int) -> list[Row]:
    """All rungs of one case, if its joints stay closed."""
    number = structure.number * ROOM + draw
    try:
        case = structure.case(draw)._replace(seated=True)
        known = judges(case, "compliant", None, Asked(SAVES, structure.balance))
    except ValueError as error:
        print(f"case {number} was refused: {error}", flush=True)
        return []
    if not all(map(_stays_closed, known)):
        print(f"case {number} does not stay closed", flush=True)
        return []
    rows = []
    for place, (name, rung) in enumerate(rungs.RUNGS.items()):
        numbers = Draw(NUMBERS, structure.number, draw, place, plain=draw == 0)
        integrator = rung.make(numbers, case)
        begun = time.process_time()
        run = attempt(case, integrator, Asked(SAVES, structure.balance))
        spent = time.process_time() - begun
        words = "default" if integrator is None else describe(integrator)
        rows.append(Row(number, structure.name, name, words, find(run, known, rung.kind), spent))
    return rows


def _stays_closed(run: Attempt) -> bool:
    """Whether every joint carries a force at every saved instant."""
    if run.answers is None:
        return True  # which `find` tells
    forces = run.answers
    return bool(np.all(forces.least_force > OPEN * forces.peak_force))


if __name__ == "__main__":
    attack.main("benchmarks.attack_seated", __doc__, attack_seated, which)
