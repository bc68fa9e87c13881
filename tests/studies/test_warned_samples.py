"""Runs that warn of their own numbers are counted in studies as failed ones are.

An ideal slider-crank in long steps: its loop drifts beyond the limit where it turns fast, and is
torn, which ends the run, where it turns faster still.
"""

from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import report_samples
from jaxclear.integrators.checks import Check
from jaxclear.plot.studies import _warned_samples
from jaxclear.results.response import REACHES, concerned
from jaxclear.studies.sensitivity.derivative import Estimate, confirmed
from jaxclear.studies.warned import concern, counted, in_words


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
def study():
    problem = jc.Problem(
        loosely_closed(),
        {"slider": jc.response.FinalCoordinate("A"), "speed": lambda run: run.states[-1, 1]},
        SPEED,
        duration=0.02,
        save=21,
        integrator=jc.integrator.ImplicitStep(1e-3),
    )
    return jc.monte_carlo(problem, 64)


def test_samples_that_warn_are_counted_by_index_and_kind(study):
    drift = study.checks.figures[Check.LOOP_DRIFT].worst[:, 0]
    over = np.flatnonzero(drift > Check.LOOP_DRIFT.limit)
    assert 0 < len(over) < 64 and not len(study.failed)
    np.testing.assert_array_equal(study.warned, over)
    assert list(study.warnings()) == list(over)
    assert all("loop closed by joint" in sentences[0] for sentences in study.warnings().values())
    assert study.sentence() == (
        f"64 samples, 0 failed, {len(over)} with warnings (loop drift in {len(over)})."
    )


def test_statistics_are_told_with_and_without_them(study):
    row = study.summary().set_index("response").loc["slider"]
    clean = np.setdiff1d(np.arange(64), study.warned)
    values = study.responses["slider"]
    assert row["warned"] == len(study.warned) and row["mean"] == pytest.approx(values.mean())
    assert row["mean without warned"] == pytest.approx(values[clean].mean())
    assert row["standard deviation without warned"] == pytest.approx(values[clean].std(ddof=1))
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
        "swinging forces": (False, True, True, True, False, True),
        "wear": (False, False, True, True, False, True),
        "worn depth": (False, False, False, True, False, True),
        "places in gaps": (False, False, True, True, False, True),
    }.items():
        found = tuple(concerned(r, concerns) for r in (position, peak, wear, depth, mean, plain))
        assert found == wanted, concerns
    assert {check.concerns for check in Check} <= set(REACHES)


def test_a_failed_sample_is_not_counted_twice(study):
    fast = eqx.tree_at(
        lambda p: (p.mechanism.connections["O"].joint.drive.speed, p.variables["crank"]),
        study.problem,
        (
            jnp.asarray(np.float64(400.0)),
            jc.Variable(SPEED["crank"].where, jc.distribution.Uniform(390.0)),
        ),
    )
    found = jc.monte_carlo(fast, 64)
    torn = np.flatnonzero(found.outcome == jc.integrator.Outcome.LOOP_TORN)
    assert 0 < len(torn) < 64 and set(torn) <= set(found.failed)
    assert not set(found.warned) & set(torn) and len(found.concerned("slider")) > 0
    assert "A loop came open" in found.failures()[int(torn[0])]
    with pytest.raises(ValueError, match='no response "force" in this study'):
        found.concerned("force")


def test_a_derivative_says_which_runs_warn_and_is_not_trusted(study):
    answers = jc.sensitivity(study.problem, sample=study, difference_samples=16)
    found = answers.derivatives["slider", "crank"]
    assert found.verdict.startswith("Agreed by ") and not found.trustworthy
    share = len(study.warned) / 64
    assert found.estimates["regression"].warned == pytest.approx(share)
    assert f"In regression, {len(study.warned)} of 64 runs warn (loop drift" in found.verdict
    assert "differences warnings" in answers.table() and "of 64 runs" in found.verdict
    few = confirmed(
        "r", "v", {"a": Estimate(1, 0.1, warned=0.01, warnings="1 of 100."), "b": Estimate(1, 0.1)}
    )
    assert few.trustworthy and few.verdict.endswith("In a, 1 of 100.")


def test_kinds_are_told_most_frequent_first(study):
    among = np.arange(64) < 60
    assert in_words({Check.HALVED_WEAR: 3, Check.LOOP_DRIFT: 1}) == (
        "halved steps: wear in 3, loop drift in 1"
    )
    assert counted(study.checks, among) == {
        Check.LOOP_DRIFT: int(np.isin(study.warned, np.flatnonzero(among)).sum())
    }
    assert concern(study.problem, "slider", study.checks, ~among | among)[0] == pytest.approx(
        len(study.warned) / 64
    )


def test_they_are_told_in_print_and_below_the_histogram(study, capsys):
    report_samples(study)
    first, *told, last = capsys.readouterr().out.splitlines()
    assert first == study.sentence()
    assert told[0].startswith(f"sample {study.warned[0]} warns. The loop closed by")
    assert last == f"and {len(study.warned) - 5} more, in the table."
    caption = " ".join(text.get_text() for text in plot.monte_carlo(study).texts)
    assert study.sentence() in caption
    assert "in doubt; the mean is" in _warned_samples(study)[1]


def test_a_figure_of_warned_infinite_answers_says_that_there_is_no_mean():
    row = {"response": "life", "unit": "cycles", "warned": 3, "mean": np.nan, "infinite": 1}
    table, responses = pandas.DataFrame([row]), {"life": np.array([1.0, np.inf])}
    told = SimpleNamespace(warned=[0], responses=responses, sentence=str, doubts=())
    told.summary = lambda: table
    table["mean without warned"] = np.nan
    said = _warned_samples(told)[-1]
    assert said == "life: 3 in doubt; there is no mean, infinite in 1 samples."
