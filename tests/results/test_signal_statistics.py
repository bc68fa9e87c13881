"""Statistics of signals: known answers of known signals, and what a gain changes."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.results.signal import full_turns

RATE, TURNS, SAMPLES = 1000.0, 8, 128


def shaken(gain=1.0, seed=3):
    """Two signals of eight turns: a cosine of the turn, and noise in its second half."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(TURNS * SAMPLES + 1) / SAMPLES
    noise = np.where(np.sin(angle) < 0, 0.1, 0.0) * rng.standard_normal((2, len(angle)))
    values = gain * (np.cos(angle) + noise)
    return jc.signal.by_turns(values, RATE, angle[None], TURNS, SAMPLES)


@pytest.mark.parametrize("turns", [True, False])
def test_a_gain_changes_levels_alone(turns):
    plain, louder = shaken(), shaken(gain=3.0)
    if not turns:
        plain, louder = plain._replace(turns=None), louder._replace(turns=None)
    for name, function in jc.signal.usual_statistics(turns).items():
        one, other = function(plain), function(louder)
        assert one.shape == other.shape == (2, one.shape[1])
        assert np.all(np.isfinite(one))
        if name != "levels":
            np.testing.assert_allclose(one, other, atol=1e-9)


def test_levels_are_the_mean_and_the_size():
    found = jc.signal.levels(shaken()._replace(values=np.array([[1.0, 3.0, 1.0, 3.0]])))
    np.testing.assert_allclose(found, [[2.0, 0.0]], atol=1e-12)


def test_the_mean_cycle_is_the_cosine_and_spread_shows_where_it_does_not_repeat():
    signal = shaken()
    cycle = jc.signal.synchronous_average(signal, bins=4)
    # A cosine's means over the quarters of a turn, beside its deviation of sqrt(1/2).
    expected = np.array([1, -1, -1, 1]) * (2 / np.pi) * np.sqrt(2)
    assert np.max(np.abs(cycle - expected)) < 0.05
    spread = jc.signal.spread_by_phase(signal, bins=2)
    assert np.all(spread[:, 1] - spread[:, 0] > 3)


def test_turns_are_read_over_the_angle_whatever_the_speed():
    time = np.linspace(0, 1, 4001)
    angle = 2 * np.pi * (2 * time + 3 * time**2)
    found = jc.signal.by_turns(np.cos(5 * angle)[None], 4000.0, angle[None], 5, 100)
    expected = np.cos(5 * 2 * np.pi * np.arange(100) / 100)
    assert np.max(np.abs(found.turns - expected)) < 1e-3


def test_an_order_is_found_in_its_band():
    angle = 2 * np.pi * np.arange(16 * 256 + 1) / 256
    signal = jc.signal.by_turns(np.cos(20 * angle)[None], RATE, angle[None], 16, 256)
    orders = np.geomspace(1.5, 128, 25)
    found = jc.signal.order_spectrum(signal)[0]
    band = np.argmax(found)
    assert len(found) == 24 and orders[band] <= 20.1 and orders[band + 1] >= 19.9


def test_impacts_are_counted():
    values = np.zeros((1, 1000))
    values[0, ::100] = 50.0
    found = jc.signal.impact_rate(jc.signal.Signal(values, RATE))
    assert found[0, -1] * (values.shape[1] - 2) == pytest.approx(9, abs=1)
    assert found[0, 0] > 0.97


@pytest.mark.parametrize("angle", [[0.0, 13.0], [0.0, -13.0], [6.2, 6.4]])
def test_whole_turns_are_counted_either_way(angle):
    begin, end = full_turns(np.array(angle))
    assert end - begin == {13.0: 2, -13.0: 2, 6.4: 0}[angle[1]]


def test_what_is_missing_is_named():
    bare = jc.signal.Signal(np.ones((1, 9)), RATE)
    with pytest.raises(ValueError, match="nothing tells these"):
        jc.signal.order_spectrum(bare)
    with pytest.raises(ValueError, match="3 turns were asked for"):
        jc.signal.by_turns(np.ones((1, 9)), RATE, np.linspace(0, 13, 9)[None], 3, 8)
