"""What is given for a start, as equations in the free speeds: coordinates and speeds of joints,
whether they carry coordinates, close a loop or have clearance, and places of bodies.

Coordinates and speeds of a joint that the tree goes through from its child to its parent.

Those of a connection are always its child's, seen from its parent. With its markers turned by
`reversal` a joint of one coordinate or two has the same ones either way; a rotation, or a place
with an orientation, becomes its inverse.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.joint import AbstractGroupJoint, AbstractJoint
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_many
from jaxclear.ground.pose import REST
from jaxclear.multibody import kinematics
from jaxclear.multibody.kinematics import JacobianRow
from jaxclear.multibody.loops import Closure, Relative, reverse_relative
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import System
from jaxclear.multibody.topology import Branch, coordinate_joint
from jaxclear.multibody.tree import Motion


def is_reversed(branch: Branch, joint: AbstractJoint) -> bool:
    """Whether the tree's coordinates are those of the parent, seen from the child."""
    return branch.reversed and isinstance(joint, AbstractGroupJoint)


def reversed_motion(joint: AbstractJoint, q: tuple, v: tuple) -> tuple[tuple, tuple]:
    """Coordinates and speeds of the inner marker as seen from the outer, from those of the outer.

    The function is its own inverse.

    Args:
        joint: between the two markers.
        q: its coordinates, as numbers.
        v: its speeds.
    """
    pose = joint.motion(q)
    columns = joint.columns(q)
    linear, angular = (
        sp.plus(sp.ZERO, *(sp.scale(x, part) for x, part in zip(v, parts, strict=True)))
        for parts in ([c.linear for c in columns], [c.angular for c in columns])
    )
    out = Relative(pose, sp.apply(pose.rotation, linear), sp.apply(pose.rotation, angular))
    back = reverse_relative(out, joint.reversal)
    return joint.coordinates_at(back.pose), joint.speeds_at(*back)


def reversed_rows(
    joint: AbstractJoint, q: Float[Array, "time q"], v: Float[Array, "time v"]
) -> tuple[Float[Array, "time q"], Float[Array, "time v"]]:
    """`reversed_motion` for every row of a history; quaternions keep their sign from row to row.

    Args:
        joint: between the two markers.
        q: its coordinates, shape (time, q).
        v: its speeds, shape (time, v).
    """

    def one(q, v):
        return tuple(map(sp.stack, reversed_motion(joint, tuple(q), tuple(v))))

    q, v = jax.vmap(one)(q, v)
    quaternion = [i for i, unit in enumerate(joint.units) if unit == "1"]
    if quaternion:
        part = q[:, jnp.array(quaternion)]
        steady = jnp.sum(part[1:] * part[:-1], axis=1) >= 0
        sign = jnp.concatenate([jnp.ones(1), jnp.cumprod(jnp.where(steady, 1.0, -1.0))])
        q = q.at[:, jnp.array(quaternion)].multiply(sign[:, None])
    return q, v


def at_start(branch: Branch, joint: AbstractJoint, q: Any, v: Any) -> tuple[tuple, tuple]:
    """The tree's coordinates and speeds from those of the connection.

    Args:
        branch: of the tree; it may run from the connection's child to its parent.
        joint: of the branch.
        q: coordinates of the connection.
        v: its speeds.
    """
    return reversed_motion(joint, tuple(q), tuple(v)) if is_reversed(branch, joint) else (q, v)


class Source(NamedTuple):
    """Where coordinates are read: those of a `branch` of the tree, or of `joint` between the two
    markers of a `closure`."""

    joint: AbstractJoint
    branch: Any  # its number; None where the tree does not carry the coordinates
    closure: Any  # a Closure, None where the tree carries the coordinates


class Equations(NamedTuple):
    """Equations in the free speeds, one a number given: by how much it is missed (joint's own
    units of speed, or of speed times s), and its Jacobian row."""

    missed: tuple
    jacobian: list[JacobianRow]


def source(mechanism: Mechanism, system: System, name: str) -> Source:
    """Where the coordinates of a name are read: a branch of the tree, or a closure.

    Args:
        mechanism: with its joints.
        system: prepared mechanism, as `prepare` returns it.
        name: connection, motor or floating body.
    """
    topology = system.topology
    for i, branch in enumerate(topology.branches):
        if branch.name == name and branch.coordinate_count:
            return Source(system.links[i].joint, i, None)
    joint = coordinate_joint(name, mechanism.bodies, mechanism.connections)
    if name in topology.loops:
        return Source(joint, None, system.closures[topology.loops.index(name)])
    if name in system.bearings:
        return Source(joint, None, system.bearings[name].closure)
    index = next(i for i, branch in enumerate(topology.branches) if branch.body == name)
    return Source(joint, None, Closure(REST, system.links[index].frame, None, index, ()))


