"""Whether two problems are one: the same mechanism, numbers, variables, responses and way to run.

A problem built anew by the same lines is the same. What differs first is named, so that a sentence
can say it.
"""

import dataclasses
import hashlib
from types import CodeType
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.studies.base import AbstractProblem

# Longest description of a thing that differs, in characters.
LONGEST = 60
# Of a digest.
DIGITS = 16


def first_difference(one: AbstractProblem, other: AbstractProblem) -> str:
    """The first thing in which `one` differs from `other`, in words; "" where they are the same."""
    if one.names != other.names:
        return f"its variables are {_listed(one.names)}, not {_listed(other.names)}"
    if one.response_names != other.response_names:
        named = _listed(one.response_names)
        return f"its responses are {named}, not {_listed(other.response_names)}"
    if type(one) is not type(other):
        return f"it is a {type(one).__name__}, not a {type(other).__name__}"
    others_parts = other.parts()
    for what, part in one.parts().items():
        found = _difference(part, others_parts.get(what), what)
        if found:
            return found
    for name in one.names:
        mine, others = one.variables[name].distribution, other.variables[name].distribution
        found = _difference(mine, others, f'distribution of "{name}"')
        if found:
            return found
    return _difference(one.correlation, other.correlation, "correlation of the variables")


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(f'"{name}"' for name in names) or "none"


def _difference(one: Any, other: Any, path: str) -> str:
    """As `first_difference`, of any part of a problem; `path` leads to it."""
    if one is other:
        return ""
    if type(one) is not type(other):
        return _said(one, other, path)
    if eqx.is_array(one):
        return "" if np.array_equal(one, other, equal_nan=True) else _said(one, other, path)
    if callable(one) and getattr(one, "__code__", None) is not None:
        return "" if _same_function(one, other) else f"{path} is another function"
    parts, others = _parts(one), _parts(other)
    if parts is None or others is None:
        return "" if one == other else _said(one, other, path)
    if parts.keys() != others.keys():
        return _said(one, other, path)
    found = (_difference(part, others[key], f"{path}{key}") for key, part in parts.items())
    return next(filter(None, found), "")


def _parts(thing: Any) -> dict[str, Any] | None:
    """What a thing consists of, each by what follows its own name; None for what is one piece."""
    if dataclasses.is_dataclass(thing):
        return {f".{f.name}": getattr(thing, f.name) for f in dataclasses.fields(thing)}
    if isinstance(thing, dict):
        return {f'["{key}"]': value for key, value in thing.items()}
    if isinstance(thing, (tuple, list)):
        return {f"[{i}]": value for i, value in enumerate(thing)}
    return None


def _same_function(one: Any, other: Any) -> bool:
    """Whether two functions do the same with the same things, wherever they were written."""
    for part in ("co_code", "co_consts", "co_names", "co_varnames"):
        if getattr(one.__code__, part) != getattr(other.__code__, part):
            return False
    held = [[cell.cell_contents for cell in f.__closure__ or ()] for f in (one, other)]
    return not _difference(held[0], held[1], "") and not _difference(
        one.__defaults__, other.__defaults__, ""
    )


def _said(one: Any, other: Any, path: str) -> str:
    words = [_short(thing) for thing in (one, other)]
    return f"{path} is {words[0]}, not {words[1]}" if words[0] != words[1] else f"{path} differs"


def _short(thing: Any) -> str:
    if eqx.is_array(thing) and np.ndim(thing) == 0:
        return f"{float(thing):.6g}"
    if isinstance(thing, (str, int, float, type(None))):
        return repr(thing)[:LONGEST]
    if isinstance(thing, dict):
        return f"{{{', '.join(map(repr, thing))}}}"[:LONGEST]
    return type(thing).__name__


def in_texts(problem: AbstractProblem) -> dict[str, str]:
    """A text for each part of a problem, by its path: two problems are one where these are the
    same. Numbers with all their digits, large arrays and functions by a digest."""
    found: dict[str, str] = {}
    for what, part in problem.parts().items():
        _tell(part, what, found)
    for name in problem.names:
        _tell(problem.variables[name].distribution, f'distribution of "{name}"', found)
    if problem.correlation is not None:
        _tell(problem.correlation, "correlation of the variables", found)
    return found


def _tell(thing: Any, path: str, found: dict[str, str]) -> None:
    """Puts the texts of a part of a problem, and of its parts, into `found`."""
    if eqx.is_array(thing) or isinstance(thing, np.ndarray):
        values = np.asarray(thing)
        digest = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:DIGITS]
        text = repr(values.item()) if values.ndim == 0 else f"an array {values.shape} {digest}"
        found[path] = text
    elif callable(thing) and getattr(thing, "__code__", None) is not None:
        _tell_function(thing, path, found)
    elif (parts := _parts(thing)) is not None:
        found[path] = type(thing).__name__
        for key, part in parts.items():
            _tell(part, f"{path}{key}", found)
    else:
        found[path] = repr(thing)[:LONGEST]


def _tell_function(function: Any, path: str, found: dict[str, str]) -> None:
    """A function by what it does and with what."""
    code = function.__code__
    # Constants of a function may be code, whose text tells where it lies in memory.
    constants = [c for c in code.co_consts if not isinstance(c, CodeType)]
    said = repr((code.co_code, constants, code.co_names, code.co_varnames)).encode()
    found[path] = f"the function {function.__name__} {hashlib.sha256(said).hexdigest()[:DIGITS]}"
    for i, cell in enumerate(function.__closure__ or ()):
        _tell(cell.cell_contents, f"{path} holds [{i}]", found)
    for i, value in enumerate(function.__defaults__ or ()):
        _tell(value, f"{path} by default [{i}]", found)
