"""What is told of a joint that touches all the time, from its reaction and its friction."""

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import CarryingEnd, carried_load
from jaxclear.components.joint import AbstractRubbingJoint
from jaxclear.formulations.base import ContactReport
from jaxclear.formulations.model import Instant
from jaxclear.formulations.permanent_reactions import (
    REACTION,
    PermanentJoint,
    Reaction,
    slid,
    speeds_of,
    touching,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.system import System

# A guide's friction adds to the moment and so to the sizes; a pass shrinks the error of the ratio
# to half of it or, at worst, to (1 + mu width / length) / 2.
PASSES = 40


def joint_components(system: System) -> tuple[tuple[str, int], ...]:
    """By joint that touches all the time, how many components its forces have in states that hold
    their impulses: its reaction, friction, the sum of the normal forces."""
    return tuple((one.name, REACTION + one.joint.components + 1) for one in touching(system))


def friction_of(instant: Instant, name: str) -> list:
    """Components of a joint's friction [N] at a saved instant whose state holds impulses."""
    return instant.means_of(name)[REACTION:-1]


def report_of_means(instant: Instant, name: str) -> ContactReport:
    """How a joint rubs at a saved instant whose state holds impulses."""
    (held,) = (one for one in touching(instant.model.system) if one.name == name)
    means = [jnp.asarray(x) for x in instant.means_of(name)]
    reaction = Reaction(tuple(means[:3]), tuple(means[3:REACTION]))
    return report(instant, held, reaction, tuple(means[REACTION:-1]))


def report(
    instant: Instant, held: PermanentJoint, reaction: Reaction, friction: tuple
) -> ContactReport:
    """How a joint carries its reaction and the components of its friction [N] at an instant."""
    joint = held.joint
    ends = _ends(joint, reaction, friction)
    found = sorted((c for end in ends for c in end.contacts), key=lambda c: c.number)
    speeds = speeds_of(instant.model.system, instant.motions, held, instant.speeds)
    slips = tuple(sp.mul(joint.arm, x) for x in speeds)
    sliding = [slid(joint, slips if len(slips) > 1 else slips[0], c.place) for c in found]
    offset, axis = _offset_and_axis(ends)
    return ContactReport(
        offset,
        axis,
        jnp.zeros(len(found)),
        sp.stack([contact.normal_force for contact in found]),
        sp.stack(sliding),
        jnp.abs(sp.stack([contact.friction for contact in found])),
        jnp.stack([sp.stack(contact.place) for contact in found]),
        sp.stack(reaction.force),
        sp.stack(reaction.torque),
        ends,
    )


def _ends(
    joint: AbstractRubbingJoint, reaction: Reaction, friction: tuple
) -> tuple[CarryingEnd, ...]:
    """Where a joint's reaction and friction are carried."""

    def improve(_, ratio):
        # Half the way: friction that adds to the forces more than the forces to friction would
        # overshoot.
        load = carried_load(joint.carrying_ends(*reaction, shares(ratio)))
        return 0.5 * (ratio + safe_divide(rubbed, load))

    # A ball's has three components.
    shares = lambda ratio: ratio[0] if len(friction) == 1 else tuple(ratio)
    rubbed = sp.stack(friction)
    ratio = jax.lax.fori_loop(0, PASSES, improve, jnp.zeros(len(friction)))
    return joint.carrying_ends(*reaction, shares(ratio))


def _offset_and_axis(ends: tuple[CarryingEnd, ...]) -> tuple:
    """Where the journal lies in its gap, and how it leans."""
    offsets, lean = jnp.stack([sp.stack(end.offset) for end in ends]), jnp.zeros(3)
    if len(ends) == 2:
        lean = (offsets[1] - offsets[0]) / (ends[1].height - ends[0].height)
    axis = (lean + jnp.array([0.0, 0.0, 1.0])) / jnp.sqrt(1 + lean @ lean)
    return jnp.mean(offsets, 0), axis
