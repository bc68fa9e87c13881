"""Whether two problems are one: the same mechanism, numbers, variables, responses and way to run.

A problem built anew by the same lines is the same. What differs first is named, so that a sentence
can say it.
"""

from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.texts import LONGEST, parts_of, texts_of


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
    parts, others = parts_of(one), parts_of(other)
    if parts is None and callable(one):
        return "" if texts_of(one) == texts_of(other) else f"{path} is another function"
    if parts is None or others is None:
        return "" if one == other else _said(one, other, path)
    if parts.keys() != others.keys():
        return _said(one, other, path)
    found = (_difference(part, others[key], f"{path}{key}") for key, part in parts.items())
    return next(filter(None, found), "")


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
