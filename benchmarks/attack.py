"""Random mechanisms, laws, rungs, speeds and loads: is any number wrong without a sentence?

    python -m benchmarks.attack [--quick] [--json FILE] [--only K ...] [--case N]

Every case is a mechanism with numbers of its own. It is run by references, one ten times tighter
than the other and one whose numbers are off in the fifth digit, and then as users run it. Every
response is right within the accuracy that the book states for the rung; or the run said that it may
not be (it was refused, ended early, or carries a warning that concerns the response); or the
references disagree, which the run should have said too (chaotic motion); or it is silently wrong.
`--case N` prints all about case N.
"""

import argparse
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

import jaxclear as jc
from benchmarks.attacks import answers, rungs, verdicts
from benchmarks.attacks.answers import RESPONSES
from benchmarks.attacks.bearings import Case
from benchmarks.attacks.numbers import Draw
from benchmarks.attacks.structures import DRAWS, NUMBERS, Structure, structures
from benchmarks.attacks.verdicts import Verdict
from benchmarks.measure import report

# Saving times of every run.
SAVES = 201
# By how much the numbers of a mechanism are never known: answers that this changes beyond the
# accuracy are no run's to give.
NUDGE = 1e-5
QUICK_EVERY, QUICK_DRAWS = 6, 3


class Attempt(NamedTuple):
    """What came of a run: its answers, or the sentence it ended with; `raw`: no sentence but a
    traceback; `warned`: the responses that its warnings concern, `sentences` the warnings."""

    answers: Any
    ended: str
    raw: bool = False
    warned: frozenset[str] = frozenset()
    sentences: tuple[str, ...] = ()


def attempt(case: Case, integrator: Any, balance: bool) -> Attempt:
    """Run a case as a user would."""
    try:
        run = jc.simulate(
            case.mechanism,
            case.duration,
            integrator=integrator,
            save=SAVES,
            start_concentric=case.concentric,
            balance=balance,
            throw=False,
        )
        if not run.succeeded:
            return Attempt(None, run.result)
        wears = answers.surfaces(run.mechanism)
        found = jax.tree.map(np.asarray, answers.read(run, balance, wears))
        return Attempt(found, "", False, verdicts.concerned(run), run.warnings)
    except ValueError as error:
        return Attempt(None, str(error))
    except Exception as error:
        return Attempt(None, f"{type(error).__name__}: {error}", True)


class Row(NamedTuple):
    """One run of one case: errors and verdicts by response, its own verdict, what it said."""

    case: int
    mechanism: str
    rung: str
    integrator: str
    verdict: Verdict
    verdicts: dict[str, Verdict]
    errors: dict[str, float]
    doubt: dict[str, float]
    said: tuple[str, ...]
    seconds: float


def row_of(
    structure: Structure, draw: int, rung: str, integrator: Any, run: Attempt, known: tuple
) -> Row:
    """The verdict on a run beside its references."""
    tight, *others = known
    errors: dict[str, float] = {}
    doubt: dict[str, float] = {}
    found: dict[str, Verdict] = {}
    said = tuple(s for s in (run.ended, *run.sentences) if s)
    if run.raw:
        verdict = Verdict.RAW
    elif run.answers is None:
        verdict = Verdict.REFUSED
    elif any(one.answers is None for one in known):
        verdict = Verdict.NO_REFERENCE
        said += tuple(f"reference: {a.ended}" for a in known if a.ended)
    else:
        errors = answers.apart(run.answers, tight.answers)
        apart = [answers.apart(other.answers, tight.answers) for other in others]
        doubt = {name: max(one[name] for one in apart) for name in errors}
        kind = rungs.RUNGS[rung].kind
        found = verdicts.judged(errors, doubt, kind, run.warned)
        verdict = verdicts.worst(found.values())
    number = structure.number * DRAWS + draw
    name = "default" if integrator is None else jc.studies.advice.pilot.describe(integrator)
    return Row(number, structure.name, rung, name, verdict, found, errors, doubt, said, 0.0)


def judges(case: Case, model: str, step: float | None, balance: bool) -> tuple[Attempt, ...]:
    """The references: the tight one, the looser one, and that of slightly other numbers."""
    loose, tight = rungs.references(model, step)
    rig = case.reference or case.mechanism
    near = nudged(rig)
    return tuple(
        attempt(case._replace(mechanism=one), integrator, balance)
        for one, integrator in ((rig, tight), (rig, loose), (near, loose))
    )


def nudged(rig: jc.Mechanism) -> jc.Mechanism:
    """The mechanism with every number off by `NUDGE`, up or down at random."""
    signs = np.random.default_rng(0)
    return jax.tree.map(
        lambda leaf: (
            leaf * (1 + NUDGE * signs.choice([-1.0, 1.0])) if eqx.is_inexact_array(leaf) else leaf
        ),
        rig,
    )


