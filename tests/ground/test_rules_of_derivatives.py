"""Functions with a rule of their own for their derivative have formulas with the same one.

Where what a `jax.lax.scan` goes through is differentiated twice, the first time backwards, JAX
forgets such rules (`_scan_known_hoisting`), and goes through the formula: second derivatives of
worn mechanisms with counted steps were nan.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxclear.components.surface import _half_disc_integral
from jaxclear.ground.numerics import arc_sine, inverse_entropy

# With the ends, what lies beyond them, and the middle.
RULED = {
    "arc_sine": (arc_sine, [-1.0, -0.7, -1e-9, 0.0, 0.5, 0.95, 1.0]),
    "half disc": (_half_disc_integral, [-3.0, -1.0, -0.7, 0.0, 0.5, 0.95, 1.0, 1e30]),
    "inverse_entropy": (inverse_entropy, [-1.0, 0.0, 1e-300, 1e-12, 1e-3, 0.3]),
}


@pytest.mark.parametrize("function, points", RULED.values(), ids=RULED)
def test_a_formula_has_the_derivative_of_its_rule(function, points):
    x = jnp.asarray(points)
    ruled, plain = (
        jax.jit(jax.grad(lambda x, f=f: jnp.sum(f(x))))(x) for f in (function, function.fun)
    )
    np.testing.assert_allclose(plain, ruled, rtol=1e-14, atol=1e-15)


def test_second_derivatives_go_through_scans():
    x = jnp.asarray(RULED["half disc"][1])
    square = lambda x: jnp.sum(_half_disc_integral(x) ** 2)

    def scanned(x):
        turn = lambda carry, _: (jnp.sin(carry), _half_disc_integral(x + carry))
        return jnp.sum(jax.lax.scan(turn, jnp.zeros(()), length=1)[1] ** 2)

    def second_derivatives(function):
        slopes = lambda x: jnp.sum(jax.grad(function)(x))
        return jax.jvp(jax.grad(function), (x,), (jnp.ones_like(x),))[1], jax.grad(slopes)(x)

    found, wanted = jax.jit(lambda: (second_derivatives(scanned), second_derivatives(square)))()
    np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)
