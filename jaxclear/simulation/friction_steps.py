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


def friction_steps(
    model: Model,
    seen: Float[Array, "looks 8 contacts"],
    depths: Float[Array, "looks contacts"] | None,
    steps: dict[Check, Float[Array, " looks"]],
) -> dict[Check, Float[Array, " contacts"]]:
    """By contact (its joint's) the figures of friction over a run, from what its looks have `seen`
    of the `contacts`, the largest indentations [m] of the saving intervals that end there
    (None: those seen), and the lengths [s] of `steps` by the check that judges them."""
    bearings = model.system.bearings
    laws = [own for b in bearings.values() for own in b.contact_laws]
    joints = np.array([name for name, b in bearings.items() for _ in b.contact_laws])
    drag, slip, normal, indented, _, _, along, across = (seen[:, part] for part in range(8))
    depths = jnp.maximum(indented, 0.0 if depths is None else depths)
    power = drag * slip
    force, stiffness = (
        jnp.stack(part, axis=1)
        for part in zip(*(_pressed(own, depths[:, k]) for k, own in enumerate(laws)), strict=True)
    )
    # Friction by slip, as the secant through rest: slip that is stopped too hard swings about it.
    secant = safe_divide(drag, slip * jnp.where(normal > 0, normal, 1.0))
    pushed = jnp.maximum(force, normal) * across
    out = {}
    for check, step in steps.items():
        steepest, spring = (
            jnp.stack(part, axis=1)
            for part in zip(*(_slopes(own, step) for own in laws), strict=True)
        )
        lengths = step[:, None]
        if check == Check.CREEP_STEP:
            hardest = jnp.maximum(stiffness * along, spring * pushed)
            rate = jnp.minimum(jnp.minimum(secant, steepest) * pushed, safe_sqrt(hardest))
            share = lengths * rate
        else:
            viscous = jnp.maximum(steepest - 0.5 * spring * lengths, 0.0) * pushed
            rate = jnp.minimum(secant * pushed, jnp.maximum(viscous, safe_sqrt(spring * pushed)))
            share = jnp.minimum(lengths * rate / STABLE, 1.0) ** POWER
        sums = jnp.stack([jnp.sum(power * share, axis=0), jnp.sum(power, axis=0)])
        # A joint's contacts wear one surface: they have one figure.
        out[check] = safe_divide(*(sums @ (joints[:, None] == joints)))
    return out


def _pressed(laws: Any, depths: Float[Array, " looks"]) -> tuple[Array, Array]:
    """Elastic force [N] at given indentations and its slope [N/m]."""
    force = laws.contact.elastic_force
    return jax.vmap(lambda depth: jax.jvp(force, (depth,), (jnp.ones(()),)))(depths)


def _slopes(laws: Any, steps: Float[Array, " looks"]) -> tuple[Array, Array]:
    """Largest slope [s/m] of a contact's friction over steps of these lengths [s], and how it grows
    with half their length [1/m]: the spring that bristles are; 0 without friction."""
    if laws.friction is None or laws.friction.set_valued:
        return jnp.zeros_like(steps), jnp.zeros_like(steps)
    slope = jax.vmap(lambda h: jnp.asarray(laws.friction.largest_slope(h), float))
    return slope(steps), 2 * (slope(2 * steps) - slope(steps)) / steps


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
