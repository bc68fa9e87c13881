"""Which classes a file may name, and by what arguments each is told.

A class is told by the arguments of its constructor, each in the form of the field of that name; a
few classes whose arguments are not their fields say here how they are told. Names are found among
classes that are defined already: a file imports nothing.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.time_table import TimeTable
from jaxclear.files.by_scipy import from_scipy, table_of
from jaxclear.files.forms import (
    AbstractForm,
    ByName,
    Choice,
    FileName,
    Listed,
    Number,
    NumberArray,
    Numbers,
    Part,
    Place,
    Text,
    Whole,
    form_of,
)
from jaxclear.files.tables import time_table
from jaxclear.ground.wording import public_name
from jaxclear.laws import contact, material
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.multibody.loops import AsNeeded, Baumgarte, Projection
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.simulation.saving import Saving
from jaxclear.studies.distribution import FromScipy
from jaxclear.studies.variable import (
    AbstractMechanismVariable,
    Condition,
    Heating,
    Variable,
)

__all__ = ["Argument", "arguments", "builders", "full_name", "members"]

Getter = Callable[[Any], Any]


@dataclasses.dataclass(frozen=True)
class Argument:
    """An argument of a class: its form (None where a file cannot hold it), whether it must be
    given, its default, how it is read off an object, and a word that goes without saying."""

    form: AbstractForm | None
    needed: bool
    default: Any
    told: Getter
    left_out: Any = None
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def _attribute(name: str) -> Getter:
    return lambda thing: getattr(thing, name)


def _nothing(thing: Any) -> None:
    return None


def _axis(marker: Marker) -> Any:
    return marker.named_axis if marker.axis is None else marker.axis


def _end(side: str, other: str) -> Getter:
    """A marker, or its body's name where that stands for it: beside a marker a name would be turned
    as that one is."""

    def told(connection: Connection) -> Any:
        marker, beside = getattr(connection, side), getattr(connection, other)
        plain = all(end.quaternion is None and _axis(end) == "z" for end in (marker, beside))
        return marker.body if plain and marker.at is None else marker

    return told


def _given(what: str) -> Getter:
    return lambda mechanism: mechanism.given[what]


def _stabilisation(mechanism: Mechanism) -> Any:
    held = mechanism.stabilisation
    return AS_NEEDED if isinstance(held, AsNeeded) else held


def _expansion(heating: Heating) -> Any:
    own = heating.expansion
    return dict(own) if isinstance(own, tuple) else own


EXPANSION = {"unit": "1/K", "meaning": "coefficient of linear expansion"}
NUMBERS_BY_NAME = ByName(Numbers({"unit": "1"}))
DIRECTION = Choice((Text(), Numbers({"unit": "1"}, (3,))))
END = Choice((Text(), Part((Marker,), spelled_out=True)))
# What stands where a mechanism does not say how its loops are held.
AS_NEEDED = "default"
# Words that go without saying, by how they are told.
LEFT_OUT: Mapping[Getter, str] = MappingProxyType({_axis: "z", _stabilisation: AS_NEEDED})
# How arguments are told that are not the field of the same name.
TOLD: dict[type, dict[str, tuple[AbstractForm | None, Getter]]] = {
    Marker: {"axis": (DIRECTION, _axis)},
    Connection: {
        "parent": (END, _end("parent", "child")),
        "child": (END, _end("child", "parent")),
        "at": (Numbers({"unit": "m"}, (2, 3)), _nothing),
        "axis": (DIRECTION, _nothing),
    },
    Mechanism: {
        "bodies": (ByName(Part((Body,))), _attribute("bodies")),
        "connections": (ByName(Part((Connection,))), _attribute("connections")),
        "start": (NUMBERS_BY_NAME, _given("start")),
        "speeds": (NUMBERS_BY_NAME, _given("speeds")),
        "guess": (NUMBERS_BY_NAME, _given("guess")),
        "stabilisation": (Part((Baumgarte, Projection)), _stabilisation),
    },
    Saving: {"at": (Choice((Whole({"at_least": 2}), NumberArray())), _attribute("at"))},
    Condition: {
        "acts": (Part((Heating,)), _attribute("acts")),
        "tolerance": (Number({"unit": "1", "above": 0}), _nothing),
    },
    Heating: {"expansion": (Choice((Number(EXPANSION), ByName(Number(EXPANSION)))), _expansion)},
    Variable: {
        "where": (Place(), _attribute("where")),
        "tolerance": (Number({"unit": "1", "above": 0}), _nothing),
        "derived": (None, _attribute("derived")),
    },
}
# Classes that a file builds by other arguments than their own.
INSTEAD: dict[type, tuple[Callable[..., Any], dict[str, Argument]]] = {
    FromScipy: (
        from_scipy,
        {
            "scipy": Argument(Text(), False, None, _nothing),
            "numbers": Argument(ByName(Number({"unit": "1"})), False, None, _nothing),
            "about": Argument(Number({"unit": "1"}), False, None, _nothing),
            "table": Argument(ByName(NumberArray()), False, None, table_of),
            "spread": Argument(
                Number({"unit": "1", "above": 0}), False, None, _attribute("spread")
            ),
        },
    ),
    TimeTable: (
        time_table,
        {
            "times": Argument(NumberArray(), False, None, _attribute("times")),
            "values": Argument(NumberArray(), False, None, _attribute("values")),
            "interpolation": Argument(Text(), False, None, _attribute("interpolation")),
            "beyond": Argument(Text(), False, None, _attribute("beyond")),
            "factor": Argument(Number({"unit": "1"}), False, None, _attribute("factor")),
            "csv": Argument(FileName(), False, None, _nothing),
            "columns": Argument(Listed(Text()), False, None, _nothing),
        },
    ),
}
# The class of a mapping that says no kind, where it is not the only one.
USUAL: Mapping[Any, type] = MappingProxyType({AbstractMechanismVariable: Variable})
# The argument for which a text alone stands.
ALONE: Mapping[Any, str] = MappingProxyType({Marker: "body"})


def members(families: tuple[type, ...]) -> dict[str, type]:
    """Final classes of some families, by short name, in the order of their definition."""
    found: dict[str, type] = {}
    for family in families:
        for kind in (family, *_below(family)):
            if not kind.__name__.startswith(("Abstract", "_")) and _is_final(kind):
                found.setdefault(kind.__name__, kind)
    return found


def _is_final(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind) and not inspect.isabstract(kind)


def _below(family: Any) -> Iterator[type]:
    own: list[type] = family.__subclasses__()
    for kind in own:
        yield kind
        yield from _below(kind)


def full_name(kind: Any) -> str:
    """What a user types for a class behind `jaxclear.`."""
    return public_name(kind)


@functools.cache
def arguments(kind: Any) -> Mapping[str, Argument]:
    """The arguments by which a class is told."""
    if kind in INSTEAD:
        return MappingProxyType(INSTEAD[kind][1])
    fields = {field.name: field for field in dataclasses.fields(kind)}
    own = TOLD.get(kind, {})
    found = {}
    for name, parameter in inspect.signature(kind).parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        needed, field = parameter.default is parameter.empty, fields.get(name)
        metadata = {} if field is None else field.metadata
        if name in own:
            form, told = own[name]
        else:
            form = None if field is None else form_of(field.type, metadata)
            told = _attribute(name)
        left_out = LEFT_OUT.get(told)
        default = _default(parameter, field)
        found[name] = Argument(form, needed, default, told, left_out, metadata)
    return MappingProxyType(found)


def _default(parameter: inspect.Parameter, field: Any) -> Any:
    if field is not None and field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return parameter.default


@functools.cache
def builders(families: tuple[type, ...]) -> dict[str, tuple[Callable, dict[str, Argument]]]:
    """Functions beside the classes of some families that a file may name: products of contact
    laws, materials."""
    found: dict[str, tuple[Callable, dict[str, Argument]]] = {}
    if any(issubclass(AbstractNormalLaw, f) or issubclass(f, AbstractNormalLaw) for f in families):
        for name in contact.__all__:
            build = getattr(contact, name)
            if inspect.isfunction(build):
                found[name] = (build, _of_product(build))
    if material.Material in families:
        found |= {"steel": (material.steel, {}), "aluminium": (material.aluminium, {})}
    return found


def _of_product(build: Any) -> dict[str, Argument]:
    return {
        name: Argument(
            form_of(field.type, field.metadata),
            field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING,
            field.default,
            _nothing,
            None,
            field.metadata,
        )
        for name, field in build.fields.items()
    }
