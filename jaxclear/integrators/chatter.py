"""Whether slip goes to and fro from step to step, as where friction stops it within one.

Of a motion whose friction the steps resolve a contact's slip turns round as the bodies do, in many
steps. Where friction is too stiff for a step, it carries slip past rest, and the next one back:
mean forces and what friction takes may still be right, but a derivative is that of the steps.

None of this is in a program of which no derivative is asked.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.integrators.trust import GROWTH, LOST

# Slip that changes by less than this share of the fastest so far within a step is at rest.
AT_REST = 1e-3
# Slip goes to and fro where its change turns round twice within so many steps.
FEW = 2


def figures(model: Model) -> int:
    """How many numbers tell it: the fastest slip so far [m/s], and of each contact its slip at the
    start of a step, its change in the last one (0: it was apart) and the steps since that last
    turned round, less `FEW`, or 0; none where nothing rubs."""
    laws = [own for each in model.system.bearings.values() for own in each.contact_laws]
    rubs = any(own.friction is not None for own in laws)
    return 1 + 7 * model.layout.contacts if rubs else 0


def followed(motion: Any, begun: Any, ended: tuple, growth: Array) -> Array:
    """The growth of derivatives (`trust`), and behind it these figures, if any, behind a step that
    began so (`mid_step.Now`) and has `ended` with (state, contacts); lost where slip goes to and
    fro."""
    if len(growth) == GROWTH:
        return growth
    end, after = ended
    count = len(after.depths)
    most, known = growth[GROWTH], growth[GROWTH + 1 :].reshape(count, 7)
    before, changed, turned = known[:, :3], known[:, 3:6], known[:, 6]
    slip = motion.slips(begun.arrays, begun.time + begun.length, end)
    size = lambda each: safe_sqrt(jnp.sum(each * each, -1))
    fastest = jnp.maximum(most, jnp.max(size(slip)))
    # Of a slip with which a run begins nothing is known before its first step.
    rubs = (begun.contacts.depths >= 0) & (after.depths >= 0) & (most > 0)
    change = jnp.where(rubs[:, None], slip - before, 0.0)
    moved = jnp.minimum(size(change), size(changed)) > AT_REST * fastest
    turns = moved & (jnp.sum(change * changed, -1) < 0)
    chatters = jnp.any(turns & (turned > 0))
    turned = jnp.where(turns, 1.0 * FEW, jnp.maximum(turned - 1, 0.0))
    here = (jnp.arange(GROWTH) == LOST) & chatters
    known = jnp.concatenate([slip, change, turned[:, None]], 1)
    return jnp.concatenate([jnp.where(here, 1.0, growth[:GROWTH]), fastest[None], known.ravel()])
