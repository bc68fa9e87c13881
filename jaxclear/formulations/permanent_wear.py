"""What joints that touch all the time wear away: by the reaction, where it is carried.

The motion is that of the ideal joint, which wear does not change. A journal also slides as its
centre goes round in the gap with the direction of the reaction.
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.components.clearance import CarryingEnd
from jaxclear.components.joint import AbstractRubbingJoint
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_reactions import (
    Answer,
    PermanentJoint,
    joint_part,
    placed,
    slid,
    touching,
)
from jaxclear.formulations.permanent_report import carrying_ends
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody import kinematics
from jaxclear.multibody.system import System

# By joint the ends that carry, and of each its centre in the gap [m] or how fast that moves [m/s].
Ends = dict[str, tuple[CarryingEnd, ...]]
Centres = dict[str, list[sp.Vec]]


def ends_that_wear(system: System, answer: Answer, friction: Any) -> Ends:
    """Where joints that wear carry their reactions, by joint.

    Args:
        system: with the joints.
        answer: reactions of the joints that touch.
        friction: components in all joints [N].
    """
    joints = touching(system)
    parts = zip(joints, answer.reactions, placed(joints), strict=True)
    return {
        fixed.name: carrying_ends(fixed, reaction, joint_part(friction, place))
        for fixed, reaction, place in parts
        if fixed.joint.maps()
    }


def centres_of(system: System, ends: Ends) -> Centres:
    """Where in the gap [m] the ends of those joints lie that turn in one."""
    turning = {fixed.name for fixed in touching(system) if fixed.joint.has_moving_centre}
    return {name: [end.offset for end in part] for name, part in ends.items() if name in turning}


def count_of_centres(system: System) -> int:
    """How many centres `centres_of` what wears knows."""
    joints = [fixed.joint for fixed in touching(system)]
    saved = [joint for joint in joints if joint.maps() and joint.has_moving_centre]
    ratios = [0.0 if joint.components == 1 else (0.0,) * joint.components for joint in saved]
    pairs = zip(saved, ratios, strict=True)
    return sum(len(joint.carrying_ends(sp.ZERO, sp.ZERO, ratio)) for joint, ratio in pairs)


def wear_rates(
    model: Model,
    motions: tuple,
    q: tuple,
    carrying: Ends,
    slips: list,
    centres: Centres | None = None,
) -> list:
    """Rates of worn volumes and of their volume-weighted locations, in the layout's order.

    Args:
        model: of the run.
        motions: motion of every link at one instant, in the order of `system.links`.
        q: coordinates, a tuple for each link.
        carrying: ends at which the joints carry, by joint.
        slips: sliding speeds of the components of all joints [m/s].
        centres: velocities of the parts' centres in the gap [m/s], by joint; None: at rest.
    """
    system, rates = model.system, []
    at = {fixed.name: k for k, fixed in enumerate(touching(system))}
    places = placed(touching(system))
    carried = {}
    for fixed in touching(system):
        if fixed.name in carrying:
            ends, depths = _indent_ends(fixed.joint, carrying[fixed.name])
            carried[fixed.name] = (*_pose_in_gap(system, motions, q, fixed, ends), ends, depths)
    for slot in model.layout.wear:
        if slot.bearing not in at:
            continue
        k = at[slot.bearing]
        joint = touching(system)[k].joint
        offset, axes, ends, depths = carried[slot.bearing]
        ((end, contact),) = (
            (j, c) for j, e in enumerate(ends) for c in e.contacts if c.number == slot.contact
        )
        _, wearing = joint.maps()[slot.surface]
        moves = None if centres is None else centres.get(slot.bearing)
        slip = joint_part(slips, places[k])
        speed = slid(joint, slip, contact.place, sp.ZERO if moves is None else moves[end])
        volume = wearing.acceleration * wearing.law.volume_rate(
            contact.normal_force, speed, jnp.abs(contact.friction)
        )
        pressed = depths[slot.contact]
        place = joint.wear_place(slot.surface, offset, axes, slot.contact, pressed)
        rates += [volume, *(sp.mul(volume, place[i]) for i in slot.averaged)]
    return rates


def _indent_ends(
    joint: AbstractRubbingJoint, ends: tuple[CarryingEnd, ...]
) -> tuple[tuple[CarryingEnd, ...], dict[int, Any]]:
    """The ends as far beyond the play as their forces press them, so that what leans is known, and
    the indentation of each contact [m] by its number."""
    depth: list[CarryingEnd] = []
    depths: dict[int, Any] = {}
    for end in ends:
        part = {c.number: joint.indentation(c.number, c.normal_force) for c in end.contacts}
        depths |= part
        beyond = sp.total(part.values())
        if not sp.is_zero(beyond):
            across = (*end.offset[:2], 0)
            beyond = sp.scale(safe_divide(beyond, sp.norm(across)), across)
            end = end._replace(offset=sp.plus(end.offset, beyond))
        depth.append(end)
    return tuple(depth) if len(ends) > 1 else ends, depths


def _pose_in_gap(
    system: System, motions: tuple, q: tuple, joint: PermanentJoint, ends: tuple[CarryingEnd, ...]
) -> tuple[sp.Vec, tuple]:
    """(offset [m] of the journal's centre in the gap, its axes on which the gap depends)."""
    share = 1 / len(ends)
    offset = sp.scale(share, sp.plus(sp.ZERO, *(end.offset for end in ends)))
    pose: Any = None
    if joint.loop is not None:
        pose = kinematics.relative_motion(system.closures[joint.loop], motions)[1]
    closes = pose is not None
    if joint.joint.gap_axes == (0, 1, 2):
        if not closes and system.topology.branches[joint.link].reversed:
            return offset, joint.joint.motion(q[joint.link]).rotation
        turn = pose.rotation if closes else joint.joint.motion(q[joint.link]).rotation
        return offset, sp.transpose(turn)
    lean: sp.Vec = sp.ZERO
    if joint.joint.gap_axes and len(ends) == 2:
        between = sp.minus(ends[1].offset, ends[0].offset)
        lean = sp.scale(1 / (ends[1].height - ends[0].height), between)
    if joint.joint.units == ("m",):
        place = (*offset[:2], pose.translation[2] if closes else q[joint.link][0])
        return place, ((1, 0, sp.neg(lean[0])), (lean[0], lean[1], 1))
    # Turns of the journal are large, leans of the order of clearance over length.
    result = {2: (lean[0], lean[1], 1)}
    if 0 in joint.joint.gap_axes:
        rotated: Any = 0.0 if closes else q[joint.link][0]
        result[0] = (
            sp.transpose(pose.rotation)[0] if closes else (jnp.cos(rotated), jnp.sin(rotated), 0)
        )
    return offset, tuple(result[axis] for axis in joint.joint.gap_axes)
