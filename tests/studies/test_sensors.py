"""Sensors on a crank that turns at a constant speed, where all they see is known; and what
instruments make of a signal."""

import dataclasses

import numpy as np
import pytest

import jaxclear as jc

SPEED, ARM, GRAVITY = 20.0, 0.3, 9.81
SENSOR = jc.sensor


@pytest.fixture(scope="module")
def run():
    turning = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(SPEED))
    rig = jc.Mechanism(
        {"crank": jc.Body(1.0, 1e-2)},
        {"O": jc.Connection(turning, "ground", "crank")},
        loads={"gravity": jc.load.Gravity((0.0, -GRAVITY))},
    )
    return jc.simulate(rig, 0.3, save=3001, verify=False)


def test_they_see_a_turning_crank_as_it_is(run):
    tip = jc.Marker("crank", (ARM, 0.0))
    angle = SPEED * np.asarray(run.time)
    # Samples are means over the interval before, and turn with it: an error of the second order.
    middle = angle[1:] - 0.5 * SPEED * 1e-4
    felt = np.asarray(SENSOR.Accelerometer(tip, "x")(run))[1:]
    np.testing.assert_allclose(felt, -(SPEED**2) * ARM + GRAVITY * np.sin(middle), atol=1e-3)
    across = np.asarray(SENSOR.Accelerometer(tip, "y")(run))[1:]
    np.testing.assert_allclose(across, GRAVITY * np.cos(middle), atol=1e-3)
    np.testing.assert_allclose(SENSOR.Gyroscope("crank")(run), SPEED, rtol=1e-9)
    np.testing.assert_allclose(SENSOR.Encoder("O")(run), angle, atol=1e-9)
    np.testing.assert_allclose(SENSOR.Displacement(tip, "y")(run), ARM * np.sin(angle), atol=1e-9)
    weight = np.asarray(SENSOR.ForceGauge("O", "y")(run))
    np.testing.assert_allclose(weight, GRAVITY, atol=1e-6)


def test_an_instrument_changes_a_signal_as_it_says():
    rng = np.random.default_rng(0)
    step = np.concatenate([np.zeros(100), np.ones(400)])[None]
    rate, cut = 1000.0, 20.0
    passed = SENSOR.Displacement("crank", bandwidth=cut).sensed(step, rate, rng)[0]
    expected = 1 - np.exp(-2 * np.pi * cut * np.arange(1, 401) / rate)
    np.testing.assert_allclose(passed[100:], expected, atol=1e-12)
    late = SENSOR.Displacement("crank", delay=0.01).sensed(step, rate, rng)[0]
    assert np.flatnonzero(late > 0.5)[0] == 110
    held = SENSOR.Displacement("crank", sampling=100.0).sensed(np.arange(50.0), rate, rng)[0]
    np.testing.assert_allclose(held, np.floor(np.arange(50) / 10) * 10)
    coarse = SENSOR.Encoder("O", resolution=0.5).sensed(np.array([0.2, 0.3, 0.9]), rate, rng)
    np.testing.assert_allclose(coarse, [[0.0, 0.5, 1.0]])
    noisy = SENSOR.Gyroscope("crank", noise=0.2).sensed(np.zeros((1, 20000)), rate, rng)
    # Three standard errors of a deviation of 20 000 numbers.
    assert abs(noisy.std() - 0.2) < 3 * 0.2 / np.sqrt(2 * 20000)


def test_what_is_not_known_is_drawn_for_each_run():
    gain = jc.Dimension(2.0, jc.distribution.Uniform(0.5), unit="1")
    sensor = SENSOR.Gyroscope("crank", gain=gain)
    found = sensor.sensed(np.ones((500, 3)), 1.0, np.random.default_rng(1))
    assert np.all(np.ptp(found, axis=1) == 0) and found.min() >= 1.5 and found.max() <= 2.5
    assert abs(found.mean() - 2.0) < 0.05
    sensor = SENSOR.Gyroscope("crank", noise=1.0, bandwidth=3.0, gain=2.0, delay=1.0, sampling=1.0)
    signal = np.random.default_rng(2).standard_normal((2, 50))
    found = sensor.ideal().sensed(signal, 100.0, np.random.default_rng(0))
    assert np.array_equal(found, signal), "the ideal instrument changes nothing"


def test_a_signal_is_no_response_of_a_study(run):
    wanted = {"seen": SENSOR.Encoder("O")}
    mass = {"mass": jc.Variable(lambda rig: rig.bodies["crank"].mass, tolerance=0.1)}
    with pytest.raises(ValueError, match='response "seen" is a sensor'):
        jc.Problem(run.mechanism, wanted, mass, duration=0.1)


@pytest.mark.parametrize(
    "wrong", [{"noise": -1.0}, {"bandwidth": 0.0}, {"delay": -1.0}, {"axis": "w"}, {"gain": "big"}]
)
def test_numbers_that_no_instrument_has_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        dataclasses.replace(SENSOR.Gyroscope("crank"), **wrong)
