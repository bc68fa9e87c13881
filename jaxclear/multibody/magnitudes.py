"""Numbers that no mechanism has, warned about where a mechanism is built: a slip of unit runs as
well as any other number, and answers nonsense.

A field says itself what is usual (`usual` of `jaxclear.quantity`). Lengths are compared with the
places of the joints, in which a mechanism has its size. Bounds lie far beyond what is built, so
that nothing built is warned about. Numbers that are being traced are not looked at.
"""

import math
from collections.abc import Iterator
from typing import Any

from jaxclear.components.body import Body
from jaxclear.ground.quantity import concrete, numbers
from jaxclear.ground.warning import warn
from jaxclear.multibody.own_numbers import coordinate_units
from jaxclear.multibody.plane import across_the_plane

__all__ = ["UnusualMagnitude", "warn_of_magnitudes"]

# A length given in mm for m is 1000 times too large: from these multiples of the largest place of a
# joint on, parts of a joint, centres of mass and radii of gyration count as slips.
LARGE_PART, LARGE_ARM, LARGE_GYRATION = 30.0, 30.0, 100.0
# A place this many times as far out as the one in the middle.
FAR_PLACE = 300.0
# More than two turns to start with: degrees for radians [rad].
MOST_TURNS = 4 * math.pi
# Of loose joints in textbooks the clearance is a twentieth of the radius.
WIDE_CLEARANCE = 0.5
# A body this long [m] whose mass is less than a hundred thousandth of so much air [kg/m3], as no
# crane's or satellite's, is given in mm; one of five times osmium's density within the length
# between its joints, in grams. What extends
# beyond the joints is seen by so many radii of gyration.
LONG, THINNEST, DENSEST, WHOLE = 10.0, 1e-5, 1e5, 3.0
# Of a body that is this share of the longest only, as a slider's, its length says nothing of it.
STUB = 0.1
IN_MM = "is it in mm? Lengths are in m"


class UnusualMagnitude(UserWarning):
    """A number that no mechanism has, probably a slip of unit; or one that moves nothing, as it
    points out of the plane in which all bodies move."""


def warn_of_magnitudes(mechanism: Any) -> None:
    """One warning with a sentence for each number that is beyond what mechanisms have."""
    parts = [(what, part, list(numbers(part))) for what, part in _parts(mechanism)]
    found = [*_unusual(parts), *_lengths(mechanism, parts), *_masses(mechanism)]
    found += [*_starts(mechanism), *across_the_plane(mechanism)]
    if found:
        warn(" ".join(found), UnusualMagnitude)


def _parts(mechanism: Any) -> Iterator[tuple[str, Any]]:
    yield from ((f'body "{name}"', body) for name, body in mechanism.bodies.items())
    yield from ((f'joint "{n}"', joint.joint) for n, joint in mechanism.connections.items())
    yield from ((f'load "{name}"', load) for name, load in mechanism.loads.items())
    yield from ((f'coupling "{n}"', coupling) for n, coupling in mechanism.couplings.items())


def _unusual(parts: list) -> Iterator[str]:
    """Numbers beyond the range that their field calls usual."""
    for what, _, found in parts:
        for path, leaf, metadata in found:
            if "usual" not in metadata:
                continue
            low, high, slip = metadata["usual"]
            value = concrete(leaf)
            if value is not None and value != 0 and not low <= value <= high:
                unit = "" if metadata["unit"] == "1" else f" {metadata['unit']}"
                yield (
                    f"{what} has {path} = {value:g}{unit}; mechanisms have {low:g} to {high:g}"
                    f"{unit}: {slip}"
                )


