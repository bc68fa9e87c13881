"""Random mechanisms, laws, rungs, speeds and loads: is any number wrong without a sentence?

    python -m benchmarks.attack [--quick] [--json FILE] [--only K ...] [--draws N] [--first N]
        [--builders] [--seated] [--minutes N] [--case N]

Every case is a mechanism with numbers of its own. It is run by references, one ten times tighter
than the other and one whose numbers are off in the fifth digit, and then as users run it. Every
response is right within what the rung promises; or the run said that it may not be (it was refused,
ended early, tells an error beyond that, or carries a warning that concerns the response); or the
references disagree, which the run should have said too (chaotic motion); or it is silently wrong.
The errors that runs tell are put beside the true ones.
`--case N` prints all about case N.

`--seated` starts the mechanisms with clearance where their loads press them
(`jaxclear.resting_state`). Where every joint of a tight `Adaptive` carries a force at every instant
that it saves, nothing hangs on how impacts are resolved: rigid contact and joints that always touch
are models of the same mechanism, and every rung is judged by that one run, within the accuracy that
the book states for it. A case in which one opens is left out.
"""

import argparse
import json
import time
from collections import Counter

import jax
import numpy as np

from benchmarks.attacks import rungs
from benchmarks.attacks.attempts import Asked, Attempt, attempt, find, judges
from benchmarks.attacks.bearings import thrown_journal
from benchmarks.attacks.numbers import Draw
from benchmarks.attacks.structures import DRAWS, NUMBERS, ROOM, Structure, structures
from benchmarks.attacks.tables import Row, accused, tables
from benchmarks.measure import about, arguments, report
from jaxclear.ground.printing import as_typed

# Saving times of every run.
SAVES = 201
QUICK_EVERY, QUICK_DRAWS = 6, 3
# A seated contact is open below this share of its reference's largest force.
OPEN = 1e-3


def attack(structure: Structure, draw: int, seated: bool = False) -> list[Row]:
    """All runs of one case, each beside its references; of a seated one by all rungs, if its joints
    stay closed."""
    number = structure.number * ROOM + draw
    try:
        case = structure.case(draw)._replace(seated=seated)
    except ValueError as error:
        print(f"case {number} was refused: {error}", flush=True)
        return []
    asked, known, rows = Asked(SAVES, structure.balance), {}, []
    if seated:
        known["compliant"] = judges(case, "compliant", None, asked)
        if not all(map(_stays_closed, known["compliant"])):
            print(f"case {number} does not stay closed", flush=True)
            return []
    for place, name in enumerate(rungs.RUNGS if seated else structure.rungs):
        rung = rungs.RUNGS[name]
        numbers = Draw(NUMBERS, structure.number, draw, place, plain=draw == 0)
        integrator = rung.make(numbers, case)
        begun = time.process_time()
        run = attempt(case, integrator, asked)
        spent = time.process_time() - begun
        model = "compliant" if seated else rung.model
        if model not in known:
            step = None if model == "compliant" else float(integrator.step)
            known[model] = judges(case, model, step, asked)
        found = find(run, known[model], rungs.promise_of(rung, integrator))
        words = "default" if integrator is None else as_typed(integrator)
        rows.append(Row(number, structure.name, name, words, found, spent))
    return rows


def _stays_closed(run: Attempt) -> bool:
    """Whether every joint carries a force at every saved instant."""
    if run.answers is None:
        return True  # which `find` tells
    forces = run.answers
    return bool(np.all(forces.least_force > OPEN * forces.peak_force))


def explain(number: int, seated: bool) -> None:
    """All about one case."""
    structure = structures()[number // ROOM]
    case = structure.case(number % ROOM)
    print(f"case {number}: {structure.name}, {case.duration:.4g} s")
    print(case.mechanism.parameters().to_string())
    for row in attack(structure, number % ROOM, seated):
        print(f"\n{row.rung}, {row.integrator}: {row.verdict} ({row.seconds:.2g} s CPU)")
        found = row.found
        for name in found.verdicts:
            told = found.told.get(name, float("nan"))
            print(
                f"  {name:14s} {found.verdicts[name]:22s} error {found.errors[name]:9.2e}"
                f"  told {told:9.2e}  references apart {found.doubts[name]:9.2e}"
            )
        for sentence in found.said:
            print("  said:", sentence)


def main() -> None:
    """Attack the structures that the command line asks for."""
    number = {"type": int, "metavar": "N"}
    options = arguments(
        str(__doc__),
        case=number | {"help": "print all about one case"},
        only={"type": int, "nargs": "*", "metavar": "K", "help": "these structures"},
        draws=number | {"help": "draws of each structure"},
        first=number | {"default": 0, "help": "the first of these"},
        builders={"action": "store_true", "help": "the first one of each builder"},
        seated={"action": "store_true", "help": "start where loads press the joints"},
        minutes={"type": float, "help": "of CPU time, after which no other one begins"},
    )
    if options.case is not None:
        explain(options.case, options.seated)
        return
    rows: list[Row] = []
    told = {"about": about("benchmarks.attack", options.json)}
    draws = options.draws or (QUICK_DRAWS if options.quick else DRAWS - options.first)
    draws = range(options.first, options.first + draws)
    for structure in chosen(options):
        if options.minutes and time.process_time() > 60 * options.minutes:
            break
        begun = time.process_time()
        own = [row for draw in draws for row in attack(structure, draw, options.seated)]
        rows += own
        counts = Counter(str(row.verdict) for row in own)
        spent = time.process_time() - begun
        print(f"{structure.number:3d} {structure.name}: {dict(counts)} ({spent:.0f} s CPU)")
        for line in accused(own):
            print("     ", line["case"], line["integrator"], line["off by"], flush=True)
        jax.clear_caches()
        if options.json:
            options.json.write_text(json.dumps(told | tables(rows), indent=1) + "\n")
    silent = argparse.Namespace(json=None)
    for title, table in tables(rows).items():
        report(title, table, silent)


def chosen(options: argparse.Namespace) -> list[Structure]:
    """The structures asked for, kinds mixed, so that what is measured first is of all kinds."""
    everything = structures()
    if options.seated:  # what has no clearance, or is thrown, cannot be
        can_be = lambda one: one.contact and one.build is not thrown_journal
        everything = list(filter(can_be, everything))
    if options.only:
        return [one for one in everything if one.number in options.only]
    if options.builders:
        first = {one.build: one for one in reversed(everything)}
        everything = [one for one in everything if one is first[one.build]]
    mixed = [one for first in range(QUICK_EVERY) for one in everything[first::QUICK_EVERY]]
    return everything[::QUICK_EVERY] if options.quick else mixed


if __name__ == "__main__":
    main()
