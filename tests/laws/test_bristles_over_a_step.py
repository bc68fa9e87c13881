"""What bristles make of a step of constant slip: their equation is linear then."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

LAW = jc.friction.Dahl(mu_kinetic=0.3, presliding=1e-6)
SLIP, START = 0.02, 0.3e-6


def over(step, start=START, slip=SLIP):
    """(deflection at the end of a step, mean coefficient over it)."""
    numbers = (jnp.asarray(slip),), abs(slip)
    (end,) = LAW.bristles_after(1.0, (jnp.asarray(start),), *numbers, step, 0.0)
    (force,), _ = LAW.linearised(1.0, (jnp.asarray(start),), *numbers, None, step, 0.0)
    return float(end), -float(force)


def exact(step, start=START, slip=SLIP):
    decay, last = abs(slip) / 1e-6, np.sign(slip) * 1e-6
    end = last + (start - last) * np.exp(-decay * step)
    mean = last + (start - last) * (1 - np.exp(-decay * step)) / (decay * step)
    return end, 0.3 * mean / 1e-6


@pytest.mark.parametrize("slip", [SLIP, -SLIP])
def test_steps_in_which_they_hardly_settle_are_of_high_order(slip):
    """Implicit Euler's steps were off by half of what settles."""
    for settles, most in ((0.1, 1e-4), (0.05, 2e-5), (0.0, 1e-10)):
        step = max(settles, 1e-6) * 1e-6 / SLIP
        for found, wanted in zip(over(step, slip=slip), exact(step, slip=slip), strict=True):
            size = 1e-6 if abs(wanted) < 1e-3 else 0.3
            assert abs(found - wanted) < most * size


@pytest.mark.parametrize("settles", [0.3, 1.0, 3.0, 30.0, 1e4])
def test_they_stay_in_bounds_in_steps_of_any_length(settles):
    step = settles * 1e-6 / SLIP
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

    slips = jnp.asarray([0.0, 9.9e-5, 1e-4, 1.01e-4, 1e-2, 10.0])
    slopes = jax.vmap(jax.grad(mean))(slips)
    assert np.all(np.isfinite(slopes))
    # The series meets what it stands for: a deflection settles by a thousandth there.
    values = jax.vmap(mean)(slips[1:4])
    assert np.ptp(np.diff(np.asarray(values)) / np.diff(np.asarray(slips[1:4]))) < 1e-2 * abs(
        float(values[0]) / 1e-4
    )
