"""When a body moves in the plane: its inertia is known about z only, and all that is given of it,
of its joints and of what acts on it lies in the plane.

A body that ideal joints hold shows by its motion whether it turns about z only (`start_check`); one
that only contacts hold is given three freedoms, and would ignore silently what points out of the
plane. It is refused here.
"""

from collections.abc import Iterator
from typing import Any

from jaxclear.components.body import GROUND, Body, Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.joint import AbstractJoint
from jaxclear.components.load import AbstractBodyLoad, Gravity, MarkerMotion
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import concrete
from jaxclear.multibody.topology import Topology

# Beside 1, or beside a length of 1 m: what a direction or a place is off the plane by rounding.
ROUNDING = 1e-9
# Times [s] at which loads that are functions of time are asked: any.
TIMES = (0.0, 0.137)


def check_plane(topology: Topology, bodies: dict, connections: dict, loads: dict) -> None:
    """Raises `ValueError` for a body in the plane of which something given lies outside it."""
    floating = {b.body for b in topology.branches if b.connection is None}
    planar = {body for body in floating if len(bodies[body].inertia) == 1}
    for body in sorted(planar):
        for what in _out_of_plane(body, bodies[body], connections, loads):
            raise ValueError(
                f'body "{body}" has an inertia about its z axis only and nothing but contacts to '
                f"hold it, so it moves in the plane; but {what}. Give its inertia by 3 or 6 "
                "numbers, and it moves in space; or give planar numbers (2) throughout."
            )
    for name, connection in connections.items():
        _check_joint(name, connection, bodies)


def across_the_plane(mechanism: Any) -> Iterator[str]:
    """Of a mechanism all of whose bodies move in the ground's xy plane, sentences for what moves
    nothing: gravity along z, and a centre of mass beside the plane of all joints."""
    bodies, connections, loads = mechanism.bodies, mechanism.connections, mechanism.loads
    flat = all(len(body.inertia) == 1 for body in bodies.values())
    if not flat or not all(map(_keeps_z, connections.values())):
        return
    markers = [marker for each in connections.values() for marker in (each.parent, each.child)]
    beside = any(_off(sp.vec3(marker.at)[2]) for marker in markers if marker.at is not None)
    for name, body in bodies.items():
        if body.com is not None and _off(sp.vec3(body.com)[2]) and not beside:
            yield (
                f'body "{name}" moves in the xy plane and has its com beside it, at '
                f"z = {concrete(body.com[2]):g} m: in the plane that moves nothing."
            )
    for label, load in loads.items():
        pull = sp.vec3(load.acceleration) if isinstance(load, Gravity) else None
        if pull is not None and _off(pull[2]) and not (_off(pull[0]) or _off(pull[1])):
            yield (
                f'load "{label}" pulls along z, across the xy plane in which all bodies move, and '
                "moves nothing: is it to be Gravity((0, -9.81))?"
            )


def _keeps_z(connection: Connection) -> bool:
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


def _out_of_plane(name: str, body: Body, connections: dict, loads: dict) -> Iterator[str]:
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
            yield from _pushed(name, label, load)


def _pushed(name: str, label: str, load: AbstractBodyLoad) -> Iterator[str]:
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
