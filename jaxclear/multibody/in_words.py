"""A mechanism in words: what `print` shows of it, every number with its unit.

What is absent is left out; `Mechanism.parameters()` is the same as a table.
"""

from typing import Any

import equinox as eqx

from jaxclear.ground.in_words import (
    INDENT,
    fields_in_words,
    in_a_line,
    number_in_words,
    numbers_in_words,
)
from jaxclear.ground.wording import public_name
from jaxclear.multibody.loops import AsNeeded
from jaxclear.multibody.own_numbers import acted_on, coordinate_units, slides, unit_along

__all__ = ["in_words"]

AS_NEEDED = "as the integrator needs it: by Projection where its steps open them, else by Baumgarte"


def in_words(mechanism: Any) -> str:
    """What it has in the first line; bodies, connections, loads, start and speeds, a line each."""
    parts = ((p, getattr(mechanism, p)) for p in ("bodies", "connections", "loads", "couplings"))
    counts = [_counted(part, names) for part, names in parts if names]
    lines = [f"Mechanism: {', '.join(counts)}"]
    for part, entry in (
        ("bodies", lambda name, body: _numbers(body)),
        ("connections", lambda name, connection: _connection(mechanism, name)),
        ("loads", lambda name, load: _load(mechanism, load)),
        ("couplings", lambda name, coupling: _coupling(mechanism, coupling)),
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
        by = f"by {public_name(type(held))} {_numbers(held)}".rstrip()
        lines.append(f"loops held {AS_NEEDED if isinstance(held, AsNeeded) else by}")
    if mechanism.topology.overconstrained:
        lines.append(str(mechanism.topology.redundancy))
    return "\n".join(lines)


def _counted(part: str, names: Any) -> str:
    """How many there are of a part, such as "2 loads"."""
    one = {"bodies": "body"}.get(part, part.removesuffix("s"))
    return f"{len(names)} {one if len(names) == 1 else part}"


def _load(mechanism: Any, load: Any) -> str:
    return f"{public_name(type(load))} {_numbers(load, slides(mechanism, acted_on(load)))}"


def _coupling(mechanism: Any, coupling: Any) -> str:
    joints = coupling.joints()
    along = bool(joints) and slides(mechanism, joints[0])
    return f"{public_name(type(coupling))} {_numbers(coupling, along)}"


def _connection(mechanism: Any, name: str) -> str:
    connection = mechanism.connections[name]
    joint = connection.joint
    ends = f"{in_a_line(connection.parent)} to {in_a_line(connection.child)}"
    along = slides(mechanism, name)
    parts = list(fields_in_words(joint, lambda metadata: unit_along(metadata, along)))
    own = [text for name, text in parts if not isinstance(getattr(joint, name), eqx.Module)]
    laws = [
        f"{INDENT}{text}" for name, text in parts if isinstance(getattr(joint, name), eqx.Module)
    ]
    first = f"{public_name(type(joint))}, {ends}; {', '.join(own)}".rstrip("; ")
    return "\n".join([first, *laws])


def _numbers(part: Any, along: bool = False) -> str:
    return numbers_in_words(part, lambda metadata: unit_along(metadata, along))


def _coordinates(mechanism: Any, name: str, values: tuple, rate: str) -> str:
    units = coordinate_units(mechanism, name)
    if set(units) == {"1"} and len(values) in (1, 3):
        return f"{number_in_words(values)} rad{rate}"  # a rotation vector in place of a quaternion
    if len(units) != len(values) or "1" in units:
        return number_in_words(values)
    return ", ".join(f"{number_in_words(x)} {u}{rate}" for x, u in zip(values, units, strict=True))
