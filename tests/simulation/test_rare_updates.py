"""Surfaces that wear more rarely than states are saved: the same loss, on maps that agree with
those of as many saving times."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.store.batch import evaluate_all
from tests.rigs.cells import slow

INTEGRATOR, DURATION = jc.integrator.FixedStep(2.5e-5), 0.02


def rig(updates):
    worn = lambda each: isinstance(each, jc.Wearing)
    rarer = lambda each: dataclasses.replace(each, updates=updates) if worn(each) else each
    return jax.tree.map(rarer, jc.scenes.slider_crank(wear=True), is_leaf=worn)


def run(updates, saves, verify=False):
    return jc.simulate(rig(updates), DURATION, save=saves, integrator=INTEGRATOR, verify=verify)


def depth(run):
    return np.asarray(run.worn["B"]["bearing"])


def test_more_updates_than_saving_times_are_those():
    alike, wanted = run(1000, 41), run(None, 41)
    for one, other in zip(jax.tree.leaves(alike), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("saves", [*slow(81), 101])
def test_as_many_updates_as_another_run_has_saving_times_wear_like_it(saves):
    """40 in both: each at the first saving time past a 40th of the run. Fixed steps fit the
    intervals of both, so that motions are the same but for what wear changes; the wear law of this
    scene changes gaps by 1e-8 of themselves."""
    found, wanted = run(40, saves), run(40, 41)
    assert depth(wanted).max() > 0
    np.testing.assert_allclose(depth(found).sum(), depth(wanted).sum(), rtol=1e-3)
    # Twice as many states are saved and every second wears; of 2.5 to an update some wear late.
    off = 1e-6 if saves == 81 else 0.1
    np.testing.assert_allclose(depth(found), depth(wanted), atol=off * depth(wanted).max())


def test_gaps_see_surfaces_as_they_were_worn_last():
    seen = np.asarray(jax.tree.leaves(run(4, 41).history.read)[0])
    changes = np.flatnonzero(np.abs(np.diff(seen, axis=0)).max(axis=1) > 0)
    assert 1 <= len(changes) <= 4


@pytest.mark.slow
def test_replicas_wear_them_more_often_in_proportion():
    """So that the error they tell holds what rare updates change."""
    replica = run(20, 161, verify=True).verification.replicas[0]
    finer = jc.integrator.FixedStep(INTEGRATOR.step / 2)
    wanted = jc.simulate(rig(40), DURATION, save=161, integrator=finer, verify=False)
    np.testing.assert_array_equal(depth(replica), depth(wanted))


def test_steps_that_are_no_share_of_the_time_between_updates_leave_them_as_rare():
    """One at each saving time of a run in which 166.7 steps fit into an interval: so the motion is
    that of surfaces that do not wear, in the same steps."""
    how = {"save": 5, "integrator": jc.integrator.FixedStep(3e-5), "verify": False}
    runs = [jc.simulate(each, DURATION, **how) for each in (rig(4), jc.scenes.slider_crank())]
    assert int(runs[0].accepted_steps) == int(runs[1].accepted_steps) == 4 * 167
    moved = [run.body("slider").com for run in runs]
    np.testing.assert_allclose(*moved, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match="updates"):
        jc.Wearing(jc.wear.Archard(), updates=0)


@pytest.mark.slow
def test_with_a_progress_bar_a_run_wears_as_without():
    """It is no kernel then, and updates follow the contact's path all the same: with two saving
    times surfaces had worn once, at the end."""
    how = {"save": 2, "integrator": INTEGRATOR, "verify": False}
    shown, wanted = (
        depth(jc.simulate(rig(None), DURATION, progress_bar=bar, **how)) for bar in (True, False)
    )
    np.testing.assert_allclose(shown, wanted, rtol=0, atol=1e-9 * wanted.max())


def test_samples_in_a_batch_wear_as_beside_others():
    """They come to their updates after different numbers of steps, and do not wait for each other:
    to the last digit the same beside samples that differ as beside those that are alike."""
    joint = lambda rig: rig.connections["B"].joint
    problem = jc.Problem(
        rig(None),
        {"depth": jc.response.PeakWornDepth("B"), "steps": lambda run: run.accepted_steps},
        {"clearance": jc.Variable(lambda rig: joint(rig).clearance, tolerance=50e-6)},
        duration=DURATION,
        integrator=INTEGRATOR,
        save=3,
    )
    nominal = problem.nominal()[0]
    different = nominal * np.linspace(0.5, 1.5, 8)[:, None]
    beside = evaluate_all(problem, different).responses
    alike = evaluate_all(problem, np.full_like(different, different[2, 0])).responses
    assert np.ptp(beside["depth"]) > 0
    for name, values in alike.items():
        np.testing.assert_array_equal(values, np.full(8, beside[name][2]))
