"""How bad input is answered: with a sentence, with a raw traceback, or not at all.

    python -m benchmarks.claims.bad_input [--quick] [--list] [--json FILE]

A *sentence* is a ValueError or TypeError (of a module's name an AttributeError, of the command line
its own exit) that is raised by a line of jaxclear, names the argument or the thing, and says what
would be right. Anything else that is raised is a *raw traceback*; what is not refused is *accepted
nonsense*. `--quick` leaves out what compiles a run.
"""

import argparse
import collections
import contextlib
import io
import json
import traceback
import warnings
from pathlib import Path

from benchmarks.inputs import by_hand, functions, generated
from benchmarks.inputs.generated import Case
from benchmarks.measure import report

CLASSES = ("sentence", "raw traceback", "accepted nonsense")
# Words by which a sentence says what would be right.
RIGHT = ("must", "give", "there is", "there are", "takes", "needs", "mean", "may be", "offers")
RIGHT += (
    "write",
    "prefer",
    "take",
    "put",
    "leave",
    "build",
    "choose",
    "it has",
    "call it",
    "need",
    "connect",
    "simulate with",
)
OWN = ("jaxclear",)


def all_cases(quick: bool) -> list[Case]:
    """Every bad input."""
    found = [*generated.constructors(), *generated.products(), *generated.members()]
    found += list(functions.cases()) if not quick else []
    return found + list(by_hand.cases(quick))


def judged(case: Case) -> tuple[str, str]:
    """(class, what was said) of one case."""
    silence = contextlib.redirect_stderr(io.StringIO())
    with warnings.catch_warnings(), silence as said:
        warnings.simplefilter("ignore")
        try:
            case.call()
        except (Exception, SystemExit) as error:
            text = said.getvalue() if isinstance(error, SystemExit) else str(error)
            return _class_of(error, text, case), f"{type(error).__name__}: {text}"
    return CLASSES[2], ""


def _class_of(error: BaseException, text: str, case: Case) -> str:
    kinds = (ValueError, TypeError, SystemExit, AttributeError)
    frames = traceback.extract_tb(error.__traceback__)
    place = next((p for p in reversed(Path(frames[-1].filename).parts) if p in OWN), "")
    own = bool(place) or (isinstance(error, SystemExit) and error.code == 2)
    low = text.lower()
    named = any(name.lower() in low for name in case.names)
    right = any(word in low for word in RIGHT)
    return CLASSES[0] if isinstance(error, kinds) and own and named and right else CLASSES[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--quick", action="store_true", help="leave out what compiles a run")
    parser.add_argument("--list", action="store_true", help="print what is not a sentence")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    options = parser.parse_args()
    counts: dict[str, collections.Counter] = {}
    for case in all_cases(options.quick):
        found, said = judged(case)
        counts.setdefault(case.group, collections.Counter())[found] += 1
        if options.list and found != CLASSES[0]:
            print(f"{found}: {case.label}: {said[:200]}", flush=True)
    rows = [
        {"group": group, "inputs": count.total()} | {name: count[name] for name in CLASSES}
        for group, count in counts.items()
    ]
    whole = {name: sum(row[name] for row in rows) for name in ("inputs", *CLASSES)}
    rows.append({"group": "all"} | whole)
    report("Bad input", rows, options)
    print(json.dumps({"sentence [%]": 100 * whole["sentence"] / whole["inputs"]}))


if __name__ == "__main__":
    main()
