"""From objects of the package to the values of a file. What holds code, or what no file form tells,
is refused with a sentence that names the place."""

import inspect
from functools import singledispatch
from typing import Any, NoReturn

import equinox as eqx
import jax
import numpy as np

from jaxclear.components.function_of_time import TimeTable
from jaxclear.files.classes import ALONE, Argument, arguments, members
from jaxclear.files.forms import (
    AbstractForm,
    ByName,
    Choice,
    Flag,
    Listed,
    Number,
    NumberArray,
    Numbers,
    Part,
    Place,
    Text,
    Whole,
)
from jaxclear.files.places import places_in_words
from jaxclear.files.reading import KIND
from jaxclear.ground.wording import described, listed
from jaxclear.multibody.mechanism import Mechanism


@singledispatch
def in_plain_values(form: AbstractForm, thing: Any, path: str, mechanism: Mechanism) -> Any:
    """A thing as dictionaries, lists, texts and numbers. `path`: what it is called; `mechanism`:
    that in which variables point. Raises `ValueError` with a sentence."""
    raise NotImplementedError(type(form).__name__)


def _refuse(path: str, sentence: str) -> NoReturn:
    raise ValueError(f"{path} {sentence}")


@in_plain_values.register
def _(form: Number, thing: Any, path: str, mechanism: Mechanism) -> Any:
    return _float(thing, path)


@in_plain_values.register
def _(form: Numbers, thing: Any, path: str, mechanism: Mechanism) -> Any:
    if not isinstance(thing, (tuple, list)):
        _refuse(path, f"is {described(thing)}, where a file holds numbers.")
    found = [_float(entry, path) for entry in thing]
    return found[0] if len(found) == 1 else found


@in_plain_values.register
def _(form: NumberArray, thing: Any, path: str, mechanism: Mechanism) -> Any:
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(thing)):
        _refuse(path, "is being traced; write it outside of jax.jit and derivatives.")
    return np.asarray(thing, float).tolist()


@in_plain_values.register
def _(form: Whole, thing: Any, path: str, mechanism: Mechanism) -> Any:
    return int(thing)


@in_plain_values.register
def _(form: Flag, thing: Any, path: str, mechanism: Mechanism) -> Any:
    return bool(thing)


@in_plain_values.register
def _(form: Text, thing: Any, path: str, mechanism: Mechanism) -> Any:
    return str(thing)


@in_plain_values.register
def _(form: Place, thing: Any, path: str, mechanism: Mechanism) -> Any:
    try:
        found = places_in_words(thing, mechanism)
    except (ValueError, KeyError, AttributeError, TypeError, IndexError) as error:
        _refuse(path, f"is {described(thing)}, which points at no number: {error}")
    return found[0] if len(found) == 1 else list(found)


@in_plain_values.register
def _(form: Listed, thing: Any, path: str, mechanism: Mechanism) -> Any:
    return [
        in_plain_values(form.entry, entry, f"{path}[{index}]", mechanism)
        for index, entry in enumerate(thing)
    ]


@in_plain_values.register
def _(form: ByName, thing: Any, path: str, mechanism: Mechanism) -> Any:
    return {
        name: in_plain_values(form.entry, entry, f'{path}["{name}"]', mechanism)
        for name, entry in thing.items()
    }


@in_plain_values.register
def _(form: Choice, thing: Any, path: str, mechanism: Mechanism) -> Any:
    for one in form.forms:
        if _is_of(one, thing):
            return in_plain_values(one, thing, path, mechanism)
    return in_plain_values(form.forms[-1], thing, path, mechanism)


@in_plain_values.register
def _(form: Part, thing: Any, path: str, mechanism: Mechanism) -> Any:
    known = members(form.families)
    kind: Any = thing.__class__
    if kind not in known.values():
        _refuse(path, _no_data(thing, known))
    found: dict[str, Any] = {}
    if form.families != (kind,):
        found[KIND] = kind.__name__
    for name, own in arguments(kind).items():
        value, place = own.told(thing), f"{path}.{name}" if path else name
        if own.form is None:
            _check_usual(own, value, place)
        elif value is None:
            # Absent where that is not the usual.
            found |= {name: None} if own.default not in (None, inspect.Parameter.empty) else {}
        elif not (isinstance(value, (str, dict)) and value in ({}, own.left_out)):
            found[name] = in_plain_values(own.form, value, place, mechanism)
    alone = ALONE.get(kind, KIND)
    if form.spelled_out:
        return found
    return found[alone] if found.keys() == {alone} else found


def _check_usual(own: Argument, value: Any, path: str) -> None:
    """What a file cannot hold must be as it is unless told otherwise."""
    if own.needed or not _is_same(value, own.default):
        _refuse(path, f"is {described(value)}, which a file cannot hold: it holds data, no code.")


def _is_same(one: Any, other: Any) -> bool:
    return bool(one is other or eqx.tree_equal(one, other))


def _no_data(thing: Any, known: dict[str, type]) -> str:
    """Why a thing has no place in a file."""
    names = listed(known)
    if callable(thing) and not isinstance(thing, eqx.Module):
        told = f"is {described(thing)}: a file holds data, no code. Take one of {names}"
        if TimeTable.__name__ not in known:
            return f"{told}."
        return (
            f"{told}; a function of time becomes data by jaxclear.TimeTable.sampled(function, "
            "times)."
        )
    return f"is {described(thing)}; a file knows {names} there."


def _float(thing: Any, path: str) -> float:
    if isinstance(thing, jax.core.Tracer):
        _refuse(path, "is being traced; write it outside of jax.jit and derivatives.")
    if np.ndim(thing) != 0:
        _refuse(path, f"is {described(thing)}, where a file holds one number.")
    return float(thing)


def _is_of(form: AbstractForm, thing: Any) -> bool:
    """Whether a thing is one that a form writes."""
    if isinstance(form, Part):
        return isinstance(thing, form.families)
    if isinstance(form, Whole):
        return isinstance(thing, (int, np.integer)) and not isinstance(thing, bool)
    if isinstance(form, Number):
        return eqx.is_array(thing) and thing.ndim == 0
    if isinstance(form, Text):
        return isinstance(thing, str)
    if isinstance(form, Flag):
        return isinstance(thing, bool)
    if isinstance(form, (Numbers, NumberArray, Listed)):
        return isinstance(thing, (tuple, list)) or eqx.is_array(thing)
    return isinstance(form, ByName) and isinstance(thing, dict)
