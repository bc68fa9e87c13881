"""Parts with a kind of their own in a file: which classes it may name, and by what arguments each
is told.

A class is told by the arguments of its constructor, each in the form of the field of that name; a
few classes whose arguments are not their fields say here how they are told. Names are found among
classes that are defined already: a file imports nothing. What a class itself refuses is said with
its own sentence.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType, NoneType
from typing import Any, NamedTuple, get_args, get_origin

import equinox as eqx
import jax
import jaxtyping

from jaxclear.components.beam import Beam
from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.function_of_time import AbstractFunctionOfTime, TimeTable
from jaxclear.components.load import AbstractLoad
from jaxclear.files.forms import (
    UNMEASURED,
    AbstractForm,
    ByName,
    Choice,
    FileName,
    Flag,
    Integer,
    Listed,
    Number,
    NumberArray,
    Numbers,
    Place,
    Schema,
    Text,
    refuse,
)
from jaxclear.files.numeric_tables import from_scipy, table_of, time_table
from jaxclear.files.text import Misread, Node, misread, plain_text
from jaxclear.ground.quantity import members_of_union
from jaxclear.ground.wording import described, is_offered, listed, public_name, unknown
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.laws import contact, material
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.multibody.loops import AsNeeded, Baumgarte, Projection
from jaxclear.multibody.mechanism import Mechanism, parts_as_drawn
from jaxclear.results.response import PositionError
from jaxclear.simulation.saving import Saving
from jaxclear.studies.distribution import Empirical, FromScipy
from jaxclear.studies.tolerance import Size
from jaxclear.studies.variable import Condition, Heating, Variable

KIND = "kind"
# What a class may refuse its arguments with.
REFUSALS = (ValueError, TypeError, OverflowError, ArithmeticError, KeyError, AttributeError)
Getter = Callable[[Any], Any]


@dataclasses.dataclass(frozen=True)
class Argument:
    """An argument of a class: its form (None where a file cannot hold it), whether it must be
    given, its default, how it is read off an object, and a word that goes without saying."""

    form: AbstractForm | None
    needed: bool
    default: Any
    read_from: Getter
    implied: Any = None
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Part(AbstractForm):
    """A thing of one of some classes or families. `spelled_out`: always written as a mapping,
    because a text alone would say something else."""

    families: tuple[type, ...]
    spelled_out: bool = False

    def looks_like(self, node: Node) -> bool:
        return isinstance(node.value, (dict, str))

    def holds(self, thing: Any) -> bool:
        return isinstance(thing, self.families)

    def read(self, node: Node, path: str, folder: Path) -> Any:
        kinds = final_classes(self.families)
        made = builders(self.families)
        values = node.value
        alone = ALONE.get(self.families[0]) if len(self.families) == 1 else None
        kind: Any = None
        if isinstance(values, dict):
            entries = {name: entry for name, entry in values.items() if name != KIND}
            named = values.get(KIND)
            if named is None:
                kind = self._only_member(kinds, made, node, path)
            else:
                kind = _find_kind(plain_text(named, f"{path}.{KIND}"), named, kinds, made, path)
        elif isinstance(values, str) and alone is not None:
            kind, entries = self.families[0], {alone: node}
        elif isinstance(values, str):
            kind, entries = _find_kind(values, node, kinds, made, path), {}
        else:
            raise misread(node, path, f"is {node.words}; it must be {_one_of(kinds, made)}.")
        if kind in made:
            called = Called(kind, *made[kind])
        else:
            build = INSTEAD[kind][0] if kind in INSTEAD else kind
            called = Called(public_name(kind), build, arguments(kind))
        return _build_part(called, entries, node, path, folder)

    def _only_member(self, kinds: dict, made: dict, node: Node, path: str) -> type:
        """The class of a mapping that does not say its kind."""
        if len(self.families) == 1 and self.families[0] in kinds.values():
            return self.families[0]
        if self.families[0] in USUAL:
            return USUAL[self.families[0]]
        raise misread(node, path, f"says no {KIND}; it must be {_one_of(kinds, made)}.")

    def plain(self, thing: Any, path: str, mechanism: Mechanism) -> Any:
        kinds = final_classes(self.families)
        kind: Any = thing.__class__
        if kind not in kinds.values():
            refuse(path, _why_not_data(thing, kinds))
        values: dict[str, Any] = {}
        if self.families != (kind,) and kind is not Body:
            values[KIND] = kind.__name__
        for name, arg in arguments(kind).items():
            value, place = arg.read_from(thing), f"{path}.{name}" if path else name
            if arg.form is None:
                _check_usual(arg, value, place)
            elif value is None:
                # Absent where that is not the usual.
                values |= {name: None} if arg.default not in (None, inspect.Parameter.empty) else {}
            elif not (isinstance(value, (str, dict)) and value in ({}, arg.implied)):
                values[name] = arg.form.plain(value, place, mechanism)
        alone = ALONE.get(kind, KIND)
        if self.spelled_out:
            return values
        return values[alone] if values.keys() == {alone} else values

    def schema(self, defs: dict[str, Schema]) -> Schema:
        kinds = {n: kind for n, kind in final_classes(self.families).items() if _is_ours(kind)}
        if not all(_is_ours(family) for family in self.families):
            return {"type": ["string", "object"]}
        made = builders(self.families)
        places: dict[str, tuple[str, Mapping[str, Argument]]] = {}
        for name, kind in kinds.items():
            places[name] = (public_name(kind), arguments(kind))
        for name, (build, taken) in made.items():
            places[name] = (public_name(build), taken)
        only = kinds.values() if len(self.families) == 1 else ()
        single = self.families[0] in {*only, *USUAL}
        refs = []
        for name, (full, args) in sorted(places.items()):
            if any(argument.needed and argument.form is None for argument in args.values()):
                continue
            place = full if full.count(".") and full.rpartition(".")[2] == name else name
            _add_definition(place, name, full, args, defs)
            refs.append({"$ref": f"#/$defs/{place}"})
        full_form: Schema = {"anyOf": refs} if single else {"anyOf": refs, "required": [KIND]}
        words = [
            name for name, (_, args) in places.items() if not any(a.needed for a in args.values())
        ]
        alone = single and ALONE.get(self.families[0])
        text: list[Schema] = [{"type": "string"}] if alone else []
        if words and not alone:
            both = {word for name in words for word in _spellings(name, places[name][0])}
            text = [{"enum": sorted(both)}]
        return {"anyOf": [full_form, *text]} if text else full_form


def _attribute_reader(name: str) -> Getter:
    return lambda thing: getattr(thing, name)


def _no_value(thing: Any) -> None:
    return None


def _axis_of_marker(marker: Marker) -> Any:
    return marker.named_axis if marker.axis is None else marker.axis


def _marker_or_body(side: str, other: str) -> Getter:
    """A marker, or its body's name where that stands for it: beside a marker a name would be turned
    as that one is."""

    def read(connection: Connection) -> Any:
        marker, facing = getattr(connection, side), getattr(connection, other)
        turns = [end.quaternion is not None or end.angle is not None for end in (marker, facing)]
        plain = not any(turns) and _axis_of_marker(marker) == "z" == _axis_of_marker(facing)
        return marker.body if plain and marker.at is None else marker

    return read


def _marker_or_name(response: PositionError) -> Any:
    return response.body.body if response.body.at is None else response.body


def _drawn_part_reader(part: str) -> Getter:
    return lambda mechanism: parts_as_drawn(mechanism)[part]


def _start_argument_reader(what: str) -> Getter:
    return lambda mechanism: mechanism.start_arguments[what]


def _stabilisation(mechanism: Mechanism) -> Any:
    value = mechanism.stabilisation
    return AS_NEEDED if isinstance(value, AsNeeded) else value


def _expansion(heating: Heating) -> Any:
    value = heating.expansion
    return dict(value) if isinstance(value, tuple) else value


EXPANSION = {"unit": "1/K", "meaning": "coefficient of linear expansion"}
NUMBERS_BY_NAME = ByName(Numbers({"unit": "1"}))
DIRECTION = Choice((Text(), Numbers({"unit": "1"}, (2, 3))))
END = Choice((Text(), Part((Marker,), spelled_out=True)))
# What stands where a mechanism does not say how its loops are held.
AS_NEEDED = "default"
# Words that go without saying, by how they are told.
IMPLIED: Mapping[Getter, str] = MappingProxyType({_axis_of_marker: "z", _stabilisation: AS_NEEDED})
# How arguments are told that are not the field of the same name.
ARGUMENT_FORMS: dict[type, dict[str, tuple[AbstractForm | None, Getter]]] = {
    Marker: {"axis": (DIRECTION, _axis_of_marker)},
    Connection: {
        "parent": (END, _marker_or_body("parent", "child")),
        "child": (END, _marker_or_body("child", "parent")),
        "at": (Numbers({"unit": "m"}, (2, 3)), _no_value),
        "axis": (DIRECTION, _no_value),
    },
    PositionError: {"body": (END, _marker_or_name)},
    Mechanism: {
        "bodies": (ByName(Part((Body, Beam))), _drawn_part_reader("bodies")),
        "connections": (ByName(Part((Connection,))), _drawn_part_reader("connections")),
        "loads": (ByName(Part((AbstractLoad,))), _drawn_part_reader("loads")),
        "start": (NUMBERS_BY_NAME, _start_argument_reader("start")),
        "speeds": (NUMBERS_BY_NAME, _start_argument_reader("speeds")),
        "guess": (NUMBERS_BY_NAME, _start_argument_reader("guess")),
        "stabilisation": (Part((Baumgarte, Projection)), _stabilisation),
    },
    Adaptive: {"breaks": (NumberArray(), _attribute_reader("breaks"))},
    Saving: {"at": (Choice((Integer({"at_least": 2}), NumberArray())), _attribute_reader("at"))},
    Condition: {
        "acts": (Part((Heating,)), _attribute_reader("acts")),
        "tolerance": (Number({"unit": "1", "above": 0}), _no_value),
    },
    Heating: {"expansion": (Choice((Number(EXPANSION), ByName(Number(EXPANSION)))), _expansion)},
    Size: {"where": (Place(), _attribute_reader("where"))},
    Variable: {
        "where": (Place(), _attribute_reader("where")),
        "tolerance": (Number({"unit": "1", "above": 0}), _no_value),
        "derived": (None, _attribute_reader("derived")),
    },
}
# Classes that a file builds by other arguments than their own.
INSTEAD: dict[type, tuple[Callable[..., Any], dict[str, Argument]]] = {
    FromScipy: (
        from_scipy,
        {
            "scipy": Argument(Text(), False, None, _no_value),
            "numbers": Argument(ByName(Number({"unit": "1"})), False, None, _no_value),
            "about": Argument(Number({"unit": "1"}), False, None, _no_value),
            "table": Argument(ByName(NumberArray()), False, None, table_of),
            "spread": Argument(
                Number({"unit": "1", "above": 0}), False, None, _attribute_reader("spread")
            ),
        },
    ),
    Empirical: (
        Empirical,
        {
            "deviations": Argument(NumberArray(), False, None, _attribute_reader("deviations")),
            "low": Argument(Number({"unit": "1"}), False, None, _attribute_reader("low")),
            "high": Argument(Number({"unit": "1"}), False, None, _attribute_reader("high")),
        },
    ),
    TimeTable: (
        time_table,
        {
            "times": Argument(NumberArray(), False, None, _attribute_reader("times")),
            "values": Argument(NumberArray(), False, None, _attribute_reader("values")),
            "interpolation": Argument(Text(), False, None, _attribute_reader("interpolation")),
            "beyond": Argument(Text(), False, None, _attribute_reader("beyond")),
            "factor": Argument(Number({"unit": "1"}), False, None, _attribute_reader("factor")),
            "csv": Argument(FileName(), False, None, _no_value),
            "columns": Argument(Listed(Text()), False, None, _no_value),
        },
    ),
}
# The class of a mapping that says no kind, where it is not the only one.
USUAL: Mapping[Any, type] = MappingProxyType({Variable: Variable, Body: Body})
# The argument for which a text alone stands.
ALONE: Mapping[Any, str] = MappingProxyType({Marker: "body"})


def final_classes(families: tuple[type, ...]) -> dict[str, type]:
    """Final classes of some families, by short name, in the order of their definition. Of one name
    the package's class counts, and of a user's classes the last one. Of the package's classes
    users name those that it offers, and functions of time, which scenes have."""
    kinds: dict[str, type] = {}
    for family in families:
        for kind in (family, *_iterate_subclasses(family)):
            named = not kind.__name__.startswith(("Abstract", "_")) and _is_final(kind)
            offered = kind is family or issubclass(kind, AbstractFunctionOfTime)
            named = named and (offered or not _is_ours(kind) or is_offered(kind))
            if named and not _is_ours(kinds.get(kind.__name__)):
                kinds[kind.__name__] = kind
    return kinds


def _is_final(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind) and not inspect.isabstract(kind)


def _iterate_subclasses(family: Any) -> Iterator[type]:
    subclasses: list[type] = family.__subclasses__()
    for kind in subclasses:
        yield kind
        yield from _iterate_subclasses(kind)


@functools.cache
def arguments(kind: Any) -> Mapping[str, Argument]:
    """The arguments by which a class is told."""
    if kind in INSTEAD:
        return MappingProxyType(INSTEAD[kind][1])
    fields = {field.name: field for field in dataclasses.fields(kind)}
    special = ARGUMENT_FORMS.get(kind, {})
    listed_args = {}
    for name, parameter in inspect.signature(kind).parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        needed, field = parameter.default is parameter.empty, fields.get(name)
        metadata = {} if field is None else field.metadata
        if name in special:
            form, read_from = special[name]
        else:
            form = None if field is None else form_of(field.type, metadata)
            read_from = _attribute_reader(name)
        implied = IMPLIED.get(read_from)
        default = _default_of(parameter, field)
        listed_args[name] = Argument(form, needed, default, read_from, implied, metadata)
    return MappingProxyType(listed_args)


def _default_of(parameter: inspect.Parameter, field: Any) -> Any:
    if field is not None and field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return parameter.default


@functools.cache
def builders(families: tuple[type, ...]) -> dict[str, tuple[Callable, dict[str, Argument]]]:
    """Functions beside the classes of some families that a file may name: products of contact
    laws, materials."""
    functions: dict[str, tuple[Callable, dict[str, Argument]]] = {}
    if any(issubclass(AbstractNormalLaw, f) or issubclass(f, AbstractNormalLaw) for f in families):
        for name in contact.__all__:
            build = getattr(contact, name)
            if inspect.isfunction(build):
                functions[name] = (build, _arguments_of_builder(build))
    if material.Material in families:
        functions |= {"steel": (material.steel, {}), "aluminium": (material.aluminium, {})}
    return functions


def _arguments_of_builder(build: Any) -> dict[str, Argument]:
    return {
        name: Argument(
            form_of(field.type, field.metadata),
            field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING,
            field.default,
            _no_value,
            None,
            field.metadata,
        )
        for name, field in build.fields.items()
    }


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
    if families and str in kinds:
        # A text alone is the name.
        return Choice((Text(), Part(families, spelled_out=True)))
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
    simple = {bool: Flag(), int: Integer(metadata), float: Number(UNMEASURED), str: Text()}
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


class Called(NamedTuple):
    """A class or function that makes a part: its `name`, what `build`s, and its arguments."""

    name: str
    build: Callable[..., Any]
    arguments: Mapping[str, Argument]


def _build_part(called: Called, entries: dict, node: Node, path: str, folder: Path) -> Any:
    """What a class or function, told by its name and arguments, makes of what is given."""
    name, build, forms = called
    code = [word for word, argument in forms.items() if argument.needed and argument.form is None]
    if code:
        raise misread(
            node, path, f"{name} takes a function ({listed(code)}); a file holds data, no code."
        )
    for word, entry in entries.items():
        if word not in forms:
            raise misread(entry, path, f"{name} {_has_no(word, forms)}")
        if forms[word].form is None:
            raise misread(entry, path, f"{name} takes {word} in Python only; leave it out.")
    missing = [word for word, argument in forms.items() if argument.needed and word not in entries]
    if missing:
        raise misread(node, path, f"{name} needs {listed(missing)}.")
    built: dict[str, Any] = dict.fromkeys(entries)
    for word, entry in entries.items():
        form = forms[word].form
        if entry.value is not None and form is not None:
            built[word] = form.read(entry, f"{path}.{word}" if path else word, folder)
    try:
        return build(**built)
    except Misread:
        raise
    except REFUSALS as error:
        raise misread(node, path, _as_sentence(error)) from None


def _has_no(word: str, names: Mapping[str, Argument]) -> str:
    text = unknown("argument", word, names)
    return f"has {text[0].lower()}{text[1:]}"


def _as_sentence(error: Exception) -> str:
    sentence = " ".join(str(error).split())
    return sentence if sentence.endswith((".", "?")) else f"{sentence}."


def _find_kind(word: str, node: Node, kinds: dict, made: dict, path: str) -> Any:
    """The class, or the name of the function, that a word names."""
    place, _, last = word.removeprefix("jaxclear.").rpartition(".")
    fits = lambda thing: not place or public_name(thing) == f"{place}.{last}"
    if last in made and fits(made[last][0]):
        return last
    if last in kinds and fits(kinds[last]):
        return kinds[last]
    raise misread(node, path, unknown("kind", word, [*kinds, *made], " that fits here"))


def _one_of(kinds: dict, made: dict) -> str:
    return f"a mapping whose {KIND} is one of {listed([*kinds, *made])}"


def _check_usual(argument: Argument, value: Any, path: str) -> None:
    """What a file cannot hold must be as it is unless told otherwise."""
    if argument.needed or not _is_same(value, argument.default):
        refuse(path, f"is {described(value)}, which a file cannot hold: it holds data, no code.")


def _is_same(one: Any, other: Any) -> bool:
    return bool(one is other or eqx.tree_equal(one, other))


def _why_not_data(thing: Any, kinds: dict[str, type]) -> str:
    """Why a thing has no place in a file."""
    names = listed(kinds)
    if callable(thing) and not isinstance(thing, eqx.Module):
        sentence = f"is {described(thing)}: a file holds data, no code. Take one of {names}"
        if TimeTable.__name__ not in kinds:
            return f"{sentence}."
        return (
            f"{sentence}; a function of time becomes data by jaxclear.TimeTable.sampled(function, "
            "times)."
        )
    return f"is {described(thing)}; a file knows {names} there."


def _is_ours(kind: type | None) -> bool:
    return kind is not None and kind.__module__.partition(".")[0] == "jaxclear"


def _spellings(name: str, full: str) -> tuple[str, ...]:
    return (name, full, f"jaxclear.{full}")


def _add_definition(
    place: str, name: str, full: str, taken_args: Mapping[str, Argument], defs: dict[str, Schema]
) -> None:
    """Puts the schema of a class or function by its arguments into `known`."""
    if place in defs:
        return
    defs[place] = {}
    properties: Schema = {KIND: {"enum": sorted(set(_spellings(name, full)))}}
    for word, argument in taken_args.items():
        if argument.form is not None:
            entry = argument.form.schema(defs)
            properties[word] = entry if argument.needed else {"anyOf": [entry, {"type": "null"}]}
    needed = [word for word, argument in taken_args.items() if argument.needed]
    defs[place] = mapping_schema(properties, needed)


def mapping_schema(properties: Schema, required: list[str]) -> Schema:
    """The schema of a mapping whose names are known."""
    schema: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return schema | ({"required": required} if required else {})
