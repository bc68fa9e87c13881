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
from jaxclear.formulations.contact_rows import ContactJacobianRow
from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import FLIP, Pose
from jaxclear.multibody import constraints, dynamics, kinematics
from jaxclear.multibody.forces import Forces, add_action_and_reaction
from jaxclear.multibody.kinematics import along
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


class Slip(NamedTuple):
    """Speed of such a joint, offset + row @ speeds; what drives prescribe is in the offset."""

    row: ContactJacobianRow
    offset: Any

    def at(self, speeds: Any) -> Any:
        return sp.add(self.offset, along(self.row, speeds))


def touching(system: System) -> tuple[PermanentJoint, ...]:
    """Joints that touch all the time: those of the tree, then those that close loops."""
    branches, loops = system.topology.branches, system.topology.loops
    found = [
        PermanentJoint(branch.name, system.links[i].joint, i, None)
        for i, branch in enumerate(branches)
    ]
    found += [PermanentJoint(name, system.closing[i], None, i) for i, name in enumerate(loops)]
    return tuple(held for held in found if isinstance(held.joint, AbstractRubbingJoint))


def speed_of(system: System, motions: tuple, held: PermanentJoint, speeds: list) -> Any:
    """Speed of a joint, at the mechanism's `speeds`."""
    if held.driven:
        twist = kinematics.joint_twist(system, motions, held.link)
        (column,) = held.joint.columns(held.joint.home)
        return sp.add(sp.dot(column.linear, twist.linear), sp.dot(column.angular, twist.angular))
    if held.loop is None:
        return speeds[system.topology.branches[held.link].speeds.start]
    relative = kinematics.relative_motion(system.closures[held.loop], motions)[2]
    return held.joint.speeds_at(*relative)[0]


def slip_of(system: System, motions: tuple, held: PermanentJoint, speeds: list) -> Slip:
    """How a joint's speed follows from the mechanism's `speeds`, at which the motions are taken."""
    if held.driven:
        return Slip({}, speed_of(system, motions, held, speeds))
    if held.loop is None:
        return Slip({system.topology.branches[held.link].speeds.start: 1}, 0)
    closure = system.closures[held.loop]
    pose = kinematics.relative_motion(closure, motions)[1]
    (row,) = kinematics.relative_jacobian(system, motions, closure, pose, held.joint.speeds_at)
    return Slip(row, sp.sub(speed_of(system, motions, held, speeds), along(row, speeds)))


def with_friction(system: System, forces: Forces, friction: Any) -> Forces:
    """The forces, with friction [N] added in each joint that touches, in the order of
    `touching`."""
    coordinate_forces, wrenches = list(forces.coordinate_forces), list(forces.wrenches)
    for k, held in enumerate(touching(system)):
        if held.driven:
            continue
        if held.loop is None:
            own = coordinate_forces[held.link][0]
            coordinate_forces[held.link] = (sp.add(own, held.joint.arm * friction[k]),)
            continue
        closure = system.closures[held.loop]
        pose = kinematics.relative_motion(closure, forces.motions)[1]
        add_action_and_reaction(wrenches, closure, pose, *held.joint.friction_wrench(friction[k]))
    return forces._replace(wrenches=tuple(wrenches), coordinate_forces=tuple(coordinate_forces))


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


def friction_response(model: Model, forces: Forces, q: tuple) -> FrictionResponse:
    """How the mechanism answers friction [N] in its touching joints, at coordinates `q`."""
    held = touching(model.system)
    rest = jnp.zeros(len(held))
    without, push = jax.linearize(
        lambda friction: sp.dense(_answer(model, forces, q, held, friction)), rest
    )
    return FrictionResponse(without, [push(rest.at[k].set(1.0)) for k in range(len(held))])


def _answer(model: Model, forces: Forces, q: tuple, touching_joints: tuple, friction) -> Answer:
    system = model.system
    forces = with_friction(system, forces, friction)
    solution = dynamics.forward_dynamics(system, forces, model.stabilisation)
    wrenches = dynamics.joint_wrenches(system, forces, solution)
    closed = []
    if any(held.link is None for held in touching_joints):
        found = constraints.constraint_wrenches(system, forces.motions, solution.multipliers)
        closed = [Reaction(force, torque) for _, force, torque, _ in found]
    reactions = tuple(
        closed[held.loop]
        if held.link is None
        else _reaction(system, held, forces.motions, q, wrenches[held.link])
        for held in touching_joints
    )
    accelerations = sp.stack([a for own in solution.accelerations for a in own])
    return Answer(accelerations, solution.multipliers, reactions)


def _reaction(system, held, motions, q, wrench) -> Reaction:
    """From the wrench that a link receives to the reaction on the connection's child in the parent
    marker's axes.
    """
    link, branch = system.links[held.link], system.topology.branches[held.link]
    if held.driven:
        pose = link.base.inverse().after(motions[held.link].relative)
    else:
        pose = link.joint.motion(q[held.link])
    return reaction_through(pose, branch.reversed, wrench)


def reaction_through(pose: Pose, turned_round: bool, wrench: Wrench) -> Reaction:
    """Reaction on a connection's child, from the wrench that a link receives through its joint and
    the joint's pose; `turned_round`: the tree goes through it from its child to its parent."""
    if not turned_round:
        return Reaction(
            sp.apply(pose.rotation, wrench.force), sp.apply(pose.rotation, wrench.torque)
        )
    force, torque = (tuple(sp.neg(x) for x in sp.apply(FLIP, part)) for part in wrench)
    return Reaction(force, sp.minus(torque, sp.cross(pose.translation, force)))
