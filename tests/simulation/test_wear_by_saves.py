"""What a run says of worn depths that hang on its saving times: beside the same run saved more
often."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from benchmarks.attacks.structures import structures
from jaxclear.formulations.base import model_of
from jaxclear.integrators import Check
from jaxclear.integrators.non_colliding import NonColliding
from jaxclear.simulation.wear import unworn, worn_by_some
from jaxclear.simulation.wear_by_saves import figures
from tests.rigs.attacked import run_of

VOLUME, NARROW = 1e-13, 0.05


@pytest.fixture(scope="module")
def model():
    formulation = jc.integrator.FixedStep().formulation
    return model_of(jc.scenes.four_bar("planar", cells=(72, 1)), formulation)


def worn_at(model, angles, length=1.0, times=1.0):
    """States of a run in which a contact loses so many `times` a volume in each interval, at these
    angles; `length` of the mean direction."""
    (slot,) = model.layout.wear
    states = np.zeros((len(angles) + 1, model.layout.size))
    features = {
        0: length * np.cos(angles),
        1: length * np.sin(angles),
        3: np.full(len(angles), 1 / NARROW),
    }
    volumes = VOLUME * times * np.ones(len(angles))
    lost = [volumes] + [volumes * features[i] for i in slot.averaged]
    states[1:, slot.start : slot.start + len(lost)] = np.cumsum(lost, axis=1).T
    return jnp.asarray(states)


def told(model, angles, *numbers):
    states, begun = worn_at(model, np.asarray(angles), *numbers), unworn(model.system)
    ended = worn_by_some(model.system, model.layout, begun, states, 1)
    return float(figures(model, begun, ended, states)[Check.WEAR_BY_SAVES][0])


@pytest.mark.slow
def test_places_between_which_a_contact_jumps_are_told_and_one_place_is_none(model):
    assert told(model, np.full(8, 0.3)) < 0.01
    assert told(model, np.tile([0.3, 2.1, 0.5, -0.4], 2)) > Check.WEAR_BY_SAVES.limit


@pytest.mark.slow
def test_a_single_loss_over_a_wide_arc_is_told(model):
    """Of which fewer saving times tell nothing: nobody knows where on its arc it was lost. In one
    place, or like those beside it, it is right."""
    angles, burst = np.full(32, 0.3), np.where(np.arange(32) == 17, 10.0, 1.0)
    limit = Check.WEAR_BY_SAVES.limit
    assert told(model, angles, 0.95, burst) > 2 * limit
    assert told(model, angles, 1.0, burst) < 0.5 * limit
    assert told(model, angles, 0.95) < 0.5 * limit


@pytest.mark.slow
def test_what_is_told_of_a_contact_that_sweeps_evenly_falls_with_the_saving_times(model):
    few, many = (told(model, np.linspace(-1.5, 1.5, count)) for count in (12, 24))
    assert many < 0.5 * few


def test_an_interval_in_which_a_contact_goes_round_more_than_once_is_told(model):
    """Unless it goes round evenly, as a shaft in whole turns."""
    assert told(model, np.array([0.3]), 0.25) == pytest.approx(0.5)
    assert told(model, np.array([0.3]), 0.01) < Check.WEAR_BY_SAVES.limit


@pytest.mark.slow
def test_turns_are_told_of_several_intervals_unless_their_uneven_rests_cancel(model):
    assert told(model, np.full(2, 0.3), 0.25) == pytest.approx(0.5)
    assert told(model, np.array([0.3, 0.3 + np.pi]), 0.25) < 0.5


def test_of_one_place_in_one_saving_interval_and_of_what_does_not_wear_nothing_is_told(model):
    states = worn_at(model, np.array([0.3]))
    assert told(model, np.array([0.3])) == 0
    assert not figures(model, {}, {}, states)


@pytest.mark.slow
def test_depths_that_few_saving_times_leave_wrong_are_told_and_those_of_many_are_not():
    """Figures are what the depths are off by, beside a run with many saving times, within a factor
    of two where they warn."""
    rig = jc.scenes.four_bar("planar", cells=(144, 1))
    whole = jc.simulate(rig, 1.26, save=2, integrator=NonColliding())
    assert "saving times" in whole.result
    runs = {n: jc.simulate(rig, 1.26, save=n, integrator=NonColliding()) for n in (26, 201, 801)}
    true = np.asarray(runs[801].worn_depth("B", "bearing"))
    for count, beyond in ((26, True), (201, False)):
        found = runs[count].checks.figures[Check.WEAR_BY_SAVES].worst.max()
        off = np.asarray(runs[count].worn_depth("B", "bearing")) - true
        assert np.sqrt((off**2).sum() / (true**2).sum()) < (2 if beyond else 1) * found
        assert (found > Check.WEAR_BY_SAVES.limit) == beyond
        assert ("saving times" in runs[count].result) == beyond


@pytest.mark.slow
def test_an_impact_that_saving_times_put_wrong_is_told():
    """The first impacts leave a fifth of what is worn in one saving interval: the deepest cell is 9
    % off at 126 saving times and 1 % at 501, which fewer of them do not tell."""
    rig, step = jc.scenes.four_bar("planar", cells=(144, 1)), jc.integrator.FixedStep(5e-6)
    runs = {n: jc.simulate(rig, 0.5, save=n, integrator=step) for n in (126, 501, 2001)}
    depths = {n: float(run.worn_depth("B", "bearing").max()) for n, run in runs.items()}
    for count, off in ((126, True), (501, False)):
        assert (abs(depths[count] / depths[2001] - 1) > 0.05) == off
        assert bool(runs[count].checks.beyond()[Check.WEAR_BY_SAVES]) == off


def test_of_a_single_loss_that_lies_right_fewer_saving_times_tell_nothing(model):
    """A third of all is lost within an interval, in one place; the fourth of the saving times
    spreads it over the way to there, which made it 0.15."""
    angles, burst = np.where(np.arange(64) < 46, 0.3, 1.9), np.where(np.arange(64) == 47, 32.0, 1.0)
    assert told(model, angles, 1.0, burst) < 0.2 * Check.WEAR_BY_SAVES.limit


def thrown():
    """A journal that is thrown about with a restitution of 0.97, and wears by 7e-8 m."""
    return run_of(8, 46, jc.integrator.Adaptive(rtol=1e-9, atol=1e-11))


@pytest.mark.slow
def test_places_that_hang_on_when_surfaces_are_updated_are_said():
    """The check of depths, which takes the motion as it was, tells nothing of that."""
    run = thrown()
    beyond = {check for check, flag in run.checks.beyond().items() if flag}
    assert Check.PLACE_IN_GAP in beyond and Check.WEAR_BY_SAVES not in beyond
    assert "worn surfaces updated half as often" in run.result


@pytest.mark.slow
def test_losses_that_are_put_on_sooner_put_a_thrown_journal_elsewhere():
    case = structures()[8].case(46)
    often = jc.simulate(
        case.mechanism,
        case.duration,
        integrator=jc.integrator.Adaptive(rtol=1e-9, atol=1e-11),
        save=10_001,
        state=jc.State(concentric=case.concentric),
    )
    clearance = float(case.mechanism.connections["B"].joint.clearance)
    here, there = (np.asarray(run.contact("B").offset)[:, :2] for run in (thrown(), often))
    assert np.abs(here - there[::50]).max() > 0.3 * clearance
