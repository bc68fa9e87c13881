"""The JSON schema of a scene file, from the same forms by which files are read: editors complete
and check by it, and other programs write by it. It tells kinds, names, units and ranges; how
numbers bound each other only reading tells.
"""

from collections.abc import Mapping
from functools import singledispatch
from typing import Any

from jaxclear.files.classes import ALONE, USUAL, Argument, arguments, builders, full_name, members
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
from jaxclear.files.reading import KIND
from jaxclear.files.scene import FORMAT, HEAD, RUN, TOP

DRAFT = "https://json-schema.org/draft/2020-12/schema"
BOUNDS = {
    "above": "exclusiveMinimum",
    "at_least": "minimum",
    "below": "exclusiveMaximum",
    "at_most": "maximum",
}
NUMBER = {"type": "number"}
Schema = dict[str, Any]


def scene_schema() -> Schema:
    """The JSON schema (draft 2020-12) of the files that `jaxclear.read_scene` reads, as a
    dictionary; classes of one's own are not in it."""
    known: dict[str, Schema] = {}
    of = lambda forms: {name: _schema(form, known) for name, form in forms.items()}
    properties = of(TOP) | {HEAD: {"const": FORMAT}, "run": _mapping(of(RUN), [])}
    return {
        "$schema": DRAFT,
        "title": "A scene of jaxclear",
        "description": "A mechanism, how it is run, what varies of it, and responses; SI units.",
        **_mapping(properties, [HEAD, "mechanism"]),
        "$defs": dict(sorted(known.items())),
    }


def _mapping(properties: Schema, required: list[str]) -> Schema:
    found: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return found | ({"required": required} if required else {})


@singledispatch
def _schema(form: AbstractForm, known: dict[str, Schema]) -> Schema:
    """The schema of a form; those of classes go into `known`."""
    raise NotImplementedError(type(form).__name__)


@_schema.register
def _(form: Number, known: dict[str, Schema]) -> Schema:
    return NUMBER | _told(form.metadata)


@_schema.register
def _(form: Numbers, known: dict[str, Schema]) -> Schema:
    several: Schema = {"type": "array", "items": NUMBER}
    counts = [count for count in form.counts if count > 1]
    if counts:
        several |= {"minItems": min(counts), "maxItems": max(counts)}
    one = [NUMBER] if not form.counts or 1 in form.counts else []
    return {"anyOf": [several, *one], **_told(form.metadata)}


@_schema.register
def _(form: NumberArray, known: dict[str, Schema]) -> Schema:
    return {"anyOf": [{"type": "array"}, NUMBER]}


@_schema.register
def _(form: Whole, known: dict[str, Schema]) -> Schema:
    return {"type": "integer"} | _told(form.metadata)


@_schema.register
def _(form: Flag, known: dict[str, Schema]) -> Schema:
    return {"type": "boolean"}


@_schema.register
def _(form: Text, known: dict[str, Schema]) -> Schema:
    return {"type": ["string", "number", "boolean"]}


@_schema.register
def _(form: FileName, known: dict[str, Schema]) -> Schema:
    return {"type": "string", "description": "a file, its path counted from this one"}


@_schema.register
def _(form: Place, known: dict[str, Schema]) -> Schema:
    one = {"type": "string", "description": 'such as connections["B"].joint.clearance'}
    return {"anyOf": [one, {"type": "array", "items": one, "minItems": 1}]}


@_schema.register
def _(form: Listed, known: dict[str, Schema]) -> Schema:
    found: Schema = {"type": "array", "items": _schema(form.entry, known)}
    return found | ({"minItems": form.length, "maxItems": form.length} if form.length else {})


@_schema.register
def _(form: ByName, known: dict[str, Schema]) -> Schema:
    return {"type": "object", "additionalProperties": _schema(form.entry, known)}


@_schema.register
def _(form: Choice, known: dict[str, Schema]) -> Schema:
    return {"anyOf": [_schema(one, known) for one in form.forms]}


@_schema.register
def _(form: Part, known: dict[str, Schema]) -> Schema:
    kinds = {n: kind for n, kind in members(form.families).items() if _is_ours(kind)}
    if not all(_is_ours(family) for family in form.families):
        return {"type": ["string", "object"]}
    made = builders(form.families)
    places: dict[str, tuple[str, Mapping[str, Argument]]] = {}
    for name, kind in kinds.items():
        places[name] = (full_name(kind), arguments(kind))
    for name, (build, taken) in made.items():
        places[name] = (full_name(build), taken)
    single = len(form.families) == 1 and form.families[0] in {*kinds.values(), *USUAL}
    refs = []
    for name, (full, own) in sorted(places.items()):
        if any(argument.needed and argument.form is None for argument in own.values()):
            continue
        place = full if full.count(".") and full.rpartition(".")[2] == name else name
        _define(place, name, full, own, known)
        refs.append({"$ref": f"#/$defs/{place}"})
    whole: Schema = {"anyOf": refs} if single else {"anyOf": refs, "required": [KIND]}
    words = [name for name, (_, own) in places.items() if not any(a.needed for a in own.values())]
    alone = single and ALONE.get(form.families[0])
    text: list[Schema] = [{"type": "string"}] if alone else []
    if words and not alone:
        both = {word for name in words for word in _spellings(name, places[name][0])}
        text = [{"enum": sorted(both)}]
    return {"anyOf": [whole, *text]} if text else whole


def _is_ours(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "jaxclear"


def _spellings(name: str, full: str) -> tuple[str, ...]:
    return (name, full, f"jaxclear.{full}")


def _define(
    place: str, name: str, full: str, own: Mapping[str, Argument], known: dict[str, Schema]
) -> None:
    """Puts the schema of a class or function by its arguments into `known`."""
    if place in known:
        return
    known[place] = {}
    properties: Schema = {KIND: {"enum": sorted(set(_spellings(name, full)))}}
    for word, argument in own.items():
        if argument.form is not None:
            found = _schema(argument.form, known)
            properties[word] = found if argument.needed else {"anyOf": [found, {"type": "null"}]}
    needed = [word for word, argument in own.items() if argument.needed]
    known[place] = _mapping(properties, needed)


def _told(metadata: Mapping[str, Any]) -> Schema:
    """What a field says of its number."""
    unit = metadata.get("unit", "1")
    words = [metadata.get("meaning", ""), "" if unit == "1" else f"[{unit}]"]
    said = " ".join(word for word in words if word)
    bounds = {word: metadata[key] for key, word in BOUNDS.items() if key in metadata}
    return (bounds if "counts" not in metadata else {}) | ({"description": said} if said else {})
