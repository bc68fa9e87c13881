"""`mechanism.with_joint`: an ideal joint becomes one with clearance, and the rest stays.

Coordinates and speeds of a connection are its child's, seen from its parent, whichever way the
tree goes through it: against the pose and the twist that they say, by hand."""

import equinox as eqx
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxclear as jc
from tests.rigs.cells import slow

STEEL = jc.contact.LankaraniNikravesh(stiffness=1e9, restitution=0.9)
PLANAR = jc.clearance.PlanarJournalBearing(STEEL, clearance=1e-4)
SPATIAL = jc.clearance.JournalBearing(STEEL, clearance=1e-4, flange=jc.clearance.Flange(STEEL))


def arm(spatial=False, **start):
    """Two links on hinges about z, 1 m each."""
    inertia = (0.01, 0.1, 0.1) if spatial else 0.1
    link = jc.Body(1.0, inertia, (0.5, 0.0, 0.0) if spatial else (0.5, 0.0))
    return jc.Mechanism(
        {"upper": link, "fore": link},
        {
            "shoulder": jc.Connection(jc.joint.Revolute(), "ground", "upper"),
            "elbow": jc.Connection(jc.joint.Revolute(), "upper", "fore", at=(1.0, 0.0)),
        },
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        **start,
    )


def test_name_markers_and_everything_else_stay():
    before = jc.scenes.slider_crank("ideal")
    after = before.with_joint("B", jc.scenes.slider_crank().connections["B"].joint)
    expected = jc.scenes.slider_crank()
    assert eqx.tree_equal(after, expected)


SPACE = pytest.param(True, SPATIAL, marks=pytest.mark.slow)


@pytest.mark.parametrize(("spatial", "bearing"), [(False, PLANAR), SPACE])
def test_the_arm_starts_as_it_stood(spatial, bearing):
    """The free forearm is assembled where the hinge held it, at angle 0 to the upper arm, and moves
    along with it: its origin goes in a circle, speeds in its own axes."""
    given = {"start": {"shoulder": 0.7}, "speeds": {"shoulder": 3.0}}
    after = arm(spatial, **given).with_joint("elbow", bearing)
    start = jc.assemble(after)
    own = {branch.body: branch for branch in after.topology.branches}["fore"]
    place, moves = start.coordinates[own.coordinates], start.speeds[own.speeds]
    flat = (np.cos(0.7), np.sin(0.7))
    turned = (0.0, np.cos(0.35), 0.0, 0.0, np.sin(0.35)) if spatial else (0.7,)
    np.testing.assert_allclose(place, (*flat, *turned), atol=1e-9)
    wanted = (0.0, 3.0, 0.0, 0.0, 0.0, 3.0) if spatial else (0.0, 3.0, 3.0)
    np.testing.assert_allclose(moves, wanted, atol=1e-9)


def test_a_start_of_the_joint_is_kept():
    after = arm(start={"shoulder": 0.7, "elbow": 0.3}).with_joint("elbow", PLANAR)
    assert float(after.start["elbow"][0]) == 0.3
    assert "elbow" not in after.guess


def test_a_drive_goes_over_to_a_joint_that_takes_one():
    before = jc.scenes.slider_crank()
    after = before.with_joint("O", jc.joint.PlainBearing(jc.friction.Coulomb(mu_kinetic=0.1)))
    assert after.driven == ("O",)
    assert float(after.connections["O"].joint.drive.speed) == 50.0


TURN = Rotation.from_rotvec([0.3, -0.5, 0.8])
QUATERNION = tuple(TURN.as_quat(scalar_first=True))
PLACE = np.array([0.2, -0.1, 0.4])
# Joint, start, speeds, and what these say: rotation, place, velocity and spin of the child's marker
# in the parent's, velocity and spin in the child's axes.
FLAT = Rotation.from_rotvec([0.0, 0.0, 0.7])
CASES = {
    "Spherical": (
        (jc.joint.Spherical(), QUATERNION, (1.0, 2.0, 3.0)),
        (TURN, np.zeros(3), np.zeros(3), np.array([1.0, 2.0, 3.0])),
    ),
    "Planar": (
        (jc.joint.Planar(), (0.2, -0.1, 0.7), (0.5, 0.3, 2.0)),
        (FLAT, np.array([0.2, -0.1, 0.0]), np.array([0.5, 0.3, 0.0]), np.array([0.0, 0.0, 2.0])),
    ),
    "Free": (
        (jc.joint.Free(), (*PLACE, *QUATERNION), (0.5, 0.3, -0.2, 1.0, 2.0, 3.0)),
        (TURN, PLACE, np.array([0.5, 0.3, -0.2]), np.array([1.0, 2.0, 3.0])),
    ),
}


@pytest.mark.parametrize("kind", ["Spherical", *slow("Planar", "Free")])
def test_a_joint_whose_child_is_the_ground_begins_as_its_child_is_told(kind):
    (joint, start, speeds), (turn, place, velocity, spin) = CASES[kind]
    rig = jc.Mechanism(
        {"top": jc.Body(1.0, (0.01, 0.02, 0.03))},
        {"S": jc.Connection(joint, "top", "ground")},
        start={"S": start},
        speeds={"S": speeds},
    )
    run = jc.simulate(rig, 0.2, save=3, integrator=jc.integrator.FixedStep(1e-2))
    body = run.body("top")
    # The ground as seen from the body is told; the body as seen from the ground is its inverse.
    back = turn.inv()
    np.testing.assert_allclose(body.rotation[0], back.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(body.com[0], -back.apply(place), atol=1e-12)
    turning = -spin
    moving = -velocity + np.cross(turning, body.com[0])
    np.testing.assert_allclose(body.spin[0], turning, atol=1e-12)
    np.testing.assert_allclose(body.velocity[0], moving, atol=1e-12)
    # What is told of the connection is what was given for it, and its rate.
    np.testing.assert_allclose(run.coordinate("S")[0], start, atol=1e-12)
    np.testing.assert_allclose(run.speed("S")[0], speeds, atol=1e-12)
    if kind == "Spherical":
        seen = Rotation.from_quat(np.asarray(run.coordinate("S")), scalar_first=True)
        np.testing.assert_allclose(seen.inv().as_matrix(), body.rotation, atol=1e-9)


def test_a_joint_of_one_coordinate_is_the_same_either_way():
    """Its markers are turned instead."""
    rig = jc.Mechanism(
        {"top": jc.Body(1.0, 0.02)},
        {"R": jc.Connection(jc.joint.Revolute(), "top", "ground")},
        start={"R": 0.4},
        speeds={"R": 2.0},
    )
    run = jc.simulate(rig, 1e-3, save=2)
    np.testing.assert_allclose(run.body("top").spin[0], [0.0, 0.0, -2.0], atol=1e-12)
    np.testing.assert_allclose((run.coordinate("R")[0], run.speed("R")[0]), (0.4, 2.0))
