"""Where couplings of bodies sit: the two markers that mesh, how they stand at home, and whose
coordinates count the whole turns of what is read off their relative pose.

Angles of a pose are known but for whole turns. One of two wheels is counted by the coordinate of
its joint, which is its turn against the line of centres where the joint's inner body carries both
axes; the turns of the other follow, since the residual is nearly zero.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.body import GROUND, Body, Connection, Marker
from jaxclear.components.coupling import AbstractBodyCoupling
from jaxclear.components.joint import AbstractVectorJoint, Planar
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import REST, Pose
from jaxclear.multibody.topology import Topology, coordinate_joint
from jaxclear.multibody.tree import Motion

TURN = 2 * jnp.pi


class Count(eqx.Module):
    """An angle [rad] as a coordinate of the tree counts it: `sign` times what it has gone from
    `home`."""

    sign: Any
    home: Any
    link: int = eqx.field(static=True)
    coordinate: int = eqx.field(static=True)

    def of(self, motions: tuple[Motion, ...]) -> Any:
        return self.sign * (motions[self.link].coordinates[self.coordinate] - self.home)


class Mesh(eqx.Module):
    """Reads the residual [m] of a coupling of bodies off the relative pose of its markers, which is
    `drawn` at home; `counts` of its angles, None where the residual tells whole turns."""

    coupling: AbstractBodyCoupling
    drawn: Pose
    counts: tuple[Count | None, ...]

    def residuals(self, pose: Pose) -> tuple:
        parts = zip(self.coupling.radii(self.drawn), self._turn_angles(pose), strict=True)
        rest = [self.coupling.rest(at, self.drawn) for at in (pose, self.drawn)]
        return (sp.add(sp.total(r * x for r, x in parts), sp.sub(*rest)),)

    def _turn_angles(self, pose: Pose) -> list:
        angles = (self.coupling.angles(at) for at in (pose, self.drawn))
        return [a - b for a, b in zip(*angles, strict=True)]

    def counted(self, residual: Any, pose: Pose, motions: tuple[Motion, ...]) -> Any:
        """The residual with whole turns; 0, which ties only speeds, where nothing counts turns.

        Args:
            residual: of the coupling, from angles within one turn [m].
            pose: the second marker in the first.
            motions: motion of every link, with the coordinates that count turns.
        """
        radii, rotated = self.coupling.radii(self.drawn), self._turn_angles(pose)
        if len(radii) > 1 and self.counts == (None,) * len(radii):
            return jnp.zeros_like(residual)
        for radius, angle, count in zip(radii, rotated, self.counts, strict=True):
            if count is not None:
                turns = jnp.round((count.of(motions) - angle) / TURN)
                residual = residual + radius * TURN * turns
        for radius, count in zip(radii, self.counts, strict=True):
            if count is None:
                residual = residual - radius * TURN * jnp.round(residual / (radius * TURN))
        return residual


class Part(NamedTuple):
    """What a joint carries: its `marker`, whether that is the child's, and the `inner` body."""

    marker: Marker
    is_child: bool
    inner: str


def carried_marker(connection: Connection) -> Part:
    """The child, or the parent where the child is the ground."""
    parent, child = connection.parent, connection.child
    if child.body == GROUND:
        return Part(parent, False, GROUND)
    return Part(child, True, parent.body)


def meshing_parts(
    coupling: AbstractBodyCoupling, connections: dict[str, Connection]
) -> tuple[Part, ...]:
    """What the joints of a coupling carry. Against the joint of its own carrier a wheel moves on
    the part that carries both: the planet on a fixed sun, the rolling wheel on the ground."""
    parts = tuple(carried_marker(connections[name]) for name in coupling.joints())
    bodies = [part.marker.body for part in parts]
    if len(parts) == 1 or bodies[0] == bodies[1]:
        return parts
    across = [bodies[1 - i] == part.inner for i, part in enumerate(parts)]
    pairs = list(zip(coupling.joints(), parts, reversed(across), strict=True))
    return tuple(
        _part_on_other_side(connections[name], part) if is_carrier and not all(across) else part
        for name, part, is_carrier in pairs
    )


def _part_on_other_side(connection: Connection, part: Part) -> Part:
    """The part against which a joint moves this one."""
    marker = connection.parent if part.is_child else connection.child
    return Part(marker, not part.is_child, part.marker.body)


def rolls_on_its_carriers_base(
    coupling: AbstractBodyCoupling, connections: dict[str, Connection]
) -> bool:
    """Whether one of its joints moves the carrier of what the other carries."""
    sides = [carried_marker(connections[name]).is_child for name in coupling.joints()]
    return sides != [part.is_child for part in meshing_parts(coupling, connections)]


def markers(coupling: AbstractBodyCoupling, connections: dict[str, Connection]) -> tuple:
    """The two markers that mesh."""
    entry = [connections[name] for name in coupling.joints()]
    if len(entry) == 1:
        return entry[0].parent, entry[0].child
    return tuple(part.marker for part in meshing_parts(coupling, connections))


def drawn_pose(
    coupling: AbstractBodyCoupling, bodies: dict[str, Body], connections: dict[str, Connection]
) -> Pose:
    """Pose of the second marker in the first where all joints are at home.

    Args:
        coupling: of two bodies, whose markers it takes from its joints.
        bodies: by name.
        connections: by name.
    """
    first, second = markers(coupling, connections)
    places = _poses_at_home(bodies, connections)
    poses = [places[marker.body].after(marker.pose()) for marker in (first, second)]
    return poses[0].inverse().after(poses[1])


