"""How much each entry of the state counts in an error control: places, speeds, remembered impact
speeds and states of loads and flanks as they are, deflections of bristles beside what they settle
within; what follows the motion (worn volumes, energies, impulses) is not held.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model
from jaxclear.ground.quantity import Scalar


def settling_length(law: Any) -> Scalar:
    """Sliding [m] within which a deflection settles, at 1 m/s."""
    rate = jax.grad(lambda z: law.tractions(1.0, (z,), (1.0,), 1.0)[1][0])(0.0)
    return 1 / jnp.maximum(-rate, 1e-300)


# Length [m] within which deflections settle from which on they are held as places are, shorter ones
# tighter in proportion: at the usual tolerance of 1e-9 m an error is then a hundred thousandth of
# the deflection at which friction is that of sliding. Held as places, those that settle within
# 0.15 um were as far off as they were deflected where a journal rested under a hundredth of the
# torque that its friction holds, and what it wore was 4 % off; now 0.05 %, for 3 % more steps
# (benchmarks/attack.py, case 527).
SETTLING = 1e-4


def error_weights(model: Model) -> Float[Array, " n"]:
    """Weights of the state's entries."""
    layout = model.layout
    parts = [jnp.ones(layout.memory_start)]
    for name, kinds in layout.memories:
        laws = model.system.bearings[name].contact_laws
        for (remembers, bristles), law in zip(kinds, laws, strict=True):
            parts += [jnp.ones(1)] * remembers
            if bristles:
                weight = jnp.maximum(1.0, SETTLING / settling_length(law.friction))
                parts += [jnp.full(bristles, weight)]
    if layout.states:
        parts += [jnp.zeros(len(layout.angles)), jnp.ones(len(layout.states))]
    weights = jnp.concatenate(parts)
    return jnp.concatenate([weights, jnp.zeros(layout.size - len(weights))])
