"""What the collars of bearings carry that always touch: the reaction along the axis, which is not
among their contact forces, rubs nothing and wears nothing.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.base import AbstractFormulation
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent_reactions import touching
from jaxclear.ground.numerics import safe_divide


def collared(model: Model) -> tuple[str, ...]:
    """The bearings with collars that always touch."""
    held = touching(model.system)
    gaps = {one.name: getattr(one.joint, "gap", None) for one in held}
    return tuple(name for name, gap in gaps.items() if getattr(gap, "flange", None) is not None)


def pressed(
    names: tuple[str, ...], now: Instant, formulation: AbstractFormulation
) -> Float[Array, "2 joints"]:
    """Of each of these joints, at a look: force on its collars, and that of its contacts [N]."""
    reports = [formulation.contact(now, name) for name in names]
    along = [abs(jnp.asarray(report.force[2])) for report in reports]
    return jnp.stack([jnp.stack(along), jnp.stack([jnp.sum(r.normal_force) for r in reports])])


def collar_forces(found: Float[Array, "looks 2 joints"]) -> Float[Array, " joints"]:
    """By joint the share of all its forces that its collars carry."""
    along, across = jnp.sum(found, axis=0)
    return safe_divide(along, along + across)
