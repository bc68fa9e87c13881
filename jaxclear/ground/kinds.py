"""What a field of a class may hold, read from its declaration once a class: a number, several, a
part of a family, a name, a count, a flag, a function.

A field says it by its type (`AbstractWearLaw | None`, `int`, `str`, `Callable`) and its metadata
(`unit`, `counts`, `at_least`). What this module does not know (`Any`, arrays) is left to the class.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator
from types import GenericAlias, NoneType, UnionType
from typing import Any, NamedTuple, Union, get_args, get_origin

import equinox as eqx
import jax
import numpy as np

from jaxclear.ground.wording import described, final_members, offered_like, public_name

__all__ = [
    "FieldRule",
    "as_given",
    "check_kinds",
    "field_rules",
    "members_of_union",
    "range_in_words",
]

FLOAT64 = np.dtype("float64")
SIMPLE: dict[Any, tuple[tuple[type, ...], str]] = {
    str: ((str,), "a name or word (text)"),
    bool: ((bool, np.bool_), "True or False"),
    int: ((int, np.integer), "a whole number"),
}
NUMBER_WORDS = {1: "one number", 2: "2 numbers", 3: "3 numbers"}


class FieldRule(NamedTuple):
    """What one field may hold: `name`; `allowed` types as they are; whether a `number` (with a
    unit), or so many of them (`counts`; () for any number); `entries` type of a tuple's entries and
    `length` of it; `wanted` in words."""

    name: str
    allowed: tuple[type, ...]
    number: bool
    counts: tuple[int, ...] | None
    function: bool
    simple: tuple[type, ...]
    entries: type | None
    length: int | None
    least: float | None
    wanted: str

    def admits(self, value: Any) -> bool:
        """Whether the field may hold this value; ranges of numbers apart."""
        if self.number and isinstance(value, jax.Array):
            return value.ndim == 0 and value.dtype == FLOAT64
        if isinstance(value, self.allowed):
            return True
        if self.counts is not None and isinstance(value, tuple):
            fits = all(isinstance(x, jax.Array) and x.ndim == 0 for x in value)
            return fits and (len(value) in self.counts if self.counts else len(value) > 0)
        if self.entries is not None and isinstance(value, tuple):
            fits = all(_is_simple(x, SIMPLE[self.entries][0]) for x in value)
            return fits and self.length in (None, len(value))
        if self.function and callable(value) and not isinstance(value, type):
            return True
        if not _is_simple(value, self.simple):
            return False
        return self.least is None or value >= self.least


def _is_simple(value: Any, kinds: tuple[type, ...]) -> bool:
    """A flag counts as a number in Python, but not here."""
    flag = isinstance(value, (bool, np.bool_))
    return bool(kinds) and isinstance(value, kinds) and (bool in kinds or not flag)


@functools.cache
def field_rules(kind: type) -> tuple[FieldRule, ...]:
    """The rules of a class's fields, of those that this module knows."""
    found = (_rule(field) for field in dataclasses.fields(kind))
    return tuple(rule for rule in found if rule is not None)


def _rule(field: dataclasses.Field) -> FieldRule | None:
    kinds = tuple(members_of_union(field.type))
    measured = "unit" in field.metadata
    counts = field.metadata.get("counts", ())
    several = measured and (tuple in kinds or "counts" in field.metadata)
    allowed = [k for k in kinds if isinstance(k, type) and issubclass(k, eqx.Module)]
    optional = NoneType in kinds or (field.default is None)
    simple = tuple(one for k in kinds if k in SIMPLE for one in SIMPLE[k][0])
    function = Callable in kinds or any(get_origin(k) is Callable for k in kinds)
    tuples = [k for k in kinds if isinstance(k, GenericAlias) and get_origin(k) is tuple]
    entries, length = None, None
    if tuples and get_args(tuples[0])[0] in SIMPLE:
        inner = get_args(tuples[0])
        entries, length = inner[0], None if Ellipsis in inner else len(inner)
    known = measured or allowed or simple or function or entries
    strange = any(k is Any or isinstance(k, str) for k in kinds) and not measured
    if not known or strange or not field.init:
        return None
    return FieldRule(
        field.name,
        (*allowed, *([NoneType] if optional else [])),
        measured and not several,
        counts if several else None,
        function,
        simple,
        entries,
        length,
        field.metadata.get("at_least") if simple else None,
        _wanted(field, allowed, several, function, (entries, length), optional),
    )


