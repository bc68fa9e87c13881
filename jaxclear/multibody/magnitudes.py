"""Numbers that no mechanism has, warned about where a mechanism is built: a slip of unit runs as
well as any other number, and answers nonsense.

A field says itself what is usual (`usual` of `jaxclear.quantity`). Lengths are compared with the
places of the joints, in which a mechanism has its size. Bounds lie far beyond what is built, so
that nothing built is warned about. Numbers that are being traced are not looked at.

When a body moves in the plane: its inertia is known about z only, and all that is given of it,
of its joints and of what acts on it lies in the plane.

A body that ideal joints hold shows by its motion whether it turns about z only (`start_check`); one
that only contacts hold is given three freedoms, and would ignore silently what points out of the
plane. It is refused here.
"""

import math
from collections.abc import Iterator
from typing import Any

from jaxclear.components.body import GROUND, Body, Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.joint import AbstractJoint
from jaxclear.components.load import AbstractBodyLoad, Gravity, MarkerMotion
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import concrete, numbers
from jaxclear.ground.warning import warn
from jaxclear.multibody.topology import Topology, all_planar, coordinate_units

# Beside 1, or beside a length of 1 m: what a direction or a place is off the plane by rounding.
ROUNDING = 1e-9
# Times [s] at which loads that are functions of time are asked: any.
TIMES = (0.0, 0.137)


def check_plane(topology: Topology, bodies: dict, connections: dict, loads: dict) -> None:
    """Raises `ValueError` for something given outside the plane in which its floating body moves.

    Args:
        topology: its floating bodies with an inertia about z only move in the plane.
        bodies: by name, with mass centres.
        connections: by name, with markers on these bodies.
        loads: by name, with markers and directions.
    """
    floating = {b.body for b in topology.branches if b.connection is None}
    planar = {body for body in floating if len(bodies[body].inertia) == 1}
    for body in sorted(planar):
        for what in _list_out_of_plane(body, bodies[body], connections, loads):
            raise ValueError(
                f'body "{body}" has an inertia about its z axis only and nothing but contacts to '
                f"hold it, so it moves in the plane; but {what}. Give its inertia by 3 or 6 "
                "numbers, and it moves in space; or give planar numbers (2) throughout."
            )
    for name, connection in connections.items():
        _check_joint(name, connection, bodies)


def across_the_plane(mechanism: Any) -> Iterator[str]:
    """Of a mechanism all of whose bodies move in the ground's xy plane, sentences for what moves
    nothing: a centre of mass beside the plane of all joints, and gravity along z where all is drawn
    in one plane: an arm drawn in space may turn about upright axes, whose bearings carry it."""
    bodies, connections, loads = mechanism.bodies, mechanism.connections, mechanism.loads
    if not all_planar(bodies) or not all(map(_preserves_z, connections.values())):
        return
    markers = [marker for each in connections.values() for marker in (each.parent, each.child)]
    relative = any(_off(sp.vec3(marker.at)[2]) for marker in markers if marker.at is not None)
    for name, body in bodies.items():
        if body.com is not None and _off(sp.vec3(body.com)[2]) and not relative:
            yield (
                f'body "{name}" moves in the xy plane and has its com beside it, at '
                f"z = {concrete(body.com[2]):g} m: in the plane that moves nothing."
            )
    for label, load in loads.items():
        pull = sp.vec3(load.acceleration) if isinstance(load, Gravity) else None
        if pull is None or relative or not _off(pull[2]):
            continue
        if not (_off(pull[0]) or _off(pull[1])):
            yield (
                f'load "{label}" pulls along z, across the xy plane in which all bodies move, and '
                "moves nothing: is it to be Gravity((0, -9.81))?"
            )


def _preserves_z(connection: Connection) -> bool:
    """Whether the z axes of both bodies point one way, or opposite ways, at home, and the joint
    slides across them."""
    parent, child = (end.pose().rotation for end in (connection.parent, connection.child))
    along = [sp.mul(a, b) for a, b in zip(parent[2], child[2], strict=True)]
    joint = connection.joint
    columns = joint.columns(joint.home) if isinstance(joint, AbstractJoint) else ()
    slides = any(_off(sp.dot(child[2], column.linear)) for column in columns)
    return not slides and not _off(abs(sum(concrete(x) or 0.0 for x in along)) - 1)


def _check_joint(name: str, connection: Connection, bodies: dict) -> None:
    """A clearance joint between planar bodies must find its contacts in the plane."""
    ends = (connection.parent.body, connection.child.body)
    flat = all(end == GROUND or len(bodies[end].inertia) == 1 for end in ends)
    if flat and isinstance(connection.joint, AbstractClearance):
        rotation = connection.parent.pose().rotation
        x, y, z = (concrete(component) or 0.0 for component in rotation[2])
        try:
            connection.joint.check_plane((x, y, z))
        except ValueError as error:
            raise ValueError(f'joint "{name}" {error}') from None


def _list_out_of_plane(name: str, body: Body, connections: dict, loads: dict) -> Iterator[str]:
    """What is given of a body, and points or lies out of the plane."""
    if body.com is not None and _off(sp.vec3(body.com)[2]):
        yield "its centre of mass lies beside it"
    for joint, connection in connections.items():
        ends = (connection.parent, connection.child)
        if name in (end.body for end in ends) and any(_off(sp.vec3(end.at)[2]) for end in ends):
            yield f'a marker of joint "{joint}" lies beside it'
    for label, load in loads.items():
        if isinstance(load, Gravity) and _off(sp.vec3(load.acceleration)[2]):
            yield f'load "{label}" pulls along z'
        if isinstance(load, AbstractBodyLoad):
            yield from _list_forces_out_of_plane(name, label, load)