def coordinate_equations(
    system: System,
    motions: tuple[Motion, ...],
    q: tuple,
    sources: list[Source],
    inputs: list[tuple],
    nearly: bool = False,
) -> list[Equations]:
    """Equations that give joints their coordinates, a list entry for each joint.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at the coordinates.
        q: coordinates of the tree, a tuple for each branch.
        sources: where the joints' coordinates are read.
        inputs: what is given for each, as `joint.start` takes it [rad, m].
        nearly: whether they are a guess: then angles count by the shorter way.
    """
    calls = []
    for where, values in zip(sources, inputs, strict=True):
        joint = where.joint
        target = joint.start(values)
        if where.branch is not None:
            part, turns = q[where.branch], nearly
            branch = system.topology.branches[where.branch]
            still = (0.0,) * len(joint.start_mask(values))
            target = at_start(branch, joint, target, still)[0]
        else:
            part = joint.coordinates_at(kinematics.relative_motion(where.closure, motions)[1])
            turns = True
        calls.append((joint, part, target, turns))
    result = []
    each = zip(sources, inputs, map_many(_increment_from, calls), strict=True)
    for where, values, missed in each:
        report = where.joint.start_mask(values)
        rows = _rows(system, motions, where, len(report))
        saved = [i for i, present in enumerate(report) if present]
        result.append(Equations(tuple(missed[i] for i in saved), [rows[i] for i in saved]))
    return result


def speed_equations(
    system: System, motions: tuple[Motion, ...], q: tuple, v: tuple, where: Source, values: tuple
) -> Equations:
    """Equations that give a joint its speeds.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at the coordinates and speeds.
        q, v: coordinates and speeds of the tree, a tuple for each branch.
        where: where the joint's speeds are read.
        values: speeds that are given [rad/s, m/s].
    """
    if where.branch is not None:
        part, branch = v[where.branch], system.topology.branches[where.branch]
        place = at_start(branch, where.joint, q[where.branch], part)[0]
        values = at_start(branch, where.joint, place, values)[1]
    else:
        part = where.joint.speeds_at(*kinematics.relative_motion(where.closure, motions)[2])
    missed = tuple(jnp.asarray(sp.sub(a, b), float) for a, b in zip(part, values, strict=True))
    return Equations(missed, _rows(system, motions, where, len(values)))


def _rows(
    system: System, motions: tuple[Motion, ...], where: Source, count: int
) -> list[JacobianRow]:
    """Rows of the joint's own speeds."""
    if where.branch is not None:
        first = system.topology.branches[where.branch].speeds.start
        return [{first + i: 1.0} for i in range(count)]
    pose = kinematics.relative_motion(where.closure, motions)[1]
    return kinematics.relative_jacobian(system, motions, where.closure, pose, where.joint.speeds_at)


def _increment_from(joint: AbstractJoint, q: tuple, origin: tuple, turns: bool) -> tuple:
    """What leads from `origin` to q, to first order, in the joint's speeds held for unit time.
    `turns`: angles are known but for whole turns."""
    q = tuple(jnp.asarray(x, float) for x in q)
    quaternion = [i for i, unit in enumerate(joint.units) if unit == "1"]
    # A quaternion and its opposite are one rotation.
    side = jnp.where(sp.total(q[i] * origin[i] for i in quaternion) < 0, -1.0, 1.0)
    gap = [
        a - (side * b if i in quaternion else b)
        for i, (a, b) in enumerate(zip(q, origin, strict=True))
    ]
    if turns:
        angles = [i for i, unit in enumerate(joint.units) if unit == "rad"]
        gap = [jnp.arctan2(jnp.sin(x), jnp.cos(x)) if i in angles else x for i, x in enumerate(gap)]
    out = []
    count = len(joint.columns(joint.home))
    for j in range(count):
        moved = joint.rate(q, tuple(1.0 if i == j else 0.0 for i in range(count)))
        out.append(sp.dot(moved, gap) / sp.dot(moved, moved))
    return tuple(out)


def angular(joint: AbstractJoint) -> tuple[bool, ...]:
    """For each speed of a joint whether it turns: rad/s, not m/s."""
    return tuple(not all(map(sp.is_zero, column.angular)) for column in joint.columns(joint.home))


def scales(joint: AbstractJoint, arm: Any) -> tuple:
    """For each speed of a joint what counts as much as a radian: 1, or the length `arm` [m]."""
    return tuple(1.0 if turns else arm for turns in angular(joint))


def speed_scales(system: System, arm: Any) -> Float[Array, " v"]:
    """The same for each free speed of a mechanism."""
    parts: list[Any] = []
    for branch, link in zip(system.topology.branches, system.links, strict=True):
        if branch.speed_count:
            parts.extend(scales(link.joint, arm))
    return sp.stack(parts)
