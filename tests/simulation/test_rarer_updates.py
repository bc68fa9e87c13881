"""A second look with worn surfaces updated half as often, and one more where paths have parted."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Check
from jaxclear.simulation.rarer_updates import moved, where_kept
from tests.rigs.attacked import run_of


def beyond(run):
    return {check for check, flag in run.checks.beyond().items() if flag}


@pytest.mark.parametrize("count", [2, 3, 6, 7])
def test_every_second_time_is_moved_to_just_before_the_next(count):
    times = np.cumsum(np.linspace(1, 2, count))
    found = moved(times)
    assert np.all(np.diff(found) > 0) and found[-1] == times[-1]
    np.testing.assert_array_equal(found[::2], times[::2])
    second = np.arange(1, count - 1, 2)
    left = times[second + 1] - found[second]
    np.testing.assert_allclose(left, 0.1 * np.diff(times)[second])


@pytest.mark.slow
def test_what_was_saved_at_times_that_are_moved_is_what_was_at_the_next():
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Hertz(stiffness=1e9),
        bearing_radius=0.01,
        clearance=1e-4,
        bearing_wear=jc.Wearing(jc.wear.Archard(), cells=(8, 1)),
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity()},
    )
    run = jc.simulate(rig, 1e-3, save=6)
    kept, rows = where_kept(run).history, [0, 2, 2, 4, 4, 5]
    np.testing.assert_array_equal(kept.time, run.time[np.array(rows)])
    np.testing.assert_array_equal(kept.states, run.states[np.array(rows)])


@pytest.mark.slow
def test_a_path_that_hangs_on_when_surfaces_are_updated_is_said():
    """A journal thrown up and down sideways unstably, worn by 5e-8 m: beside a hundred times the
    saving times it is a fifth of its clearance elsewhere, of which shorter steps tell 0.02."""
    assert Check.PLACE_IN_GAP in beyond(run_of(2, 50, jc.integrator.Adaptive()))


@pytest.mark.slow
def test_mean_forces_that_agree_by_chance_where_paths_have_parted_are_said():
    """Of a spatial four-bar: 44.91 N, with steps a quarter as long 44.87 N, right is 46.10 N."""
    run = run_of(20, 51, jc.integrator.FixedStep(2e-5), balance=True)
    assert abs(float(jc.response.MeanContactForce("B")(run)) / 46.10 - 1) > 0.02
    assert float(run.checks.figures[Check.MEAN_FORCE].worst.max()) < 0.002
    assert Check.PARTED_FORCE in beyond(run)
