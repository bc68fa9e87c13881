"""Motion of the whole mechanism: of every link, of one marker as seen from another, and how both
follow from unit speeds.

Nothing here knows of forces. Alike subtrees are traced once.
"""

from collections.abc import Callable, Iterable
from typing import Any

import jax

from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_grouped, map_many
from jaxclear.ground.pose import STILL, Pose, Twist
from jaxclear.multibody import loops, tree
from jaxclear.multibody.loops import Closure, Relative
from jaxclear.multibody.system import System
from jaxclear.multibody.tree import Motion

# A row of a Jacobian: its entries by the index of the free speed, those that are not zero.
JacobianRow = dict[int, Any]


def along(row: JacobianRow, speeds: Any) -> Any:
    """A row of a Jacobian times a vector of speeds.

    Args:
        row: entries of the row by the index of the speed, a dict.
        speeds: speeds [m/s, rad/s], an array or tuple.

    Returns:
        the rate of what the row is the gradient of [per s].
    """
    return sp.total(sp.mul(entry, speeds[j]) for j, entry in row.items())


def link_motions(system: System, q: tuple, v: tuple, time: Any) -> tuple[Motion, ...]:
    """Motion of every link; alike subtrees are traced once.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        q: coordinates, a tuple for each link (empty where driven).
        v: speeds, a tuple for each link (empty where driven).
        time: instant [s], from which driven joints take their motion.
    """
    calls = [
        (*by_subtree(subtree, system.links, q, v), time) for subtree in system.topology.subtrees
    ]
    with jax.named_scope("kinematics"):
        return tuple(motion for part in map_grouped(tree.link_motions, calls) for motion in part)


def link_accelerations(
    system: System, motions: tuple[Motion, ...], accelerations: tuple | None
) -> tuple[Twist, ...]:
    """Spatial acceleration of every link, in its axes, with the fictitious part for gravity.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        accelerations: free accelerations, a tuple for each link; None: zero.
    """
    ground = upward(system)
    out: list[Twist] = []
    for subtree in system.topology.subtrees:
        links, part = by_subtree(subtree, system.links, motions)
        free = None if accelerations is None else tuple(accelerations[i] for i in subtree)
        out.extend(tree.link_accelerations(links, part, free, ground))
    return tuple(out)


def upward(system: System) -> sp.Vec:
    """Acceleration of the ground [m/s^2] that stands for gravity."""
    return tuple(sp.neg(x) for x in system.gravity)


def by_subtree(subtree: tuple[int, ...], *parts: tuple) -> tuple[tuple, ...]:
    """The entries of one subtree from sequences by link."""
    return tuple(tuple(part[i] for i in subtree) for part in parts)


def relative_motion(
    closure: Closure, motions: tuple[Motion, ...]
) -> tuple[loops.Sides, Pose, Relative]:
    """The closure's markers, and the child's marker as seen from the parent's."""
    view = loops.sides(closure, tuple(m.pose for m in motions), tuple(m.twist for m in motions))
    pose = loops.relative_pose(view)
    velocity, spin = loops.relative_velocity(pose, view.parent_twist, view.child_twist)
    return view, pose, Relative(pose, velocity, spin)


def relative_motions(closures: Iterable[Closure], motions: tuple[Motion, ...]) -> list[Relative]:
    """The same of many closures, without their markers; alike ones are traced once."""

    def one(parent, child, parent_ends, child_ends):
        pose_and_twist = lambda ends: (None, None) if ends is None else ends
        (parent_pose, parent_twist), (child_pose, child_twist) = map(
            pose_and_twist, (parent_ends, child_ends)
        )
        view = loops.Sides(
            loops.marker_pose(parent_pose, parent),
            loops.marker_pose(child_pose, child),
            loops.marker_twist(parent_twist, parent),
            loops.marker_twist(child_twist, child),
        )
        pose = loops.relative_pose(view)
        return Relative(pose, *loops.relative_velocity(pose, view.parent_twist, view.child_twist))

    ends = lambda link: None if link is None else (motions[link].pose, motions[link].twist)
    return map_many(
        one, [(c.parent, c.child, ends(c.parent_link), ends(c.child_link)) for c in closures]
    )


