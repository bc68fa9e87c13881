"""Long arrays of a loop's state stand in memory, where a turn reads and changes them: values and
derivatives are those of JAX's own loops, and what cannot be told by it is left to XLA."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import NoKernel, explain, loop, only_kernels, scan, verdict, while_loop
from jaxclear.native.verdicts import KERNELS

LENGTH, TURNS = 90, 12
# Sums of products in another order.
ROUNDING = 1e-11
NOTHING = jnp.zeros((), int)
FIRST = jnp.linspace(0.1, 1.0, LENGTH).reshape(45, 2)


def entry(array, place):
    return jax.lax.dynamic_slice(array, place, (1, 1))[0, 0]


def worn(own_scan, own_loop, p):
    """A place goes round a map, and takes off as many cells there as it is far from where it began;
    a second map of few numbers keeps count."""
    rows = jnp.arange(TURNS) * 1.0

    def turn(state, number):
        x, depth, few = state
        first = jnp.floor(7.0 * x).astype(int)

        def cell(carry):
            count, total, depth, few = carry
            place = (first + count) % 45, count % 2
            before = entry(depth, place)
            after = before + p[1] * jnp.sin(before + x) * (1.0 + entry(depth, (count, NOTHING)))
            depth = jax.lax.dynamic_update_slice(depth, after[None, None], place)
            kept = jax.lax.dynamic_slice(few, (count % 3,), (1,))
            few = jax.lax.dynamic_update_slice(few, kept + after, (count % 3,))
            return count + 1, total + after, depth, few

        begin = NOTHING, jnp.zeros(()), depth, few
        long = {} if own_loop is jax.lax.while_loop else {"long": (False, False, True, True)}
        steps = 1 + (number.astype(int) + first) % 5
        _, total, depth, few = own_loop(lambda carry: carry[0] < steps, cell, begin, **long)
        return (x + 0.1 * p[0] + 0.01 * total, depth, few), (total, depth)

    long = {} if own_scan is jax.lax.scan else {"long": (False, True, True)}
    first = p[0], p[2] * FIRST, jnp.zeros(3)
    return own_scan(turn, first, rows, **long)


OWN = lambda p: worn(scan, while_loop, p)
JAXS = lambda p: worn(jax.lax.scan, jax.lax.while_loop, p)
P = jnp.array([1.0, 0.3, 0.5])
BATCH = P * jnp.linspace(0.6, 1.4, 11)[:, None]
WAYS = {
    "values": lambda f: f(P),
    "of a batch": lambda f: jax.vmap(f)(BATCH),
    "along one direction": lambda f: jax.jvp(f, (P,), (jnp.ones(3),)),
    "slopes": lambda f: jax.jacfwd(f)(P),
    "slopes in a batch": lambda f: jax.vmap(jax.jacfwd(f))(BATCH),
}


@pytest.mark.parametrize("way", WAYS)
def test_long_arrays_change_as_in_loops_of_jax(way):
    # Fixed numbers, that XLA does not work out beforehand: a batch of one is another program.
    found, wanted = (jax.jit(lambda f=f: WAYS[way](f))() for f in (OWN, JAXS))
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert np.all(np.isfinite(other)) and np.any(np.asarray(other) != 0)
        np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=ROUNDING)


def test_its_gradient_is_that_of_slopes():
    """JAX goes through a loop whose turns it does not know forwards alone."""
    answer = lambda f: lambda p: (lambda last, left: last[1].sum() + left[0][3])(*f(p))
    found = jax.jit(jax.grad(answer(OWN)))(P)
    np.testing.assert_allclose(found, jax.jit(jax.jacfwd(answer(JAXS)))(P), rtol=ROUNDING)


def test_a_long_array_that_changes_is_part_of_the_kernel():
    with only_kernels():
        told = jax.jit(lambda p: verdict(OWN(p)[0][0]))(P)
    assert explain(int(told)) == KERNELS


def test_what_a_kernel_is_given_stays_as_it_was():
    given = FIRST + 0.0
    last, _ = jax.jit(
        lambda depth: scan(
            lambda now, _: (jax.lax.dynamic_update_slice(now, jnp.ones((1, 2)), (3, 0)), ()),
            depth,
            np.zeros(2),
            long=True,
        )
    )(given)
    np.testing.assert_array_equal(given, FIRST)
    np.testing.assert_array_equal(last, FIRST.at[3].set(1.0))


def before_it_changed(now):
    other = jax.lax.dynamic_update_slice(now, jnp.ones((1, 2)), (3, 0))
    return jax.lax.dynamic_update_slice(other, now[3:4] + 1.0, (4, 0))


def all_of_it(now):
    return 2.0 * now


@pytest.mark.parametrize("change", [before_it_changed, all_of_it])
def test_what_machine_code_cannot_do_to_a_long_array_is_left_to_xla(change, monkeypatch):
    """An array as it was before it changed is nowhere any more; numbers all of which change are no
    matter of an index."""
    turn = lambda now: (now[0] + 1, change(now[1]))
    run = lambda depth: while_loop(lambda now: now[0] < 2, turn, (NOTHING, depth), (False, True))[1]
    with pytest.raises(NoKernel, match="long array"), only_kernels():
        jax.jit(run)(FIRST)
    monkeypatch.setattr(loop, "_WARNED", set())
    with pytest.warns(RuntimeWarning, match="long array"):
        found = jax.jit(lambda depth: run(depth))(FIRST)
    np.testing.assert_allclose(found, change(change(FIRST)), rtol=1e-15)


def test_whole_rows_of_a_long_table_are_read_where_they_stand():
    """A row of more numbers than registers hold, of another row for each turn and each sample."""
    table = jnp.sin(jnp.arange(6 * LENGTH) * 1.0).reshape(6, LENGTH)

    def sums(own_scan, begin, table):
        def turn(total, k):
            row = jax.lax.dynamic_index_in_dim(table, (begin + k) % 6, keepdims=False)
            three = jax.lax.dynamic_slice(row, (7 * k,), (3,))
            return total + jnp.sum(three), three

        return own_scan(turn, jnp.zeros(()), jnp.arange(TURNS))

    begins, tables = jnp.arange(5), jnp.stack([table, 2 * table, table, -table, table + 1])
    found, wanted = (
        jax.jit(jax.vmap(lambda *own, f=f: sums(f, *own)))(begins, tables)
        for f in (scan, jax.lax.scan)
    )
    with only_kernels():
        alone = jax.jit(lambda *own: sums(scan, *own))(begins[3], tables[3])
    for one, other, single in zip(*map(jax.tree.leaves, (found, wanted, alone)), strict=True):
        np.testing.assert_allclose(one, other, rtol=ROUNDING)
        np.testing.assert_allclose(single, other[3], rtol=ROUNDING)
