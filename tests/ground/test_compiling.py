"""What is compiled quickly, and what is traced once for all calls that are alike."""

import gc

import jax
import jax.numpy as jnp
import pytest

from jaxclear.ground.compiling import by_form, share_trace
from jaxclear.ground.quantity import is_traced
from jaxclear.native.compiled import compiled_quickly


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


def counted():
    """A function that is traced once, and how often it has been."""
    times = []

    @share_trace
    def function(vector, way):
        times.append(1)
        x, y, z = vector
        turned = way(x) if callable(way) else x * way
        return (turned, y, 0 if isinstance(z, int) else z * y), way

    return function, times


def test_programs_that_ask_alike_share_one_trace():
    function, times = counted()
    first = jax.jit(lambda x, y: function((x, y, 0), 2)[0])(3.0, 5.0)
    second = jax.jit(lambda x, y: function((y, x + 1.0, 0), 2)[0])(3.0, 5.0)
    assert first == (6.0, 5.0, 0) and second == (10.0, 4.0, 0)
    assert len(times) == 1


def test_what_the_scene_leaves_out_stays_out():
    function, times = counted()
    zeros = []

    def program(x, y):
        for z in (0, x):
            (_, _, last), way = function((x, y, z), 2)
            zeros.append((isinstance(last, int), way))
        return function((x, y, x), True)[0]

    jax.make_jaxpr(program)(3.0, 5.0)
    assert zeros == [(True, 2), (False, 2)]
    # With z, without, and True, which is no 1.
    assert len(times) == 3


def test_functions_are_asked_each_time():
    function, times = counted()

    def program(x):
        # Each closes over a number of its own.
        return [function((x, x, 0), lambda y, k=k: x * y + k)[0][0] for k in range(3)]

    assert jax.jit(program)(2.0) == [4.0, 5.0, 6.0]
    assert len(times) == 3


def test_derivatives_and_batches_go_through():
    function, _ = counted()
    value = lambda x, y: sum(function((x, y, x), 3)[0])
    # 3 x + y + x y.
    assert jax.grad(value, (0, 1))(2.0, 5.0) == (8.0, 3.0)
    assert jax.vmap(value)(jnp.arange(3.0), jnp.ones(3)).tolist() == [1.0, 5.0, 9.0]
    assert jax.jacfwd(jax.grad(value, 0), 1)(2.0, 5.0) == 1.0


def test_python_does_not_look_for_garbage_while_a_program_is_traced():
    seen = []

    @compiled_quickly
    def traced(x):
        seen.append(gc.isenabled())
        if x.ndim:
            raise ValueError("a number was wanted")
        return x

    traced(jnp.ones(()))
    assert seen == [False] and gc.isenabled()
    with pytest.raises(ValueError, match="a number was wanted"):
        traced(jnp.ones(3))
    assert gc.isenabled()
    gc.disable()
    try:
        traced(jnp.ones((), int))
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_what_hangs_on_the_form_is_asked_once_and_sees_no_numbers():
    asked = []

    @by_form
    def said(numbers, name):
        asked.append(is_traced(numbers))
        return name, [isinstance(x, int) for x in numbers]

    for value in (1.0, 2.0):
        assert said((jnp.asarray(value), 0), "a") == ("a", [False, True])
    assert said((jnp.asarray(1.0), 0), "b") == ("b", [False, True])
    assert asked == [True, True]