def ancestry(system: System, link: int | None) -> list[int]:
    """Links from a link to its root, the link first; none for the ground."""
    if link is None:
        return []
    subtree = next(subtree for subtree in system.topology.subtrees if link in subtree)
    path = [link]
    while system.links[path[-1]].parent >= 0:
        path.append(subtree[system.links[path[-1]].parent])
    return path


def jacobian_columns(
    system: System, motions: tuple[Motion, ...], link: int | None
) -> dict[int, Twist]:
    """Twist of a link for each free unit speed that moves it, in the link's axes, by speed index.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        link: index; None: the ground, which no speed moves.
    """
    columns: dict[int, Twist] = {}
    for index in reversed(ancestry(system, link)):
        columns = {
            j: tree.transform_twist(motions[index].relative, twist) for j, twist in columns.items()
        }
        start = system.topology.branches[index].speeds.start
        columns |= {start + k: column for k, column in enumerate(motions[index].columns)}
    return columns


def relative_jacobian(
    system: System, motions: tuple[Motion, ...], closure: Closure, pose: Pose, rates: Callable
) -> list[JacobianRow]:
    """Jacobian rows, by speed index, of rates that are linear in a closure's relative motion.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        closure: pair of markers.
        pose: the child's marker in the parent's.
        rates: function of the pose, relative velocity [m/s] and spin [rad/s]: one rate for each
            row.
    """
    rows: list[JacobianRow] = [{} for _ in rates(pose, sp.ZERO, sp.ZERO)]
    ends = ((closure.parent_link, closure.parent), (closure.child_link, closure.child))
    for side, (link, marker) in enumerate(ends):
        for j, column in jacobian_columns(system, motions, link).items():
            twist = loops.marker_twist(column, marker)
            pair = (twist, STILL) if side == 0 else (STILL, twist)
            entries = rates(pose, *loops.relative_velocity(pose, *pair))
            for row, entry in zip(rows, entries, strict=True):
                if not sp.is_zero(entry):
                    row[j] = sp.add(row.get(j, 0), entry)
    return rows


def relative_jacobians(
    system: System, motions: tuple[Motion, ...], closures: list[Closure], rates: list[tuple]
) -> list[list[JacobianRow]]:
    """Jacobian rows of many closures (`relative_jacobian`); alike ones are traced once.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        closures: pairs of markers.
        rates: for each closure a function, its first arguments (a tuple), and the pose; the
            function
            also takes the relative velocity and spin.
    """
    columns = [
        [jacobian_columns(system, motions, link) for link in (part.parent_link, part.child_link)]
        for part in closures
    ]

    def entries(values, pose, markers, twists, rates):
        result = []
        for side, (marker, entry) in enumerate(zip(markers, twists, strict=True)):
            for column in entry:
                twist = loops.marker_twist(column, marker)
                pair = (twist, STILL) if side == 0 else (STILL, twist)
                velocities = loops.relative_velocity(pose, *pair)
                result.append(tuple(rates(*values, pose, *velocities)))
        return tuple(result)

    calls = [
        (inputs, pose, (part.parent, part.child), tuple(tuple(x.values()) for x in moved), function)
        for part, moved, (function, inputs, pose) in zip(closures, columns, rates, strict=True)
    ]
    jacobians = []
    each = zip(columns, rates, map_many(entries, calls), strict=True)
    for moved, (function, inputs, pose), out in each:
        places = [j for part in moved for j in part]
        like = out[0] if out else function(*inputs, pose, sp.ZERO, sp.ZERO)
        rows: list[JacobianRow] = [{} for _ in like]
        for j, part in zip(places, out, strict=True):
            for row, entry in zip(rows, part, strict=True):
                if not sp.is_zero(entry):
                    row[j] = sp.add(row.get(j, 0), entry)
        jacobians.append(rows)
    return jacobians


def joint_twist(system: System, motions: tuple[Motion, ...], index: int) -> Twist:
    """Twist of a link relative to its parent link, in the link's axes.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        index: of the link.
    """
    path = ancestry(system, index)
    twist = motions[index].twist
    if len(path) == 1:
        return twist
    inboard = tree.transform_twist(motions[index].relative, motions[path[1]].twist)
    return Twist(sp.minus(twist.linear, inboard.linear), sp.minus(twist.angular, inboard.angular))
