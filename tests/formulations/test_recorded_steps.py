"""Steps and their derivatives from stored states are those of an earlier version."""

import json

import numpy as np
import pytest

from tests.rigs.recorded_steps import CASES, FAST, RECORD, stepped

RECORDED = json.loads(RECORD.read_text())


def off(found, known):
    """Largest difference beside the largest number; nan must be where it was."""
    found, known = np.asarray(found), np.asarray(known)
    finite = np.isfinite(known)
    np.testing.assert_array_equal(np.isfinite(found), finite)
    return np.abs(found - known)[finite].max(initial=0) / np.abs(known)[finite].max(initial=1e-300)


@pytest.mark.parametrize(
    ("name", "rung"),
    [case if case in FAST else pytest.param(*case, marks=pytest.mark.slow) for case in CASES],
)
def test_steps_and_their_derivatives_are_as_recorded(name, rung):
    """To rounding, which three steps through contacts make larger."""
    known = RECORDED[f"{name} by {rung}"]
    ends, slopes = stepped(name, rung, np.asarray(known["time"]), np.asarray(known["state"]))
    assert off(ends, known["end"]) < 1e-11
    assert off(slopes, known["slope"]) < 1e-9
