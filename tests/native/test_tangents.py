"""The derivative of a loop is a loop: as JAX's own, in every order of mapping and differentiating,
through one kernel, which goes through the motion once for several tangents.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import explain, loop, verdict, while_loop
from jaxclear.native.verdicts import KERNELS

# Sums of products in another order.
ROUNDING = 1e-11
TABLE = jnp.linspace(-1.0, 1.0, 200) ** 3


def through(make, p):
    """A damped swing over 40 turns by four numbers, one of them the factor of a long table; with a
    time and a largest value that move nothing."""

    table = p[3] * TABLE

    def turn(s):
        count, time, (x, v), largest = s
        read = table[jnp.clip((20 * time).astype(int), 0, 199)]
        pull = jnp.where(x > 0, p[0], p[1]) * jnp.sin(x) + read
        v = 0.9 * v - 0.1 * jax.jit(jnp.tanh)(pull) + 0.01 * p[2]
        largest = jnp.maximum(largest, jax.lax.stop_gradient(jnp.abs(v)))
        return count + 1, time + 0.1, (x + 0.1 * v, v), largest

    first = (0, 0.0, (p[2], jnp.ones(())), jnp.zeros(()))
    count, _, (x, v), largest = make(lambda s: s[0] < 40, turn, first)
    return jnp.stack([x, v, x * v]), (count, largest)


AT = jnp.array([1.0, 2.0, 0.5, 0.3])
END = lambda make: lambda p: through(make, p)[0]
# 1, 2, 9 and 19 tangents: alone, side by side, in lanes, and more than fill the last of them.
WAYS = {
    "along one direction": lambda f: jax.jvp(f, (AT,), (jnp.ones(4),))[1],
    "by four numbers": lambda f: jax.jacfwd(f)(AT),
    "by nine": lambda f: jax.jacfwd(lambda q: f(AT * q[:4] + q[4:8] + q[8]))(jnp.ones(9)),
    "by nineteen": lambda f: jax.jacfwd(lambda q: f(AT + q.reshape(-1, 1)[:4, 0] * q.sum()))(
        jnp.linspace(0.0, 0.1, 19)
    ),
    "in a batch": lambda f: jax.vmap(jax.jacfwd(f))(AT * jnp.linspace(0.9, 1.1, 11)[:, None]),
    "of a batch": lambda f: jax.jacfwd(
        lambda q: jax.vmap(lambda c: f(AT * q + c))(jnp.arange(3.0))
    )(jnp.ones(4)),
    "of second order": lambda f: jax.jacfwd(jax.jacfwd(f))(AT),
    "as a linear map": lambda f: jax.vmap(jax.linearize(f, AT)[1])(jnp.eye(4)),
}


@pytest.mark.parametrize("way", WAYS)
def test_derivatives_are_those_of_jaxs_own_loop(way):
    found, wanted = (
        jax.jit(lambda m=m: WAYS[way](END(m)))() for m in (while_loop, jax.lax.while_loop)
    )
    assert found.shape == wanted.shape
    np.testing.assert_allclose(found, wanted, rtol=ROUNDING, atol=ROUNDING)


def test_all_tangents_go_through_one_kernel_whose_motion_is_shared(monkeypatch):
    built, build = [], loop.kernels.build
    monkeypatch.setattr(
        loop.kernels, "build", lambda program, lanes: built.append(program) or build(program, lanes)
    )

    @jax.jit
    def slopes(p):
        push = lambda t: jax.jvp(END(while_loop), (p,), (t,))
        # `None`: the motion is the same for all tangents, and known to be.
        value, slopes = jax.vmap(push, out_axes=(None, 0))(jnp.eye(4)[:2])
        return value, slopes, verdict(value)

    value, _, number = slopes(AT)
    assert explain(number) == KERNELS
    np.testing.assert_allclose(value, END(jax.lax.while_loop)(AT), rtol=ROUNDING)
    (program,) = built
    state = program.body.in_avals[program.body_constants :]
    # Count, time, place, speed, largest value, and the tangents of place and speed.
    assert len(state) == 7


def test_what_moves_nothing_keeps_its_value_and_has_no_slope():
    def largest(make):
        return jax.jvp(lambda p: through(make, p)[1][1], (AT,), (AT,))

    (value, slope), (wanted, zero) = largest(while_loop), largest(jax.lax.while_loop)
    assert abs(value - wanted) < ROUNDING and slope == zero == 0


def test_reverse_mode_is_refused_with_a_sentence():
    with pytest.raises(ValueError, match=r"steps_per_save.*forward\s+mode"):
        jax.grad(lambda p: END(while_loop)(p).sum())(AT)


def test_in_a_batch_the_motion_is_shared_by_tangents_as_well(monkeypatch):
    """Two of four stand side by side in one body, whichever map comes first."""
    built, build = [], loop.kernels.build
    monkeypatch.setattr(
        loop.kernels, "build", lambda program, lanes: built.append(program) or build(program, lanes)
    )

    def slopes(p):
        push = lambda t: jax.jvp(END(while_loop), (p,), (t,))
        return jax.vmap(push, out_axes=(None, 0))(jnp.eye(4))

    batch = AT * jnp.linspace(0.9, 1.1, 11)[:, None]
    value, slope = jax.jit(jax.vmap(slopes))(batch)
    np.testing.assert_allclose(
        value, jax.vmap(END(jax.lax.while_loop))(batch), rtol=ROUNDING, atol=ROUNDING
    )
    assert slope.shape == (11, 4, 3)
    (program,) = built
    state = program.body.in_avals[program.body_constants :]
    # Count, time, place, speed, largest value, and two tangents each of place and speed.
    assert [a.shape for a in state] == [()] * 5 + [(2,)] * 2
