"""What overlaps at the end of a step through rigid contact, moved apart (metric: the masses)."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.complementarity import FrictionContact
from jaxclear.complementarity.kept_states import with_kept_states
from jaxclear.formulations import contact_rows
from jaxclear.formulations.contact_rows import MiddleOfStep, TimeStep, split
from jaxclear.formulations.delassus import DelassusOperator
from jaxclear.formulations.model import Model
from jaxclear.formulations.state_rate import drift
from jaxclear.formulations.unilateral import MoreauJeanSettings, UnilateralContact
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.state import unpack_motion


class Projected(NamedTuple):
    """After projection: coordinates, by how much they were moved (in terms of speeds), energy that
    this put in [J].
    """

    coordinates: list
    moved: list
    energy: Any


def project(
    model: Model,
    time_step: TimeStep,
    middle: MiddleOfStep,
    contacts: list[UnilateralContact],
    delassus: DelassusOperator,
    end: tuple[list, list],
    settings: MoreauJeanSettings,
) -> Projected:
    """Coordinates at the `end` (q, v) of a step, moved apart in the metric of the masses until
    contacts overlap by no more than they would leave or fall in a step: one at rest stays closed
    whatever rounding and the turning of its normal do, and what strikes and rebounds undoes its
    overlap itself; moving it would give it energy."""
    (q, v), h = end, time_step.length
    motion = unpack_motion(model.system, [*q, *v])
    depths = contact_rows.indentations(model, time_step.end, *motion)
    responses = split(delassus.responses, [len(contact.rows) for contact in contacts])
    normals = DelassusOperator(
        [contact.rows[0] for contact in contacts],
        delassus.free,
        delassus.multipliers,
        [own[0] for own in responses],
    )
    change = middle.change_to(v)
    opening = sp.stack([sp.add(c.velocities[0], along(c.rows[0], change)) for c in contacts])
    # What a contact gains in closing speed within a step if nothing holds it.
    pressed = h * sp.stack(
        [positive_part(sp.neg(along(row, delassus.free))) for row in normals.rows]
    )
    wanted = zip(pressed, opening, depths, strict=True)
    problem = FrictionContact(
        [sp.stack(line) for line in normals.matrix()],
        jnp.stack([h * (most + jnp.abs(u)) - depth for most, u, depth in wanted]),
        jnp.zeros(len(contacts)),
    )
    shifts = with_kept_states(problem, settings.solver().iterate(problem).z)
    if settings.striking is not None:
        shifts = jnp.where(settings.striking, jax.lax.stop_gradient(shifts), shifts)
    moved, _ = normals.under([shifts[i] for i in range(len(contacts))])
    energy = sp.neg(sp.dot(middle.free_motion.right, moved))
    return Projected(drift(model.system, q, q, moved, 1.0), moved, energy)
