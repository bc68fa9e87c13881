"""Singular positions that a run meets: found with time and joint, whatever the saving times, and
none where there are none."""

import dataclasses

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.simulation.singular_positions import singular_positions
from tests.rigs.four_bars import HINGE, four_bar, link
from tests.simulation.test_dead_points import cranks_through, full_stroke

DEAD = [0.125, 0.375, 0.625, 0.875]


def parallelogram(speed=10.0):
    """Driven at its crank: flat twice a turn, where it could go on crossed."""
    links = {"crank": 0.1, "coupler": 0.3, "rocker": 0.1}
    drive, guess = jc.drive.ConstantSpeed(speed, 0.5), {"A": -0.5, "D": 0.5}
    return four_bar(links, 0.3, link, drive=drive, guess=guess)


def quickly(rig, save, integrator=None):
    return jc.simulate(rig, 1.0, save=save, integrator=integrator, verify=False)


@pytest.fixture(scope="module")
def passing():
    return quickly(full_stroke(), 101)


@pytest.mark.parametrize("save", [3, 11, 101, 401])
def test_all_dead_centres_are_found_whatever_the_saving_times(save):
    """401 of them meet the dead centres exactly, 3 none within half a second."""
    found = quickly(full_stroke(), save).singular_positions
    np.testing.assert_allclose([one.time for one in found], DEAD, atol=1e-4)
    assert {(one.joint, one.free, one.drives) for one in found} == {("B", "O", ("G",))}
    # Of two within a saving interval nothing tells which way the first went.
    assert {one.is_reversed for one in found} == ({None} if save == 3 else {False})


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.FixedStep(1e-4),
        jc.integrator.ImplicitStep(1e-3),
        pytest.param(jc.integrator.NonColliding(1e-3), marks=pytest.mark.slow),
        pytest.param(jc.integrator.MoreauJean(1e-3), marks=pytest.mark.slow),
        pytest.param(jc.integrator.Adaptive(), marks=pytest.mark.slow),
    ],
    ids=lambda one: type(one).__name__,
)
def test_they_are_found_and_passed_on_every_integrator(integrator):
    """Beside the closed form of a crank that goes through."""
    run = quickly(full_stroke(), 101, integrator)
    assert [round(one.time, 3) for one in run.singular_positions] == DEAD
    assert all(one.is_passed for one in run.singular_positions)
    angle = np.asarray(run.coordinate("O"))
    np.testing.assert_allclose(angle, cranks_through(np.asarray(run.time)), atol=2e-3)


def test_a_passage_is_a_remark(passing):
    assert passing.warnings == () and passing.result == "The run reached its end."
    said = str(passing)
    assert 'drive "G" does not say which way joint "O" goes on there' in said
    assert "It went on as its inertia has it. So it did 3 more times." in said


def test_a_crank_that_is_turned_round_is_a_warning(passing):
    """The mirror of the motion behind the first dead centre meets the same drive."""
    history, layout = passing.history, passing.history.layout()
    behind = np.asarray(passing.time) > 0.125
    states, both = np.array(passing.states), layout.memory_start
    states[behind, :both] *= -1
    turned = dataclasses.replace(
        passing, history=dataclasses.replace(history, states=states), singular_positions=()
    )
    first = singular_positions(turned)[0]
    assert first.is_reversed and first.speeds[0] == pytest.approx(-first.speeds[1], rel=0.01)
    told = dataclasses.replace(turned, singular_positions=(first,))
    (warning,) = told.warnings
    assert warning.startswith('At 0.125 s the loop through joint "B" is at a singular position')
    assert "The run turned it round, its speed from -10.6 to 10.6; nothing pushed it." in warning


@pytest.mark.parametrize("save", [3, 101])
@pytest.mark.parametrize("amplitude", [0.045, 0.04999])
def test_none_is_found_within_the_stroke(amplitude, save):
    assert quickly(full_stroke(amplitude), save).singular_positions == ()


def test_none_is_found_where_there_is_none(monkeypatch):
    """Rod and crank are in line twice a turn, where the piston stands; loops are regular. Loops
    that no drive holds are not looked at."""
    rig = jc.scenes.slider_crank("ideal", crank_speed=20.0)
    assert quickly(rig, 26).singular_positions == ()

    def never(*_):
        raise AssertionError

    monkeypatch.setattr("jaxclear.simulation.singular_positions._along", never)
    joints = rig.connections | {"O": jc.Connection(HINGE, "ground", "crank")}
    free = jc.Mechanism(rig.bodies, joints, rig.loads, start={"O": 0.8}, guess={"G": 0.15})
    assert quickly(free, 11).singular_positions == ()


@pytest.mark.parametrize("save", [11, 101])
def test_a_parallelogram_passes_its_change_points(save):
    run = quickly(parallelogram(), save, jc.integrator.ImplicitStep(1e-3))
    flat = (np.pi * np.arange(1, 4) - 0.5) / 10.0
    found = run.singular_positions
    np.testing.assert_allclose([one.time for one in found], flat, atol=1e-6)
    assert all(one.is_passed and one.drives == ("O",) for one in found)
    # It stays a parallelogram.
    rocker = np.asarray(run.coordinate("D"))
    np.testing.assert_allclose(rocker, 0.5 + 10.0 * np.asarray(run.time), atol=1e-9)
