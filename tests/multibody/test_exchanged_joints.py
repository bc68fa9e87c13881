"""`mechanism.with_joint`: an ideal joint becomes one with clearance, and the rest stays."""

import equinox as eqx
import numpy as np
import pytest

import jaxclear as jc

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


@pytest.mark.parametrize(
    ("name", "joint", "sentence"),
    [
        ("elbw", PLANAR, 'no joint "elbw" in this mechanism.*Did you mean "elbow"'),
        ("elbow", PLANAR.contact, 'what is put in place of "elbow" is a ContactForce'),
        ("elbow", jc.joint.Prismatic, "it must be one of jaxclear.joint"),
        (
            "elbow",
            jc.clearance.SliderGuide(STEEL),
            '"elbow" is a Revolute; a SliderGuide, which without its play is a Prismatic',
        ),
    ],
)
def test_what_does_not_fit_is_refused(name, joint, sentence):
    with pytest.raises(ValueError, match=sentence):
        arm().with_joint(name, joint)


def test_a_slide_takes_no_journal():
    with pytest.raises(ValueError, match='"G" is a Prismatic; a PlanarJournalBearing'):
        jc.scenes.slider_crank().with_joint("G", PLANAR)


def test_a_driven_joint_gets_no_play():
    with pytest.raises(ValueError, match='"O" is driven, and a PlanarJournalBearing takes no dri'):
        jc.scenes.slider_crank().with_joint("O", PLANAR)


def test_a_bearing_of_the_plane_does_not_hold_a_body_in_space():
    with pytest.raises(ValueError, match='acts in a plane, and nothing else holds body "fore"'):
        arm(spatial=True).with_joint("elbow", PLANAR)
