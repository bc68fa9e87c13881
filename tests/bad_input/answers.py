"""How bad input is answered: with a sentence, with a raw traceback, or not at all.

A *sentence* is a ValueError or TypeError (of a module's name an AttributeError, of the command line
its own exit) that is raised by a line of jaxclear, names the argument or the thing, and says what
would be right. Anything else that is raised is a *raw traceback*; what is not refused is *accepted
nonsense*."""

import contextlib
import io
import traceback
import warnings
from pathlib import Path

from tests.bad_input import by_hand, functions, generated
from tests.bad_input.generated import Case

CLASSES = ("sentence", "raw traceback", "accepted nonsense")
# Words by which a sentence says what would be right.
RIGHT = ("must", "give", "there is", "there are", "takes", "needs", "mean", "may be", "offers")
RIGHT += ("write", "prefer", "take", "put", "leave", "build", "choose", "it has", "call it", "need")
RIGHT += ("connect", "simulate with")
OWN = ("jaxclear",)


def all_cases(runs: bool) -> list[Case]:
    """Every bad input whose refusal compiles a run, or every other one."""
    if runs:
        return [*functions.cases(), *by_hand.compiled_cases()]
    return [
        *generated.constructors(),
        *generated.products(),
        *generated.members(),
        *by_hand.cases(),
    ]


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
