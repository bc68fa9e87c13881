r"""Recursions over one subtree of the spanning tree, in body axes: forward kinematics, recursive
Newton-Euler, composite rigid bodies.

Each link's own frame sits at its inboard joint, so most joint motions and inertias are sparse or
constant. Accelerations are spatial; gravity enters as an upward acceleration of the ground. The
bias forces hold zero accelerations: :math:`M(q) \dot v + b(q, v, t) = f`. Source: Featherstone
2008, Rigid Body Dynamics Algorithms, chapters 5 and 6, doi:10.1007/978-1-4899-7560-7.
"""

from typing import Any, NamedTuple

import equinox as eqx

from jaxclear.components.joint import AbstractJoint
from jaxclear.components.joint.base import drive_of
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import STILL, Pose, Twist
from jaxclear.ground.quantity import Scalar


class Wrench(NamedTuple):
    """Force and torque about the frame's origin, in the frame's axes."""

    force: sp.Vec
    torque: sp.Vec


NOTHING = Wrench(sp.ZERO, sp.ZERO)


class Link(eqx.Module):
    """A body ready for the recursions, its numbers in the link's own frame: mass [kg], first moment
    of mass [kg m] and inertia [kg m2] about its origin. `base`: the inboard joint's frame in the
    parent link; `frame`: the link's frame in the body's; `parent`: index in the subtree, -1 for
    the ground; `rotor`: inertia that moves with the joint's single speed alone, None for none.
    """

    joint: AbstractJoint
    base: Pose
    frame: Pose
    mass: Scalar
    first_moment: sp.Vec
    inertia: sp.Mat
    parent: int = eqx.field(static=True)
    rotor: Scalar | None = None


class Motion(NamedTuple):
    """Motion of one link: pose in the parent link and in the ground, twist, twist of each free unit
    speed of its joint, and the bias acceleration: the part relative to the parent that does not
    depend on the free accelerations. Coordinates and speeds of its joint, and the accelerations
    that a drive prescribes."""

    relative: Pose
    pose: Pose
    twist: Twist
    columns: tuple[Twist, ...]
    bias: Twist
    coordinates: tuple = ()
    speeds: tuple = ()
    prescribed: tuple = ()


def transform_twist(relative: Pose, twist: Twist) -> Twist:
    """A parent's twist (or spatial acceleration) in the child's frame, the two rigidly joined:
    the motion transform from parent to child.
    """
    linear = sp.plus(twist.linear, sp.cross(twist.angular, relative.translation))
    return Twist(
        sp.apply_transposed(relative.rotation, linear),
        sp.apply_transposed(relative.rotation, twist.angular),
    )


def transform_wrench(relative: Pose, wrench: Wrench) -> Wrench:
    """A wrench on the child, about the child's origin, in the parent's frame: the force transform
    from child to parent."""
    force = sp.apply(relative.rotation, wrench.force)
    torque = sp.plus(
        sp.apply(relative.rotation, wrench.torque), sp.cross(relative.translation, force)
    )
    return Wrench(force, torque)


def add_twists(*twists: Twist) -> Twist:
    """Sum of twists in the same axes."""
    return Twist(sp.plus(*[t.linear for t in twists]), sp.plus(*[t.angular for t in twists]))


def linear_combination(columns: tuple[Twist, ...], factors: tuple) -> Twist:
    """Sum of factors times columns."""
    scaled = [
        Twist(sp.scale(f, c.linear), sp.scale(f, c.angular))
        for c, f in zip(columns, factors, strict=True)
    ]
    return add_twists(STILL, *scaled)


def power(twist: Twist, wrench: Wrench) -> Any:
    """Power of a wrench along a twist [W]."""
    return sp.add(sp.dot(twist.linear, wrench.force), sp.dot(twist.angular, wrench.torque))


def link_motions(
    links: tuple[Link, ...], coordinates: tuple, speeds: tuple, time: Scalar
) -> tuple[Motion, ...]:
    """Motions of a subtree's links, from root to tips.

    Args:
        links: of the subtree, parents first.
        coordinates, speeds: a tuple for each link, empty where a drive gives them.
        time: instant [s] of the drives.
    """
    motions: list[Motion] = []
    for link, q, v in zip(links, coordinates, speeds, strict=True):
        drive = drive_of(link.joint)
        acceleration: tuple = ()
        if drive is not None:
            q, v, acceleration = ((part,) for part in drive.motion(time))
        relative = link.base.after(link.joint.motion(q))
        columns = link.joint.columns(q)
        joint_twist = linear_combination(columns, v)
        parent = motions[link.parent] if link.parent >= 0 else None
        twist = (
            add_twists(transform_twist(relative, parent.twist), joint_twist)
            if parent
            else joint_twist
        )
        pose = parent.pose.after(relative) if parent else relative
        spin = Twist(
            sp.plus(
                sp.cross(twist.linear, joint_twist.angular),
                sp.cross(twist.angular, joint_twist.linear),
            ),
            sp.cross(twist.angular, joint_twist.angular),
        )
        bias = spin
        if drive is not None:
            bias = add_twists(bias, linear_combination(columns, acceleration))
        change = link.joint.bias(q, v)
        if change is not None:
            bias = add_twists(bias, change)
        free = () if drive is not None else columns
        motions.append(Motion(relative, pose, twist, free, bias, q, v, acceleration))
    return tuple(motions)