# How far joints are moved to see whether wheels stay as far apart [rad, m], and how much nearer or
# further [1] they may be then.
MOVED, AS_FAR = 0.3, 1e-6


def is_distance_free(
    coupling: AbstractBodyCoupling, bodies: dict[str, Body], connections: dict[str, Connection]
) -> bool:
    """Whether the distance of two wheels' axes changes as other joints move: no body carries both.

    Args:
        coupling: of two wheels.
        bodies: by name.
        connections: by name; joints on groups are left at home.
    """
    first, second = markers(coupling, connections)
    others = {n: c for n, c in connections.items() if n not in coupling.joints()}
    moved = {n: MOVED / (1 + i) for i, n in enumerate(others)}
    result = []
    for shifts in ({}, moved):
        places = _poses_at_home(bodies, connections, shifts)
        one, other = (places[marker.body].after(marker.pose()) for marker in (first, second))
        x, y, _ = one.inverse().after(other).translation
        result.append(float(jnp.hypot(jnp.asarray(x, float), jnp.asarray(y, float))))
    return abs(result[1] - result[0]) > AS_FAR * result[0]


def _poses_at_home(
    bodies: dict[str, Body],
    connections: dict[str, Connection],
    shifts: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Pose]:
    """Poses of the bodies in the ground where all joints are at home, each by the first way that
    leads there; some joints moved by `shifts`."""
    places, rest = {GROUND: REST}, dict(connections)
    while len(places) <= len(bodies):
        name = next(
            n for n, c in rest.items() if (c.parent.body in places) != (c.child.body in places)
        )
        connection = rest.pop(name)
        parent, child = connection.parent, connection.child
        joint = coordinate_joint(name, bodies, connections)
        shift = shifts.get(name, 0.0) if isinstance(joint, AbstractVectorJoint) else 0.0
        across = joint.motion(tuple(jnp.asarray(x, float) + shift for x in joint.home))
        if parent.body in places:
            onward = parent.pose().after(across).after(child.pose().inverse())
            places[child.body] = places[parent.body].after(onward)
        else:
            onward = child.pose().after(across.inverse()).after(parent.pose().inverse())
            places[parent.body] = places[child.body].after(onward)
    return places


def make_mesh_reading(
    coupling: AbstractBodyCoupling,
    topology: Topology,
    bodies: dict[str, Body],
    connections: dict[str, Connection],
) -> Mesh:
    """How the residual of a coupling of bodies is read: pose at home and what counts turns.

    Args:
        coupling: of two bodies.
        topology: its tree says which coordinates count whole turns.
        bodies: by name.
        connections: by name.
    """
    drawn = drawn_pose(coupling, bodies, connections)
    parts = list(meshing_parts(coupling, connections))
    if len(coupling.angles(drawn)) == 1:
        return Mesh(coupling, drawn, (_single(coupling, parts, topology, bodies, connections),))
    depths = [_depth_in_tree(topology, part.marker.body) for part in parts]
    deepest = [depth == max(depths) for depth in depths]
    together = parts[0].inner == parts[1].inner
    counts = tuple(
        _turn_count(name, part, topology, bodies, connections) if together or deep else None
        for name, part, deep in zip(coupling.joints(), parts, deepest, strict=True)
    )
    return Mesh(coupling, drawn, counts)


def _single(
    coupling: AbstractBodyCoupling,
    parts: list[Part],
    topology: Topology,
    bodies: dict,
    connections: dict,
) -> Count | None:
    """What counts the one angle of a coupling: how the second marker turns in the first, which is
    the child's in the parent's of one joint, or what stands still as a part turns beneath it."""
    is_private = len(parts) == 1
    if not is_private and parts[0].inner != parts[1].inner:
        return None
    result = _turn_count(coupling.joints()[0], parts[0], topology, bodies, connections)
    if result is None:
        return None
    return eqx.tree_at(lambda count: count.sign, result, 1.0 if is_private else -result.sign)


def _depth_in_tree(topology: Topology, body: str) -> int:
    """How many joints of the tree lead from the ground to a body."""
    inboard = {branch.body: branch.parent for branch in topology.branches}
    depth = 0
    while body != GROUND:
        body, depth = inboard[body], depth + 1
    return depth


def _turn_count(
    name: str, part: Part, topology: Topology, bodies: dict, connections: dict
) -> Count | None:
    """The coordinate that counts the turns of what a joint carries against its inner body."""
    joint = coordinate_joint(name, bodies, connections)
    branch = topology.branch_of(name)
    if branch is not None:
        if not isinstance(joint, AbstractVectorJoint) or joint.units.count("rad") != 1:
            return None
        place = joint.units.index("rad")
        side = 1.0 if part.is_child else -1.0
        return Count(side, joint.home[place], topology.branches.index(branch), place)
    if part.inner != GROUND:
        return None
    body = part.marker.body
    link: Any = topology.index(body)
    if topology.branches[link].connection is not None or len(bodies[body].inertia) > 1:
        return None
    # A body that floats in the plane turns about the ground's z axis.
    drawn = _poses_at_home(bodies, connections)[body]
    home = jnp.arctan2(*(jnp.asarray(drawn.rotation[i][0], float) for i in (1, 0)))
    upward = drawn.after(part.marker.pose()).rotation[2][2]
    sign = jnp.where(jnp.asarray(upward, float) < 0, -1.0, 1.0)
    return Count(sign, home, link, Planar.units.index("rad"))
