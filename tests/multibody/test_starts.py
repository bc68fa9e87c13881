"""What a mechanism starts with: closed loops, given values held, and derivatives of both."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground.least_change import least_change
from jaxclear.multibody.assembly import assemble_arrays

ROD = 0.12


def started(rig, where):
    """Coordinates and speeds at the start, as a function of a number of the mechanism."""

    def start(value):
        found = assemble_arrays(eqx.tree_at(where, rig, value))
        return jnp.concatenate([found.coordinates, found.speeds])

    return start


def rod_length(rig):
    return rig.connections["B"].parent.at[0]


# A start that closes exactly, and one that does not.
@pytest.mark.parametrize("length", [ROD, 0.13])
@pytest.mark.parametrize("kind", ["planar", "ideal"])
def test_the_derivative_of_a_start_is_that_of_its_differences(kind, length):
    start = jax.jit(started(jc.scenes.slider_crank(kind), rod_length))
    step = 1e-6
    differences = (start(length + step) - start(length - step)) / (2 * step)
    # (x, y, xd, yd): the slider is where crank and rod end; the rod turns at -r w / l.
    expected = [0.0, 1.0, 50.0 * 0.05 / length**2, 0.0]
    for derivative in (jax.jacfwd(start)(length), jax.jacrev(start)(length)):
        np.testing.assert_allclose(derivative, expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(derivative, differences, rtol=1e-6, atol=1e-6)


def test_a_batch_of_starts_calls_no_factorisation_of_another_library():
    """Two threads whose batched factorisations meet there wait for each other for ever."""
    for rig in (jc.scenes.antenna(), jc.scenes.four_bar("ideal")):
        numbers, rest = eqx.partition(rig, eqx.is_inexact_array)
        many = jax.tree.map(lambda x: jnp.stack([x, x]), numbers)

        def coordinates(own, rest=rest):
            return assemble_arrays(eqx.combine(own, rest)).coordinates

        assert "custom_call" not in jax.jit(jax.vmap(coordinates)).lower(many).as_text()


def test_the_least_change_meets_what_it_can_and_moves_no_further():
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(4, 6))
    rows[2] = rows[0] - 2 * rows[1]
    scales = rng.uniform(0.1, 10.0, 6)
    targets = np.array([1.0, 2.0, 7.0, -1.0])
    change, met = least_change(*map(jnp.asarray, (rows, targets, scales)))
    assert met.tolist() == [True, True, False, True]
    free = [0, 1, 3]
    expected = scales * (np.linalg.pinv(rows[free] * scales) @ targets[free])
    np.testing.assert_allclose(change, expected, atol=1e-13)
