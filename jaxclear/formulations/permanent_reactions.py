"""Joints that touch all the time: their sliding speeds, and the motion and reactions of the
mechanism as linear functions of their friction.

Accelerations, closure multipliers and reactions R at an instant are linear in the friction T of the
joints, R = R0 + dR/dT T: what Delassus' operator is for contacts.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.joint import AbstractRubbingJoint
from jaxclear.components.joint.base import drive_of
from jaxclear.formulations.loads_over_step import NO_LOADS, LoadsInStep, with_loads
from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.pose import FLIP, Pose
from jaxclear.multibody import constraints, dynamics, kinematics
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces, with_rows
from jaxclear.multibody.rows import (
    Direction,
    LinearRate,
    OnClosure,
    OnLink,
    Row,
    wrench_in_joint,
)
from jaxclear.multibody.system import System
from jaxclear.multibody.tree import Wrench


class PermanentJoint(NamedTuple):
    """A joint that touches all the time: its connection, and the link that it holds in the tree or
    the loop that it closes.
    """

    name: str
    joint: Any  # an AbstractRubbingJoint
    link: Any  # a whole number, or None
    loop: int | None

    @property
    def driven(self) -> bool:
        """Whether a drive prescribes its motion, which friction then does not change."""
        return drive_of(self.joint) is not None


def touching(system: System) -> tuple[PermanentJoint, ...]:
    """Joints that touch all the time: those of the tree, then those that close loops."""
    branches, loops = system.topology.branches, system.topology.closing
    joints = [
        PermanentJoint(branch.name, system.links[i].joint, i, None)
        for i, branch in enumerate(branches)
    ]
    joints += [PermanentJoint(name, system.closing[i], None, i) for i, name in enumerate(loops)]
    return tuple(joint for joint in joints if isinstance(joint.joint, AbstractRubbingJoint))


def placed(joints: tuple[PermanentJoint, ...]) -> tuple[slice, ...]:
    """Where the friction and the sliding speeds of each joint lie among those of all."""
    out, start = [], 0
    for one in joints:
        out.append(slice(start, start + one.joint.components))
        start += one.joint.components
    return tuple(out)


def joint_part(values: Any, place: slice) -> Any:
    """A joint's own among the values of all: one number, of a ball three."""
    if place.stop - place.start == 1:
        return values[place.start]
    return tuple(values[i] for i in range(place.start, place.stop))


def slid(joint: AbstractRubbingJoint, slip: Any, place: sp.Vec, centre: sp.Vec = sp.ZERO) -> Any:
    """Sliding speed [m/s] at a contact of a joint that always touches.

    Args:
        joint: ideal joint that rubs.
        slip: sliding speed of the joint [m/s]; of a ball that of its surface, a vector.
        place: of the contact, towards which the normal points [m].
        centre: velocity of the inner part's centre in the gap [m/s].
    """
    still = all(sp.is_zero(x) for x in centre)
    if joint.components == 1 and still:
        return jnp.abs(slip)
    size = sp.norm(place)
    normal = tuple(safe_divide(x, size) for x in place)
    if joint.components == 1:
        x, y, _ = normal
        return jnp.abs(slip + x * centre[1] - y * centre[0])
    if still:
        return sp.norm(sp.minus(slip, sp.scale(sp.dot(slip, normal), normal)))
    surface = sp.plus(sp.cross(slip, normal), centre)
    return sp.norm(sp.minus(surface, sp.scale(sp.dot(surface, normal), normal)))


def _rotation_to_parent(system: System, motions: tuple, joint: PermanentJoint) -> sp.Mat:
    """From the speeds of a ball of the tree to its angular velocity in the parent marker's axes."""
    if system.topology.branches[joint.link].reversed:
        return tuple(tuple(sp.neg(x) for x in row) for row in sp.IDENTITY)
    return joint_pose(system, motions, joint).rotation


def joint_pose(system: System, motions: tuple, joint: PermanentJoint) -> Pose:
    """Pose of the outer marker of a joint of the tree in the inner one.

    Args:
        system: with the links.
        motions: motion of every link at one instant, in the order of `system.links`.
        joint: of the tree.
    """
    return system.links[joint.link].base.inverse().after(motions[joint.link].relative)


