"""Maps over many rows are loops within a kernel, and say what JAX says."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxclear.ground.grouping import stacked, unstacked
from jaxclear.native import as_kernel, only_kernels


def _springs(state, parameters):
    """Rates of a chain of many masses, stated number by number."""
    count = len(state) // 2
    numbers = unstacked(state)
    places, speeds = numbers[:count], numbers[count:]
    ends = stacked(places[:1] + places[:-1], 12)
    one = lambda _, row: (
        None,
        jnp.where(row[0] > row[1], row[2] * (row[1] - row[0]), 0.1 * row[3]),
    )
    pulls = jax.lax.scan(one, None, (stacked(places, 12), ends, parameters, stacked(speeds, 12)))[1]
    return jnp.concatenate([stacked(speeds, 12), pulls])


@pytest.mark.parametrize("samples", [1, 3])
def test_a_map_over_many_rows_is_what_jax_makes_of_it(samples):
    rng = np.random.default_rng(0)
    states = jnp.asarray(rng.normal(size=(samples, 160)))
    parameters = jnp.asarray(rng.normal(size=80))

    def run(state):
        # A state this long stands in memory while the loop goes on.
        wide = jnp.concatenate([state, 2 * state])
        step = lambda y, _: (
            y + 1e-2 * jnp.concatenate([_springs(y[:160], parameters), y[160:]]),
            None,
        )
        return jax.lax.scan(step, wide, length=30)[0]

    with only_kernels():
        found = jax.jit(jax.vmap(lambda state: as_kernel(run, state)))(states)
    np.testing.assert_allclose(found, jax.vmap(run)(states), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("samples", [1, 5])
def test_an_axis_of_length_one_stands_for_all_beside_a_long_array(samples):
    """Stages of a step, row upon row, times a column of weights, or the first row: JAX multiplies
    arrays of shapes (7, 1) and (7, 40), too."""

    def turned(first):
        def turn(carry):
            i, rows = carry
            own = jnp.sum(jnp.cos(rows[:, :1]) * rows + rows[:1] * (i + 1.0), 0)
            return i + 1, jnp.concatenate([rows[1:], own[None]])

        rows = jnp.concatenate([jnp.zeros((6, 40)), first[None]])
        return jax.lax.while_loop(lambda carry: carry[0] < 3, turn, (jnp.asarray(0), rows))[1]

    given = jnp.asarray(np.random.default_rng(3).normal(size=(samples, 40)))
    with only_kernels():
        found = jax.jit(jax.vmap(lambda first: as_kernel(turned, first)))(given)
    # Sums are rounded in another order.
    np.testing.assert_allclose(found, jax.vmap(turned)(given), rtol=1e-12, atol=1e-12)
