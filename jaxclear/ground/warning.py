"""Warnings and errors name the user's line: that which built or called something, however deep in
the package its cause is found, and that of a function of the user's in which the package failed.
"""

import sys
import sysconfig
import traceback
import warnings
from pathlib import Path

__all__ = ["users_line", "warn"]

# Packages whose frames lie between a user's line and the cause of a warning.
BETWEEN = ("jaxclear", "equinox", "jax", "jaxtyping", "contextlib", "functools")
# Where libraries are, those of Python too.
INSTALLED = (str(Path(sysconfig.get_path("stdlib"))), "site-packages")


def warn(sentence: str, kind: type[Warning] = UserWarning) -> None:
    """A warning at the nearest line outside the package."""
    level, frame = 1, sys._getframe(0)
    while frame.f_back is not None and _is_between(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, kind, stacklevel=level)


def users_line(error: BaseException) -> str:
    """Where in the user's own code an error comes from, such as 'in "float(x)" (file.py, line 3)';
    "" where nobody knows."""
    found = ""
    for frame, number in traceback.walk_tb(error.__traceback__):
        code = frame.f_code
        installed = any(place in code.co_filename for place in INSTALLED)
        if not installed and not _is_between(frame.f_globals.get("__name__", "")):
            [line] = traceback.StackSummary.extract([(frame, number)])
            said = f'"{line.line.rstrip(",")}" ' if line.line else ""
            found = f"in {said}({Path(code.co_filename).name}, line {number})"
    return found


def _is_between(module: str) -> bool:
    return module.partition(".")[0] in BETWEEN
