"""A mechanism in words: what `print` shows of it, every number with its unit.

What is absent is left out; `Mechanism.parameters()` is the same as a table.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax

from jaxclear.components.body import Marker
from jaxclear.ground.wording import described, public_name
from jaxclear.multibody.own_numbers import acted_on, coordinate_units, slides, unit_along

__all__ = ["in_words"]

INDENT = " " * 6


def in_words(mechanism: Any) -> str:
    """Bodies, connections, loads, start and speeds, a line each."""
    lines = []
    for part, entry in (
        ("bodies", lambda name, body: _numbers(body)),
        ("connections", lambda name, connection: _connection(mechanism, name)),
        ("loads", lambda name, load: _load(mechanism, load)),
        ("start", lambda name, values: _coordinates(mechanism, name, values, "")),
        ("guess", lambda name, values: _coordinates(mechanism, name, values, "")),
        ("speeds", lambda name, values: _coordinates(mechanism, name, values, "/s")),
    ):
        given = getattr(mechanism, part)
        if given:
            width = max(map(len, given))
            lines += [part, *(f"  {n:<{width}}  {entry(n, x)}".rstrip() for n, x in given.items())]
    if mechanism.topology.loops and mechanism.stabilisation is not None:
        held = mechanism.stabilisation
        lines.append(f"loops held by {public_name(type(held))} {_numbers(held)}".rstrip())
    if mechanism.topology.redundancy is not None:
        lines.append(str(mechanism.topology.redundancy))
    return "\n".join(lines)


def _load(mechanism: Any, load: Any) -> str:
    return f"{public_name(type(load))} {_numbers(load, slides(mechanism, acted_on(load)))}"


def _connection(mechanism: Any, name: str) -> str:
    connection = mechanism.connections[name]
    joint = connection.joint
    ends = f"{_marker(connection.parent)} to {_marker(connection.child)}"
    parts = list(_fields(joint, slides(mechanism, name)))
    own = [text for name, text in parts if not isinstance(getattr(joint, name), eqx.Module)]
    laws = [
        f"{INDENT}{text}" for name, text in parts if isinstance(getattr(joint, name), eqx.Module)
    ]
    first = f"{public_name(type(joint))}, {ends}; {', '.join(own)}".rstrip("; ")
    return "\n".join([first, *laws])


def _marker(marker: Marker) -> str:
    place = "" if marker.at is None else f" at {_tuple(marker.at)} m"
    axis = f" along {marker.named_axis}" if marker.named_axis != "z" else ""
    axis = axis if marker.axis is None else f" along {_tuple(marker.axis)}"
    turned = "" if marker.quaternion is None else f" turned by {_tuple(marker.quaternion)}"
    return f'"{marker.body}"{place}{axis}{turned}'


def _numbers(part: Any, along: bool = False) -> str:
    return ", ".join(text for _, text in _fields(part, along))


def _fields(part: Any, along: bool = False) -> Iterator[tuple[str, str]]:
    """Every field that holds something, by name: numbers with units, parts by their kind.
    `along`: whether it is of a coordinate that slides."""
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if value is None:
            continue
        unit = unit_along(field.metadata, along)
        unit = "" if unit in ("", "1") else f" {unit}"
        if isinstance(value, Marker):
            yield field.name, f"{field.name} {_marker(value)}"
        elif isinstance(value, eqx.Module):
            inner = _numbers(value, along)
            yield field.name, f"{field.name} {type(value).__name__}{f'({inner})' if inner else ''}"
        elif isinstance(value, tuple):
            yield field.name, f"{field.name} {_tuple(value)}{unit}"
        elif isinstance(value, jax.Array) or not callable(value):
            yield field.name, f"{field.name} {_number(value)}{unit}"
        else:
            yield field.name, f"{field.name} {described(value)}{unit}"


def _coordinates(mechanism: Any, name: str, values: tuple, rate: str) -> str:
    units = coordinate_units(mechanism, name)
    if set(units) == {"1"} and len(values) in (1, 3):
        return f"{_tuple(values)} rad{rate}"  # a rotation vector in place of a quaternion
    if len(units) != len(values) or "1" in units:
        return _tuple(values)
    return ", ".join(f"{_number(x)} {u}{rate}" for x, u in zip(values, units, strict=True))


def _tuple(values: tuple) -> str:
    numbers = ", ".join(map(_number, values))
    return f"({numbers})" if len(values) != 1 else numbers


def _number(value: Any) -> str:
    if isinstance(value, jax.core.Tracer):
        return "(traced)"
    return f"{float(value):.6g}" if isinstance(value, (jax.Array, float)) else str(value)