def _lengths(mechanism: Any, parts: list) -> Iterator[str]:
    """Places, centres of mass, inertias and joints out of proportion."""
    places = {
        f'joint "{name}" on body "{marker.body}"': _norm(marker.at)
        for name, connection in mechanism.connections.items()
        for marker in (connection.parent, connection.child)
        if marker.at is not None
    }
    reached = sorted(x for x in places.values() if x > 0)
    if not reached:
        return
    size, middle = reached[-1], reached[len(reached) // 2 if len(reached) > 2 else 0]
    for what, place in places.items():
        if place > FAR_PLACE * middle:
            yield f"{what} is {place:g} m away from its origin, others {middle:g} m: {IN_MM}."
    for name, body in mechanism.bodies.items():
        away = 0.0 if body.com is None else _norm(body.com)
        if away > LARGE_ARM * size:
            yield f'body "{name}" has its com {away:g} m away, no joint {size:g} m: {IN_MM}.'
        inertia = max((concrete(x) or 0.0 for x in body.inertia[:3]), default=0.0)
        gyration = math.sqrt(inertia / (concrete(body.mass) or math.inf))
        if gyration > LARGE_GYRATION * size:
            yield (
                f'body "{name}" has inertia = {inertia:g} kg m^2, as if its mass were {gyration:g} '
                f"m away, where no joint is beyond {size:g} m: is it in kg mm^2?"
            )
    for what, part, found in parts:
        if not isinstance(part, Body):
            yield from _of_part(what, part, found, size)


def _masses(mechanism: Any) -> Iterator[str]:
    """Bodies that are lighter than any gas, or heavier than any metal, within their own length."""
    ends = [end for own in mechanism.connections.values() for end in (own.parent, own.child)]
    places = [(end.body, end.at) for end in ends] + [
        (n, b.com) for n, b in mechanism.bodies.items()
    ]
    lengths = {name: 0.0 for name, _ in places}
    for name, at in places:
        lengths[name] = max(lengths[name], 0.0 if at is None else _norm(at))
    for name, body in mechanism.bodies.items():
        length = lengths[name]
        mass, inertia = concrete(body.mass), [concrete(x) for x in body.inertia[:3]]
        if length <= STUB * max(lengths.values()) or mass is None or None in inertia:
            continue
        # What stands out beyond the joints shows in the inertia.
        size = max(length, WHOLE * math.sqrt(max(x or 0.0 for x in inertia) / mass))
        if length >= LONG and mass < THINNEST * length**3:
            yield f'body "{name}" is {length:g} m long and has {mass:g} kg: {IN_MM}.'
        elif mass > DENSEST * size**3:
            yield (
                f'body "{name}" has {mass:g} kg within {length:g} m, more than any metal: is it in '
                "g? Masses are in kg."
            )


def _of_part(what: str, part: Any, found: list, size: float) -> Iterator[str]:
    for path, leaf, metadata in found:
        if metadata.get("unit") != "m" or "." in path:
            continue
        value = abs(concrete(leaf) or 0.0)
        if value > LARGE_PART * size:
            yield f"{what} has {path} = {value:g} m beside links of {size:g} m: {IN_MM}."
        elif path == "clearance" and value > WIDE_CLEARANCE * _radius(part):
            yield f"{what} has clearance = {value:g} m in a part of {_radius(part):g} m: {IN_MM}."


def _radius(joint: Any) -> float:
    """Radius or width [m] of what is around the gap."""
    names = ("bearing_radius", "socket_radius", "width")
    found = [concrete(getattr(joint, name, None)) for name in names]
    return next((size for size in found if size is not None), math.inf)


def _starts(mechanism: Any) -> Iterator[str]:
    """Angles of many turns."""
    for what in ("start", "guess"):
        for name, values in getattr(mechanism, what).items():
            for value, unit in zip(values, coordinate_units(mechanism, name), strict=False):
                angle = concrete(value)
                if unit == "rad" and angle is not None and abs(angle) > MOST_TURNS:
                    told = f'{what} of "{name}" is {angle:g} rad'
                    yield f"{told}: is it in degrees? Angles are in rad."


def _norm(vector: Any) -> float:
    found = [concrete(x) for x in vector]
    known = [x for x in found if x is not None]
    return math.hypot(*known) if len(known) == len(found) else 0.0
