"""A scan with loops in its turns is one kernel, which writes itself what the turns leave; its
values and derivatives are those of JAX's own scan."""

import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import TableLayout, explain, loop, scan, stop, stoppable, verdict, while_loop
from jaxclear.native.verdicts import KERNELS
from tests.rigs.cells import slow_but

# Sums of products in another order, beside numbers up to some ten.
ROUNDING = 1e-11
TABLE = jnp.linspace(-1.0, 1.0, 200) ** 3
PLACE = jnp.array([1.0, 0.7, 0.5])


def through(own_scan, own_loop, p, turns=30):
    """A damped swing that is knocked at every third saving time, two to four steps apart."""
    times = jnp.linspace(0.0, 1.0, turns)
    rows = times, jnp.arange(turns), jnp.arange(turns) % 3 == 0

    def turn(state, row):
        (x, v, steps), (now, number, knocked) = state, row
        read = TABLE[jnp.clip((20 * now).astype(int), 0, 199)]

        def step(carry):
            count, x, v = carry
            v = 0.9 * v - 0.1 * jnp.tanh(p[0] * x) + 0.01 * p[1] * read
            return count + 1, x + 0.1 * v, v

        begin = (jnp.zeros((), int), x, v)
        more, x, v = own_loop(lambda carry: carry[0] < 2 + number % 3, step, begin)
        x = jnp.where(knocked, x * p[2], x)
        return (x, v, steps + more), (jnp.stack([x, v]), steps, knocked, p[1] * x)

    first = p[2], jnp.ones(()), jnp.zeros((), int)
    return own_scan(turn, first, rows)


OWN = lambda p: through(scan, while_loop, p)
JAXS = lambda p: through(jax.lax.scan, jax.lax.while_loop, p)


def floats(of):
    """Of last state and table what moves."""

    def some(p):
        last, (states, _, _, scaled) = of(p)
        return last[0], states, scaled

    return some


WAYS = {
    "values": lambda f: lambda p: f(p),
    "of a batch": lambda f: lambda p: jax.vmap(f)(p * jnp.linspace(0.9, 1.1, 11)[:, None]),
    "along one direction": lambda f: lambda p: jax.jvp(floats(f), (p,), (jnp.ones(3),)),
    "slopes by three": lambda f: jax.jacfwd(floats(f)),
    "slopes by nineteen": lambda f: (
        lambda p: jax.jacfwd(lambda q: floats(f)(p + q[:3] * q.sum()))(jnp.linspace(0.0, 0.1, 19))
    ),
    "slopes in a batch": lambda f: (
        lambda p: jax.vmap(jax.jacfwd(floats(f)))(p * jnp.linspace(0.9, 1.1, 11)[:, None])
    ),
    "slopes of a batch": lambda f: jax.jacfwd(
        lambda q: jax.vmap(lambda c: floats(f)(q * c))(jnp.linspace(0.9, 1.1, 3))
    ),
    "of second order": lambda f: jax.jacfwd(jax.jacfwd(floats(f))),
    "as a linear map": lambda f: lambda p: jax.vmap(jax.linearize(floats(f), p)[1])(jnp.eye(3)),
}


def same(found, wanted):
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=ROUNDING)


QUICK = ("values", "of a batch", "slopes in a batch", "as a linear map")


@pytest.mark.parametrize("way", slow_but(QUICK, WAYS))
def test_a_scan_is_that_of_jax_through_one_kernel(way, built):

    def told(p):
        found = WAYS[way](OWN)(p)
        return found, verdict(jax.tree.leaves(found)[0])

    found, number = jax.jit(told)(PLACE)
    same(found, jax.jit(WAYS[way](JAXS))(PLACE))
    assert explain(number) == KERNELS
    assert [program.length for program in built] == [30]


@pytest.mark.parametrize("turns", [1, 2, 64, 65])
def test_tables_of_any_length(turns):
    found, wanted = (
        jax.jit(lambda p, how=how: through(*how, p, turns))(PLACE)
        for how in ((scan, while_loop), (jax.lax.scan, jax.lax.while_loop))
    )
    same(found, wanted)


