"""What is compiled quickly gives the same alone and within other programs."""

import jax
import jax.numpy as jnp

from jaxclear.ground.compiling import compiled_quickly


@compiled_quickly
def squared_sine(x):
    return jnp.sin(x) ** 2


def test_alone_and_within_other_programs_it_is_the_same_function():
    x, points = jnp.asarray(0.3), jnp.linspace(0.0, 1.0, 3)
    assert jnp.allclose(squared_sine(x), jnp.sin(x) ** 2, rtol=1e-14)
    assert jnp.allclose(jax.jit(squared_sine)(x), jnp.sin(x) ** 2, rtol=1e-14)
    # Also of a number that is known while the other program is being traced.
    assert jnp.allclose(jax.jit(lambda y: y + squared_sine(0.3))(x), x + jnp.sin(x) ** 2)
    assert jnp.allclose(jax.vmap(squared_sine)(points), jnp.sin(points) ** 2, rtol=1e-14)
    assert jnp.allclose(jax.grad(squared_sine)(x), jnp.sin(2 * x), rtol=1e-14)
