"""Ideal joints and their reactions against histories computed with MSC Adams.

A body of 4 m hangs by one end in one joint; the cases of a joint differ by numbers only, so each
joint compiles once. Tolerance 1e-3 of each history's own scale: the reference's integrator, not its
print, is the limit."""

import json
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

import jaxclear as jc

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata/adams_joints.json").read_text())
TIMES = np.array(REFERENCE["time"])
# The reference's turns about x [degrees] and places of the joint.
TURN = {
    "revolute": {"case1": -90.0, "case2": -45.0},
    "spherical": {"case1": 0.0, "case2": -45.0},
    "prismatic": {"case1": 0.0, "case2": -45.0, "case3": -90.0},
    "cylindrical": {"case1": 0.0, "case2": -90.0, "case3": -45.0},
}
JOINTS = {name: getattr(jc.joint, name.capitalize()) for name in TURN}
CASES = [(name, case) for name in TURN for case in TURN[name]]


def held(joint, at, quaternion):
    body = jc.Body(mass=1.0, inertia=(0.04, 0.1, 0.1), com=(2.0, 0.0, 0.0))
    return jc.Mechanism(
        {"bar": body},
        {"joint": jc.Connection(joint, jc.Marker("ground", at, quaternion=quaternion), "bar")},
        {"gravity": jc.load.Gravity((0.0, 0.0, -9.80665))},
    )


def turned(degrees):
    half = np.deg2rad(degrees) / 2
    return (np.cos(half), np.sin(half), 0.0, 0.0)


def close(found, case, key, floor):
    """Largest error within the tolerance of the history's scale, at least `floor`."""
    scale = max(case[f"{key}_scale"], floor)
    error = np.abs(np.asarray(found)[1:] - np.array(case[key])).max() / scale
    assert error < REFERENCE["tolerance"], f"{key}: {error:.2e} of {scale:.3g}"


def on_ground(run, name, at):
    """Force and torque that the ground receives at its own marker."""
    reaction = run.reaction(name)
    arm = run.body("bar").origin - np.array(at)
    return -reaction.force, -(reaction.torque + np.cross(arm, reaction.force))


@pytest.mark.parametrize(("name", "case"), CASES)
def test_motion_and_reaction_of_an_ideal_joint_agree_with_adams(name, case):
    reference = REFERENCE["cases"][name][case]
    central = case == "case1" or (name, case) == ("cylindrical", "case2")
    at = (0.0, 0.0, 0.0) if central else (1.0, 2.0, 3.0)
    rig = held(JOINTS[name](), at, turned(TURN[name][case]))
    precise = jc.integrator.Adaptive(rtol=1e-10, atol=1e-12)
    run = jc.simulate(rig, TIMES[-1], save=TIMES, integrator=precise)
    motion = run.body("bar")
    close(motion.com, reference, "position", 1.0)
    close(motion.velocity, reference, "velocity", 1.0)
    close(motion.spin, reference, "spin", 1.0)
    force, torque = on_ground(run, "joint", at)
    close(force, reference, "force", 9.80665)
    close(torque, reference, "torque", 2 * 9.80665)


@pytest.mark.parametrize("case", ["case1", "case2"])
def test_drive_of_a_slide_pushes_as_in_adams(case):
    """The reaction along the slide is the actuator's force (given on the body), that across it the
    slide's own."""
    reference = REFERENCE["cases"]["actuator"][case]
    speed, degrees = {"case1": (1.0, 0.0), "case2": (0.5, 45.0)}[case]
    half = np.deg2rad(degrees) / 2
    slide = jc.joint.Prismatic(drive=jc.drive.ConstantSpeed(speed))
    turned = (np.cos(half), 0.0, np.sin(half), 0.0)
    rail = jc.Marker("ground", (0.0, 0.0, 0.0), quaternion=turned)
    rig = jc.Mechanism(
        {"bar": jc.Body(mass=1.0, inertia=(1.0, 1.0, 1.0))},
        {"slide": jc.Connection(slide, rail, "bar")},
        {"gravity": jc.load.Gravity((0.0, 0.0, -9.80665))},
    )
    run = jc.simulate(rig, TIMES[-1], save=TIMES)
    close(run.body("bar").com, reference, "position", 1.0)
    close(run.body("bar").velocity, reference, "velocity", 1.0)
    along = np.array([np.sin(2 * half), 0.0, np.cos(2 * half)])
    force = np.asarray(run.reaction("slide").force)
    push = np.outer(force @ along, along)
    close(push, reference, "actuator_force", 9.80665)
    close(push - force, reference, "force", 9.80665)
    close(on_ground(run, "slide", np.zeros(3))[1], reference, "torque", 9.80665)


def test_cases_of_a_joint_share_one_compiled_run():
    """The reference's cases are numbers: a second one must not trace again."""
    rigs = (held(jc.joint.Revolute(), (0.0, 0.0, z), turned(z)) for z in (0.0, 45.0))
    static = [eqx.filter(rig, eqx.is_array, inverse=True) for rig in rigs]
    assert eqx.tree_equal(*static)