def attack(structure: Structure, draw: int) -> list[Row]:
    """All runs of one case."""
    try:
        case = structure.case(draw)
    except ValueError as error:
        print(f"case {structure.number * DRAWS + draw} was refused: {error}", flush=True)
        return []
    known: dict[Any, tuple] = {}
    rows = []
    for place, name in enumerate(structure.rungs):
        rung = rungs.RUNGS[name]
        integrator = rung.make(Draw(NUMBERS, structure.number, draw, place, plain=draw == 0))
        step = None if rung.model == "compliant" else float(integrator.step)
        begun = time.process_time()
        run = attempt(case, integrator, structure.balance)
        spent = time.process_time() - begun
        if rung.model not in known:
            known[rung.model] = judges(case, rung.model, step, structure.balance)
        row = row_of(structure, draw, name, integrator, run, known[rung.model])
        rows.append(row._replace(seconds=spent))
    return rows


def summary(rows: list[Row]) -> list[dict[str, Any]]:
    """Runs by rung and verdict, with the share of right ones that carry a warning."""
    table = []
    for rung in [*dict.fromkeys(row.rung for row in rows), "all"]:
        own = [row for row in rows if rung in (row.rung, "all")]
        counts = Counter(row.verdict for row in own)
        right = [row for row in own if row.verdict == Verdict.RIGHT]
        warned = sum(bool(row.said) for row in right)
        table.append(
            {"rung": rung, "runs": len(own)}
            | {str(verdict): counts[verdict] for verdict in Verdict}
            | {"right, yet warned [%]": 100.0 * warned / max(len(right), 1)}
        )
    return table


def by_response(rows: list[Row]) -> list[dict[str, Any]]:
    """Responses by verdict."""
    return [
        {"response": name}
        | {
            str(verdict): sum(row.verdicts.get(name) == verdict for row in rows)
            for verdict in Verdict
        }
        for name in RESPONSES
    ]


def accused(rows: list[Row]) -> list[dict[str, Any]]:
    """The runs whose numbers are wrong without a sentence, and those that broke."""
    bad = (Verdict.WRONG, Verdict.UNSAID, Verdict.RAW)
    table = []
    for row in rows:
        if row.verdict in bad:
            off = [
                f"{name} {row.errors[name]:.2g}"
                + (f" (+-{row.doubt[name]:.1g})" if name != "drift" else "")
                for name, verdict in row.verdicts.items()
                if verdict in bad
            ]
            table.append(
                {
                    "case": row.case,
                    "mechanism": row.mechanism,
                    "integrator": row.integrator,
                    "verdict": str(row.verdict),
                    "off by": ", ".join(off) or " ".join(row.said)[:100],
                }
            )
    return table


def explain(number: int) -> None:
    """All about one case."""
    structure = structures()[number // DRAWS]
    case = structure.case(number % DRAWS)
    print(f"case {number}: {structure.name}, {case.duration:.4g} s")
    print(case.mechanism.parameters().to_string())
    for row in attack(structure, number % DRAWS):
        print(f"\n{row.rung}, {row.integrator}: {row.verdict} ({row.seconds:.2g} s CPU)")
        for name in row.verdicts:
            print(
                f"  {name:14s} {row.verdicts[name]:22s} error {row.errors[name]:9.2e}"
                f"  references apart {row.doubt[name]:9.2e}"
            )
        for sentence in row.said:
            print("  said:", sentence)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a sixth of the mechanisms")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    parser.add_argument("--case", type=int, metavar="N", help="print all about one case")
    parser.add_argument("--only", type=int, nargs="*", metavar="K", help="these structures")
    parser.add_argument("--draws", type=int, metavar="N", help="draws of each structure")
    return parser.parse_args()


def main() -> None:
    options = _options()
    if options.case is not None:
        explain(options.case)
        return
    wanted = structures()
    if options.only:
        wanted = [wanted[k] for k in options.only]
    elif options.quick:
        wanted = wanted[::QUICK_EVERY]
    draws = options.draws or (QUICK_DRAWS if options.quick else DRAWS)
    rows: list[Row] = []
    for structure in wanted:
        begun = time.process_time(), time.perf_counter()
        own = [row for draw in range(draws) for row in attack(structure, draw)]
        rows += own
        counts = Counter(str(row.verdict) for row in own)
        spent = time.process_time() - begun[0], time.perf_counter() - begun[1]
        print(
            f"{structure.number:3d} {structure.name}: {dict(counts)}"
            f" ({spent[0]:.0f} s CPU, {spent[1]:.0f} s)",
            flush=True,
        )
        for line in accused(own):
            print("     ", line["case"], line["integrator"], line["off by"], flush=True)
        jax.clear_caches()
    report("runs by rung", summary(rows), options)
    report("answers by response", by_response(rows), options)
    if accused(rows):
        report("wrong without a sentence", accused(rows), options)


if __name__ == "__main__":
    main()