def test_what_has_no_machine_code_keeps_its_inner_kernels():
    def swing(own_scan, own_loop):
        def turn(state, row):
            step = lambda s: (s[0] + 1, 0.9 * s[1] + row)
            _, state = own_loop(lambda s: s[0] < 5, step, (jnp.zeros((), int), state))
            return jnp.sort(state), state

        return own_scan(turn, jnp.array([1.0, -1.0]), jnp.linspace(0.0, 1.0, 7))

    def told():
        last, rows = swing(scan, while_loop)
        return (last, rows), verdict(last)

    found, number = jax.jit(told)()
    same(found, jax.jit(lambda: swing(jax.lax.scan, jax.lax.while_loop))())
    assert explain(number) == KERNELS


def test_a_kernel_that_leaves_no_rows_is_not_taken_where_it_is_checked(monkeypatch, built, checked):
    monkeypatch.setattr(loop.kernels.Tables, "leave", lambda self, row: None)
    shifted = lambda p: through(scan, while_loop, p + 0.125)
    same(jax.jit(shifted)(PLACE), jax.jit(lambda p: JAXS(p + 0.125))(PLACE))
    # The scan's kernel, then that of the loop within its turns.
    assert [program.length for program in built] == [30, 0]


def test_nothing_that_was_stopped_looks_like_an_answer():
    def long(limit):
        def turn(x, _):
            step = lambda s: (s[0] + 1, jnp.cos(s[1]))
            _, x = while_loop(lambda s: s[0] < limit, step, (jnp.zeros((), int), x))
            return x, x

        return scan(turn, jnp.array(0.5), jnp.zeros(5))

    run = jax.jit(long).lower(1).compile()
    assert np.all(np.isfinite(run(1)[1]))
    begun = time.perf_counter()
    kept = []
    with pytest.raises(KeyboardInterrupt), stoppable():
        threading.Timer(0.2, stop).start()
        kept.append(jax.block_until_ready(run(10**15)))
    assert time.perf_counter() - begun < 5
    for last, rows in kept:
        assert np.isnan(last) and np.all(np.isnan(rows))


TURNS, SEEN = 30, np.array([4, 11, 29])


def by_parts(turn, first, rows):
    """A scan as `through` asks for it, what its turns leave kept in parts: states behind a first
    one, some at three turns only, some in reversed order."""
    numbers = np.arange(TURNS)
    looks = np.where(np.isin(numbers, SEEN), np.searchsorted(SEEN, numbers), len(SEEN))

    def one(state, row):
        state, (states, steps, knocked, scaled) = turn(state, row)
        return state, (states, (steps, scaled), knocked)

    kept = [
        TableLayout(numbers + 1, TURNS + 1, jnp.stack([first[0], 2 * first[1]])),
        TableLayout(looks, len(SEEN)),
        TableLayout(numbers[::-1], TURNS),
    ]
    last, (states, (steps, scaled), knocked) = scan(one, first, rows, kept)
    return last, (states, steps, knocked, scaled)


def by_jax(turn, first, rows):
    """The same picked out of what JAX's own scan leaves."""
    last, (states, steps, knocked, scaled) = jax.lax.scan(turn, first, rows)
    states = jnp.vstack([jnp.stack([first[0], 2 * first[1]]), states])
    return last, (states, steps[SEEN], knocked[::-1], scaled[SEEN])


@pytest.mark.parametrize("way", slow_but(["of a batch"], WAYS))
def test_parts_go_to_their_places(way, monkeypatch):
    kernels = jax.jit(WAYS[way](lambda p: through(by_parts, while_loop, p)))(PLACE)
    wanted = jax.jit(WAYS[way](lambda p: through(by_jax, jax.lax.while_loop, p)))(PLACE)
    same(kernels, wanted)
    # Where there are no kernels.
    monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", "1")
    same(jax.jit(WAYS[way](lambda p: through(by_parts, while_loop, p)))(PLACE), wanted)


@pytest.mark.parametrize(
    "places, height, sentence",
    [
        ([0, 2], 3, "rows that no turn leaves"),
        ([-1, 0], 1, "places below 0"),
        ([0, 0], 0, "has 0 rows"),
        ([0, 1, 2], 3, "a whole number for each"),
        ([0.0, 1.0], 2, "a whole number for each"),
    ],
)
def test_a_table_that_is_none_is_refused(places, height, sentence):
    kept = [TableLayout(np.array(places), height)]
    with pytest.raises(ValueError, match=sentence):
        scan(lambda state, row: (state, (row,)), jnp.zeros(()), jnp.zeros(2), kept)
