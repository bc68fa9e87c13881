"""The cycle at which a clearance reaches its limit, from records at several times."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.identification.result import Identified, Unknown
from jaxclear.studies.identification.several_records import next_record
from jaxclear.studies.identification.signal_answers import of_records
from jaxclear.studies.identification.signal_fit import CredibleInterval
from tests.plot.identified import identified

PROBLEM = jc.FunctionProblem(
    lambda gap: 2 * gap, {"gap": jc.Dimension(2e-4, jc.distribution.Uniform(2e-4))}
)
ERROR = 4e-6


def found(value, verdict="identified"):
    """A gap that is told to within a standard deviation of 4 um."""
    drawn = value + ERROR * np.random.default_rng(1).standard_normal(4000)
    ends = value - 1.96 * ERROR, value + 1.96 * ERROR
    row = Unknown("gap", "m", value, *ends, 0.0, 4e-4, 0.04, verdict, "")
    return Identified(PROBLEM, (row,), drawn[:, None], 256, 0, "by hand")


def test_two_records_tell_the_cycle_of_failure():
    """Growth of 50 um in a million cycles, and its error by the two records' own."""
    life = jc.remaining_life({1e6: found(1.0e-4), 2e6: found(1.5e-4)}, "gap", 3e-4)
    middle, low, high = life.band(life.rate)
    assert middle == pytest.approx(5e-11, rel=0.01)
    assert 0.5 * (high - low) == pytest.approx(1.645 * np.sqrt(2) * ERROR / 1e6, rel=0.05)
    middle, low, high = life.failure_band
    assert middle == pytest.approx(5e6, rel=0.02) and low < 5e6 < high
    # To first order: errors of the last gap and of the growth that led to it.
    first = 1.645 * ERROR / 5e-11 * np.hypot(4.0, 3.0)
    assert 0.5 * (high - low) == pytest.approx(first, rel=0.15)
    assert life.remaining[0] == pytest.approx(3e6, rel=0.03)
    assert "are left after the last of 2 records" in life.sentence() and not life.warnings


def test_more_records_tell_it_better():
    by_two = jc.remaining_life({0: found(0.5e-4), 2e6: found(1.5e-4)}, "gap", 3e-4)
    values = {1e6 * k: found(0.5e-4 + 0.5e-4 * k) for k in (0, 0.5, 1, 1.5, 2)}
    by_five = jc.remaining_life(values, "gap", 3e-4)
    width = lambda life: np.diff(life.failure_band[1:])[0]
    assert width(by_five) < 0.9 * width(by_two)


def test_growth_that_speeds_up_is_said_and_none_has_no_end_in_sight():
    values = {0: found(0.5e-4), 1e6: found(0.7e-4), 2e6: found(1.7e-4)}
    (said,) = jc.remaining_life(values, "gap", 3e-4).warnings
    assert "does not grow along a straight line" in said
    life = jc.remaining_life({0: found(1e-4), 1e6: found(1e-4)}, "gap", 3e-4)
    assert life.failure_band[2] > 1e8 and np.all(life.rate > 0)


def test_what_cannot_be_asked_is_refused():
    with pytest.raises(ValueError, match="two at least, at different cycles"):
        jc.remaining_life({0: found(1e-4)}, "gap", 3e-4)
    with pytest.raises(ValueError, match='no unknown "gab"'):
        jc.remaining_life({0: found(1e-4), 1: found(1e-4)}, "gab", 3e-4)


def test_several_records_by_statistics_tell_the_next_one():
    every = [found(value) for value in (1.0e-4, 1.1e-4, 1.2e-4)]
    whole = of_records(PROBLEM, every, 0)
    told = [CredibleInterval(own["gap"].estimate, 0.0, 0.0, ERROR, 0.0, 4e-4) for own in every]
    expected = next_record(told)
    assert whole["gap"].estimate == pytest.approx(expected.value)
    assert whole["gap"].high == pytest.approx(expected.high, rel=1e-3)
    assert "next record" in whole.how and np.all(whole.posterior_values >= 0)
    two = identified(jc.FunctionProblem(lambda a, b: a + b, dict.fromkeys("ab", PARTS)))
    assert len(of_records(two.problem, [two, two], 0).unknowns) == 2


PARTS = jc.Dimension(2.0, jc.distribution.Uniform(0.5), unit="1")
