"""The arc sine that XLA goes through eight numbers at a time is the C library's."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear  # noqa: F401  (float64)
from jaxclear.ground.numerics import arc_sine


def test_it_is_the_librarys():
    tiny = 10.0 ** -np.arange(0.0, 300.0, 7.0)
    x = np.concatenate([np.linspace(-1.0, 1.0, 20001), tiny, -tiny, 1.0 - tiny, [0.0, -0.0]])
    found, wanted = np.asarray(jax.jit(arc_sine)(x)), np.arcsin(x)
    # A few roundings of the last digit.
    np.testing.assert_allclose(found, wanted, rtol=1e-15, atol=0.0)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(wanted))
    assert np.isnan(arc_sine(jnp.asarray(np.nan)))


def test_its_slope_is_that_of_the_angle_and_finite_at_the_ends():
    x = jnp.linspace(-0.99, 0.99, 101)
    for order, slope in ((1, jax.grad(arc_sine)), (2, jax.grad(jax.grad(arc_sine)))):
        wanted = (1 - x**2) ** -0.5 if order == 1 else x * (1 - x**2) ** -1.5
        np.testing.assert_allclose(jax.vmap(slope)(x), wanted, rtol=1e-12, atol=1e-12)
        assert all(np.isfinite(slope(end)) for end in (-1.0, 0.0, 1.0))
