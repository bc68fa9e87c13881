"""Warnings and errors name the user's line: that which built or called something, however deep in
the package its cause is found, and that of a function of the user's in which the package failed.

What functions answer that a user has given: a response, a place, a load, a drive. One that
leaves JAX or fails is refused in a sentence that names what it is of, and the line.
"""

import sys
import sysconfig
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

# Packages whose frames lie between a user's line and the cause of a warning.
BETWEEN = ("jaxclear", "equinox", "jax", "jaxtyping", "contextlib", "functools")
# Where libraries are, those of Python too.
INSTALLED = (str(Path(sysconfig.get_path("stdlib"))), "site-packages")


# How many warnings there have been.
_warning_count = [0]


def count_warnings() -> int:
    """How many times this process was warned."""
    return _warning_count[0]


def warn(sentence: str, kind: type[Warning] = UserWarning) -> None:
    """A warning at the nearest line outside the package."""
    level, frame = 1, sys._getframe(0)
    while frame.f_back is not None and _is_between(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    _warning_count[0] += 1
    warnings.warn(sentence, kind, stacklevel=level)


def users_line(error: BaseException) -> str:
    """Where in the user's own code an error comes from, such as 'in "float(x)" (file.py, line 3)';
    "" where nobody knows."""
    location = ""
    for frame, number in traceback.walk_tb(error.__traceback__):
        code = frame.f_code
        installed = any(place in code.co_filename for place in INSTALLED)
        if not installed and not _is_between(frame.f_globals.get("__name__", "")):
            [line] = traceback.StackSummary.extract([(frame, number)])
            code_text = f'"{line.line.rstrip(",")}" ' if line.line else ""
            location = f"in {code_text}({Path(code.co_filename).name}, line {number})"
    return location


def _is_between(module: str) -> bool:
    return module.partition(".")[0] in BETWEEN


# What JAX raises where Python, or NumPy, wants the value of what is being traced.
UNTRACEABLE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)
IN_JAX = (
    "Leave float() and int() out; write jax.numpy.sqrt for math.sqrt or numpy.sqrt (and so on), "
    "jax.numpy.where for `if`, and jax.lax.while_loop for `while`."
)


def call_user(what: str, function: Callable, *arguments: Any, requirement: str = "") -> Any:
    """Result of a function that a user gave.

    Args:
        what: begins the message: whose function it is.
        function: of the user.
        arguments: of the function.
        requirement: ends the message: a sentence with what it must do.

    Raises:
        ValueError: it fails, or leaves JAX.
    """
    try:
        return function(*arguments)
    except UNTRACEABLE as error:
        raise ValueError(
            f"{what} leaves JAX {users_line(error)}: it is compiled before any number is known. "
            f"{IN_JAX}"
        ) from error
    except Exception as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        failed = f"{what} fails {users_line(error)}".rstrip()
        reason = f"{kind}{error}".partition("\n")[0]
        explanation = f"{reason.rstrip('.')}. {requirement}" if requirement else reason
        raise ValueError(f"{failed}: {explanation}") from error


def shape_of(function: Callable, *arguments: Any) -> Any:
    """The shapes of what a function answers; nothing is computed. Errors come as they are raised,
    without what JAX adds to those that pass it."""
    try:
        return jax.eval_shape(function, *arguments)
    except ValueError as error:
        raise ValueError(*error.args) from error.__cause__
