"""The cylinder laws against DyS's table, against their own published equations, and in their
derivatives.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import lambertw

from jaxclear.ground.numerics import inverse_entropy
from jaxclear.laws import contact
from jaxclear.laws.material import Material
from jaxclear.laws.stiffness import CombinedModulus, Shape, fitted
from tests.laws.law_family import shape

REFERENCE = json.loads((Path(__file__).parent / "dys_cylindrical_contact.json").read_text())
MODULUS, LENGTH, INNER, OUTER = 1.1e11, 0.03, 9.9e-3, 10e-3
CLEARANCE = OUTER - INNER


def johnson(f):
    return f / (np.pi * MODULUS) * (np.log(4 * np.pi * MODULUS * CLEARANCE / f) - 1)


def two_sided(f):
    return 2 * f / (np.pi * MODULUS) * (np.log(np.pi * MODULUS * CLEARANCE / f) - 1)


def radzimovsky(f):
    width = 1.60 * np.sqrt(2 * f * INNER * OUTER / (CLEARANCE * MODULUS))
    return f / (np.pi * MODULUS) * (2 / 3 + np.log(4 * INNER / width) + np.log(4 * OUTER / width))


def goldsmith(f):
    argument = LENGTH**3 * CLEARANCE * np.pi * MODULUS / (f * LENGTH * INNER * OUTER)
    return f / (np.pi * MODULUS) * (np.log(argument) + 1)


PUBLISHED = {
    contact.Johnson: johnson,
    contact.TwoSidedJohnson: two_sided,
    contact.Radzimovsky: radzimovsky,
    contact.Goldsmith: goldsmith,
}
implicit = pytest.mark.parametrize("law", PUBLISHED, ids=lambda law: law.__name__)


def build(law, **fields):
    return fitted(law(modulus=MODULUS, **fields), Shape(INNER, OUTER, LENGTH))


def test_dys_table_is_reproduced():
    given = REFERENCE["parameters"]
    aluminium = Material(given["young_modulus"], given["poisson_ratio"])
    law = contact.TwoSidedJohnson(modulus=CombinedModulus(aluminium, aluminium))
    law = fitted(law, Shape(given["inner_radius"], given["outer_radius"], given["length"]))
    force = jax.vmap(law.elastic_force)(np.array(REFERENCE["indentation"]))
    np.testing.assert_allclose(force, REFERENCE["force"], rtol=REFERENCE["tolerance"])


@implicit
def test_force_solves_the_published_equation(law):
    """From 1e-14 m to the end of the theory, the published formula gives back the indentation to
    rounding."""
    force = jax.jit(jax.vmap(build(law).elastic_force))
    depths = np.logspace(-14, np.log10(0.19 * CLEARANCE), 60)
    # a clearance rounded as a difference of radii, and the cancellation of the logarithm at the
    # deep end
    np.testing.assert_allclose(
        PUBLISHED[law](np.asarray(force(depths)) / LENGTH), depths, rtol=1e-12
    )


@implicit
def test_derivatives_follow_the_implicit_function_theorem(law):
    """By indentation, modulus, length and both radii, forwards, backwards and in a batch, against
    central differences of a solution by scipy's brentq."""

    def force(indentation, modulus, inner, outer, length):
        return fitted(law(modulus=modulus), Shape(inner, outer, length)).elastic_force(indentation)

    point = (2e-6, MODULUS, INNER, OUTER, LENGTH)

    @jax.jit
    def told():
        way = jax.grad(force, argnums=range(5))
        many = jax.vmap(way, in_axes=(0, None, None, None, None))(
            np.array([2e-6, 3e-6]), *point[1:]
        )
        return way(*point), jax.jacfwd(force, argnums=range(5))(*point), many

    slopes, forwards, batch = told()
    np.testing.assert_allclose(forwards, slopes, rtol=1e-12)
    np.testing.assert_allclose([slope[0] for slope in batch], slopes, rtol=1e-12)
    for index, slope in enumerate(slopes):
        step = 1e-6 * point[index] * (1e-2 if index in (2, 3) else 1)
        solved = [
            _solved(law, [x + sign * step * (i == index) for i, x in enumerate(point)])
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(slope, (solved[0] - solved[1]) / (2 * step), rtol=1e-5)


def _solved(law, point):
    """The published equation by bracketing, in the logarithm of the load."""
    indentation, modulus, inner, outer, length = point
    clearance = outer - inner
    scale, logarithm = {
        contact.Johnson: (1, np.log(4 * np.pi * modulus * clearance) - 1),
        contact.TwoSidedJohnson: (2, np.log(np.pi * modulus * clearance) - 1),
        contact.Radzimovsky: (1, np.log(16 * modulus * clearance / (2 * 1.60**2)) + 2 / 3),
        contact.Goldsmith: (
            1,
            np.log(length**2 * clearance * np.pi * modulus / (inner * outer)) + 1,
        ),
    }[law]

    def residual(t):
        return scale * np.exp(t) / (np.pi * modulus) * (logarithm - t) / indentation - 1

    return length * np.exp(brentq(residual, 0, logarithm - 1, xtol=1e-14, rtol=1e-15))


@implicit
def test_force_stays_stiff_and_smooth_beyond_the_theory(law):
    force = build(law).elastic_force
    slope = np.asarray(jax.jit(jax.vmap(jax.grad(force)))(np.linspace(1e-7, 1e-3, 2000)))
    assert np.all(np.diff(slope) >= -1e-12 * slope[1:]) and np.isfinite(slope).all()
    # linear at the end: Goldsmith's limit is 6.6e-4 m here, the others' below the clearance of 1e-4
    # m
    np.testing.assert_allclose(slope[-1], slope[-500], rtol=1e-12)


def test_second_derivative_of_the_implicit_force_is_finite():
    assert np.isfinite(jax.jit(jax.grad(jax.grad(build(contact.Johnson).elastic_force)))(1e-6))


def test_inverse_entropy_is_minus_the_lower_branch_of_lambert():
    x = np.logspace(-280, np.log10(0.27), 200)
    # w = -x / W(-x) by scipy
    np.testing.assert_allclose(inverse_entropy(x), x / -lambertw(-x, -1).real, rtol=1e-13)
    assert inverse_entropy(jnp.asarray(-1.0)) == 0 and jax.grad(inverse_entropy)(0.0) == 0


def test_liu_meets_its_formula_and_bai_zhao_is_its_slope():
    liu, bai_zhao = build(contact.Liu), build(contact.BaiZhao)
    for depth in (1e-9, 1e-6, 1e-4, 1e-3):
        expected = np.pi / 2 * MODULUS * LENGTH * depth * np.sqrt(depth / (2 * (CLEARANCE + depth)))
        np.testing.assert_allclose(liu.elastic_force(depth), expected, rtol=1e-12)
        np.testing.assert_allclose(
            bai_zhao.elastic_force(depth), depth * jax.grad(liu.elastic_force)(depth), rtol=1e-12
        )


def test_a_law_remembers_the_impact_speed_only_when_it_damps():
    assert not fitted(contact.Johnson(), shape()).remembers_impact_speed
    assert fitted(contact.Johnson(restitution=0.9), shape()).remembers_impact_speed