def members_of_union(declared: Any) -> Iterator[Any]:
    """The members of a union, or the type itself."""
    if isinstance(declared, UnionType) or get_origin(declared) is Union:
        for part in get_args(declared):
            yield from members_of_union(part)
    else:
        yield declared


def _wanted(field, allowed, several, function, of_tuple, optional) -> str:
    """What the field may hold, in words."""
    entries, length = of_tuple
    if "wanted" in field.metadata:
        words = [field.metadata["wanted"]]
    elif several:
        counts = field.metadata.get("counts", ())
        number = " or ".join(map(str, counts)) if counts else "several"
        words = [f"{number} numbers{_unit(field)}"]
    elif "unit" in field.metadata:
        words = [f"one number{_unit(field)}"]
        words += [_family(kind) for kind in allowed]
    elif entries is not None:
        what = SIMPLE[entries][1].removeprefix("a ").removesuffix(" (text)")
        words = [f"{length or 'some'} {what}s in a tuple"]
    else:
        words = [_family(kind) for kind in allowed]
        words += [SIMPLE[kind][1] for kind in members_of_union(field.type) if kind in SIMPLE]
        limits = range_in_words(field.metadata)
        words[-1:] = [f"{words[-1]}, {limits}"] if limits and words else words[-1:]
    words += ["a function of time"] if function and "unit" in field.metadata else []
    words += ["a function"] if function and "unit" not in field.metadata else []
    return " or ".join([*words, *(["None"] if optional else [])])


def _unit(field: dataclasses.Field) -> str:
    unit = field.metadata["unit"]
    return "" if unit == "1" or unit.startswith("(") else f" [{unit}]"


def _family(kind: type) -> str:
    """A class, or for a family the place where its members are."""
    path = public_name(kind)
    place, _, name = path.rpartition(".")
    if not kind.__module__.startswith("jaxclear"):
        return f"one of {kind.__module__.partition('.')[0]}"
    if not kind.__name__.startswith("Abstract"):
        return f"a jaxclear.{path}"
    places = dict.fromkeys(public_name(own).rpartition(".")[0] for own in final_members(kind))
    found = [place] if place in places or not any(places) else [each for each in places if each]
    if not any(found):
        return f"a {name.removeprefix('Abstract')}"
    return f"one of {' or '.join(f'jaxclear.{each}' for each in found)}"


def range_in_words(metadata: Any) -> str:
    """The range of a field: "above 0 and at most 1"."""
    words = {"above": "above", "at_least": "at least", "below": "below", "at_most": "at most"}
    return " and ".join(
        f"{word} {metadata[key]:g}" for key, word in words.items() if key in metadata
    )


def check_kinds(owner: Callable[[], str], part: Any) -> None:
    """Raises `ValueError` where a field holds what it may not; `owner` says whose field it is."""
    for rule in field_rules(type(part)):  # type: ignore[arg-type]
        value = getattr(part, rule.name)
        if not rule.admits(value):
            raise ValueError(
                f"{owner()} has {rule.name} = {described(value)}; it must be {rule.wanted}"
                f"{_remedy(rule, value)}."
            )


def _remedy(rule: FieldRule, value: Any) -> str:
    """For what has only not been built, how to build it."""
    if isinstance(value, type) and issubclass(value, rule.allowed):
        return f": build one, {value.__name__}(...)"
    if isinstance(value, str) and not rule.simple:
        for kind in rule.allowed:
            path = public_name(kind)
            close = offered_like(value, path) if "." in path else ""
            if close:
                return f", such as {close}(...)"
    fields = dataclasses.fields(value) if isinstance(value, eqx.Module) else ()
    for inner in (getattr(value, field.name) for field in fields):
        if isinstance(inner, rule.allowed):
            return f": what it holds is one, {public_name(type(inner))}(...)"
    if rule.allowed and not rule.function and callable(value) and value.__class__ is type(_rule):
        return f": call it, {value.__name__}(...)"
    return ""


def as_given(converter: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The converter of a field, which leaves alone what it cannot convert: the field's check then
    refuses it by name."""

    @functools.wraps(converter)
    def convert(value: Any) -> Any:
        try:
            return converter(value)
        except (ValueError, TypeError, OverflowError):
            return value

    return convert


def finite_and_within(value: float, metadata: Any) -> bool:
    """Whether a known number is finite and in its field's range."""
    return (
        math.isfinite(value)
        and value > metadata.get("above", -math.inf)
        and value >= metadata.get("at_least", -math.inf)
        and value < metadata.get("below", math.inf)
        and value <= metadata.get("at_most", math.inf)
    )
