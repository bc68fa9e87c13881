"""Bristles of friction laws: the sliding within which their deflection settles."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar


def settling_length(law: Any) -> Scalar:
    """Sliding [m] within which a deflection settles, at 1 m/s."""
    rate = jax.grad(lambda z: law.tractions(1.0, (z,), (1.0,), 1.0)[1][0])(0.0)
    return 1 / jnp.maximum(-rate, 1e-300)
