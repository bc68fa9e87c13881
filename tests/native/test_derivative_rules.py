"""Backwards by columns a function has the derivative that JAX gives it, in every order of mapping
and differentiating, for one trip through its loop; forwards it is the function itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import by_columns, while_loop

# Sums of products in another order.
ROUNDING = 1e-11
AT = jnp.array([1.0, 2.0, 0.5, 0.3])
SHARED = jnp.array(0.7)


def swing(make):
    """A damped swing over 40 turns by four numbers and one more, its whole way; with a count."""

    def run(p, q):
        turn = lambda s: (s[0] + 1, s[1] + 0.1 * s[2], 0.9 * s[2] - p[0] * jnp.sin(s[1]) * p[1])
        count, x, v = make(lambda s: s[0] < 40, turn, (0, p[2], q * p[3]))
        return {"end": jnp.stack([x, v * q, x * v]), "count": count, "said": "a word"}

    return run


def ours(p, q=SHARED):
    return by_columns(swing(while_loop), p, q)["end"]


def plain(p, q=SHARED):
    return swing(jax.lax.while_loop)(p, q)["end"]


SOME = AT * jnp.linspace(0.9, 1.1, 3)[:, None]
# By `d`, backwards by ours and forwards by JAX's own.
WAYS = {
    "alone": lambda f, d: d(f)(AT),
    "by both": lambda f, d: d(lambda *a: f(*a)[2], (0, 1))(AT, SHARED),
    "in a batch": lambda f, d: jax.vmap(d(f))(SOME),
    "of a batch, by what is its own and by what is shared": lambda f, d: d(
        lambda p, q: jnp.sum(jax.vmap(f, (0, None))(p, q) ** 2), (0, 1)
    )(SOME, SHARED),
    "of a batch of batches": lambda f, d: d(
        lambda p: jax.vmap(jax.vmap(f), 1)(p[:, None] * jnp.ones((2, 1)))
    )(SOME),
    "of more than fit side by side": lambda f, d: d(
        lambda p: by_columns(lambda n: f(n.reshape(-1, 4).sum(0)), p)
    )(jnp.linspace(0.01, 0.1, 36)),
    "of second order": lambda f, d: jax.jacfwd(d(f))(AT),
    "twice backwards": lambda f, d: d(d(f))(AT),
    "backwards of forwards": lambda f, d: d(jax.jacfwd(f))(AT),
    "forwards, of a batch": lambda f, d: jax.jacfwd(lambda c: jax.vmap(f)(SOME * c))(1.0),
}
QUICK = ("of a batch, by what is its own and by what is shared", "by both")


@pytest.mark.parametrize(
    "way", [pytest.param(w, marks=[pytest.mark.slow] * (w not in QUICK)) for w in WAYS]
)
def test_derivatives_are_those_of_jaxs_own_loop_forwards(way):
    found = jax.jit(lambda: WAYS[way](ours, jax.jacrev))()
    wanted = jax.jit(lambda: WAYS[way](plain, jax.jacfwd))()
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert one.shape == other.shape
        np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.slow
def test_its_linear_map_is_its_derivative():
    columns = jax.jit(lambda: jax.vmap(jax.linearize(ours, AT)[1])(jnp.eye(4)))()
    np.testing.assert_allclose(columns, jax.jacfwd(plain)(AT).T, rtol=ROUNDING, atol=ROUNDING)


def test_what_is_no_number_and_what_is_known_come_back_as_they_are():
    known = jnp.arange(3.0)
    found = jax.jit(lambda p: by_columns(lambda a, b: (a * b["times"], b), p, {"times": known})[0])
    assert found(jnp.asarray(2.0)).tolist() == [0, 2, 4]
    whole = by_columns(swing(while_loop), AT, SHARED)
    assert whole["said"] == "a word" and whole["count"] == 40
    told = []
    jax.jit(lambda p: told.append(by_columns(lambda a, b: (a, b), p, known)[1]))(1.0)
    assert told[0] is known


def test_value_and_gradient_go_through_one_loop_once(built):
    jax.jit(jax.value_and_grad(lambda p: jnp.sum(ours(p) ** 2)))(AT)
    (program,) = built
    assert len(program.body.in_avals) > program.body_constants + 3


def overflowing(p):
    """12 times squared: from 1.5 beyond the largest float."""
    turn = lambda s: (s[0] + 1, s[1] * s[1] * p)
    return by_columns(lambda p: while_loop(lambda s: s[0] < 12, turn, (0, p))[1], p)


def test_samples_that_do_not_count_leave_the_others_slopes_alone():
    def total(scale):
        found = jax.vmap(overflowing)(scale * jnp.array([0.999, 1.5]))
        return jnp.sum(jnp.where(jnp.isfinite(found), found, 0.0))

    value, slope = jax.jit(jax.value_and_grad(total))(1.0)
    # p to the power of 2^13 - 1.
    np.testing.assert_allclose([value, slope], [0.999**8191, 8191 * 0.999**8191], rtol=1e-9)


def test_what_would_tell_the_host_something_is_left_as_it_is():
    """Its derivative backwards is JAX's own."""
    told = []

    def run(p):
        jax.debug.callback(told.append, p)
        return p**2

    assert jax.grad(lambda p: by_columns(run, p))(3.0) == 6.0 and told
