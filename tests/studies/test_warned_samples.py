"""Runs that warn of their own numbers are counted in studies as failed ones are; studies beyond
Monte Carlo tell which of theirs warn, of what, and what rests on these.

An ideal slider-crank in long steps: its loop drifts beyond the limit where it turns fast, and is
torn, which ends the run, where it turns faster still."""

from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import report_samples
from jaxclear.integrators.checks import Check, Checks, Figure
from jaxclear.plot.studies import _warned_samples
from jaxclear.results.response import REACHES, depends_on
from jaxclear.studies.run_warnings import (
    codes_of,
    concern,
    concerning,
    counted,
    in_words,
    sentences,
)
from jaxclear.studies.sensitivity.derivative import Estimate, confirmed


def loosely_closed():
    """One whose loop drifts open: by default such steps close it anew."""
    ideal = jc.scenes.slider_crank("ideal", crank_speed=60.0)
    parts = ideal.bodies, ideal.connections, ideal.loads
    return jc.Mechanism(*parts, **ideal.start_arguments, stabilisation=jc.Baumgarte())


SPEED = {
    "crank": jc.Variable(
        lambda rig: rig.connections["O"].joint.drive.speed, jc.distribution.Uniform(55.0)
    )
}
SLIDER = {"slider": jc.response.FinalCoordinate("A")}


def problem_of(response):
    step = jc.integrator.ImplicitStep(1e-3)
    how = {"duration": 0.02, "save": 21, "integrator": step}
    return jc.Problem(loosely_closed(), response, SPEED, **how)


@pytest.fixture(scope="module")
def study():
    return jc.monte_carlo(problem_of(SLIDER | {"speed": lambda run: run.states[-1, 1]}), 64)


def test_samples_that_warn_are_counted_by_index_and_kind(study):
    drift = study.checks.figures[Check.LOOP_DRIFT].worst[:, 0]
    over = np.flatnonzero(drift > Check.LOOP_DRIFT.limit)
    assert 0 < len(over) < 64 and not len(study.failed)
    np.testing.assert_array_equal(study.warned, over)
    assert list(study.warnings()) == list(over)
    assert all("loop closed by joint" in sentences[0] for sentences in study.warnings().values())
    assert study.sentence().endswith(
        f" 64 samples, 0 failed, {len(over)} with warnings (loop drift in {len(over)})."
    )


def test_statistics_are_told_with_and_without_them(study):
    row = study.summary().set_index("response").loc["slider"]
    clean = np.setdiff1d(np.arange(64), study.warned)
    values = study.responses["slider"]
    assert row["warned"] == len(study.warned) and row["mean"] == pytest.approx(values.mean())
    assert row["mean, samples without warnings"] == pytest.approx(values[clean].mean())
    # Of quasi-random samples the variance is the mean square and that of the mean.
    least, most = values[clean].std(), values[clean].std(ddof=1)
    assert least <= row["standard deviation, samples without warnings"] <= most
    table = study.table()
    assert list(np.flatnonzero(table["warnings"] != "")) == list(study.warned)
    assert set(table["in doubt"]) == {"", "slider, speed"}


def test_one_sample_can_be_run_alone(study):
    index = int(study.warned[-1])
    run = study.rerun(index)
    assert run.warnings == study.warnings()[index]
    np.testing.assert_allclose(run.states[-1, 0], study.responses["slider"][index], rtol=1e-12)


def test_a_response_is_in_doubt_where_a_warning_concerns_it():
    position, peak = jc.response.FinalCoordinate("A"), jc.response.PeakContactForce("B")
    wear, mean = jc.response.WornVolume("B"), jc.response.MeanContactForce("B")
    depth = jc.response.PeakWornDepth("B")
    plain = lambda run: run.states[-1, 0]
    for concerns, wanted in {
        "motion": (True, True, True, True, True, True),
        "forces": (False, True, True, True, True, True),
        "peak forces": (False, True, False, False, False, True),
        "wear": (False, False, True, True, False, True),
        "worn depth": (False, False, False, True, False, True),
        "places in gaps": (False, False, True, True, False, True),
    }.items():
        found = tuple(depends_on(r, concerns) for r in (position, peak, wear, depth, mean, plain))
        assert found == wanted, concerns
    assert {check.concerns for check in Check} <= set(REACHES)


def test_a_failed_sample_is_not_counted_twice(study):
    where = lambda p: (p.mechanism.connections["O"].joint.drive.speed, p.variables["crank"])
    spread = jc.Variable(SPEED["crank"].where, jc.distribution.Uniform(390.0))
    fast = eqx.tree_at(where, study.problem, (jnp.asarray(400.0), spread))
    found = jc.monte_carlo(fast, 64)
    torn = np.flatnonzero(found.outcome == jc.integrator.Outcome.LOOP_OPEN)
    assert 0 < len(torn) < 64 and set(torn) <= set(found.failed)
    assert not set(found.warned) & set(torn) and len(found.affected_samples("slider")) > 0
    assert "A loop came open" in found.failures()[int(torn[0])]
    with pytest.raises(ValueError, match='no response "force" in this study'):
        found.affected_samples("force")


