"""The claims about the flap actuation system (paper 002)."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.commands.flap import lasting_contact
from jaxclear.scenes.flap import ARM, FIRST_ROD, FREQUENCY, JOINTS, SECOND_ROD, STROKE, flap
from tests.rigs.refusals import refusals

STEP, DURATION, SAVES = 2e-6, 0.07, 7001


def simulated(**scene):
    implicit = jc.integrator.ImplicitStep(STEP)
    return jc.simulate(flap(**scene), DURATION, save=SAVES, integrator=implicit)


@pytest.fixture(scope="module")
def run():
    return simulated()


def forces(run):
    return {name: np.asarray(run.contact(name).normal_force).sum(axis=1) for name in JOINTS}


@pytest.mark.slow
def test_ideal_joints_move_as_the_linkage_says():
    """Two four-bars in a row: circles of the rods about pins that are known."""
    run = jc.simulate(flap("ideal"), 1 / FREQUENCY, save=11)
    for t, shaft in zip(run.time, run.body("shaft").rotation, strict=True):
        pin = np.array([0.5 * STROKE * (1 - np.cos(2 * np.pi * FREQUENCY * t)), 0.0])
        for length, pivot in ((FIRST_ROD, FIRST_ROD), (SECOND_ROD, FIRST_ROD + SECOND_ROD)):
            away = np.array([pivot, -ARM]) - pin
            distance = np.hypot(*away)
            along = (distance**2 + length**2 - ARM**2) / (2 * distance)
            normal = np.array([-away[1], away[0]]) / distance
            pin = pin + along * away / distance + np.sqrt(length**2 - along**2) * normal
        np.testing.assert_allclose(ARM * shaft[:2, 1], pin - [pivot, -ARM], atol=1e-9)


@pytest.mark.slow
def test_the_shaft_keeps_its_speed_while_its_joint_is_free(run):
    free = (np.asarray(run.contact("J4").indentation) < 0).all(axis=1)
    between = free[1:] & free[:-1]
    change = np.abs(np.diff(np.asarray(run.speed("O2"))))
    assert between.sum() > 1000
    # Apart from saving intervals within which an impact began and ended.
    assert np.quantile(change[between], 0.99) < 1e-12
    assert change[~between].max() > 1e-3


@pytest.mark.slow
def test_joints_of_a_rigid_rod_carry_nearly_the_same(run):
    mean = {name: force.mean() for name, force in forces(run).items()}
    assert mean["J2"] == pytest.approx(mean["J1"], rel=0.03)
    assert mean["J4"] == pytest.approx(mean["J3"], rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_the_lever_ratio_decides_who_carries_most(ratio):
    mean = {name: force.mean() for name, force in forces(simulated(lever_ratio=ratio)).items()}
    assert mean["J3"] / mean["J2"] == pytest.approx(1 / ratio, rel=0.03)
    # Nearer to the input within a rod: its inertia.
    assert mean["J1"] > mean["J2"] and mean["J3"] > mean["J4"]


@pytest.mark.slow
def test_an_impact_shows_in_all_joints_of_a_chain_in_contact(run):
    """The first impact of J4 finds the other three in contact; all jump within 0.1 ms."""
    strike = run.modes("J4").query("mode == 'impact'")["from [s]"].iloc[0]
    time = np.asarray(run.time)
    before, after = ((time > strike + a) & (time < strike + b) for a, b in ((-2e-4, 0), (0, 1e-4)))
    found = forces(run)
    for name in JOINTS:
        assert found[name][after].max() > 20 * max(found[name][before].max(), 10.0)


def test_clearance_takes_up_the_play_joint_by_joint(run):
    """From the actuator to the shaft, within the paper's first 6 to 20 ms."""
    first = [run.modes(name)["to [s]"].iloc[0] for name in JOINTS]
    assert first[0] > 6e-3 and first == sorted(first) and first[-1] < 20e-3


test_bad_input_is_refused_by_name = refusals(
    {
        'no joint "J5" in kind of flap': lambda: flap(("J5",)),
        "lever_ratio of flap": lambda: flap(lever_ratio=0.0),
    }
)


@pytest.mark.slow
def test_where_all_joints_stay_in_contact_the_shaft_is_that_of_ideal_joints(run):
    """From the paper's first impacts to the turn of the stroke; a figure of the flap's study."""
    ideal = jc.simulate(flap("ideal"), DURATION, save=SAVES)
    (found,) = lasting_contact(run, ideal).itertuples(index=False)
    begins, ends, speed, acceleration = found
    assert 0.012 < begins < 0.02 and ends > 0.06
    assert speed < 5e-3 and acceleration < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("ideal", [("J1",), ("J4",), JOINTS])
def test_a_joint_in_lasting_contact_moves_the_shaft_as_an_ideal_one(run, ideal):
    """In a window in which all joints of the run have been in contact for a while (before, one
    clearance less is taken up, and impacts come at other times)."""
    begins, ends = 30e-3, 60e-3
    for name in JOINTS:
        lasting = run.modes(name).query("mode == 'contact'")
        assert ((lasting["from [s]"] < begins) & (lasting["to [s]"] > ends)).any()
    other = simulated(kind=tuple(name for name in JOINTS if name not in ideal))
    time = np.asarray(run.time)
    window = (time > begins) & (time < ends)
    speed, wanted = (np.asarray(r.body("shaft").spin)[:, 2] for r in (run, other))
    np.testing.assert_allclose(speed[window], wanted[window], atol=5e-3 * np.abs(wanted).max())
    away = np.gradient(speed - wanted, time)[window]
    largest = np.abs(np.gradient(wanted, time)[window]).max()
    # Both still ring from their impacts, which came at different times.
    assert np.sqrt(np.mean(away**2)) < 0.08 * largest


@pytest.mark.slow
def test_implicit_steps_get_through_dampers_stiffer_than_the_springs(run):
    """With two iterations on the laws forces of a million times the true ones were left over."""
    for step, off, way in ((2e-5, 1e-3, 1e-2), (1e-4, 0.05, None)):
        integrator = jc.integrator.ImplicitStep(step)
        other = jc.simulate(flap(), DURATION, save=SAVES // 10, integrator=integrator)
        for name in JOINTS:
            force = jc.response.MeanContactForce(name)
            np.testing.assert_allclose(force(other), force(run), rtol=off)
        if way is not None:
            times = np.asarray(other.time)
            speed = np.interp(times, run.time, np.asarray(run.body("shaft").spin)[:, 2])
            found = np.asarray(other.body("shaft").spin)[:, 2]
            np.testing.assert_allclose(found, speed, atol=way * np.abs(speed).max())
