"""What the collars of bearings carry that always touch: the reaction along the axis, which is not
among their contact forces, rubs nothing and wears nothing.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.base import ContactReport
from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_divide
from jaxclear.simulation.gap_motion import in_gaps


def collared(model: Model) -> tuple[str, ...]:
    """The bearings with collars that always touch."""
    gaps = in_gaps(model)
    return tuple(name for name, gap in gaps.items() if getattr(gap, "flange", None) is not None)


def pressed(reports: list[ContactReport]) -> Float[Array, "2 joints"]:
    """Of joints that are told of at a look: force on its collars, and that of its contacts [N]."""
    along = [abs(jnp.asarray(report.force[2])) for report in reports]
    return jnp.stack([jnp.stack(along), jnp.stack([jnp.sum(r.normal_force) for r in reports])])


def collar_forces(found: Float[Array, "looks 2 joints"]) -> Float[Array, " joints"]:
    """By joint the share of all its forces that its collars carry."""
    along, across = jnp.sum(found, axis=0)
    return safe_divide(along, along + across)
