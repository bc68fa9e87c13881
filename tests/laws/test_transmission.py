"""What a transmission does with the stretch of its line of action, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxclear.laws.transmission import freewheel_pull, helix_of_thread, holding, loss, one_sided

K, D = 2e3, 0.7


def test_a_freewheel_holds_or_slips_and_never_both():
    drawn = np.random.default_rng(1)
    for twist, rate in drawn.uniform(-1, 1, (50, 2)) * (0.01, 5.0):
        pull, turning = freewheel_pull(abs(twist), rate, K, D)
        slip = rate - turning
        assert pull.force >= 0 and slip <= 0
        np.testing.assert_allclose(pull.force * slip, 0.0, atol=1e-9)
        # what goes in is stored or lost
        given = pull.force * rate - K * abs(twist) * turning
        np.testing.assert_allclose(given, pull.dissipated, rtol=1e-9, atol=1e-12)


def test_a_freewheel_that_is_loaded_does_not_creep():
    assert freewheel_pull(0.01, 0.0, K, D)[1] == 0.0


def test_a_one_sided_spring_never_pulls_and_never_gives_energy():
    drawn = np.random.default_rng(2)
    for stretch, rate in drawn.uniform(-1, 1, (50, 2)) * (0.01, 300.0):
        found = one_sided(stretch, rate, K, D)
        assert found.force >= 0 and found.dissipated >= 0
        assert found.force <= 2 * K * max(stretch, 0.0)
    slope = jax.grad(lambda x: one_sided(x, 1.0, K, D).force)
    assert jnp.isfinite(slope(0.0)) and jnp.isfinite(slope(-1.0))


@pytest.mark.parametrize("raises", [1, -1])
def test_a_thread_takes_the_torque_of_the_textbook(raises):
    # Shigley, example 8-1: d = 32 mm, pitch 4 mm, double thread, square; mu = 0.08, F = 6.4 kN
    load, mu, lead, diameter = 6.4e3, 0.08, 8e-3, 30e-3
    own = helix_of_thread(lead, diameter, 0.0)
    # the elastic part carries the load less what friction carries of it
    elastic = load / (1 - raises * mu * own.normal * own.axial)
    torque = elastic * (lead / (2 * np.pi) + raises * mu * own.normal * own.lever)
    # 15.94 and -0.466 N m of the book, to the figures that it prints
    np.testing.assert_allclose(torque, {1: 15.94, -1: 0.466}[raises], rtol=0.002)


def test_inclined_flanks_take_more():
    lead, diameter, mu, flank = 5e-3, 0.02, 0.15, np.radians(14.5)
    own = helix_of_thread(lead, diameter, flank)
    secant = 1 / np.cos(flank)
    wanted = 0.5 * diameter * (lead + np.pi * mu * diameter * secant)
    wanted /= np.pi * diameter - mu * lead * secant
    rub = mu * own.normal
    found = (lead / (2 * np.pi) + rub * own.lever) / (1 - rub * own.axial)
    np.testing.assert_allclose(found, wanted, rtol=1e-13)


def test_what_comes_out_is_its_share_of_what_goes_in():
    force = 40.0
    forwards = force + loss(force, 1.0, 0.9, 0.7)
    np.testing.assert_allclose(force / forwards, 0.9, rtol=1e-14)
    back = force + loss(force, -1.0, 0.9, 0.7)
    np.testing.assert_allclose(back / force, 0.7, rtol=1e-14)
    # self-locking: nothing is left to turn it
    assert force + loss(force, -1.0, 0.4, 0.0) == 0


def test_friction_that_holds_is_a_spring_and_then_no_more():
    assert holding(2e-4, 0.0, 1e-3, 1e-3) == (0.2, 0.0)
    share, rate = holding(1e-3, 5.0, 1e-3, 1e-3)
    assert share == 1 and rate == 0
    assert holding(1e-3, -5.0, 1e-3, 1e-3)[1] == -5.0
