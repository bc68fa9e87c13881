"""In a batch XLA may evaluate an expression twice with different rounding, so that two choices that
hang on it disagree. Nothing that is computed may then be far from both sides.

The arc sine that XLA goes through eight numbers at a time is the C library's."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import Literal

from jaxclear.complementarity import interior_point
from jaxclear.components.joint import group
from jaxclear.ground import numerics
from jaxclear.ground.factorisation import eliminate
from jaxclear.ground.numerics import arc_sine, direction_angle


def evaluated(program, values, turned):
    """What a jaxpr gives, each choice numbered in `turned` made the other way; and what was
    chosen."""
    known, chosen = dict(zip(program.jaxpr.constvars, program.consts, strict=True)), []

    def run(jaxpr, known):
        get = lambda atom: atom.val if isinstance(atom, Literal) else known[atom]
        for equation in jaxpr.eqns:
            inputs = [get(atom) for atom in equation.invars]
            inner = equation.params.get("jaxpr")
            if inner is not None and equation.primitive.name in ("jit", "pjit"):
                own = dict(zip(inner.jaxpr.invars, inputs, strict=True))
                own |= dict(zip(inner.jaxpr.constvars, inner.consts, strict=True))
                out = run(inner.jaxpr, own)
            elif equation.primitive.name == "select_n" and np.asarray(inputs[0]).dtype == bool:
                choice = np.asarray(inputs[0])
                out = [jnp.where(choice ^ (len(chosen) in turned), inputs[2], inputs[1])]
                chosen.append(choice)
            else:
                out = equation.primitive.bind(*inputs, **equation.params)
                out = out if equation.primitive.multiple_results else [out]
            known |= dict(zip(equation.outvars, out, strict=True))
        return [get(atom) for atom in jaxpr.outvars]

    known |= dict(zip(program.jaxpr.invars, values, strict=True))
    return run(program.jaxpr, known), chosen


LEAST = numerics.TINY_SQUARE
# Functions on the guarded side of the place where their choice turns, and how far from their value
# there the formula for the other side may be at the harmless point (choices of arguments stay).
AT_THE_TURN = {
    "safe_sqrt": (numerics.safe_sqrt, (LEAST,), 1e-49),
    "safe_divide": (lambda x: numerics.safe_divide(1.0, x), (0.0,), 0.0),
    "power": (lambda x: numerics.power(x, None), (0.0,), 1e-99),
    "general power": (lambda x: numerics.power(x, 1.2), (0.0,), 1e-99),
    "positive_part": (numerics.positive_part, (0.0,), 0.0),
    "inverse_entropy": (numerics.inverse_entropy.fun, (numerics.SMALLEST_LOAD,), 1e-299),
    "direction_angle": (lambda x: direction_angle(x, 0.0), (LEAST**0.5,), 0.0),
    "arc_sine": (numerics.arc_sine.fun, (0.5,), 1e-15),
    "half_turn": (group.half_turn, (group.SERIES_SQUARE,), 1e-15),
    "lag": (lambda s: group.lag(s, *group.half_turn(s)), (group.SERIES_SQUARE,), 1e-13),
    "interior point": (
        lambda fall: interior_point._length(jnp.ones(2), jnp.ones(2), jnp.zeros(2) + fall, 1.0),
        (0.0,),
        0.0,
    ),
}


@pytest.mark.parametrize("name", AT_THE_TURN)
def test_choices_that_disagree_do_no_harm(name):
    function, values, within = AT_THE_TURN[name]
    values = tuple(map(jnp.asarray, values))
    program = jax.make_jaxpr(function)(*values)
    usual, choices = evaluated(program, values, ())
    # Choices of values; those before the last of a double where are choices of its arguments.
    double = name not in ("arc_sine", "half_turn", "lag", "interior point")
    for turned in [len(choices) - 1] if double else range(len(choices)):
        for found, wanted in zip(evaluated(program, values, (turned,))[0], usual, strict=True):
            np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=within)


def test_ties_of_pivots_are_no_matter_of_rounding():
    """Pivots that are alike but for rounding are chosen alike, so that no row is taken twice."""
    matrix = np.array([[2.0, 1.0, -1.0, 1.0], [-2.0, 3.0, 1.0, 2.0], [2.0, 0.5, 4.0, 3.0]])
    solve = lambda lines: jnp.stack(eliminate(list(lines[:, :3]), lines[:, 3]))
    program, made = jax.make_jaxpr(solve)(matrix), []
    for off in (0.0, 1e-15, -1e-15):
        nudged = matrix * (1 + off * np.array([[1.0], [-1.0], [1.0]]))
        (found,), choices = evaluated(program, (jnp.asarray(nudged),), ())
        np.testing.assert_allclose(found, np.linalg.solve(matrix[:, :3], matrix[:, 3]), rtol=1e-13)
        made.append(choices)
    for one, other in itertools.pairwise(made):
        np.testing.assert_array_equal(one, other)


def test_scales_are_no_matter_of_rounding():
    scale, powers = jax.jit(interior_point._power_of_two), 2.0 ** np.arange(-3, 4)
    usual, above, below = (scale(powers * (1 + off)) for off in (0, 1e-15, -1e-15))
    np.testing.assert_array_equal(usual, above)
    np.testing.assert_array_equal(usual, below)


def test_it_is_the_librarys():
    tiny = 10.0 ** -np.arange(0.0, 300.0, 7.0)
    x = np.concatenate([np.linspace(-1.0, 1.0, 20001), tiny, -tiny, 1.0 - tiny, [0.0, -0.0]])
    found, wanted = np.asarray(jax.jit(arc_sine)(x)), np.arcsin(x)
    # A few roundings of the last digit.
    np.testing.assert_allclose(found, wanted, rtol=1e-15, atol=0.0)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(wanted))
    assert np.isnan(arc_sine(jnp.asarray(np.nan)))


def test_its_slope_is_that_of_the_angle_and_finite_at_the_ends():
    x = np.concatenate([np.linspace(-0.99, 0.99, 101), [-1.0, 0.0, 1.0]])
    first = jax.grad(arc_sine)
    found = jax.jit(jax.vmap(lambda x: (first(x), jax.grad(first)(x))))(x)
    inside = x[:101]
    wanted = (1 - inside**2) ** -0.5, inside * (1 - inside**2) ** -1.5
    for slope, own in zip(found, wanted, strict=True):
        np.testing.assert_allclose(slope[:101], own, rtol=1e-12, atol=1e-12)
        assert np.all(np.isfinite(slope[101:]))
