"""Whether two problems are one: the same mechanism, numbers, variables, responses and way to run.

A problem built anew by the same lines is the same. What differs first is named, so that a sentence
can say it.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxclear.studies.problem import Problem

# Longest description of a thing that differs, in characters.
LONGEST = 60


def first_difference(one: Problem, other: Problem) -> str:
    """The first thing in which `one` differs from `other`, in words; "" where they are the same."""
    if one.names != other.names:
        return f"its variables are {_listed(one.names)}, not {_listed(other.names)}"
    if one.response_names != other.response_names:
        named = _listed(one.response_names)
        return f"its responses are {named}, not {_listed(other.response_names)}"
    for what in ("mechanism", "response", "duration", "shares", "integrator", "state"):
        found = _difference(getattr(one, what), getattr(other, what), what)
        if found:
            return found
    for name in one.names:
        if _places(one, name) != _places(other, name):
            return f'variable "{name}" points at another number'
        mine, others = one.variables[name].distribution, other.variables[name].distribution
        found = _difference(mine, others, f'distribution of "{name}"')
        if found:
            return found
    return ""


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(f'"{name}"' for name in names) or "none"


def _places(problem: Problem, name: str) -> list[int]:
    """Which leaves of the mechanism a variable points at."""
    known = [id(leaf) for leaf in jax.tree.leaves(problem.mechanism)]
    wanted = jax.tree.leaves(problem.variables[name].where(problem.mechanism))
    return [known.index(id(leaf)) for leaf in wanted]


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
