"""What is told of a joint that touches all the time, from its reaction and its friction."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import CarryingEnd, carried_load
from jaxclear.components.joint import AbstractRubbingJoint
from jaxclear.formulations.base import ContactReport
from jaxclear.formulations.model import Instant
from jaxclear.formulations.permanent_reactions import PermanentJoint, Reaction, speed_of
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide

# A guide's friction adds to the moment and so to the sizes; a pass shrinks the error of the ratio
# to half of it or, at worst, to (1 + mu width / length) / 2.
PASSES = 40


def report(
    instant: Instant, held: PermanentJoint, reaction: Reaction, friction: Any
) -> ContactReport:
    """How a joint carries its reaction and friction [N] at an instant."""
    joint = held.joint
    ends = _ends(joint, reaction, friction)
    found = sorted((c for end in ends for c in end.contacts), key=lambda c: c.number)
    speed = speed_of(instant.model.system, instant.motions, held, instant.speeds)
    offset, axis = _offset_and_axis(ends)
    return ContactReport(
        offset,
        axis,
        jnp.zeros(len(found)),
        sp.stack([contact.normal_force for contact in found]),
        jnp.full(len(found), jnp.abs(joint.arm * speed)),
        jnp.abs(sp.stack([contact.friction for contact in found])),
        jnp.stack([sp.stack(contact.place) for contact in found]),
        sp.stack(reaction.force),
        sp.stack(reaction.torque),
        ends,
    )


def _ends(
    joint: AbstractRubbingJoint, reaction: Reaction, friction: Any
) -> tuple[CarryingEnd, ...]:
    """Where a joint's reaction and friction are carried."""

    def improve(_, ratio):
        # Half the way: friction that adds to the forces more than the forces to friction would
        # overshoot.
        load = carried_load(joint.carrying_ends(*reaction, ratio))
        return 0.5 * (ratio + safe_divide(friction, load))

    ratio = jax.lax.fori_loop(0, PASSES, improve, jnp.zeros(()))
    return joint.carrying_ends(*reaction, ratio)


def _offset_and_axis(ends: tuple[CarryingEnd, ...]) -> tuple:
    """Where the journal lies in its gap, and how it leans."""
    offsets, lean = jnp.stack([sp.stack(end.offset) for end in ends]), jnp.zeros(3)
    if len(ends) == 2:
        lean = (offsets[1] - offsets[0]) / (ends[1].height - ends[0].height)
    axis = (lean + jnp.array([0.0, 0.0, 1.0])) / jnp.sqrt(1 + lean @ lean)
    return jnp.mean(offsets, 0), axis
