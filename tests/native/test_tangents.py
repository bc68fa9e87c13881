"""The derivative of a loop is a loop: as JAX's own, in every order of mapping and differentiating,
through one kernel, which goes through the motion once for several tangents."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import explain, forwards_only, scan, verdict, while_loop
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


def test_all_tangents_go_through_one_kernel_whose_motion_is_shared(built):

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
    # Count, time, place, speed, and the tangents of place and speed; nobody asks for the largest.
    assert len(state) == 6


def test_what_moves_nothing_keeps_its_value_and_has_no_slope():
    def largest(make):
        return jax.jvp(lambda p: through(make, p)[1][1], (AT,), (AT,))

    (value, slope), (wanted, zero) = largest(while_loop), largest(jax.lax.while_loop)
    assert abs(value - wanted) < ROUNDING and slope == zero == 0


SOME = AT * jnp.linspace(0.9, 1.1, 3)[:, None]
# By `d`, backwards or forwards; the loop reads 200 numbers of a table that move.
BACKWARDS = {
    "alone": lambda f, d: d(f)(AT),
    "of a batch": lambda f, d: d(lambda p: jnp.sum(jax.vmap(f)(p) ** 2))(SOME),
    "in a batch": lambda f, d: jax.vmap(d(f))(SOME),
    "of second order": lambda f, d: jax.jacfwd(d(f))(AT),
    "twice backwards": lambda f, d: d(d(f))(AT),
}


@pytest.mark.parametrize(
    "way", [pytest.param(w, marks=[pytest.mark.slow] * (w != "of a batch")) for w in BACKWARDS]
)
def test_reverse_mode_gives_what_forward_mode_of_jaxs_own_loop_does(way):
    found = jax.jit(lambda: BACKWARDS[way](END(while_loop), jax.jacrev))()
    wanted = jax.jit(lambda: BACKWARDS[way](END(jax.lax.while_loop), jax.jacfwd))()
    np.testing.assert_allclose(found, wanted, rtol=ROUNDING, atol=ROUNDING)


def overflowing(p):
    """12 times squared: from 1.5 beyond the largest float."""
    turn = lambda s: (s[0] + 1, s[1] * s[1] * p)
    return while_loop(lambda s: s[0] < 12, turn, (jnp.zeros((), int), p))[1]


def test_samples_that_do_not_count_leave_the_others_reverse_slopes_alone():
    def total(scale):
        found = jax.vmap(overflowing)(scale * jnp.array([0.999, 1.5]))
        return jnp.sum(jnp.where(jnp.isfinite(found), found, 0.0))

    assert not jnp.isfinite(overflowing(1.5))
    value, slope = jax.jit(jax.value_and_grad(total))(1.0)
    # p to the power of 2^13 - 1.
    np.testing.assert_allclose([value, slope], [0.999**8191, 8191 * 0.999**8191], rtol=1e-9)


def test_a_square_keeps_its_curvature_where_it_vanishes():
    """There the cotangent is 0, and its own slope counts."""
    miss = lambda p: (while_loop(lambda s: s[0] < 3, lambda s: (s[0] + 1, s[1] * p), (0, p))[1]) - 1
    assert jax.jit(jax.hessian(lambda p: miss(p) ** 2))(1.0) == pytest.approx(2 * 4**2)


def test_reverse_mode_passes_where_only_an_empty_array_moves():
    def run(some):
        turn = lambda s: (s[0] + 1, s[1] + jnp.sum(s[2]), 2 * s[2])
        return while_loop(lambda s: s[0] < 3, turn, (0, 1.0, some))[1]

    assert jax.grad(run)(jnp.zeros(0)).shape == (0,)


@pytest.mark.slow
def test_reverse_mode_passes_through_the_rows_of_a_scan():
    turn = lambda s, row: ((s[0] * 0.9 + row * s[1], s[1]), s[0] ** 2)
    run = lambda make: lambda p: jnp.sum(make(turn, (p[0], p[1]), p[2] * jnp.arange(5.0))[1])
    found, wanted = (jax.grad(run(make))(AT[:3]) for make in (scan, jax.lax.scan))
    np.testing.assert_allclose(found, wanted, rtol=ROUNDING)


def test_what_is_forwards_only_says_so_backwards_and_is_itself_forwards():
    square = lambda x: forwards_only("this way only", (x**2, 3))[0]
    assert jax.vmap(lambda x: jax.jvp(square, (x,), (1.0,))[1])(AT).tolist() == (2 * AT).tolist()
    with pytest.raises(ValueError, match="this way only"):
        jax.grad(square)(1.0)


@pytest.mark.parametrize(("count", "together"), [(2, 2), (4, 4), (6, 3)])
def test_in_a_batch_the_motion_is_shared_by_tangents_as_well(built, count, together):
    """Up to four stand side by side in one body, in even portions, whichever map comes first."""
    directions = jnp.asarray(np.random.default_rng(1).normal(size=(count, 4)))

    def slopes(p):
        push = lambda t: jax.jvp(END(while_loop), (p,), (t,))
        return jax.vmap(push, out_axes=(None, 0))(directions)

    batch = AT * jnp.linspace(0.9, 1.1, 16)[:, None]
    value, slope = jax.jit(jax.vmap(slopes))(batch)
    plain = END(jax.lax.while_loop)
    np.testing.assert_allclose(value, jax.vmap(plain)(batch), rtol=ROUNDING, atol=ROUNDING)
    matrix = jax.vmap(jax.jacfwd(plain))(batch)
    np.testing.assert_allclose(
        slope, jnp.einsum("kp,sxp->skx", directions, matrix), rtol=1e-12, atol=1e-13
    )
    (program,) = built
    state = program.body.in_avals[program.body_constants :]
    # Count, time, place, speed, and the tangents of place and speed; nobody asks for the largest.
    assert [a.shape for a in state] == [()] * 4 + [(together,)] * 2


def in_steps_of_its_own(make):
    """Decays one after the other, whose derivative is that of a loop which looks at the tangent."""

    def turn(x, rate):
        return x - 0.1 * rate * x

    @jax.custom_jvp
    def decay(x, rate):
        return make(lambda s: s[0] < 8, lambda s: (s[0] + 1, turn(s[1], rate)), (0, x))[1]

    @decay.defjvp
    def moving(numbers, tangents):
        (x, rate), (dx, d_rate) = numbers, tangents

        def both(s):
            return s[0] + 1, *jax.jvp(turn, (s[1], rate), (s[2], d_rate))

        go = lambda s: (s[0] < 8) & (jnp.abs(s[2]) < 0.7)
        return decay(x, rate), make(go, both, (0, x, dx))[2]

    def function(p):
        outer = lambda s: (s[0] + 1, decay(s[1], p[s[0] % 2]) + p[2])
        return make(lambda s: s[0] < 5, outer, (0, p[0] * p[1]))[1][None]

    return function


@pytest.mark.parametrize("way", ["along one direction", "by four numbers", "by nine", "in a batch"])
def test_loops_within_whose_steps_follow_their_tangents_are_kernels(way):
    """Each tangent goes through the motion by itself. What is left to XLA is an error here."""
    found, wanted = (
        jax.jit(lambda m=m: WAYS[way](in_steps_of_its_own(m)))()
        for m in (while_loop, jax.lax.while_loop)
    )
    np.testing.assert_allclose(found, wanted, rtol=ROUNDING)
