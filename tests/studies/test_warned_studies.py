"""Studies beyond Monte Carlo tell which of their runs warn, of what, and what rests on these.

A slider-crank with an ideal loop whose runs drift open beyond the limit where the crank turns fast;
and a response that this concerns beside one that it does not.
"""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Check, Checks, Figure
from jaxclear.studies.warned import codes_of, concerning, sentences


def loosely_closed():
    """One whose loop drifts open: by default such steps close it anew."""
    ideal = jc.scenes.slider_crank("ideal", crank_speed=60.0)
    return jc.Mechanism(
        ideal.bodies, ideal.connections, ideal.loads, **ideal.given, stabilisation=jc.Baumgarte()
    )


SPEED = {
    "crank": jc.Variable(
        lambda rig: rig.connections["O"].joint.drive.speed, jc.distribution.Uniform(55.0)
    )
}


@pytest.fixture(scope="module")
def problem():
    return jc.Problem(
        loosely_closed(),
        {"slider": jc.response.FinalCoordinate("A")},
        SPEED,
        duration=0.02,
        save=21,
        integrator=jc.integrator.ImplicitStep(1e-3),
    )


@pytest.fixture(scope="module")
def share(problem):
    """Share of the runs that warn."""
    return len(jc.monte_carlo(problem, 64).warned) / 64


def told(sentences, share, runs):
    """Whether one sentence tells as many of so many runs as warn, of the loop."""
    (said,) = sentences
    count, among = int(said.split()[1]), int(said.split()[3])
    assert said == f'"slider": {count} of {among} runs warn (loop drift in {count}).'
    assert among == runs and count == pytest.approx(share * runs, abs=0.15 * runs)
    return True


def test_codes_are_bits_by_the_number_of_a_check(problem):
    two = {
        check: Figure(np.array([[low], [high], [0.0]]), np.zeros((3, 1)), ("a",))
        for check, low, high in ((Check.LOOP_DRIFT, 0.0, 1.0), (Check.WEAR_BY_SAVES, 1.0, 1.0))
    }
    found = codes_of(Checks.of(two), 3)
    np.testing.assert_array_equal(found, [1 << 14, 1 | 1 << 14, 0])
    # A worn depth is nothing to where a slider is.
    np.testing.assert_array_equal(concerning(problem, "slider", found), [0, 1, 0])
    assert sentences(problem, found) == ('"slider": 1 of 3 runs warn (loop drift in 1).',)
    assert sentences(problem, found, []) == () and sentences(problem, found[2:]) == ()


def test_sobol_indices(problem, share):
    found = jc.sobol_indices(problem, 64, scramblings=4)
    assert told(found.warnings, share, found.runs) and str(found).endswith(found.warnings[0])


@pytest.mark.slow
def test_shapley_effects_surface_and_what_corrects_it(problem, share):
    found = jc.shapley_effects(problem, 64)
    assert told(found.warnings, share, found.runs) and str(found).endswith(found.warnings[0])
    surface = jc.surface(problem, 64)
    assert told(surface.warnings, share, 64) and surface.warnings[0] in str(surface)
    on_surface = jc.shapley_effects(surface, 64)
    assert on_surface.warnings == surface.warnings
    fresh = jc.corrected(surface, 8, scramblings=4)
    assert told(fresh.warnings, share, fresh.runs) and fresh.warnings[0] in str(fresh)


@pytest.mark.slow
def test_the_worst_case_tells_whose_run_warns(problem):
    found = jc.worst_case(problem, samples=32)
    drift = lambda values: problem.rerun(np.asarray(values), 0, 1).warnings
    for end, one in (("least", found.least), ("largest", found.largest)):
        said = f'The run of the {end} "slider" warns (loop drift).'
        assert (said in found.warnings) == bool(drift(one["slider"].values))
    assert found.warnings and str(found).endswith(found.warnings[-1])


@pytest.mark.slow
def test_reliability(problem, share):
    middle = float(np.median(jc.monte_carlo(problem, 64).responses["slider"]))
    limit = jc.limit_state.Above("slider", middle)
    found = jc.reliability(problem, limit, methods="importance", most_runs=256)
    (said,) = found.warnings
    assert said in found.sentence() and told([said], share, int(said.split()[3]))


def test_a_design_of_runs_in_doubt_is_not_said_to_hold(problem, tmp_path):
    asked = {
        "cost": {"crank": jc.cost.Reciprocal(1.0)},
        "limits": jc.limit.Quantile("slider", at_most=1.0, share=0.9),
        "tolerance": {"crank": (20.0, 55.0)},
        "settings": jc.DesignSettings(samples=64, check=64, rounds=1, runs=64),
        "store": tmp_path / "kept",
    }
    found = jc.design(problem, **asked)
    assert np.all(found.excess <= found.allowed_excess) and not found.rounds[-1].check.failed
    assert not found.holds and "All limits hold" not in found.sentence()
    assert 'It is not known to hold, by runs in doubt. "slider": ' in found.sentence()
    assert f"Of all runs: {found.warnings[0]}" in found.sentence()
    # What was kept in a folder is told again.
    again = jc.design(problem, **asked)
    assert again.computed == 0 and again.sentence() == found.sentence()
