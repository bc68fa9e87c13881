"""Where a joint that touches all the time carries its reaction with its friction, and what is told
of it by them.

Friction at the side of a guide adds to the moment that it carries, and so to what it is a share of;
what a journal, a slideway or a ball carries does not hang on friction.
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.components.clearance import CarryingEnd, carried_load
from jaxclear.components.journal_film import film_of
from jaxclear.formulations.base import ContactReport
from jaxclear.formulations.loads_over_step import forces_of_means, with_loads
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent_reactions import (
    REACTION,
    PermanentJoint,
    Reaction,
    joint_part,
    slid,
    sliding_speeds,
    touching,
    with_friction,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.contact_point import JointReport
from jaxclear.multibody.forces import Forces, read_load
from jaxclear.multibody.rows import wrench_in_joint
from jaxclear.multibody.state import Followed
from jaxclear.multibody.system import System


def carrying_ends(
    joint: PermanentJoint, reaction: Reaction, friction: Any
) -> tuple[CarryingEnd, ...]:
    """Where a joint carries its reaction and friction: its ends with their contacts.

    Args:
        joint: that always touches.
        reaction: on its child, in the parent marker's axes.
        friction: [N]; of a ball three components.
    """
    if joint.joint.components > 1:
        none = (0.0,) * joint.joint.components
        load = carried_load(joint.joint.carrying_ends(*reaction, none))
        return joint.joint.carrying_ends(*reaction, tuple(safe_divide(x, load) for x in friction))
    return joint.joint.carrying_ends(*reaction, _friction_share(joint, reaction, friction))


def _friction_share(joint: PermanentJoint, reaction: Reaction, friction: Any) -> Any:
    """Friction beside the load that it adds to: two turns, and where they lead (Steffensen's
    extrapolation; the load is linear in the share until an end changes its side)."""
    if joint.joint.friction is None:
        return 0.0 * friction

    def better(share):
        return safe_divide(friction, carried_load(joint.joint.carrying_ends(*reaction, share)))

    first = better(0.0 * friction)
    second = better(first)
    third = better(second)
    step, change = third - second, third - 2 * second + first
    return third - safe_divide(step * step, change)


def pressing(joint: PermanentJoint, reaction: Reaction, friction: Any) -> Any:
    """Sum of the normal forces [N] of a joint's contacts; 0 where a film carries.

    Args:
        joint: that always touches.
        reaction: on its child, in the parent marker's axes.
        friction: [N]; of a ball three components.
    """
    ends = carrying_ends(joint, reaction, friction)
    if joint.joint.gap_load(joint.name) is not None:
        return 0.0 * jnp.asarray(sp.total(reaction.force))
    return sp.total(contact.normal_force for end in ends for contact in end.contacts)


def moved_in_films(
    model: Model, motions: tuple, followed: Followed, reactions: tuple[Reaction, ...], h: Any
) -> dict[int, Any]:
    """States of journals on films after a step, by index in the state.

    Args:
        model: of the run.
        motions: motion of every link, in the middle of the step.
        followed: states of the films before.
        reactions: mean, of the joints that touch.
        h: length of the step [s].
    """
    system, result = model.system, dict[int, Any]()
    for fixed, reaction in zip(touching(system), reactions, strict=True):
        name = film_of(fixed.name)
        if name in system.loads:
            load, place = system.loads[name], model.layout.states.index((name, "x"))
            (motion,) = read_load(system, motions, load, name, followed)[0]
            force = tuple(reaction.force[:2])
            after = load.moved(followed.states[name], motion.spin[2], force, h)
            result |= {model.layout.state_start + place + i: x for i, x in enumerate(after)}
    return result


def joint_components(system: System) -> tuple[tuple[str, int], ...]:
    """By joint that touches all the time, how many components its forces have in states that hold
    their impulses: its reaction, friction, the sum of the normal forces."""
    return tuple((one.name, REACTION + one.joint.components + 1) for one in touching(system))


def forces_of_impulses(instant: Instant, reports: dict[str, JointReport]) -> Forces:
    """Everything that acts at a saved instant whose state holds impulses, with the clearance joints
    as reported."""
    system = instant.model.system
    friction = [x for one in touching(system) for x in instant.means_of(one.name)[REACTION:-1]]
    forces = with_friction(system, instant.forces(reports), friction)
    return with_loads(system, forces, forces_of_means(instant))


def report_of_means(instant: Instant, name: str) -> ContactReport:
    """How a joint rubs at a saved instant whose state holds impulses."""
    (fixed,) = (one for one in touching(instant.model.system) if one.name == name)
    means = [jnp.asarray(x) for x in instant.means_of(name)]
    reaction = Reaction(tuple(means[:3]), tuple(means[3:REACTION]))
    return report(instant, fixed, reaction, tuple(means[REACTION:-1]))


def report(
    instant: Instant, fixed: PermanentJoint, reaction: Reaction, friction: tuple
) -> ContactReport:
    """Contact report of a joint that always touches.

    Args:
        instant: at which it is read.
        fixed: the joint.
        reaction: on its child, in the parent marker's axes.
        friction: its components [N].
    """
    joint = fixed.joint
    ends = carrying_ends(fixed, reaction, joint_part(friction, slice(0, len(friction))))
    result = sorted((c for end in ends for c in end.contacts), key=lambda c: c.number)
    slips = tuple(sliding_speeds(instant.model.system, instant.motions, fixed))
    sliding = [slid(joint, slips if len(slips) > 1 else slips[0], c.place) for c in result]
    offset, axis = _offset_and_axis(ends)
    normal = sp.stack([contact.normal_force for contact in result])
    if joint.gap_load(fixed.name) is not None:
        # The film carries, wherever the journal lies.
        offset = jnp.stack([*instant.followed.states[film_of(fixed.name)][:2], jnp.zeros(())])
        normal = 0.0 * normal
    loads = wrench_in_joint(instant.forces({}).rows, fixed.name)
    return ContactReport(
        offset,
        axis,
        jnp.zeros(len(result)),
        normal,
        sp.stack(sliding),
        jnp.abs(sp.stack([contact.friction for contact in result])),
        jnp.stack([sp.stack(contact.place) for contact in result]),
        sp.stack(sp.plus(reaction.force, loads.force)),
        sp.stack(sp.plus(reaction.torque, loads.torque)),
        ends,
    )


def _offset_and_axis(ends: tuple[CarryingEnd, ...]) -> tuple:
    """Where the journal lies in its gap, and how it leans."""
    offsets, lean = jnp.stack([sp.stack(end.offset) for end in ends]), jnp.zeros(3)
    if len(ends) == 2:
        lean = (offsets[1] - offsets[0]) / (ends[1].height - ends[0].height)
    axis = (lean + jnp.array([0.0, 0.0, 1.0])) / jnp.sqrt(1 + lean @ lean)
    return jnp.mean(offsets, 0), axis
