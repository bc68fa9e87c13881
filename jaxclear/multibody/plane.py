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
