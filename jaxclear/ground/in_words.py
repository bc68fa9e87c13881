"""A thing with numbers in words: its kind, and every field that holds something, numbers with their
units.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxclear.ground.wording import described, public_name

__all__ = [
    "as_typed",
    "fields_in_words",
    "in_a_line",
    "number_in_words",
    "numbers_in_words",
    "part_in_words",
]

INDENT = " " * 6
# Longest line [characters] that holds the parts of a thing, too.
LONGEST = 100
# What decides accuracy is typed of an integrator even where it is the default.
ALWAYS_TYPED = ("step", "rtol", "atol")
# Unit of a number by the metadata of its field.
Unit = Callable[[Mapping[str, Any]], str]


def unit_of_field(metadata: Mapping[str, Any]) -> str:
    """The unit that a field declares."""
    return metadata.get("unit", "1")


def part_in_words(part: Any) -> str:
    """What a user types for its class, and its fields: in a line, or a line for each part in it."""
    kind = public_name(type(part))
    told = list(fields_in_words(part))
    line = f"{kind} {', '.join(text for _, text in told)}".rstrip()
    if len(line) <= LONGEST:
        return line
    inner = [text for name, text in told if isinstance(getattr(part, name), eqx.Module)]
    own = [text for name, text in told if not isinstance(getattr(part, name), eqx.Module)]
    return "\n".join([f"{kind} {', '.join(own)}".rstrip(), *(f"{INDENT}{text}" for text in inner)])


def as_typed(part: Any) -> str:
    """A part as a user would write it, defaults left out: FixedStep(step=5e-05, method="euler")."""
    told = []
    for field in dataclasses.fields(part):
        value, usual = getattr(part, field.name), field.default
        if usual is dataclasses.MISSING and field.default_factory is not dataclasses.MISSING:
            usual = field.default_factory()
        number = isinstance(value, (jax.Array, float)) and np.ndim(value) == 0
        if isinstance(value, eqx.Module):
            said = "" if type(value) is type(usual) else f"{type(value).__name__}()"
        elif number and (field.name in ALWAYS_TYPED or usual is None or value != usual):
            said = f"{float(value):.9g}"
        elif number or value == usual:
            said = ""
        else:
            said = f'"{value}"' if isinstance(value, str) else repr(value)
        told += [f"{field.name}={said}"] if said else []
    return f"{type(part).__name__}({', '.join(told)})"


def numbers_in_words(part: Any, unit: Unit = unit_of_field) -> str:
    """All fields of a part in a line."""
    return ", ".join(text for _, text in fields_in_words(part, unit))


def fields_in_words(part: Any, unit: Unit = unit_of_field) -> Iterator[tuple[str, str]]:
    """Every field that holds something, by name: numbers with units, parts by their kind."""
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        empty = isinstance(value, (str, tuple, dict)) and not value
        if value is not None and not empty:
            yield field.name, f"{field.name} {_in_words(value, field.metadata, unit)}"


def _in_words(value: Any, metadata: Mapping[str, Any], unit: Unit) -> str:
    if isinstance(value, eqx.Module):
        return in_a_line(value, unit)
    own = unit(metadata)
    own = "" if own in ("", "1") or own.startswith("(") else f" {own}"
    return f"{number_in_words(value)}{own}"


@functools.singledispatch
def in_a_line(part: Any, unit: Unit = unit_of_field) -> str:
    """A part of a thing: its class, and its fields in brackets. What has words of its own registers
    them."""
    inner = numbers_in_words(part, unit)
    return f"{type(part).__name__}{f'({inner})' if inner else ''}"


def number_in_words(value: Any) -> str:
    """A number, several in brackets, a name; of anything large its kind."""
    if isinstance(value, jax.core.Tracer):
        return "(traced)"
    if isinstance(value, tuple):
        told = ", ".join(map(_entry, value))
        return f"({told})" if len(value) != 1 else told
    if isinstance(value, (jax.Array, float)) and not getattr(value, "shape", ()):
        return f"{float(value):.6g}"
    return value if isinstance(value, str) else described(value)


def _entry(value: Any) -> str:
    return in_a_line(value) if isinstance(value, eqx.Module) else number_in_words(value)