def sliding_directions(
    system: System, motions: tuple, pair: PermanentJoint
) -> tuple[Direction, ...]:
    """Direction of each component of a joint's friction, which moves at its sliding speed [m/s].

    Those of a ball are axes of the parent marker, at the speed of its surface.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        pair: joint that always touches.
    """
    joint, link, name = pair.joint, pair.link, pair.name
    if pair.loop is not None:
        closure = system.closures[pair.loop]
        pose = kinematics.relative_motion(closure, motions)[1]
        units: Any = (1,) if joint.components == 1 else sp.IDENTITY
        wrenches = [Wrench(*joint.friction_wrench(unit)) for unit in units]
        return tuple(Direction((OnClosure(closure, pose, each, name),)) for each in wrenches)
    if joint.components == 1:
        return (Direction((OnLink(link, joint.arm),)),)
    turn = _rotation_to_parent(system, motions, pair)
    parts = [[OnLink(link, sp.mul(joint.arm, x), j) for j, x in enumerate(row)] for row in turn]
    return tuple(Direction(tuple(each)) for each in parts)


def sliding_rates(system: System, motions: tuple, joint: PermanentJoint) -> tuple[LinearRate, ...]:
    """Components of a joint's sliding speed [m/s], with their Jacobian rows.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        joint: that always touches.
    """
    directions = sliding_directions(system, motions, joint)
    return tuple(each.linear_rate(system, motions) for each in directions)


def sliding_speeds(system: System, motions: tuple, joint: PermanentJoint) -> list:
    """Components of a joint's sliding speed [m/s].

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        joint: that always touches.
    """
    return [each.rate(motions) for each in sliding_directions(system, motions, joint)]


def with_friction(system: System, forces: Forces, friction: Any) -> Forces:
    """The forces with friction in every joint that always touches.

    Args:
        system: with the joints, in the order of `touching`.
        forces: without friction.
        friction: components in all joints [N].
    """
    rows, joints = [], touching(system)
    for joint, place in zip(joints, placed(joints), strict=True):
        # What friction does to a joint that a drive moves, the drive takes.
        directions = () if joint.driven else sliding_directions(system, forces.motions, joint)
        for k, direction in enumerate(directions, place.start):
            rows.append(Row(joint.name, direction, friction[k]))
    return with_rows(forces, rows)


# Numbers of a reaction: force and torque.
REACTION = 6


class Reaction(NamedTuple):
    """Force [N] and torque [N m] on a joint's child about its marker, in the parent marker's
    axes."""

    force: sp.Vec
    torque: sp.Vec


class Answer(NamedTuple):
    """What follows from the friction of the joints: free accelerations, closure multipliers,
    reactions of touching joints.
    """

    accelerations: Any
    multipliers: Any
    reactions: tuple[Reaction, ...]


class FrictionResponse(NamedTuple):
    """The answer without friction, and what a unit of friction in each joint adds."""

    without: Answer
    units: list[Answer]

    def at(self, friction: Any) -> Answer:
        """The answer at some friction."""
        return jax.tree.map(
            lambda x, *slopes: x + sum(s * friction[k] for k, s in enumerate(slopes)),
            self.without,
            *self.units,
        )


def friction_response(
    model: Model, forces: Forces, q: tuple, loads: LoadsInStep = NO_LOADS
) -> FrictionResponse:
    """Accelerations and reactions as linear functions of friction and of loads' forces.

    Args:
        model: of the run.
        forces: all that acts but these.
        q: coordinates, a tuple for each link.
        loads: whose forces follow the friction, along their rows.
    """
    joints = touching(model.system)
    count = sum(one.joint.components for one in joints)
    rest = jnp.zeros(count + len(loads.rates))

    def answer(friction):
        acting = with_friction(model.system, forces, friction)
        sums = loads.by_load(model.system, [friction[count + i] for i in range(len(loads.rates))])
        acting = with_loads(model.system, acting, sums)
        solution = dynamics.forward_dynamics(model.system, acting, model.stabilisation)
        return sp.dense(answer_to(model.system, acting, q, joints, solution))

    without, push = jax.linearize(answer, rest)
    return FrictionResponse(without, [push(rest.at[k].set(1.0)) for k in range(len(rest))])


