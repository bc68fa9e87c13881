"""What a kernel is checked against, operation by operation, against JAX's own evaluation."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import by_numpy

TABLE = np.arange(60.0).reshape(4, 5, 3)
PLACES = np.array([[2, 7], [-1, 3], [0, 4]])
NUMBERS = np.array([-0.75, 0.5, 0.25, 0.0])


def read(offset, collapsed, starts, sizes, mode):
    numbers = lax.GatherDimensionNumbers(offset, collapsed, starts)
    return lambda a, at: lax.gather(a, at, numbers, sizes, mode=mode)


def written(function, window, inserted, starts, mode):
    numbers = lax.ScatterDimensionNumbers(window, inserted, starts)
    return lambda a, at, new: function(a, at, new, numbers, mode=mode)


CASES = {
    # Beyond the table a window is moved into it.
    "gather rows": (read((1, 2), (0,), (0,), (1, 2, 3), "clip"), TABLE, PLACES[:, :1]),
    "gather in front": (read((0, 1), (1,), (1,), (2, 1, 2), "clip"), TABLE, PLACES[:, 1:]),
    "gather entries": (read((), (0, 1, 2), (2, 1), (1, 1, 1), "clip"), TABLE, PLACES),
    "gather one window": (read((0, 1), (2,), (0, 1), (2, 3, 1), "clip"), TABLE, PLACES[0]),
    "take": (lambda a: jnp.take(a, np.array([3, 0, 3]), axis=1, mode="clip"), TABLE),
}
for way in ("clip", "drop"):
    # Beyond the table a window is moved into it, or goes nowhere.
    for put in (lax.scatter, lax.scatter_add):
        CASES |= {
            f"{put.__name__} rows, {way}": (
                written(put, (1,), (0, 1), (1, 0), way),
                TABLE,
                PLACES,
                np.arange(9.0).reshape(3, 3),
            ),
            f"{put.__name__} one window, {way}": (
                written(put, (0, 1), (2,), (0, 1), way),
                TABLE,
                np.array([1, 2]),
                np.arange(6.0).reshape(2, 3),
            ),
        }
for name in ("ceil", "cbrt", "tan", "asin", "acos", "atan", "log1p", "expm1"):
    CASES[name] = (getattr(lax, name), NUMBERS)
CASES |= {
    "rsqrt": (lax.rsqrt, NUMBERS**2 + 0.1),
    "clamp": (lax.clamp, np.array(-0.5), NUMBERS, np.array(0.25)),
    "transpose": (lambda a: lax.transpose(a, (2, 0, 1)), TABLE),
    "rev": (lambda a: lax.rev(a, (0, 2)), TABLE),
    "iota": (lambda a: a + lax.broadcasted_iota(float, (4, 5, 3), 1), TABLE),
    "slice": (lambda a: lax.slice(a, (1, 0, 0), (4, 5, 2), (2, 3, 1)), TABLE),
    "dynamic_slice": (lambda a, i: lax.dynamic_slice(a, (i, 4, 0), (2, 2, 3)), TABLE, np.array(-3)),
    "dynamic_update": (
        lambda a, i: lax.dynamic_update_slice(a, -a[:2, :2], (i, 4, 0)),
        TABLE,
        np.array(2),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_an_operation_is_jaxs_own(name, monkeypatch):
    def left_to_jax(equation, _):
        raise AssertionError(f"{equation.primitive.name} is left to JAX")

    monkeypatch.setattr(by_numpy, "_bound", left_to_jax)
    function, *given = CASES[name]
    program = jax.make_jaxpr(function)(*given)
    (found,) = by_numpy.evaluator(program)(*given)
    wanted = np.asarray(function(*map(jnp.asarray, given)))
    assert found.dtype == wanted.dtype
    # Two libraries' functions differ by rounding.
    np.testing.assert_allclose(found, wanted, rtol=1e-15, atol=1e-16)


def test_what_is_read_beyond_a_table_and_filled_is_left_to_jax():
    read_or_nan = functools.partial(jnp.take, indices=np.array([1, 9]), axis=0, mode="fill")
    (found,) = by_numpy.evaluator(jax.make_jaxpr(read_or_nan)(TABLE))(TABLE)
    assert np.isnan(found[1]).all() and (found[0] == TABLE[1]).all()
