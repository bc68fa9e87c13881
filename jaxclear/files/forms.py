"""What an argument of a class is in a file: a number, a list, a name, things by name. A form reads
it from the values of a file, tells it as such values, and as JSON schema: no class has a reader of
its own, and a new form is one class. The form of a part with a kind of its own is in `parts`.

What does not fit is refused, in a file by line and place (`Misread`), of an object by its name
(`ValueError`), with what would be right.
"""

import dataclasses
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.files.places import NumberPlaces, places_in_words, steps_of
from jaxclear.files.text import Node, as_float, is_number, misread, plain_text, read_nested
from jaxclear.ground.wording import described
from jaxclear.multibody.mechanism import Mechanism

Schema = dict[str, Any]
UNMEASURED: Mapping[str, Any] = {"unit": "1"}
AS_A_NUMBER = re.compile(r"[+-]?\.?\d")
NUMBER = {"type": "number"}
BOUNDS = {
    "above": "exclusiveMinimum",
    "at_least": "minimum",
    "below": "exclusiveMaximum",
    "at_most": "maximum",
}


class AbstractForm(ABC):
    """What an argument is in a file."""

    __slots__ = ()

    @abstractmethod
    def read(self, node: Node, path: str, folder: Path) -> Any:
        """What a value of a file is.

        Args:
            node: the value with its line.
            path: its place in the file, for messages.
            folder: in which files that it names are.

        Raises:
            Misread: it is not of this form.
        """

    @abstractmethod
    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        """A thing as dictionaries, lists, texts and numbers.

        Args:
            thing: value of an argument.
            path: what it is called in messages.
            mechanism: in which variables point.

        Raises:
            ValueError: it cannot be written to a file.
        """

    @abstractmethod
    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Its JSON schema; those of classes go into `known`."""

    def looks_like(self, node: Node) -> bool:
        """Whether a value is written as things of this form are."""
        return False

    def holds(self, thing: Any) -> bool:
        """Whether a thing is one that this form writes."""
        return False


@dataclasses.dataclass(frozen=True)
class Number(AbstractForm):
    """One number; `metadata` holds unit, meaning and range."""

    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def read(self, node: Node, path: str, folder: Path) -> Any:
        if not is_number(node):
            required = f"one number{_unit(self.metadata)}"
            raise misread(node, path, f"is {node.words}; it must be {required}.")
        return as_float(node, path)

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        return _as_float(thing, path)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return NUMBER | _field_schema(self.metadata)

    def looks_like(self, node: Node) -> bool:
        return is_number(node)

    def holds(self, thing: Any) -> bool:
        return eqx.is_array(thing) and thing.ndim == 0


@dataclasses.dataclass(frozen=True)
class Numbers(AbstractForm):
    """A list of so many numbers (`counts`; () for any number); one may stand without a list."""

    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    counts: tuple[int, ...] = ()

    def read(self, node: Node, path: str, folder: Path) -> Any:
        if is_number(node):
            return as_float(node, path)
        if not isinstance(node.value, list):
            counts = " or ".join(map(str, self.counts))
            required = f"a list of {counts} numbers" if counts else "a list of numbers"
            required += _unit(self.metadata)
            raise misread(node, path, f"is {node.words}; it must be {required}.")
        for index, entry in enumerate(node.value):
            if not is_number(entry):
                raise misread(entry, f"{path}[{index}]", f"is {entry.words}; it must be a number.")
        return tuple(as_float(entry, path) for entry in node.value)

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        if not isinstance(thing, (tuple, list)):
            refuse(path, f"is {described(thing)}, where a file holds numbers.")
        values = [_as_float(entry, path) for entry in thing]
        return values[0] if len(values) == 1 else values

    def schema(self, defs: dict[str, Schema]) -> Schema:
        several: Schema = {"type": "array", "items": NUMBER}
        counts = [count for count in self.counts if count > 1]
        if counts:
            several |= {"minItems": min(counts), "maxItems": max(counts)}
        one = [NUMBER] if not self.counts or 1 in self.counts else []
        return {"anyOf": [several, *one], **_field_schema(self.metadata)}

    def looks_like(self, node: Node) -> bool:
        return is_number(node) or isinstance(node.value, list)

    def holds(self, thing: Any) -> bool:
        return _is_list(thing)


@dataclasses.dataclass(frozen=True)
class NumberArray(AbstractForm):
    """Lists of numbers, nested."""

    def read(self, node: Node, path: str, folder: Path) -> Any:
        return jnp.asarray(read_nested(node, path), float)

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(thing)):
            refuse(path, "is being traced; write it outside of jax.jit and derivatives.")
        return np.asarray(thing, float).tolist()

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return {"anyOf": [{"type": "array"}, NUMBER]}

    def looks_like(self, node: Node) -> bool:
        return isinstance(node.value, list)

    def holds(self, thing: Any) -> bool:
        return _is_list(thing)


@dataclasses.dataclass(frozen=True)
class Integer(AbstractForm):
    """A whole number."""

    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def read(self, node: Node, path: str, folder: Path) -> Any:
        if not self.looks_like(node):
            raise misread(node, path, f"is {node.words}; it must be a whole number.")
        return node.value

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        return int(thing)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return {"type": "integer"} | _field_schema(self.metadata)

    def looks_like(self, node: Node) -> bool:
        return isinstance(node.value, int) and not isinstance(node.value, bool)

    def holds(self, thing: Any) -> bool:
        return isinstance(thing, (int, np.integer)) and not isinstance(thing, bool)


@dataclasses.dataclass(frozen=True)
class Flag(AbstractForm):
    """True or false."""

    def read(self, node: Node, path: str, folder: Path) -> Any:
        if not self.looks_like(node):
            raise misread(node, path, f"is {node.words}; it must be true or false.")
        return node.value

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        return bool(thing)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return {"type": "boolean"}

    def looks_like(self, node: Node) -> bool:
        return isinstance(node.value, bool)

    def holds(self, thing: Any) -> bool:
        return isinstance(thing, bool)


@dataclasses.dataclass(frozen=True)
class Text(AbstractForm):
    """A name or word."""

    def read(self, node: Node, path: str, folder: Path) -> Any:
        return plain_text(node, path)

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        return str(thing)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return {"type": ["string", "number", "boolean"]}

    def looks_like(self, node: Node) -> bool:
        return isinstance(node.value, str)

    def holds(self, thing: Any) -> bool:
        return isinstance(thing, str)


@dataclasses.dataclass(frozen=True)
class FileName(AbstractForm):
    """The name of a file, beside the one that names it; read only."""

    def read(self, node: Node, path: str, folder: Path) -> Any:
        try:
            return folder / plain_text(node, path)
        except ValueError as error:
            raise misread(node, path, str(error)) from None

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        refuse(path, "is the name of a file, of which the numbers are written.")

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return {"type": "string", "description": "a file, its path counted from this one"}


@dataclasses.dataclass(frozen=True)
class Place(AbstractForm):
    """Where a number of the mechanism stands, or several that vary together."""

    def read(self, node: Node, path: str, folder: Path) -> Any:
        entries = node.value if isinstance(node.value, list) and node.value else [node]
        paths = tuple(plain_text(entry, path) for entry in entries)
        for entry, words in zip(entries, paths, strict=True):
            try:
                steps_of(words)
            except ValueError as error:
                raise misread(entry, path, str(error)) from None
        return NumberPlaces(paths)

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        try:
            paths = places_in_words(thing, mechanism)
        except (ValueError, KeyError, AttributeError, TypeError, IndexError) as error:
            refuse(path, f"is {described(thing)}, which points at no number: {error}")
        return paths[0] if len(paths) == 1 else list(paths)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        one = {"type": "string", "description": 'such as connections["B"].joint.clearance'}
        return {"anyOf": [one, {"type": "array", "items": one, "minItems": 1}]}


@dataclasses.dataclass(frozen=True)
class Listed(AbstractForm):
    """A list of things of one form; `length` of it, None for any."""

    entry: AbstractForm
    length: int | None = None

    def read(self, node: Node, path: str, folder: Path) -> Any:
        if not isinstance(node.value, list):
            raise misread(node, path, f"is {node.words}; it must be a list.")
        if self.length is not None and len(node.value) != self.length:
            raise misread(node, path, f"is {node.words}; it must be a list of {self.length}.")
        entries = enumerate(node.value)
        return tuple(self.entry.read(entry, f"{path}[{i}]", folder) for i, entry in entries)

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        entries = enumerate(thing)
        return [self.entry.plain(entry, f"{path}[{i}]", mechanism) for i, entry in entries]

    def schema(self, defs: dict[str, Schema]) -> Schema:
        schema: Schema = {"type": "array", "items": self.entry.schema(defs)}
        return schema | ({"minItems": self.length, "maxItems": self.length} if self.length else {})

    def looks_like(self, node: Node) -> bool:
        return isinstance(node.value, list)

    def holds(self, thing: Any) -> bool:
        return _is_list(thing)


@dataclasses.dataclass(frozen=True)
class ByName(AbstractForm):
    """Things of one form by name."""

    entry: AbstractForm

    def read(self, node: Node, path: str, folder: Path) -> Any:
        if not isinstance(node.value, dict):
            raise misread(node, path, f"is {node.words}; it must be a mapping from names.")
        entries = node.value.items()
        return {n: self.entry.read(entry, f'{path}["{n}"]', folder) for n, entry in entries}

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        entries = thing.items()
        return {n: self.entry.plain(entry, f'{path}["{n}"]', mechanism) for n, entry in entries}

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return {"type": "object", "additionalProperties": self.entry.schema(defs)}

    def looks_like(self, node: Node) -> bool:
        return isinstance(node.value, dict)

    def holds(self, thing: Any) -> bool:
        return isinstance(thing, dict)


@dataclasses.dataclass(frozen=True)
class Choice(AbstractForm):
    """One of several forms, told apart by how they are written."""

    forms: tuple[AbstractForm, ...]

    def read(self, node: Node, path: str, folder: Path) -> Any:
        # A number with its unit behind it is a text, and meant as a number.
        written = isinstance(node.value, str) and AS_A_NUMBER.match(node.value)
        for one in self.forms:
            if (written and isinstance(one, (Number, Numbers))) or one.looks_like(node):
                return one.read(node, path, folder)
        return self.forms[0].read(node, path, folder)

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        one = next((one for one in self.forms if one.holds(thing)), self.forms[-1])
        return one.plain(thing, path, mechanism)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        return {"anyOf": [one.schema(defs) for one in self.forms]}


def refuse(path: str, sentence: str) -> NoReturn:
    """Raises `ValueError` for a thing that a file cannot hold."""
    raise ValueError(f"{path} {sentence}")


def _as_float(thing: Any, path: str) -> float:
    if isinstance(thing, jax.core.Tracer):
        refuse(path, "is being traced; write it outside of jax.jit and derivatives.")
    if np.ndim(thing) != 0:
        refuse(path, f"is {described(thing)}, where a file holds one number.")
    return float(thing)


def _is_list(thing: Any) -> bool:
    return isinstance(thing, (tuple, list)) or eqx.is_array(thing)


def _unit(metadata: Mapping[str, Any]) -> str:
    unit = metadata.get("unit", "1")
    return "" if unit == "1" or unit.startswith("(") else f" [{unit}]"


def _field_schema(metadata: Mapping[str, Any]) -> Schema:
    """What a field says of its number."""
    unit = metadata.get("unit", "1")
    sliding = f"; {metadata['sliding']} for a sliding joint" if "sliding" in metadata else ""
    words = [metadata.get("meaning", ""), "" if unit == "1" else f"[{unit}{sliding}]"]
    text = " ".join(word for word in words if word)
    bounds = {word: metadata[key] for key, word in BOUNDS.items() if key in metadata}
    return (bounds if "counts" not in metadata else {}) | ({"description": text} if text else {})