def answer_to(
    system: System, forces: Forces, q: tuple, touching_joints: tuple, solution: Solution
) -> Answer:
    """Accelerations, multipliers, and reactions of the joints that touch.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        forces: that cause the solution.
        q: coordinates, a tuple for each link.
        touching_joints: whose reactions are computed.
        solution: accelerations and multipliers.
    """
    acting = dynamics.with_closures(system, forces, solution)
    wrenches = dynamics.joint_wrenches(system, acting, solution)
    closing = acting.rows[len(forces.rows) :]
    reactions = tuple(
        Reaction(*wrench_in_joint([row for row in closing if row.owner == joint.name], joint.name))
        if joint.link is None
        else reaction_of_link(system, joint, forces.motions, q, wrenches[joint.link])
        for joint in touching_joints
    )
    accelerations = sp.stack([a for part in solution.accelerations for a in part])
    return Answer(accelerations, solution.multipliers, reactions)


def reaction_of_link(system, joint, motions, q, wrench) -> Reaction:
    """Reaction on a connection's child in the parent marker's axes, for a joint of the tree.

    Args:
        system: with the links.
        joint: that always touches.
        motions: motion of every link.
        q: coordinates, a tuple for each link.
        wrench: that the link receives through the joint, in the link's frame.
    """
    branch = system.topology.branches[joint.link]
    if joint.driven:
        pose = joint_pose(system, motions, joint)
    else:
        pose = system.links[joint.link].joint.motion(q[joint.link])
    return reaction_through(pose, branch.reversed, wrench, joint.joint.reversal)


def reaction_through(
    pose: Pose, is_reversed: bool, wrench: Wrench, turn: sp.Mat = FLIP
) -> Reaction:
    """Reaction on a connection's child in the parent marker's axes.

    Args:
        pose: of the joint.
        is_reversed: whether the tree goes through it from its child to its parent.
        wrench: that the link receives through the joint, in the link's frame.
        turn: rotation between marker and link frame of a reversed joint.
    """
    if not is_reversed:
        return Reaction(
            sp.apply(pose.rotation, wrench.force), sp.apply(pose.rotation, wrench.torque)
        )
    force, torque = (tuple(sp.neg(x) for x in sp.apply(turn, part)) for part in wrench)
    return Reaction(force, sp.minus(torque, sp.cross(pose.translation, force)))


class ReactionNotUnique(ValueError):
    """Friction would hang on a reaction that is not unique."""


def check_unique(system: System) -> None:
    """Raises `ReactionNotUnique` where friction would hang on a reaction that is not unique.

    Source: Wojtyra 2017, Multibody Syst. Dyn. 39, 337, doi:10.1007/s11044-016-9535-6.
    """
    redundancy = system.topology.redundancy
    for joint in touching(system):
        rubs = joint.joint.friction is not None and joint.joint.follows_reaction
        if redundancy is not None and rubs and joint.name in redundancy.joints:
            raise ReactionNotUnique(
                f'friction in joint "{joint.name}" follows its reaction, which is not unique: the '
                f"loops are {redundancy} Leave its friction out, give another joint of this loop "
                "more freedom, or take a compliant integrator such as ImplicitStep."
            )


def reactions_without_motion(
    system: System, motions: tuple, q: tuple, joints: tuple[PermanentJoint, ...], in_space: bool
) -> list[tuple[Reaction, ...]]:
    """Reactions in equilibrium with each other, for each row of a loop that no motion changes.

    They are those of a force 1 [N, N m] in the row.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        q: coordinates, a tuple for each link.
        joints: whose reactions are computed.
        in_space: whether bodies move in space; in the plane, rows that are structurally 0 are
            unloaded.
    """
    answers = []
    for k, closure in enumerate(system.closures):
        rows = constraints.constraint_rows(system, motions, closure)
        places = [i for i in range(len(closure.rows)) if i not in rows.moving]
        for place in places if in_space else rows.fixed:
            unit: tuple = tuple({place: 1.0} if j == k else {} for j in range(len(system.closures)))
            closing, through = constraints.wrenches_of_rows(system, motions, unit)
            reactions = tuple(
                Reaction(*closing[one.loop])
                if one.loop is not None
                else reaction_of_link(system, one, motions, q, through[one.link])
                for one in joints
            )
            answers.append(reactions)
    return answers
