"""What two passes through the windows of a run end with beside each other: how far they are apart,
and which sizes are so small that nothing is told by a share of them.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.multibody.system import wear_maps

# Size, beside the largest, below which a coordinate's changes do not matter.
LEAST = 0.1
# Share of what contacts carry, as an acceleration of all masses together, as which mean forces
# count at least, and forces at an instant: what rests on contacts has no others. Implicit steps h
# of a bias b rest where it moves by b h a / 2, held by the acceleration a: half the steps, half
# the speed, which is no force.
CARRIED, CARRIED_NOW = 0.01, 0.1
# Worn depth, beside the root of its surface's area, below which nothing wears: a thousand million
# such runs take less than an atom off a bearing.
NO_WEAR = 1e-17


def difference(
    coarse: Array, fine: Array, usual: Array, scales: Any = 1.0, least: Any = 0.0
) -> Float[Array, " entries"]:
    """Difference beside the size, both summed over the windows, or beside the size that is `usual`
    in the run if that is more; entries that are small beside the largest count as a tenth of it,
    and none as less than what is the `least` that counts."""
    met = jnp.sum(jnp.maximum(abs(coarse), abs(fine)), axis=0)
    size = jnp.maximum(met, usual) * scales
    off = jnp.sum(abs(fine - coarse), axis=0) * scales
    counted = jnp.maximum(LEAST * jnp.max(size, initial=0.0), least)
    return safe_divide(off, jnp.maximum(size, counted))


def by_contacts(model: Model, impulses: Float[Array, "windows joints"]) -> Float[Array, ""]:
    """What such impulses of contacts [N s] change of the speed of all masses together [m/s], summed
    over the windows; forces of an acceleration."""
    mass = sp.total(link.mass for link in model.system.links)
    return safe_divide(jnp.sum(abs(impulses)), jnp.asarray(mass, float))


def least_volumes(model: Model) -> list[Float[Array, ""]]:
    """Volume [m3] below which the surface of each contact that wears has not worn."""
    maps = wear_maps(model.system)
    areas = [jnp.sum(maps[slot.bearing][slot.surface][0].areas()) for slot in model.layout.wear]
    return [NO_WEAR * area * safe_sqrt(area) for area in areas]
