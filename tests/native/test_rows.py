"""A function over rows is what `jax.vmap` makes of it, however many rows, however long the
function, with its derivatives, with and without a kernel.
"""

import jax
import jax.numpy as jnp
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import loop, one_row, over_rows, rows

ROUNDING = 1e-13


@pytest.fixture(autouse=True)
def few_operations_are_many(monkeypatch):
    monkeypatch.setattr(rows, "SHORT", 10)


def long(x, table, key):
    """More operations than `rows.SHORT`, on a number, a table and a whole number."""
    for _ in range(rows.SHORT // 2):
        x = jnp.sin(x) + 0.1 * x
    return {"x": x, "with": (jnp.sum(table[:3]) * x, key + 1)}


def short(x, table, key):
    return {"x": x * x, "with": (table[1] - x, key)}


def given(count):
    x = jnp.linspace(-1.0, 1.0, count)
    return x, jnp.outer(x, jnp.arange(100.0)), jnp.arange(count)


@pytest.mark.parametrize("function", [long, short])
@pytest.mark.parametrize("count", [1, 7, 2 * rows.AT_A_TIME + 3])
def test_rows_are_those_of_vmap(function, count):
    found = jax.jit(lambda *x: over_rows(function, *x))(*given(count))
    wanted = jax.vmap(function)(*given(count))
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for one, other in zip(*map(jax.tree.leaves, (found, wanted)), strict=True):
        assert one.dtype == other.dtype
        assert jnp.allclose(one, other, rtol=ROUNDING, atol=ROUNDING)


def test_a_long_function_is_one_kernel(monkeypatch):
    built = []
    monkeypatch.setattr(loop.kernels, "build", lambda *asked: built.append(asked) or 1 / 0)
    x = given(rows.AT_A_TIME + 5)
    found = jax.jit(lambda *x: over_rows(long, *x))(*x)["x"]
    assert len(built) == 1
    # Without one rows are gone through one after the other, and nobody is warned: no run is slow.
    assert jnp.allclose(found, jax.vmap(long)(*x)["x"], rtol=ROUNDING)


@pytest.mark.parametrize("function", [long, short])
def test_one_row_is_the_function_itself(function):
    row = jax.tree.map(lambda each: each[3], given(5))
    found, wanted = jax.jit(lambda *x: one_row(function, *x))(*row), function(*row)
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for one, other in zip(*map(jax.tree.leaves, (found, wanted)), strict=True):
        assert jnp.allclose(one, other, rtol=ROUNDING, atol=ROUNDING)


def test_derivatives_in_both_directions_and_in_batches():
    x, table, key = given(9)

    def total(way, scale):
        return jnp.sum(way(lambda x, *rest: long(scale * x, *rest)["with"][0])(x, table, key) ** 2)

    ours = lambda s: total(lambda f: lambda *rows: over_rows(f, *rows), s)
    plain = lambda s: total(jax.vmap, s)
    wanted = jax.grad(plain)(0.7)
    assert abs(jax.grad(ours)(0.7) - wanted) < 1e-11 * abs(wanted)
    assert abs(jax.jvp(ours, (0.7,), (1.0,))[1] - wanted) < 1e-11 * abs(wanted)
    scales = jnp.array([0.5, 0.7])
    assert jnp.allclose(jax.vmap(ours)(scales), jax.vmap(plain)(scales), rtol=ROUNDING)