def _list_forces_out_of_plane(name: str, label: str, load: AbstractBodyLoad) -> Iterator[str]:
    markers = load.markers()
    if name not in (marker.body for marker in markers):
        return
    if any(_off(sp.vec3(marker.at)[2]) for marker in markers if marker.at is not None):
        yield f'a marker of load "{label}" lies beside it'
    motions = tuple(MarkerMotion(marker.pose(), sp.ZERO, sp.ZERO) for marker in markers)
    for time in TIMES:
        for action in load.effect(time, motions).actions:
            if action.marker.body == name and (
                _off(action.force[2]) or _off(action.torque[0]) or _off(action.torque[1])
            ):
                yield f'load "{label}" acts out of it'
                return


def _off(x: Any) -> bool:
    """Whether a number that is known is not zero."""
    return abs(concrete(x) or 0.0) > ROUNDING


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
LONG, THINNEST, DENSEST, TURNS = 10.0, 1e-5, 1e5, 3.0
# Of a body that is this share of the longest only, as a slider's, its length says nothing of it.
STUB = 0.1
IN_MM = "is it in mm? Lengths are in m"


class UnusualMagnitude(UserWarning):
    """A number that no mechanism has, probably a slip of unit; or one that moves nothing, as it
    points out of the plane in which all bodies move."""


def warn_of_magnitudes(mechanism: Any) -> None:
    """One warning with a sentence for each number that is beyond what mechanisms have."""
    parts = [(what, part, list(numbers(part))) for what, part in _iterate_parts(mechanism)]
    result = [*_list_unusual(parts), *_list_lengths(mechanism, parts), *_list_masses(mechanism)]
    result += [*_list_starts(mechanism), *across_the_plane(mechanism)]
    if result:
        warn(" ".join(result), UnusualMagnitude)


def _iterate_parts(mechanism: Any) -> Iterator[tuple[str, Any]]:
    yield from ((f'body "{name}"', body) for name, body in mechanism.bodies.items())
    yield from ((f'joint "{n}"', joint.joint) for n, joint in mechanism.connections.items())
    yield from ((f'load "{name}"', load) for name, load in mechanism.loads.items())
    yield from ((f'coupling "{n}"', coupling) for n, coupling in mechanism.couplings.items())


def _list_unusual(parts: list) -> Iterator[str]:
    """Numbers beyond the range that their field calls usual."""
    for what, _, result in parts:
        for path, leaf, metadata in result:
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


def _list_lengths(mechanism: Any, parts: list) -> Iterator[str]:
    """Places, centres of mass, inertias and joints out of proportion."""
    places = {
        f'joint "{name}" on body "{marker.body}"': _norm_of(marker.at)
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
        away = 0.0 if body.com is None else _norm_of(body.com)
        if away > LARGE_ARM * size:
            yield f'body "{name}" has its com {away:g} m away, no joint {size:g} m: {IN_MM}.'
        inertia = max((concrete(x) or 0.0 for x in body.inertia[:3]), default=0.0)
        gyration = math.sqrt(inertia / (concrete(body.mass) or math.inf))
        if gyration > LARGE_GYRATION * size:
            yield (
                f'body "{name}" has inertia = {inertia:g} kg m^2, as if its mass were {gyration:g} '
                f"m away, where no joint is beyond {size:g} m: is it in kg mm^2?"
            )
    for what, part, result in parts:
        if not isinstance(part, Body):
            yield from _list_lengths_of_part(what, part, result, size)


def _list_masses(mechanism: Any) -> Iterator[str]:
    """Bodies that are lighter than any gas, or heavier than any metal, within their own length."""
    ends = [end for part in mechanism.connections.values() for end in (part.parent, part.child)]
    places = [(end.body, end.at) for end in ends] + [
        (n, b.com) for n, b in mechanism.bodies.items()
    ]
    lengths = {name: 0.0 for name, _ in places}
    for name, at in places:
        lengths[name] = max(lengths[name], 0.0 if at is None else _norm_of(at))
    for name, body in mechanism.bodies.items():
        length = lengths[name]
        mass, inertia = concrete(body.mass), [concrete(x) for x in body.inertia[:3]]
        if length <= STUB * max(lengths.values()) or mass is None or None in inertia:
            continue
        # What stands out beyond the joints shows in the inertia.
        size = max(length, TURNS * math.sqrt(max(x or 0.0 for x in inertia) / mass))
        if length >= LONG and mass < THINNEST * length**3:
            yield f'body "{name}" is {length:g} m long and has {mass:g} kg: {IN_MM}.'
        elif mass > DENSEST * size**3:
            yield (
                f'body "{name}" has {mass:g} kg within {length:g} m, more than any metal: is it in '
                "g? Masses are in kg."
            )


def _list_lengths_of_part(what: str, part: Any, result: list, size: float) -> Iterator[str]:
    for path, leaf, metadata in result:
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
    result = [concrete(getattr(joint, name, None)) for name in names]
    return next((size for size in result if size is not None), math.inf)


def _list_starts(mechanism: Any) -> Iterator[str]:
    """Angles of many turns."""
    for what in ("start", "guess"):
        for name, values in getattr(mechanism, what).items():
            if name in mechanism.topology.motors:
                continue
            for value, unit in zip(values, coordinate_units(mechanism, name), strict=False):
                angle = concrete(value)
                if unit == "rad" and angle is not None and abs(angle) > MOST_TURNS:
                    report = f'{what} of "{name}" is {angle:g} rad'
                    yield f"{report}: is it in degrees? Angles are in rad."


def _norm_of(vector: Any) -> float:
    result = [concrete(x) for x in vector]
    values = [x for x in result if x is not None]
    return math.hypot(*values) if len(values) == len(result) else 0.0