def test_a_derivative_says_which_runs_warn_and_is_not_trusted(study):
    answers = jc.sensitivity(study.problem, sample=study, difference_samples=16)
    found = answers.derivatives["slider", "crank"]
    assert found.verdict.startswith("From ") and not found.trustworthy
    share = len(study.warned) / 64
    assert found.estimates["regression"].warned == pytest.approx(share)
    assert f"In regression, {len(study.warned)} of 64 runs warn (loop drift" in found.verdict
    assert "differences warnings" in answers.table() and "of 64 runs" in found.verdict
    few = confirmed(
        "r", "v", {"a": Estimate(1, 0.1, warned=0.01, warnings="1 of 100."), "b": Estimate(1, 0.1)}
    )
    assert few.trustworthy and few.verdict.endswith("In a, 1 of 100.")


def test_kinds_are_told_most_frequent_first(study):
    among, kinds = np.arange(64) < 60, {Check.GAP_MOTION: 3, Check.LOOP_DRIFT: 1}
    assert in_words(kinds) == "motion in the gap in 3, loop drift in 1"
    found = counted(study.checks, among)
    assert found == {Check.LOOP_DRIFT: int(np.isin(study.warned, np.flatnonzero(among)).sum())}
    share = concern(study.problem, "slider", study.checks, ~among | among)[0]
    assert share == pytest.approx(len(study.warned) / 64)


def test_they_are_told_in_print_and_below_the_histogram(study, capsys):
    report_samples(study)
    first, *told, last = capsys.readouterr().out.splitlines()
    assert first == study.sentence()
    assert told[0].startswith(f"sample {study.warned[0]} warns. The loop closed by")
    assert last == f"and {len(study.warned) - 5} more, in the table."
    caption = " ".join(text.get_text() for text in plot.monte_carlo(study).texts)
    assert study.count_sentence() in caption
    assert "in doubt; the mean is" in _warned_samples(study)[1]


def test_a_figure_of_warned_infinite_answers_says_that_there_is_no_mean():
    row = {"response": "life", "unit": "cycles", "warned": 3, "mean": np.nan, "infinite": 1}
    table, responses = pandas.DataFrame([row]), {"life": np.array([1.0, np.inf])}
    told = SimpleNamespace(
        warned=[0], responses=responses, count_sentence=str, accuracy_warnings=()
    )
    told.summary = lambda: table
    table["mean, samples without warnings"] = np.nan
    said = _warned_samples(told)[-1]
    assert said == "life: 3 in doubt; there is no mean, infinite in 1 samples."


# ---- studies beyond Monte Carlo ----


@pytest.fixture(scope="module")
def problem():
    return problem_of(SLIDER)


@pytest.fixture(scope="module")
def share(study):
    """Share of the runs that warn."""
    return len(study.warned) / 64


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
        for check, low, high in ((Check.LOOP_DRIFT, 0.0, 1.0), (Check.WEAR_BY_CELLS, 1.0, 1.0))
    }
    found = codes_of(Checks.of(two), 3)
    np.testing.assert_array_equal(found, [1 << 31, 1 | 1 << 31, 0])
    # A worn depth is nothing to where a slider is.
    np.testing.assert_array_equal(concerning(problem, "slider", found), [0, 1, 0])
    assert sentences(problem, found) == ('"slider": 1 of 3 runs warn (loop drift in 1).',)
    assert sentences(problem, found, []) == () and sentences(problem, found[2:]) == ()


def test_sobol_indices(problem, share):
    found = jc.sobol_indices(problem, 64, scramblings=4)
    assert told(found.warnings, share, found.runs) and str(found).endswith(found.warnings[0])


@pytest.mark.slow(sample=False)
def test_shapley_effects_surface_and_what_corrects_it(problem, share):
    found = jc.shapley_effects(problem, 64)
    assert told(found.warnings, share, found.runs) and str(found).endswith(found.warnings[0])
    surface = jc.surface(problem, 64)
    assert told(surface.warnings, share, 64) and surface.warnings[0] in str(surface)
    on_surface = jc.shapley_effects(surface, 64)
    assert on_surface.warnings == surface.warnings
    fresh = jc.corrected_statistics(surface, 8, scramblings=4)
    assert told(fresh.warnings, share, fresh.runs) and fresh.warnings[0] in str(fresh)


@pytest.mark.slow(sample=False)
def test_the_worst_case_tells_whose_run_warns(problem):
    found = jc.worst_case(problem, samples=32)
    drift = lambda values: problem.detail(np.asarray(values)).warnings
    for end, one in (("least", found.least), ("largest", found.largest)):
        said = f'The run of the {end} "slider" warns (loop drift).'
        assert (said in found.warnings) == bool(drift(one["slider"].values))
    assert found.warnings and str(found).endswith(found.warnings[-1])


@pytest.mark.slow(sample=False)
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
    assert np.all(found.excess <= found.allowed_excess) and not found.round.check.failed
    assert not found.holds and "All limits hold" not in found.sentence()
    assert 'It is not known to hold, by runs in doubt. "slider": ' in found.sentence()
    assert f"Of all runs: {found.warnings[0]}" in found.sentence()
    # What was kept in a folder is told again.
    again = jc.design(problem, **asked)
    assert again.computed == 0 and again.sentence() == found.sentence()
