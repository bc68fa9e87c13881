"""Random mechanisms, laws, rungs, speeds and loads: is any number wrong without a sentence?

    python -m benchmarks.attack [--quick] [--json FILE] [--only K ...] [--draws N] [--first N]
        [--builders] [--case N]

Every case is a mechanism with numbers of its own. It is run by references, one ten times tighter
than the other and one whose numbers are off in the fifth digit, and then as users run it. Every
response is right within what the rung promises; or the run said that it may not be (it was refused,
ended early, tells an error beyond that, or carries a warning that concerns the response); or the
references disagree, which the run should have said too (chaotic motion); or it is silently wrong.
The errors that runs tell are put beside the true ones.
`--case N` prints all about case N.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import jax

from benchmarks.attacks import rungs
from benchmarks.attacks.attempts import Asked, attempt, find, judges
from benchmarks.attacks.bearings import Case
from benchmarks.attacks.numbers import Draw
from benchmarks.attacks.structures import DRAWS, NUMBERS, ROOM, Structure, structures
from benchmarks.attacks.tables import Row, accused, tables
from benchmarks.measure import about, arguments, report
from jaxclear.ground.printing import as_typed

# Saving times of every run.
SAVES = 201
QUICK_EVERY, QUICK_DRAWS = 6, 3

Attack = Callable[[Structure, int], list[Row]]


def number_of(structure: Structure, draw: int) -> int:
    """The number of a case."""
    return structure.number * ROOM + draw


def case_of(structure: Structure, draw: int) -> Case | None:
    """The case, or None where it was refused, which is said."""
    try:
        return structure.case(draw)
    except ValueError as error:
        print(f"case {number_of(structure, draw)} was refused: {error}", flush=True)
        return None


def attack(structure: Structure, draw: int) -> list[Row]:
    """All runs of one case."""
    case = case_of(structure, draw)
    if case is None:
        return []
    found: dict[str, tuple] = {}

    def references(rung: rungs.Rung, integrator: Any) -> tuple:
        if rung.model not in found:
            step = None if rung.model == "compliant" else float(integrator.step)
            found[rung.model] = judges(case, rung.model, step, Asked(SAVES, structure.balance))
        return found[rung.model]

    return judged(structure, draw, case, structure.rungs, references)


def judged(
    structure: Structure,
    draw: int,
    case: Case,
    names: Iterable[str],
    references: Callable[[rungs.Rung, Any], tuple],
) -> list[Row]:
    """The runs of a case by the rungs of these names, each beside its `references`."""
    rows = []
    for place, name in enumerate(names):
        rung = rungs.RUNGS[name]
        numbers = Draw(NUMBERS, structure.number, draw, place, plain=draw == 0)
        integrator = rung.make(numbers, case)
        begun = time.process_time()
        run = attempt(case, integrator, Asked(SAVES, structure.balance))
        spent = time.process_time() - begun
        found = find(run, references(rung, integrator), rungs.promise_of(rung, integrator))
        words = "default" if integrator is None else as_typed(integrator)
        number = number_of(structure, draw)
        rows.append(Row(number, structure.name, name, words, found, spent))
    return rows


def explain(number: int, one: Attack) -> None:
    """All about one case."""
    structure = structures()[number // ROOM]
    case = structure.case(number % ROOM)
    print(f"case {number}: {structure.name}, {case.duration:.4g} s")
    print(case.mechanism.parameters().to_string())
    for row in one(structure, number % ROOM):
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


def _options(description: str | None) -> argparse.Namespace:
    number = {"type": int, "metavar": "N"}
    return arguments(
        description or "",
        case=number | {"help": "print all about one case"},
        only={"type": int, "nargs": "*", "metavar": "K", "help": "these structures"},
        draws=number | {"help": "draws of each structure"},
        first=number | {"default": 0, "help": "the first of these"},
        builders={"action": "store_true", "help": "the first one of each builder"},
    )


def main(
    name: str = "benchmarks.attack",
    description: str | None = __doc__,
    one: Attack = attack,
    which: Callable[[Structure], bool] = lambda _: True,
) -> None:
    """Attack `which` structures by `one`, as the command line asks for."""
    options = _options(description)
    if options.case is not None:
        explain(options.case, one)
        return
    rows: list[Row] = []
    told = {"about": about(name, options.json)}
    draws = options.draws or (QUICK_DRAWS if options.quick else DRAWS - options.first)
    draws = range(options.first, options.first + draws)
    for structure in filter(which, chosen(options)):
        begun = time.process_time()
        own = [row for draw in draws for row in one(structure, draw)]
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
    if options.only:
        return [everything[k] for k in options.only]
    if options.builders:
        first = {one.build: one for one in reversed(everything)}
        everything = [one for one in everything if one is first[one.build]]
    mixed = [one for first in range(QUICK_EVERY) for one in everything[first::QUICK_EVERY]]
    return everything[::QUICK_EVERY] if options.quick else mixed


if __name__ == "__main__":
    main()
