"""What is compiled quickly gives the same alone and within other programs."""

import jax
import jax.numpy as jnp
import pytest

from jaxclear.ground.compiling import compiled_quickly, kernels_or
from jaxclear.native import while_loop


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


@pytest.mark.filterwarnings("ignore:jaxclear runs a time loop.*sort")
def test_a_program_whose_loops_are_no_kernels_is_another_and_known_again():
    compiled = []

    def twice(name):
        def function(x, step):
            compiled.append(name)
            return while_loop(lambda s: s[0] < 2, lambda s: (s[0] + 1, step(s[1])), (0, x))[1]

        return jax.jit(function, static_argnums=1)

    both = kernels_or(twice("soon"), twice("usual"))
    x = jnp.asarray([0.2, 0.1])
    for _ in range(2):
        assert jnp.allclose(both(x, jnp.sort), jnp.sort(x))
        assert jnp.allclose(both(x, jnp.sin), jnp.sin(jnp.sin(x)), rtol=1e-14)
    assert compiled == ["soon", "usual", "soon"]
    assert jnp.allclose(both(x[:1], jnp.sort), x[:1]) and compiled[3:] == ["soon", "usual"]
