"""Every contact law and every product of elastic force and dissipation factor keeps the contract;
Hertz, Kelvin-Voigt and the exact rebound are oracles.

What rigid contact takes from laws that are functions: their coefficients of friction.

How deep a force presses is the law of contact the other way round.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import jaxclear as jc
from jaxclear.laws import contact, friction
from jaxclear.laws.contact.base import SHALLOWEST, indentation_under
from jaxclear.laws.material import Material, combined_modulus, steel
from jaxclear.laws.stiffness import HertzStiffness, Shape, fitted
from tests.laws.contracts import (
    CONTACT_CHECKS,
    contact_contract,
    contact_never_pulls,
    contact_recovers_restitution,
    contact_stiffness_is_the_slope,
    rebound,
)
from tests.laws.law_family import contact_laws, contact_products, members, shape

LAWS = contact_laws()
PRODUCTS = contact_products()


@pytest.mark.parametrize("check", CONTACT_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("law", [law for _, law in LAWS], ids=[name for name, _ in LAWS])
def test_contact_law_keeps_the_contract(law, check):
    check(law)


@pytest.mark.parametrize("law", PRODUCTS)
def test_every_product_keeps_the_contract(law):
    """All but what is of one part alone: the rebound (see test_restitution), the stiffness. Not
    compiled, which would take longer than the evaluations."""
    of_one_part = (contact_recovers_restitution, contact_stiffness_is_the_slope)
    with jax.disable_jit():
        for check in CONTACT_CHECKS:
            if check not in of_one_part:
                check(law)


def test_whole_contract_takes_an_unfitted_law():
    contact_contract(contact.Hertz(HertzStiffness(steel(), steel())))


def test_contract_refuses_a_law_that_pulls():
    # Not a subclass, so that the walk over the family never meets it.
    class Sticky(eqx.Module):
        def normal_force(self, indentation, rate, impact_speed):
            return indentation * (1e8 + 1e9 * rate)

    with pytest.raises(AssertionError):
        contact_never_pulls(Sticky())


def test_hertz_sphere_in_socket_matches_hand_calculation():
    """The four-bar's paper, eq. 2 and Table II: 206.8 GPa, 0.29, radii 9.8 and 10 mm."""
    h = (1 - 0.29**2) / (np.pi * 206.8e9)
    expected = 4 / (3 * np.pi * 2 * h) * np.sqrt(9.8e-3 * 10e-3 / 0.2e-3)
    law = fitted(contact.Hertz(HertzStiffness(steel(), steel())), Shape(9.8e-3, 10e-3))
    np.testing.assert_allclose(law.stiffness, expected, rtol=1e-12)
    np.testing.assert_allclose(law.normal_force(1e-6, 0.0, 0.0), expected * 1e-9, rtol=1e-12)


def test_hertz_stiffness_differentiates_in_the_clearance():
    """K ~ ((R - c) R / c)^(1/2), so dK/dc = -K R / (2 c (R - c)) at a fixed outer radius R."""
    radius, clearance = 10e-3, 1e-4

    def stiffness(clearance):
        return fitted(
            contact.Hertz(HertzStiffness(steel(), steel())), Shape(radius - clearance, radius)
        ).stiffness

    expected = -stiffness(clearance) * radius / (2 * clearance * (radius - clearance))
    for slope in (jax.grad(stiffness)(clearance), jax.jit(jax.jacfwd(stiffness))(clearance)):
        np.testing.assert_allclose(slope, expected, rtol=1e-9)


def test_combined_modulus_of_a_rigid_partner_is_the_other_bodys():
    soft, rigid = Material(70e9, 0.3), Material(1e30, 0.0)
    np.testing.assert_allclose(combined_modulus(soft, rigid), 70e9 / (1 - 0.09), rtol=1e-12)
    np.testing.assert_allclose(combined_modulus(soft, soft), 70e9 / (1 - 0.09) / 2, rtol=1e-12)


def test_fits_are_found_at_any_depth():
    nested = fitted(
        (contact.Hertz(HertzStiffness(steel(), steel())), {"line": contact.Johnson()}), shape()
    )
    assert all(eqx.is_array(leaf) and leaf.dtype == jnp.float64 for leaf in jax.tree.leaves(nested))
    np.testing.assert_allclose(nested[1]["line"].clearance, 1e-4, rtol=1e-9)


def test_deepest_indentation_of_an_elastic_impact():
    """Energy: m v^2 / 2 = 2 K delta^(5/2) / 5; the force does that work on the way in."""
    law = contact.Hertz(stiffness=1e10)
    deepest = (5 * 1.0 * 0.1**2 / (4 * 1e10)) ** (2 / 5)
    depth = np.linspace(0, deepest, 20001)
    work = np.trapezoid(jax.vmap(law.elastic_force)(depth), depth)
    np.testing.assert_allclose(work, 0.5 * 0.1**2, rtol=1e-6)
    assert abs(rebound(law) - 1) < 1e-6


def test_kelvin_voigt_rebounds_as_the_damped_oscillator():
    """Without pulling the mass leaves when K x + D v = 0: e = exp(-zeta phi / sqrt(1 - zeta^2)),
    Schwager & Poschel 2007."""
    stiffness, mass, zeta = 1e8, 1.0, 0.1
    law = contact.KelvinVoigt(
        stiffness=stiffness, damping=2 * zeta * np.sqrt(stiffness * mass), onset_depth=1e-9
    )
    omega, damped = np.sqrt(stiffness / mass), np.sqrt(stiffness / mass) * np.sqrt(1 - zeta**2)
    time = brentq(
        lambda t: (
            2 * zeta * np.cos(damped * t)
            + (1 - 2 * zeta**2) / np.sqrt(1 - zeta**2) * np.sin(damped * t)
        ),
        1 / damped,
        np.pi / damped,
    )
    speed = np.exp(-zeta * omega * time) * (
        np.cos(damped * time) - zeta / np.sqrt(1 - zeta**2) * np.sin(damped * time)
    )
    # the smooth onset of the damper over 1e-9 m of an indentation of 1e-5 m
    np.testing.assert_allclose(rebound(law), -speed, atol=2e-4)


