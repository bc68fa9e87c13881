"""By how much the restitution of impacts is that of the steps instead of the contact law's, in
steps in which a contact does the work of its law whatever their length.

An impact that the steps resolve ends with the law's restitution. One that falls within a step ends
with what the step keeps of an elastic impact, less a part of the law's loss: right by chance where
the law loses as little as the step does, and nowhere else.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt

# Rise of an indentation within a step, beside the largest, up to which impacts are resolved.
RESOLVED = 0.6
# A step in which an impact falls leaves 1 / (1 + SLOWED d) of what it keeps of an elastic one, d
# the law's damping force over its elastic force at the touch: journals thrown at their bearings by
# laws of restitution 0.2 to 0.9 (tests/simulation/test_checks_of_rebound.py).
SLOWED = 0.3


def rebound_steps(
    model: Model,
    rise: Float[Array, " contacts"],
    depth: Float[Array, " contacts"],
    steps: Float[Array, "2"],
) -> Float[Array, " contacts"]:
    """By contact about how much the restitution of its impacts is off, beside the law's, over a run
    with these largest rises of indentations within a step [m] and largest indentations [m];
    `steps`: their length [s], and what they keep of an elastic impact's speed, at most."""
    length, kept = steps
    share = safe_divide(rise, jnp.max(depth, initial=0.0))
    within = positive_part(share - RESOLVED) / (1 - RESOLVED)
    laws = [own.contact for b in model.system.bearings.values() for own in b.contact_laws]
    damping = jnp.stack(
        [_damping(law, depth[k], safe_divide(rise[k], length)) for k, law in enumerate(laws)]
    )
    # Restitution by the damping at the touch: Gonthier et al. 2004, Multibody Syst. Dyn. 11, 209.
    wanted = 0.5 * (safe_sqrt(damping**2 + 4) - damping)
    return within * abs(kept / (1 + SLOWED * damping) / wanted - 1)


def _damping(law: Any, depth: Any, speed: Any) -> Float[Array, ""]:
    """Damping force over elastic force [1] of a contact of this depth [m] that closes with the
    speed [m/s] of its touch."""
    elastic = law.elastic_force(depth)
    return safe_divide(positive_part(law.normal_force(depth, speed, speed) - elastic), elastic)