def link_accelerations(
    links: tuple[Link, ...], motions: tuple[Motion, ...], rates: tuple | None, ground: sp.Vec
) -> tuple[Twist, ...]:
    """Spatial accelerations of a subtree's links, in their axes [m/s2, rad/s2].

    Args:
        links: of the subtree, parents first.
        motions: of these links.
        rates: free accelerations, a tuple for each link; None: zero.
        ground: acceleration of the ground [m/s2], upwards where it stands for gravity.
    """
    accelerations: list[Twist] = []
    for index, (link, motion) in enumerate(zip(links, motions, strict=True)):
        inboard = accelerations[link.parent] if link.parent >= 0 else Twist(ground, sp.ZERO)
        parts = [transform_twist(motion.relative, inboard), motion.bias]
        if rates is not None:
            parts.append(linear_combination(motion.columns, rates[index]))
        accelerations.append(add_twists(*parts))
    return tuple(accelerations)


def joint_wrenches(
    links: tuple[Link, ...],
    motions: tuple[Motion, ...],
    accelerations: tuple[Twist, ...],
    loads: tuple[Wrench, ...],
) -> tuple[Wrench, ...]:
    """Wrench that each link receives through its inboard joint, in the link's frame.

    Args:
        links: of the subtree, parents first.
        motions: of these links.
        accelerations: spatial, of these links (`link_accelerations`).
        loads: wrench on each link about its origin, in its axes.
    """
    through: list[Any] = []
    for link, motion, acceleration, load in zip(links, motions, accelerations, loads, strict=True):
        velocity = motion.twist
        momentum = sp.plus(
            sp.scale(link.mass, velocity.linear), sp.cross(velocity.angular, link.first_moment)
        )
        spin = sp.plus(
            sp.apply(link.inertia, velocity.angular), sp.cross(link.first_moment, velocity.linear)
        )
        force = sp.plus(
            sp.scale(link.mass, acceleration.linear),
            sp.cross(acceleration.angular, link.first_moment),
            sp.cross(velocity.angular, momentum),
        )
        torque = sp.plus(
            sp.apply(link.inertia, acceleration.angular),
            sp.cross(link.first_moment, acceleration.linear),
            sp.cross(velocity.angular, spin),
            sp.cross(velocity.linear, momentum),
        )
        through.append(Wrench(sp.minus(force, load.force), sp.minus(torque, load.torque)))
    for index in range(len(links) - 1, -1, -1):
        parent = links[index].parent
        if parent >= 0:
            crossed = transform_wrench(motions[index].relative, through[index])
            through[parent] = Wrench(
                sp.plus(through[parent].force, crossed.force),
                sp.plus(through[parent].torque, crossed.torque),
            )
    return tuple(through)


def bias_forces(links, motions, ground: sp.Vec, loads: tuple[Wrench, ...]) -> tuple:
    """Generalised forces, one for each free speed, at which all free accelerations are zero.

    Args:
        links: of the subtree, parents first.
        motions: of these links.
        ground: acceleration of the ground [m/s2], upwards where it stands for gravity.
        loads: wrench on each link about its origin, in its axes.
    """
    through = joint_wrenches(
        links, motions, link_accelerations(links, motions, None, ground), loads
    )
    return tuple(
        power(column, wrench)
        for motion, wrench in zip(motions, through, strict=True)
        for column in motion.columns
    )


def mass_matrix(links: tuple[Link, ...], motions: tuple[Motion, ...]) -> tuple[tuple, ...]:
    """Mass matrix of a subtree as rows of sparse scalars, by composite rigid bodies."""
    composite = [(link.mass, link.first_moment, link.inertia) for link in links]
    for index in range(len(links) - 1, -1, -1):
        parent = links[index].parent
        if parent >= 0 and _has_free_speed(links, motions, parent):
            mass, moment, inertia = composite[index]
            rotation, offset = motions[index].relative
            rotated = sp.apply(rotation, moment)
            shifted = sp.shift_inertia(sp.congruence(rotation, inertia), mass, rotated, offset)
            sub_mass, sub_moment, sub_inertia = composite[parent]
            composite[parent] = (
                sp.add(sub_mass, mass),
                sp.plus(sub_moment, rotated, sp.scale(mass, offset)),
                sp.plus_matrix(sub_inertia, shifted),
            )
    places = [
        (index, k) for index, motion in enumerate(motions) for k in range(len(motion.columns))
    ]
    position = {place: number for number, place in enumerate(places)}
    rows = [[0] * len(places) for _ in places]
    for index, k in places:
        mass, moment, inertia = composite[index]
        column = motions[index].columns[k]
        wrench = Wrench(
            sp.plus(sp.scale(mass, column.linear), sp.cross(column.angular, moment)),
            sp.plus(sp.apply(inertia, column.angular), sp.cross(moment, column.linear)),
        )
        other = index
        while other >= 0:
            for m, against in enumerate(motions[other].columns):
                if other < index or m <= k:
                    entry = power(against, wrench)
                    rows[position[index, k]][position[other, m]] = entry
                    rows[position[other, m]][position[index, k]] = entry
            wrench = transform_wrench(motions[other].relative, wrench)
            other = links[other].parent
    for index, link in enumerate(links):
        if link.rotor is not None:
            part = position[index, 0]
            rows[part][part] = sp.add(rows[part][part], link.rotor)
    return tuple(map(tuple, rows))


def _has_free_speed(links, motions, index) -> bool:
    """True where the link or one of its ancestors has a free speed, so that its composite inertia
    is needed.
    """
    while index >= 0:
        if motions[index].columns:
            return True
        index = links[index].parent
    return False
