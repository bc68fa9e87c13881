"""Whether a run's explicit steps follow the damping of contacts that last, told from saved states.

Laws that divide by the impact speed damp the harder the slower a contact was touched: a journal
that came down gently and is pressed afterwards has a damper far stiffer than its spring. Where that
is faster than the steps its force swings from step to step about a mean that is right, so that
neither motion nor mean forces nor wear tell.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.system import System

# Speed [m/s] of an indentation below which rounding of its force hides what damps it.
LEAST_RATE = 1e-9


def damper_steps(
    seen: Float[Array, "looks 8 contacts"], lengths: Float[Array, " looks"]
) -> Float[Array, " contacts"]:
    """By contact the largest rate of damping in the looks, as the secant through rest, times the
    steps' `lengths` there [s], each beside what is stable; `seen` as `friction_steps.contacts`
    says."""
    _, _, normal, _, rate, elastic, along, _ = (seen[:, part] for part in range(8))
    pressed = (normal > 0) & (abs(rate) > LEAST_RATE)
    damper = safe_divide(normal - elastic, jnp.where(pressed, rate, 0.0))
    return jnp.max(lengths[:, None] * damper * along, axis=0, initial=0.0)


def damping(system: System) -> bool:
    """Whether the law of some contact damps."""
    return not all(own.contact.lossless for b in system.bearings.values() for own in b.contact_laws)