def test_adams_impact_meets_its_formula():
    law = contact.AdamsImpact(stiffness=1e10, exponent=None, damping=1e3, full_damping_depth=1e-5)
    half = 1e10 * (5e-6) ** 1.5
    np.testing.assert_allclose(law.normal_force(5e-6, 0.1, 0.0), half + 0.5 * 1e3 * 0.1, rtol=1e-13)
    np.testing.assert_allclose(
        law.normal_force(5e-5, 0.1, 0.0), 1e10 * (5e-5) ** 1.5 + 1e3 * 0.1, rtol=1e-13
    )
    assert law.normal_force(1e-6, -100.0, 0.0) == 0


def test_modified_flores_is_hertz_for_small_indentation():
    law = fitted(contact.ModifiedFlores(modulus=combined_modulus(steel(), steel())), shape())
    hertz = fitted(contact.Hertz(HertzStiffness(steel(), steel())), shape())
    # R_s^2 stands for R_i R_j: half a per cent at a clearance of a hundredth of the radius
    np.testing.assert_allclose(law.elastic_force(1e-8), hertz.elastic_force(1e-8), rtol=6e-3)


exponents = st.floats(5, 13)


@jax.jit
def _value_and_slopes(law, indentation, rate):
    def force(law, indentation, rate):
        return law.normal_force(indentation, rate, jnp.abs(rate))

    return jax.value_and_grad(force, argnums=(0, 1, 2))(law, indentation, rate)


@settings(max_examples=40, deadline=None)
@given(
    exponents,
    st.floats(-16, -3),
    st.floats(-10, 10),
    st.floats(0.02, 1),
    st.floats(1, 3),
    st.booleans(),
)
def test_extreme_parameters_stay_finite(stiffness, depth, rate, restitution, exponent, closed):
    indentation = jnp.asarray(10.0**depth if closed else -(10.0**depth))
    power = 1.01 * exponent
    laws = [
        law(stiffness=10.0**stiffness, exponent=power, restitution=restitution)
        for law in (contact.Gonthier, contact.CarvalhoMartins, contact.Flores)
    ]
    laws += [
        contact.Hertz(stiffness=10.0**stiffness),
        contact.AdamsImpact(stiffness=10.0**stiffness, exponent=power),
        contact.KelvinVoigt(stiffness=10.0**stiffness),
    ]
    for law in laws:
        value, slopes = _value_and_slopes(law, indentation, jnp.asarray(rate))
        assert np.isfinite(value) and value >= 0
        assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(slopes))


FRICTION = [
    law
    for base in (friction.AbstractSlipFriction, friction.AbstractBristleFriction)
    for law in members(base)
] + members(friction.AbstractSetValuedFriction)


def fields(law):
    return {field.name for field in dataclasses.fields(law)}


@pytest.mark.parametrize("kind", FRICTION, ids=lambda kind: kind.__name__)
def test_every_friction_law_of_the_package_gives_its_coefficients(kind):
    static = {"mu_static": 0.4} if "mu_static" in fields(kind) else {}
    found = kind(mu_kinetic=0.2, **static).coulomb()
    assert float(found.mu_kinetic) == 0.2
    assert float(found.bound(1.0)) == 0.2
    assert float(found.bound(0.0)) == (0.4 if static else 0.2)


SHAPE = Shape(9.95e-3, 10e-3, 20e-3)
PRESSED = [
    jc.contact.Hertz(stiffness=1e10),
    jc.contact.Hertz(stiffness=1e10, exponent=1.1),
    jc.contact.Hertz(stiffness=1e10, exponent=2.2),
    jc.contact.Liu(),
    jc.contact.BaiZhao(),
    jc.contact.Johnson(),
    jc.contact.Radzimovsky(),
    jc.contact.Goldsmith(),
    jc.contact.BallInSocket(),
    jc.contact.KelvinVoigt(),
    jc.contact.AdamsImpact(),
]


@jax.jit
def pressed(law, forces):
    """Depth under forces, the force there, and the slopes of both."""

    def at(force):
        depth, slope = jax.value_and_grad(lambda f: indentation_under(law, f))(force)
        return depth, slope, *jax.value_and_grad(law.elastic_force)(depth)

    return jax.vmap(at)(forces)


@pytest.mark.parametrize("law", PRESSED, ids=str)
def test_the_law_gives_the_force_back_and_its_slope(law):
    """No force presses next to nothing, with a finite slope."""
    law = fitted(law, SHAPE)
    forces = np.array([0.0, 100.0, 1e3, 1e4, 1e6])
    depth, slope, found, steep = map(np.asarray, pressed(law, forces))
    np.testing.assert_allclose(found[1:], forces[1:] + found[0], rtol=1e-6)
    np.testing.assert_allclose(slope[1:], 1 / steep[1:], rtol=1e-5)
    assert depth[0] == pytest.approx(SHALLOWEST, rel=1e-9) and np.isfinite(slope[0])
    assert slope[0] > 0


def test_rigid_parts_do_not_overlap():
    assert indentation_under(jc.contact.Rigid(), 1e3) == 0.0
