"""A program whose time loops are no kernels is compiled another way."""

import jax
import jax.numpy as jnp
import pytest

from jaxclear.native import while_loop
from jaxclear.native.compiled import kernels_or


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
