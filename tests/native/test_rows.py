"""A function over rows is what `jax.vmap` makes of it, however many rows, however long the
function, with its derivatives, with and without a kernel; samples that are gone through one after
the other are what they are side by side, and each takes only the branch that it chooses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import (
    explain,
    in_one,
    loop,
    one_by_one,
    one_row,
    over_rows,
    rows,
    verdict,
)
from jaxclear.native.verdicts import NO_LOOPS

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


def no_rule(x, table, key):
    """A part of it that no kernel can be."""
    return {"x": jnp.sort(table[:4] * jnp.sin(long(x, table, key)["x"]))}


@pytest.mark.parametrize("function", [long, short, no_rule])
@pytest.mark.parametrize("kernels", [True, False])
def test_a_function_in_one_is_itself_in_a_batch_too_and_tells_nothing(
    function, kernels, monkeypatch
):
    if not kernels:
        monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", "1")
    one = lambda *x: in_one(lambda: function(*x))
    numbers = given(5)
    mapped = jax.jit(lambda *x: (jax.vmap(one)(*x), verdict(x[0])))
    found, said = mapped(*numbers)
    wanted = jax.vmap(function)(*numbers)
    for each, other in zip(*map(jax.tree.leaves, (found, wanted)), strict=True):
        np.testing.assert_allclose(each, other, rtol=ROUNDING, atol=ROUNDING)
    assert explain(said) == NO_LOOPS
    assert "while" not in mapped.lower(*numbers).as_text()
    slopes = jax.vmap(jax.grad(lambda x, *rest: jnp.sum(one(x, *rest)["x"])))(*numbers)
    own = jax.vmap(jax.grad(lambda x, *rest: jnp.sum(function(x, *rest)["x"])))(*numbers)
    np.testing.assert_allclose(slopes, own, rtol=ROUNDING)


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


SCALE = jnp.linspace(1.0, 2.0, 3)


def plain(state, p):
    x, count = state
    dear = lambda: jnp.sin(p * x) * SCALE
    return jax.lax.cond(jnp.sum(x) > 1.0, dear, lambda: x * p), count + 1


def through(function):
    """In the turns of a loop, what is handed in aside from the loop's carry included."""

    def of(p):
        turn = lambda carry, row: (function(carry, p * row), carry[0].sum())
        first = p * jnp.array([0.3, 0.5, 0.1]), jnp.zeros((), int)
        (x, count), sums = jax.lax.scan(turn, first, jnp.linspace(0.5, 1.5, 5))
        return x, sums, count

    return of


MANY = jnp.linspace(0.5, 3.0, 6)
WAYS = {
    "alone": lambda f: f(2.0),
    "a batch": lambda f: jax.vmap(f)(MANY),
    "a batch of batches": lambda f: jax.vmap(jax.vmap(f))(MANY.reshape(2, 3)),
    "slopes": lambda f: jax.jacfwd(lambda p: f(p[0] + p[1] ** 2)[:2])(jnp.array([1.0, 0.5])),
    "slopes of each of a batch": lambda f: jax.vmap(jax.jacfwd(lambda p: f(p[0] + p[1] ** 2)[:2]))(
        jnp.stack([MANY, MANY], 1)
    ),
    "slopes of a batch": lambda f: jax.jacfwd(lambda p: jax.vmap(f)(p * MANY)[:2])(1.0),
    "of second order": lambda f: jax.vmap(jax.jacfwd(jax.jacfwd(lambda p: f(p)[0])))(MANY),
}


@pytest.mark.parametrize("in_turn", [True, False], ids=["in turn", "on an accelerator"])
@pytest.mark.parametrize("way", WAYS)
def test_one_by_one_is_side_by_side(monkeypatch, way, in_turn):
    monkeypatch.setattr(rows, "_in_turn", lambda: in_turn)
    found, wanted = (
        jax.jit(lambda f=f: WAYS[way](through(f)))() for f in (one_by_one(plain), plain)
    )
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert one.shape == other.shape and one.dtype == other.dtype
        # Sums of products in another order.
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)


def _choices(jaxpr):
    """Shapes of what the conditions of a program, and of those within it, hang on."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "cond":
            yield equation.invars[0].aval.shape
        for inner in jax.tree.leaves(list(equation.params.values())):
            if hasattr(inner, "eqns") or hasattr(inner, "jaxpr"):
                yield from _choices(getattr(inner, "jaxpr", inner))


def test_a_sample_takes_its_own_branch():
    batch = lambda f: jax.make_jaxpr(jax.vmap(through(f)))(MANY).jaxpr
    assert list(_choices(batch(one_by_one(plain)))) == [()]
    # Side by side both branches are taken, and each sample's picked.
    assert list(_choices(batch(plain))) == []


def test_many_tangents_share_the_motion():
    """What does not hang on tangents is worked out once for all of them."""
    slopes = jax.make_jaxpr(jax.jacfwd(lambda p: one_by_one(plain)((p, 0), 2.0)[0]))(SCALE)
    (own,) = [e for e in slopes.jaxpr.eqns if e.primitive.name == "jaxclear_one_by_one"]
    assert [atom.aval.shape for atom in own.outvars] == [(3,), (), (3, 3)]
