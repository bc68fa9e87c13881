"""What an argument of a class is in a file, told by the type of its field: a number, a list, a part
with a kind of its own. Reading, writing and the schema follow a form; no class has a reader of its
own.
"""

import dataclasses
from collections.abc import Callable, Mapping
from types import NoneType
from typing import Any, get_args, get_origin

import equinox as eqx
import jax
import jaxtyping

from jaxclear.components.function_of_time import AbstractFunctionOfTime
from jaxclear.ground.quantity import members_of_union

UNMEASURED: Mapping[str, Any] = {"unit": "1"}


class AbstractForm:
    """What an argument is in a file."""

    __slots__ = ()


@dataclasses.dataclass(frozen=True)
class Number(AbstractForm):
    """One number; `metadata` holds unit, meaning and range."""

    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Numbers(AbstractForm):
    """A list of so many numbers (`counts`; () for any number); one may stand without a list."""

    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    counts: tuple[int, ...] = ()


@dataclasses.dataclass(frozen=True)
class NumberArray(AbstractForm):
    """Lists of numbers, nested."""


@dataclasses.dataclass(frozen=True)
class Whole(AbstractForm):
    """A whole number."""

    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Flag(AbstractForm):
    """True or false."""


@dataclasses.dataclass(frozen=True)
class Text(AbstractForm):
    """A name or word."""


@dataclasses.dataclass(frozen=True)
class FileName(AbstractForm):
    """The name of a file, beside the one that names it."""


@dataclasses.dataclass(frozen=True)
class Place(AbstractForm):
    """Where a number of the mechanism stands, or several that vary together."""


@dataclasses.dataclass(frozen=True)
class Listed(AbstractForm):
    """A list of things of one form; `length` of it, None for any."""

    entry: AbstractForm
    length: int | None = None


@dataclasses.dataclass(frozen=True)
class ByName(AbstractForm):
    """Things of one form by name."""

    entry: AbstractForm


@dataclasses.dataclass(frozen=True)
class Part(AbstractForm):
    """A thing of one of some classes or families. `spelled_out`: always written as a mapping,
    because a text alone would say something else."""

    families: tuple[type, ...]
    spelled_out: bool = False


@dataclasses.dataclass(frozen=True)
class Choice(AbstractForm):
    """One of several forms, told apart by how they are written."""

    forms: tuple[AbstractForm, ...]


def form_of(declared: Any, metadata: Mapping[str, Any]) -> AbstractForm | None:
    """The form of a field by its type and metadata; None where it has none. A function without
    said arguments is one of time."""
    kinds = [kind for kind in members_of_union(declared) if kind is not NoneType]
    families = tuple(k for k in kinds if isinstance(k, type) and _is_a_part(k))
    forms: list[AbstractForm] = []
    if "unit" in metadata:
        several = "counts" in metadata or tuple in kinds
        forms.append(Numbers(metadata, metadata.get("counts", ())) if several else Number(metadata))
    if Callable in kinds:
        families = (*families, AbstractFunctionOfTime)
    if families:
        forms.append(Part(families))
    if "unit" not in metadata:
        plain = (_plain_form(kind, metadata) for kind in kinds if kind not in families)
        forms += [form for form in plain if form is not None]
    if not forms:
        return None
    return forms[0] if len(forms) == 1 else Choice(tuple(forms))


def _is_a_part(kind: type) -> bool:
    array = issubclass(kind, (jax.Array, jaxtyping.AbstractArray))
    return not array and (issubclass(kind, eqx.Module) or dataclasses.is_dataclass(kind))


def _plain_form(kind: Any, metadata: Mapping[str, Any]) -> AbstractForm | None:
    """The form of what is neither a number with a unit nor a part."""
    simple = {bool: Flag(), int: Whole(metadata), float: Number(UNMEASURED), str: Text()}
    if kind in simple:
        return simple[kind]
    if kind is tuple:
        return Numbers(UNMEASURED)
    if isinstance(kind, type) and issubclass(kind, (jax.Array, jaxtyping.AbstractArray)):
        return NumberArray()
    inner = get_args(kind)
    if get_origin(kind) is tuple:
        entry = form_of(inner[0], {})
        length = None if Ellipsis in inner else len(inner)
        return None if entry is None else Listed(entry, length)
    if get_origin(kind) is dict and inner[0] is str:
        entry = form_of(inner[1], {})
        return None if entry is None else ByName(entry)
    return None
