"""What a drive gives, which power decides also where overconstrained loops leave reactions open."""

import warnings

import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.overconstrained import COUPLER, CRANK, GRAVITY, LENGTH, parallel_cranks
from tests.rigs.spatial_loops import BRAKE, SPEED, double_cardan

ANGLE = 0.6


def test_the_drive_of_parallel_cranks_gives_what_lifts_them():
    """g G cos(theta) at a constant speed, of three cranks whose reactions are not unique."""
    drive = jc.drive.ConstantSpeed(2.0, start=ANGLE)
    near = {"foot 1": ANGLE, "foot 2": ANGLE, "top 0": -ANGLE}
    rig = parallel_cranks(3, crank=jc.joint.Revolute(drive=drive), guess=near)
    run = jc.simulate(rig, 1.0, save=21)
    moment = 3 * CRANK * LENGTH / 2 + COUPLER * LENGTH
    wanted = GRAVITY * moment * np.cos(ANGLE + 2.0 * np.asarray(run.time))
    np.testing.assert_allclose(run.transmitted("foot 0"), wanted, rtol=1e-6, atol=1e-7)
    with pytest.warns(
        UserWarning, match=r'not unique.*drive gives is: run.transmitted\("foot 0"\)'
    ):
        run.reaction("foot 0")
    with pytest.warns(UserWarning, match="would tell which.$"):
        run.reaction("foot 1")


@pytest.mark.slow
def test_the_input_of_double_cardan_shafts_is_the_brakes_torque():
    """By power, whatever the branches share: the output turns as the input does, and what lies
    between gives back within a turn what it takes."""
    run = jc.simulate(double_cardan(), 2 * np.pi / SPEED, save=33)
    np.testing.assert_allclose(np.asarray(run.speed("outlet")), SPEED, rtol=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        torque = np.asarray(run.transmitted("inlet"))
    np.testing.assert_allclose(torque[:-1].mean(), BRAKE, rtol=1e-8)
    with pytest.warns(UserWarning, match=r'not unique.*drive gives is: run.transmitted\("inlet"\)'):
        reaction = run.reaction("inlet")
    np.testing.assert_allclose(torque, reaction.torque[:, 2], rtol=1e-9)


@pytest.mark.parametrize("ends", [("ground", "arm"), ("arm", "ground")])
def test_a_driven_arm_is_held_by_its_drive_whichever_way_it_is_written(ends):
    """m g l cos(theta) + J theta''; the angle is the child's against the parent."""
    side = 1 if ends[1] == "arm" else -1
    lift = jc.drive.Harmonic(amplitude=0.5, frequency=1.0)
    rig = jc.Mechanism(
        {"arm": jc.Body(2.0, 1e-2, (0.3, 0.0))},
        {"hinge": jc.Connection(jc.joint.Revolute(drive=lift), *ends)},
        {"g": jc.load.Gravity((0.0, -9.81))},
    )
    run = jc.simulate(rig, 1.0, save=21)
    swing = np.sin(2 * np.pi * np.asarray(run.time))
    turning = -(1e-2 + 2.0 * 0.3**2) * 0.5 * (2 * np.pi) ** 2 * swing
    wanted = turning + side * 2.0 * 9.81 * 0.3 * np.cos(0.5 * swing)
    np.testing.assert_allclose(run.transmitted("hinge"), wanted, rtol=1e-11, atol=1e-11)


def test_a_driven_slide_gives_its_force():
    """m (a + g) along a slide that is driven to and fro."""
    lift = jc.drive.Harmonic(amplitude=0.1, frequency=1.0)
    rig = jc.Mechanism(
        {"car": jc.Body(2.0, 1e-2)},
        {"slide": jc.Connection(jc.joint.Prismatic(drive=lift), "ground", "car", axis="y")},
        {"g": jc.load.Gravity((0.0, -9.81))},
    )
    run = jc.simulate(rig, 1.0, save=21)
    wanted = 2.0 * (9.81 - 0.1 * (2 * np.pi) ** 2 * np.sin(2 * np.pi * np.asarray(run.time)))
    np.testing.assert_allclose(run.transmitted("slide"), wanted, rtol=1e-12)
    with pytest.raises(ValueError, match='no coupling, driven joint .*"none".*"slide"'):
        run.transmitted("none")
