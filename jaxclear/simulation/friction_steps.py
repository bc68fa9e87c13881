"""Whether a run's steps resolve its friction, told from the saved states: by how much friction
changes over a step with the slip that was met, and how fast the contacts vibrate in which it stops
slip.

Figures are means over a joint's contacts and the run by the power that friction takes: where it
takes little it may be stiff. Of explicit steps what counts is the power that is taken where they
are near their limit of stability: steps a tenth as long are right, so a run that is spent there is,
and one that spends a few hundredths of its power in chatter is not.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.formulations import contact_rows, delassus
from jaxclear.formulations.base import AbstractFormulation
from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.integrators.checks import Check

KINDS = (Check.FRICTION_STEP, Check.CREEP_STEP)
# Explicit steps h of a slip that decays (or of bristles that vibrate) at the rate r carry it past
# rest, back and forth, from h r = STABLE on; below, what they are off by falls as a power of h r.
STABLE, POWER = 2.0, 3


def rubbing(model: Model) -> set[str]:
    """The joints in which a contact has friction that its slip decides."""
    return {
        name
        for name, bearing in model.system.bearings.items()
        for own in bearing.contact_laws
        if own.friction is not None and not own.friction.set_valued
    }


def taken(
    model: Model,
    seen: Float[Array, "8 contacts"],
    depths: Any,
    steps: dict[Check, Any],
) -> dict[Check, Float[Array, "2 contacts"]]:
    """By the check that judges steps of these lengths [s]: of every contact the power [W] that
    friction takes where these do not resolve it, and all of it, from what a look has `seen` of the
    `contacts`, and the largest indentations [m] in the saving interval that ends there (0: those
    seen count)."""
    laws = [own for b in model.system.bearings.values() for own in b.contact_laws]
    drag, slip, normal, indented, _, _, along, across = seen
    power = drag * slip
    depths = jnp.maximum(indented, depths)
    pressed = [_pressed(own, depths[k]) for k, own in enumerate(laws)]
    force, stiffness = (jnp.stack(part) for part in zip(*pressed, strict=True))
    # Friction by slip, as the secant through rest: slip that is stopped too hard swings about it.
    secant = safe_divide(drag, slip * jnp.where(normal > 0, normal, 1.0))
    pushed = jnp.maximum(force, normal) * across
    out = {}
    for check, step in steps.items():
        slopes = [_slopes(own, step) for own in laws]
        steepest, spring = (jnp.stack(part) for part in zip(*slopes, strict=True))
        if check == Check.CREEP_STEP:
            hardest = jnp.maximum(stiffness * along, spring * pushed)
            rate = jnp.minimum(jnp.minimum(secant, steepest) * pushed, safe_sqrt(hardest))
            share = step * rate
        else:
            viscous = jnp.maximum(steepest - 0.5 * spring * step, 0.0) * pushed
            rate = jnp.minimum(secant * pushed, jnp.maximum(viscous, safe_sqrt(spring * pushed)))
            share = jnp.minimum(step * rate / STABLE, 1.0) ** POWER
        out[check] = jnp.stack([power * share, power])
    return out


def friction_steps(
    model: Model, power: Float[Array, "looks 2 contacts"]
) -> Float[Array, " contacts"]:
    """By contact (its joint's) a figure of friction over a run, from the power `taken` at its
    looks."""
    bearings = model.system.bearings
    joints = np.array([name for name, b in bearings.items() for _ in b.contact_laws])
    # A joint's contacts wear one surface: they have one figure.
    return safe_divide(*(jnp.sum(power, axis=0) @ (joints[:, None] == joints)))


def _pressed(laws: Any, depth: Any) -> tuple[Array, Array]:
    """Elastic force [N] at an indentation and its slope [N/m]."""
    return jax.jvp(laws.contact.elastic_force, (depth,), (jnp.ones(()),))


def _slopes(laws: Any, step: Any) -> tuple[Array, Array]:
    """Largest slope [s/m] of a contact's friction over a step of this length [s], and how it grows
    with half its length [1/m]: the spring that bristles are; 0 without friction."""
    if laws.friction is None or laws.friction.set_valued:
        return jnp.zeros(()), jnp.zeros(())
    slope = lambda h: jnp.asarray(laws.friction.largest_slope(h), float)
    return slope(step), 2 * (slope(2 * step) - slope(step)) / step


def contacts(now: Instant, formulation: AbstractFormulation) -> Float[Array, "8 contacts"]:
    """Of every possible contact: friction [N], slip [m/s], normal force [N], indentation [m] and
    its rate [m/s], the elastic part of the normal force [N], and the inverse of the mass [1/kg]
    that a force along its normal moves, and one across."""
    reports = formulation.forces(now).reports
    points = [point for report in reports.values() for point in report.points]
    free = contact_rows.free_motion(now.model, now.time, now.q, now.v, now.angles)
    rows = [row for contact in free.contacts for row in contact.rows]
    light = delassus.delassus_operator(free, rows).lightness(
        [len(contact.rows) - 1 for contact in free.contacts]
    )
    found = zip(
        *(
            (
                point.traction,
                point.slip_speed,
                point.normal_force,
                point.indentation,
                point.rate,
                point.elastic_force,
            )
            for point in points
        ),
        strict=True,
    )
    return jnp.stack([sp.stack(part) for part in (*found, *zip(*light, strict=True))])
