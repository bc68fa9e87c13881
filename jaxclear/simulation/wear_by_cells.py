"""Whether how deep a run wears hangs on the number of cells: where a scar is hardly wider than a
cell, the deepest one tells a mean over much that is less deep, and a contact is taken wider than it
is. Its volume is right on any cells.

A mean over three cells to a side is nine times as far off as that over one, where a scar is smooth;
what it makes of the deepest place tells how wide that is, in cells.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.wear_map import AbstractWearMap
from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_divide
from jaxclear.integrators.checks import Check
from jaxclear.multibody.system import wear_maps
from jaxclear.simulation.wear import Worn

# A surface that wears less than this share of the one that wears most is judged beside that.
NEGLIGIBLE = 0.01


def figures(model: Model, begun: Worn, ended: Worn) -> dict[Check, Float[Array, " places"]]:
    """By how much the deepest place of each contact's surface is less deep over three cells to a
    side, beside its depth; 0 of a surface that has lost nothing since the run began."""
    if not ended or not model.layout.wear:
        return {}
    begun, ended = jax.lax.stop_gradient((begun, ended))
    least = NEGLIGIBLE * jnp.max(jnp.stack([*map(jnp.max, jax.tree.leaves(ended))]))
    shares = {}
    for joint, surfaces in wear_maps(model.system).items():
        for surface, (wear_map, _) in surfaces.items():
            depth, before = ended[joint][surface], begun[joint][surface]
            share = narrowness(wear_map, depth, least)
            shares[joint, surface] = jnp.where(jnp.any(depth > before), share, 0.0)
    places = [shares[slot.bearing, slot.surface] for slot in model.layout.wear]
    return {Check.WEAR_BY_CELLS: jnp.stack(places)}


def narrowness(
    wear_map: AbstractWearMap, depth: Float[Array, "around along"], least: Array | float = 0.0
) -> Array:
    """By how much the deepest place is less deep over three cells to a side, beside its depth, or
    beside the `least` [m] that counts."""
    deepest = jnp.max(depth)
    return safe_divide(deepest - jnp.max(wear_map.over_three(depth)), jnp.maximum(deepest, least))
