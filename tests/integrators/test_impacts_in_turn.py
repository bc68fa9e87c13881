"""Corners of a slider that strike the wall of their guide one after the other, beside their impacts
by hand."""

import numpy as np
import pytest

import jaxclear as jc

MASS, INERTIA, HALF_LENGTH, CLEARANCE, FALL, STEP = 1.0, 1e-3, 0.02, 1e-3, 0.1, 1e-4
# Steps to the first impact.
BEFORE = 3.3


def landed(pitch, restitution):
    """Speed [m/s] and spin [rad/s] of a slider that has fallen on the wall with this pitch [rad],
    without gravity and friction."""
    guide = jc.clearance.SliderGuide(
        jc.contact.Rigid(restitution=restitution),
        width=0.02,
        length=2 * HALF_LENGTH,
        clearance=CLEARANCE,
    )
    height = -CLEARANCE + FALL * BEFORE * STEP + HALF_LENGTH * np.sin(abs(pitch))
    rig = jc.Mechanism(
        {"slider": jc.Body(MASS, INERTIA)},
        {"G": jc.Connection(guide, jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x"))},
        start={"slider": (0.0, height, pitch)},
        speeds={"slider": (0.0, -FALL, 0.0)},
    )
    times = 10 * STEP
    run = jc.simulate(rig, times, integrator=jc.integrator.MoreauJean(STEP), save=3)
    return np.asarray(run.speed("slider"))[-1][[1, 2]]


def by_hand(pitch, restitution):
    """The corner that is lower strikes, then the other, if it still comes down."""
    sides = np.sign(pitch) * np.array([-1.0, 1.0])
    speed, spin = -FALL, 0.0
    for side in sides:
        own = 1 / MASS + HALF_LENGTH**2 / INERTIA
        closing = -(speed + side * HALF_LENGTH * spin)
        percussion = (1 + restitution) * max(closing, 0.0) / own
        speed += percussion / MASS
        spin += side * HALF_LENGTH * percussion / INERTIA
    return np.array([speed, spin])


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("pitch", [1e-5, -1e-5])
def test_corners_that_strike_within_a_step_strike_one_after_the_other(pitch, restitution):
    """They touch 4 us apart, in steps of 100 us; at once they would leave the slider level."""
    exact = by_hand(pitch, restitution)
    assert abs(exact[1]) > 0.1
    np.testing.assert_allclose(landed(pitch, restitution), exact, rtol=1e-3)


def test_corners_that_touch_at_once_strike_at_once():
    speed, spin = landed(0.0, 0.5)
    assert speed == pytest.approx(0.5 * FALL, rel=1e-9) and abs(spin) < 1e-9
