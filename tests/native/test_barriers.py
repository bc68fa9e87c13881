"""Long functions in pieces, for accelerators: the same numbers, and little is worked out anew."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import Literal

import jaxclear as jc
from jaxclear.native import program_pieces
from jaxclear.native.loop import reference_in_pieces, reference_of_batch
from jaxclear.native.program import replay
from jaxclear.native.while_loops import while_loop


@jax.custom_jvp
def halved(x):
    return 0.5 * x


halved.defjvp(lambda given, ways: (halved(*given), 0.5 * ways[0]))


def turned(x):
    """Twenty times: three numbers taken apart, put together again at other places, multiplied."""
    for _ in range(20):
        a, b, c = x
        x = jnp.stack([b * c, jnp.sin(a) + c, halved(a - b)])
        x = jnp.eye(3)[::-1] @ x
    return x


def looped(x):
    """Loops whose turns are such functions."""

    def turn(carry):
        i, y = carry
        return i + 1, turned(y) + 0.1

    x = jax.lax.while_loop(lambda carry: carry[0] < 3, turn, (0, x))[1]
    x, rows = jax.lax.scan(lambda y, t: (turned(y + t), y.sum()), x, jnp.arange(4.0))
    return jnp.where(x[0] > 0, x, jax.lax.cond(x[1] > 0, turned, jnp.cos, x)), rows


def barriers_in(program):
    return str(program).count("optimization_barrier")


def in_pieces_of(function):
    def called(*given):
        program = jax.make_jaxpr(function)(*given)
        return program_pieces.in_pieces(program)(*given)

    return called


@pytest.mark.parametrize("function", [turned, looped])
def test_numbers_are_the_same(function):
    given = np.random.default_rng(3).normal(size=(8, 3))
    expected = jax.tree.leaves(jax.jit(jax.vmap(function))(given))
    found = jax.jit(jax.vmap(in_pieces_of(function)))(given)
    assert barriers_in(jax.make_jaxpr(in_pieces_of(function))(given[0])) >= 2
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)


def most_work(program, reader=None):
    """The most operations that a number of a program takes within its piece, by brute force: what
    stands at another place than what reads it is written out again. Of what operations of a name
    read alone, if one is given."""
    work, most = {}, 0
    for equation in program.jaxpr.eqns:
        if equation.primitive.name == "optimization_barrier":
            work = {}
            continue
        read = sum(work.get(v, 0) for v in equation.invars if not isinstance(v, Literal))
        times = 3 if equation.primitive.name == "dot_general" else 1
        for out in equation.outvars:
            work[out] = 1 + times * read
        if reader is None:
            most = max(most, 1 + times * read)
        elif equation.primitive.name == reader:
            most = max(most, read)
    return most


def test_a_piece_ends_before_work_is_done_many_times():
    whole = jax.make_jaxpr(turned)(jnp.ones(3))
    cut = jax.make_jaxpr(in_pieces_of(turned))(jnp.ones(3))
    flat = jax.make_jaxpr(lambda x: replay(whole, [x]))(jnp.ones(3))
    # An operation of three terms that reads others of fewer than `WORK`.
    assert most_work(cut) < 10 * program_pieces.WORK < 1e-6 * most_work(flat)


def looked_up(angle, table):
    """Three neighbours in a table, where a chain of operations says, thrice."""
    for _ in range(3):
        for _ in range(8):
            angle = jnp.sin(angle) + 0.1 * angle
        place = jnp.floor(100.0 * angle).astype(int)
        angle += sum(jax.lax.dynamic_slice(table, (place,), (3,)))
    return angle


def test_where_to_read_is_worked_out_once():
    table = jnp.asarray(np.random.default_rng(2).normal(size=(50,)))
    over = jax.vmap(looked_up, (0, None))
    angles = jnp.linspace(0.0, 1.0, 4)
    cut = jax.make_jaxpr(in_pieces_of(over))(angles, table)
    whole = jax.make_jaxpr(over)(angles, table)
    flat = jax.make_jaxpr(lambda *given: replay(whole, given))(angles, table)
    assert most_work(cut, "gather") <= program_pieces.LITTLE < 30 < most_work(flat, "gather")
    found = in_pieces_of(over)(angles, table)
    np.testing.assert_allclose(found[0], over(angles, table), rtol=1e-12)


def test_what_is_short_is_left_whole():
    program = jax.make_jaxpr(in_pieces_of(lambda x: jnp.sin(x) + x[0]))(jnp.ones(3))
    assert barriers_in(program) == 0


def lowered(platform):
    """A Monte Carlo's program, lowered for a platform that need not be there."""
    rig = jc.scenes.slider_crank()
    clearance = jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=20e-6)
    how = {"duration": 0.002, "integrator": jc.integrator.ImplicitStep(1e-4), "save": 3}
    problem = jc.Problem(rig, jc.response.MeanContactForce("B"), {"c": clearance}, **how)
    values = jnp.tile(problem.nominal(), (5, 1))
    traced = jax.jit(jax.vmap(problem.evaluate)).trace(values)
    return traced.lower(lowering_platforms=(platform,)).as_text()


def test_programs_for_accelerators_are_in_pieces_and_take_samples_side_by_side(monkeypatch):
    cut = lowered("cuda")
    monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", "1")
    plain = lowered("cpu")
    assert cut.count("optimization_barrier") > 5 > plain.count("optimization_barrier") == 0
    # On a CPU functions of one turn are loops over the samples.
    assert cut.count("stablehlo.while") < plain.count("stablehlo.while")


def test_loops_in_pieces_give_what_plain_loops_do():
    def run(x):
        return while_loop(lambda carry: carry[0] < 5, lambda c: (c[0] + 1, turned(c[1])), (0, x))

    (equation,) = (
        e
        for e in jax.make_jaxpr(jax.vmap(run))(jnp.ones((4, 3))).jaxpr.eqns
        if e.primitive.name == "jaxclear_loop"
    )
    program, rank = equation.params["program"], equation.params["rank"]
    first = np.random.default_rng(5).normal(size=(4, 3))
    given = [first if v.aval.shape == (4, 3) else np.zeros(4, int) for v in equation.invars]
    plain, cut = (
        jax.jit(functools.partial(way, program=program, rank=rank))(*given)
        for way in (reference_of_batch, reference_in_pieces)
    )
    for one, other in zip(plain, cut, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)
