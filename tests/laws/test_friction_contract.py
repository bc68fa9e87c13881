"""Every friction law keeps the contract; the published curves are oracles.

What bristles make of a step of constant slip: their equation is linear then.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxclear as jc
from jaxclear.laws import friction
from tests.laws.contracts import (
    BRISTLE_CHECKS,
    SLIP_CHECKS,
    bristle_never_gives_energy_and_its_springs_are_bounded,
    friction_contract,
    slide,
    slip_never_gives_energy_and_is_bounded,
)
from tests.laws.law_family import family

SLIP = family(friction.AbstractSlipFriction)
BRISTLE = family(friction.AbstractBristleFriction)
exponents = st.floats(-9, 0)
coefficients = st.floats(0, 2)


@pytest.mark.parametrize("check", SLIP_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("law", [law for _, law in SLIP], ids=[name for name, _ in SLIP])
def test_slip_friction_keeps_the_contract(law, check):
    check(law)


@pytest.mark.parametrize("check", BRISTLE_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("law", [law for _, law in BRISTLE], ids=[name for name, _ in BRISTLE])
def test_bristle_friction_keeps_the_contract(law, check):
    check(law)


def test_set_valued_friction_is_declared_but_has_no_function():
    for _, law in family(friction.AbstractSetValuedFriction):
        friction_contract(law)
        assert "coefficient" not in dir(law)


def test_contract_refuses_a_law_that_pushes():
    # Not a subclass, so that the walk over the family never meets it.
    class Pushing(eqx.Module):
        mu_kinetic: float = 0.1

        def coefficient(self, slip_speed):
            return -self.mu_kinetic * jnp.tanh(slip_speed)

    with pytest.raises(AssertionError):
        slip_never_gives_energy_and_is_bounded(Pushing())


@jax.jit
def _value_and_slope(law, slip_speed):
    return jax.value_and_grad(lambda law, v: law.coefficient(v), argnums=(0, 1))(law, slip_speed)


@settings(max_examples=40, deadline=None)
@given(coefficients, coefficients, exponents, st.floats(-12, 2), st.booleans())
def test_extreme_parameters_stay_finite(mu_static, mu_kinetic, exponent, speed_exponent, at_rest):
    mu_kinetic, mu_static = sorted((mu_static, mu_kinetic))
    slow = 10.0**exponent
    speed = jnp.asarray(0.0 if at_rest else 10.0**speed_exponent)
    laws = (
        friction.CoulombTanh(mu_kinetic=mu_kinetic, transition_speed=slow),
        friction.Ambrosio(mu_kinetic=mu_kinetic, inner_speed=slow, outer_speed=2 * slow),
        friction.ThreeZone(
            mu_static=mu_static, mu_kinetic=mu_kinetic, static_speed=slow, kinetic_speed=1.5 * slow
        ),
        friction.AdamsStep(
            mu_static=mu_static, mu_kinetic=mu_kinetic, static_speed=slow, kinetic_speed=1.5 * slow
        ),
        friction.Threlfall(mu_kinetic=mu_kinetic, transition_speed=slow),
        friction.BengisuAkay(
            mu_static=mu_static, mu_kinetic=mu_kinetic, peak_speed=slow, decay=1 / slow
        ),
        friction.Stribeck(
            mu_static=mu_static,
            mu_kinetic=mu_kinetic,
            stribeck_speed=slow,
            transition_speed=slow / 2,
        ),
    )
    for law in laws:
        value, slopes = _value_and_slope(law, speed)
        assert 0 <= value <= max(mu_static, mu_kinetic) * (1 + 1e-12)
        assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(slopes))


@settings(max_examples=25, deadline=None)
@given(coefficients, coefficients, exponents, st.floats(-3, 3))
def test_extreme_bristles_stay_finite(mu_static, mu_kinetic, exponent, slip):
    mu_kinetic, mu_static = sorted((mu_static, mu_kinetic))
    for law in (
        friction.LuGre(mu_static=mu_static, mu_kinetic=mu_kinetic, stribeck_speed=10.0**exponent),
        friction.Dahl(mu_kinetic=mu_kinetic),
    ):
        values = _bristle_slopes(law, jnp.asarray(3e-7), jnp.asarray(slip))
        assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(values))


@jax.jit
def _bristle_slopes(law, deflection, slip):
    def force(law, z, v):
        return law.coefficient(z, law.deflection_rate(z, v, jnp.abs(v)), v)

    return jax.value_and_grad(force, argnums=(0, 1, 2))(law, deflection, slip)


def test_three_zones_meet_the_published_curve():
    """The four-bar's paper, eq. 4, at the ends and the middle of each zone."""
    law = friction.ThreeZone(mu_static=0.2, mu_kinetic=0.1, static_speed=1e-3, kinetic_speed=3e-3)
    speeds = np.array([0.5e-3, 1e-3, 2e-3, 3e-3, 1.0])
    expected = [0.2 * np.sin(np.pi / 4), 0.2, 0.15, 0.1, 0.1]
    np.testing.assert_allclose(jax.vmap(law.coefficient)(speeds), expected, rtol=1e-14)


def test_adams_step_meets_the_published_curve():
    """The flap's paper, eq. 8, with STEP(x) = low + (high - low) s^2 (3 - 2 s)."""
    law = friction.AdamsStep(mu_static=0.2, mu_kinetic=0.1, static_speed=1e-3, kinetic_speed=3e-3)
    s = (0.5e-3 + 1e-3) / 2e-3
    speeds = np.array([0.5e-3, 1e-3, 2e-3, 3e-3, 1.0])
    expected = [-0.2 + 0.4 * s * s * (3 - 2 * s), 0.2, 0.15, 0.1, 0.1]
    np.testing.assert_allclose(jax.vmap(law.coefficient)(speeds), expected, rtol=1e-13)


