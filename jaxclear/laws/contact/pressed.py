"""How deep a force presses: the elastic part of a law of contact, the other way round."""

import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar
from jaxclear.laws.contact.base import AbstractNormalLaw

__all__ = ["indentation_under"]

# Where the search begins [m], and turns of it: each takes the law for a power of the indentation,
# which Hertz's is.
FIRST, TURNS = 1e-5, 4
# Indentations that tell the power differ by this share.
APART = 1e-3
# What presses by next to nothing presses so deep [m]: at 0 a root has no slope.
SHALLOWEST = 1e-10


def indentation_under(law: AbstractNormalLaw, force: Scalar) -> Scalar:
    """Indentation [m] at which the elastic part of a law carries a force [N, at least 0]; 0 where
    bodies do not overlap."""
    if not law.compliant:
        return jnp.zeros(())
    wanted = force + law.elastic_force(jnp.asarray(SHALLOWEST))
    depth = jnp.asarray(FIRST)
    for _ in range(TURNS):
        here, beyond = law.elastic_force(depth), law.elastic_force((1 + APART) * depth)
        power = jnp.log(beyond / here) / jnp.log1p(APART)
        depth = depth * (wanted / here) ** (1 / power)
    return depth
