"""From the values of a file to objects of the package. What does not fit is refused by line and
place, with what would be right; what a class itself refuses is said with its own sentence.
"""

import re
from collections.abc import Mapping
from functools import singledispatch
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from jaxclear.files.classes import (
    ALONE,
    INSTEAD,
    USUAL,
    Argument,
    arguments,
    builders,
    full_name,
    members,
)
from jaxclear.files.forms import (
    AbstractForm,
    ByName,
    Choice,
    FileName,
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
from jaxclear.files.places import NumberPlaces, steps_of
from jaxclear.files.text import Misread, Node, as_float, is_number, misread, nested, plain_text
from jaxclear.ground.wording import listed, unknown

KIND = "kind"
AS_A_NUMBER = re.compile(r"[+-]?\.?\d")
# What a class may refuse its arguments with.
REFUSALS = (ValueError, TypeError, OverflowError, ArithmeticError, KeyError, AttributeError)


@singledispatch
def read(form: AbstractForm, node: Node, path: str, folder: Path) -> Any:
    """What a value of a file is, read in a form. `path`: its place in the file; `folder`: where
    files that it names are. Raises `Misread` with a sentence."""
    raise NotImplementedError(type(form).__name__)


@read.register
def _(form: Number, node: Node, path: str, folder: Path) -> Any:
    if not is_number(node):
        raise misread(node, path, f"is {node.said}; it must be one number{_unit(form.metadata)}.")
    return as_float(node, path)


@read.register
def _(form: Numbers, node: Node, path: str, folder: Path) -> Any:
    if is_number(node):
        return as_float(node, path)
    if not isinstance(node.value, list):
        raise misread(
            node, path, f"is {node.said}; it must be {_how_many(form)}{_unit(form.metadata)}."
        )
    for index, entry in enumerate(node.value):
        if not is_number(entry):
            raise misread(entry, f"{path}[{index}]", f"is {entry.said}; it must be a number.")
    return tuple(as_float(entry, path) for entry in node.value)


@read.register
def _(form: NumberArray, node: Node, path: str, folder: Path) -> Any:
    return jnp.asarray(nested(node, path), float)


@read.register
def _(form: Whole, node: Node, path: str, folder: Path) -> Any:
    if not isinstance(node.value, int) or isinstance(node.value, bool):
        raise misread(node, path, f"is {node.said}; it must be a whole number.")
    return node.value


@read.register
def _(form: Flag, node: Node, path: str, folder: Path) -> Any:
    if not isinstance(node.value, bool):
        raise misread(node, path, f"is {node.said}; it must be true or false.")
    return node.value


@read.register
def _(form: Text, node: Node, path: str, folder: Path) -> Any:
    return plain_text(node, path)


@read.register
def _(form: FileName, node: Node, path: str, folder: Path) -> Any:
    try:
        return folder / plain_text(node, path)
    except ValueError as error:
        raise misread(node, path, str(error)) from None


@read.register
def _(form: Place, node: Node, path: str, folder: Path) -> Any:
    entries = node.value if isinstance(node.value, list) and node.value else [node]
    paths = tuple(plain_text(entry, path) for entry in entries)
    for entry, words in zip(entries, paths, strict=True):
        try:
            steps_of(words)
        except ValueError as error:
            raise misread(entry, path, str(error)) from None
    return NumberPlaces(paths)


@read.register
def _(form: Listed, node: Node, path: str, folder: Path) -> Any:
    if not isinstance(node.value, list):
        raise misread(node, path, f"is {node.said}; it must be a list.")
    if form.length is not None and len(node.value) != form.length:
        raise misread(node, path, f"is {node.said}; it must be a list of {form.length}.")
    entries = enumerate(node.value)
    return tuple(read(form.entry, entry, f"{path}[{i}]", folder) for i, entry in entries)


@read.register
def _(form: ByName, node: Node, path: str, folder: Path) -> Any:
    if not isinstance(node.value, dict):
        raise misread(node, path, f"is {node.said}; it must be a mapping from names.")
    return {
        name: read(form.entry, entry, f'{path}["{name}"]', folder)
        for name, entry in node.value.items()
    }


@read.register
def _(form: Choice, node: Node, path: str, folder: Path) -> Any:
    for one in form.forms:
        # A number with its unit behind it is a text, and meant as a number.
        written = isinstance(node.value, str) and AS_A_NUMBER.match(node.value)
        if (written and isinstance(one, (Number, Numbers))) or _looks_like(one, node):
            return read(one, node, path, folder)
    return read(form.forms[0], node, path, folder)


@read.register
def _(form: Part, node: Node, path: str, folder: Path) -> Any:
    known = members(form.families)
    made = builders(form.families)
    values = node.value
    alone = ALONE.get(form.families[0]) if len(form.families) == 1 else None
    kind: Any = None
    if isinstance(values, dict):
        given = {name: entry for name, entry in values.items() if name != KIND}
        named = values.get(KIND)
        if named is None:
            kind = _only_member(form, known, made, node, path)
        else:
            kind = _known(plain_text(named, f"{path}.{KIND}"), named, known, made, path)
    elif isinstance(values, str) and alone is not None:
        kind, given = form.families[0], {alone: node}
    elif isinstance(values, str):
        kind, given = _known(values, node, known, made, path), {}
    else:
        raise misread(node, path, f"is {node.said}; it must be {_one_of(known, made)}.")
    if kind in made:
        called: tuple[str, Any, Mapping[str, Argument]] = (kind, *made[kind])
    else:
        build = INSTEAD[kind][0] if kind in INSTEAD else kind
        called = (full_name(kind), build, arguments(kind))
    return _built(called, given, node, path, folder)


def _built(
    called: tuple[str, Any, Mapping[str, Argument]], given: dict, node: Node, path: str, folder: Any
) -> Any:
    """What a class or function, told by its name and arguments, makes of what is given."""
    name, build, known = called
    code = [word for word, own in known.items() if own.needed and own.form is None]
    if code:
        raise misread(
            node, path, f"{name} takes a function ({listed(code)}); a file holds data, no code."
        )
    for word, entry in given.items():
        if word not in known:
            raise misread(entry, path, f"{name} {_has_no(word, known)}")
        if known[word].form is None:
            raise misread(entry, path, f"{name} takes {word} in Python only; leave it out.")
    missing = [word for word, own in known.items() if own.needed and word not in given]
    if missing:
        raise misread(node, path, f"{name} needs {listed(missing)}.")
    built: dict[str, Any] = dict.fromkeys(given)
    for word, entry in given.items():
        form = known[word].form
        if entry.value is not None and form is not None:
            built[word] = read(form, entry, _inner(path, word), folder)
    try:
        return build(**built)
    except Misread:
        raise
    except REFUSALS as error:
        raise misread(node, path, _one_line(error)) from None


def _has_no(word: str, known: Mapping[str, Argument]) -> str:
    text = unknown("argument", word, known)
    return f"has {text[0].lower()}{text[1:]}"


def _one_line(error: Exception) -> str:
    said = " ".join(str(error).split())
    return said if said.endswith((".", "?")) else f"{said}."


def _inner(path: str, word: str) -> str:
    return f"{path}.{word}" if path else word


def _only_member(form: Part, known: dict, made: dict, node: Node, path: str) -> type:
    """The class of a mapping that does not say its kind."""
    if len(form.families) == 1 and form.families[0] in known.values():
        return form.families[0]
    if form.families[0] in USUAL:
        return USUAL[form.families[0]]
    raise misread(node, path, f"says no {KIND}; it must be {_one_of(known, made)}.")


def _known(word: str, node: Node, known: dict, made: dict, path: str) -> Any:
    """The class, or the name of the function, that a word names."""
    place, _, last = word.removeprefix("jaxclear.").rpartition(".")
    fits = lambda thing: not place or full_name(thing) == f"{place}.{last}"
    if last in made and fits(made[last][0]):
        return last
    if last in known and fits(known[last]):
        return known[last]
    raise misread(node, path, unknown("kind", word, [*known, *made], " that fits here"))


def _one_of(known: dict, made: dict) -> str:
    return f"a mapping whose {KIND} is one of {listed([*known, *made])}"


def _looks_like(form: AbstractForm, node: Node) -> bool:
    """Whether a value is written as things of a form are."""
    value = node.value
    if isinstance(form, (Number, Numbers)) and is_number(node):
        return True
    if isinstance(form, Part):
        return isinstance(value, (dict, str))
    if isinstance(form, (Numbers, NumberArray, Listed)):
        return isinstance(value, list)
    if isinstance(form, Whole):
        return isinstance(value, int) and not isinstance(value, bool)
    if isinstance(form, Text):
        return isinstance(value, str)
    if isinstance(form, Flag):
        return isinstance(value, bool)
    return isinstance(form, ByName) and isinstance(value, dict)


def _how_many(form: Numbers) -> str:
    counts = " or ".join(map(str, form.counts))
    return f"a list of {counts} numbers" if counts else "a list of numbers"


def _unit(metadata: Mapping[str, Any]) -> str:
    unit = metadata.get("unit", "1")
    return "" if unit == "1" or unit.startswith("(") else f" [{unit}]"