def test_ambrosio_and_threlfall_and_bengisu_akay_at_chosen_speeds():
    ambrosio = friction.Ambrosio(mu_kinetic=0.1, inner_speed=1e-3, outer_speed=3e-3)
    np.testing.assert_allclose(
        jax.vmap(ambrosio.coefficient)(np.array([5e-4, 2e-3, 5e-3])), [0, 0.05, 0.1], atol=1e-15
    )
    threlfall = friction.Threlfall(mu_kinetic=0.1, transition_speed=1e-3)
    # Threlfall's own 0.95 differs from 1 - exp(-3) by 2.2e-4
    np.testing.assert_allclose(
        threlfall.coefficient(5e-4), 0.1 * (1 - np.exp(-1.5)) / 0.95, rtol=3e-4
    )
    bengisu = friction.BengisuAkay(mu_static=0.2, mu_kinetic=0.1, peak_speed=1e-3, decay=1e3)
    expected = [0.2 * 0.75, 0.2, 0.1 + 0.1 * np.exp(-2)]
    np.testing.assert_allclose(
        jax.vmap(bengisu.coefficient)(np.array([5e-4, 1e-3, 3e-3])), expected, rtol=1e-13
    )


def test_dahl_follows_its_closed_solution():
    """At constant slip z = z_0 (1 - exp(-v t / z_0)), so the coefficient depends on the distance
    alone."""
    law = friction.Dahl(mu_kinetic=0.3, presliding=1e-6)
    step, speed = 1e-5, 1e-3
    distance = speed * step * np.arange(1000)
    # fourth-order Runge-Kutta at a hundredth of the yield deflection
    _, coefficient = slide(law, jnp.full(2001, speed), step)
    np.testing.assert_allclose(coefficient, 0.3 * -np.expm1(-distance / 1e-6), atol=1e-9)


def test_lugre_slides_on_the_stribeck_curve():
    law = friction.LuGre(mu_static=0.2, mu_kinetic=0.1)
    for speed in (1e-3, 1e-2, 1e-1):
        _, coefficient = slide(law, jnp.full(8001, speed), 1e-7 / speed)
        np.testing.assert_allclose(
            coefficient[-1], 0.1 + 0.1 * np.exp(-((speed / 1e-2) ** 2)), rtol=1e-9
        )


def test_lugre_stays_passive_however_slow_its_bristles_settle():
    """The fading damping keeps t |v| / (z_0 s) below 4, the limit of passivity, even at a settling
    time of a second."""
    bristle_never_gives_energy_and_its_springs_are_bounded(friction.LuGre(settling_time=1.0))


LAW = jc.friction.Dahl(mu_kinetic=0.3, presliding=1e-6)
SLIDING, START = 0.02, 0.3e-6


def over(step, start=START, slip=SLIDING):
    """(deflection at the end of a step, mean coefficient over it)."""
    numbers = (jnp.asarray(slip),), abs(slip)
    (end,) = LAW.bristles_after(1.0, (jnp.asarray(start),), *numbers, step, 0.0)
    (force,), _ = LAW.linearised(1.0, (jnp.asarray(start),), *numbers, None, step, 0.0)
    return float(end), -float(force)


def exact(step, start=START, slip=SLIDING):
    decay, last = abs(slip) / 1e-6, np.sign(slip) * 1e-6
    end = last + (start - last) * np.exp(-decay * step)
    mean = last + (start - last) * (1 - np.exp(-decay * step)) / (decay * step)
    return end, 0.3 * mean / 1e-6


@pytest.mark.parametrize("slip", [SLIDING, -SLIDING])
def test_steps_in_which_they_hardly_settle_are_of_high_order(slip):
    """Implicit Euler's steps were off by half of what settles."""
    for settles, most in ((0.1, 1e-4), (0.05, 2e-5), (0.0, 1e-10)):
        step = max(settles, 1e-6) * 1e-6 / SLIDING
        for found, wanted in zip(over(step, slip=slip), exact(step, slip=slip), strict=True):
            size = 1e-6 if abs(wanted) < 1e-3 else 0.3
            assert abs(found - wanted) < most * size


@pytest.mark.parametrize("settles", [0.3, 1.0, 3.0, 30.0, 1e4])
def test_they_stay_in_bounds_in_steps_of_any_length(settles):
    step = settles * 1e-6 / SLIDING
    end, mean = over(step)
    assert START < end <= 1e-6 and 0.3 * START / 1e-6 < mean <= 0.3
    at_rest, _ = over(step, start=1e-6)
    assert at_rest == pytest.approx(1e-6, rel=1e-12)


def test_slopes_are_finite_at_rest_and_across_the_series():
    def mean(slip):
        (force,), _ = LAW.linearised(
            1.0, (jnp.asarray(START),), (slip,), jnp.abs(slip), None, 1e-5, 0.0
        )
        return -force

    slips = np.array([0.0, 9.9e-5, 1e-4, 1.01e-4, 1e-2, 10.0])
    values, slopes = map(np.asarray, jax.jit(jax.vmap(jax.value_and_grad(mean)))(slips))
    assert np.all(np.isfinite(slopes))
    # The series meets what it stands for: a deflection settles by a thousandth there.
    kink = np.ptp(np.diff(values[1:4]) / np.diff(slips[1:4]))
    assert kink < 1e-2 * abs(values[1] / 1e-4)
