"""Whether a run's explicit steps follow the damping of contacts that last, told from saved states.

Laws that divide by the impact speed damp the harder the slower a contact was touched: a journal
that came down gently and is pressed afterwards has a damper far stiffer than its spring. Where that
is faster than the steps its force swings from step to step about a mean that is right, so that
neither motion nor mean forces nor wear tell.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.system import System

# Speed [m/s] of an indentation below which rounding of its force hides what damps it.
LEAST_RATE = 1e-9


def damper_step(seen: Float[Array, "8 contacts"], length: Any) -> Float[Array, " contacts"]:
    """By contact the rate of damping at a look, as the secant through rest, times the length [s] of
    the steps there beside what is stable; `seen` as `friction_steps.contacts` says."""
    _, _, normal, _, rate, elastic, along, _ = seen
    pressed = (normal > 0) & (abs(rate) > LEAST_RATE)
    damper = safe_divide(normal - elastic, jnp.where(pressed, rate, 0.0))
    return length * damper * along


def damping(system: System) -> bool:
    """Whether the law of some contact damps."""
    return not all(own.contact.lossless for b in system.bearings.values() for own in b.contact_laws)
