"""A clearance joint's wrench does exactly the work that its indentations tell, for every joint,
worn or not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.clearance import AbstractClearance, ContactLaws
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Pose
from jaxclear.laws.stiffness import fitted
from jaxclear.multibody.contact_point import PointState, evaluate
from jaxclear.multibody.loops import Relative
from tests.components.test_ideal_joints import members
from tests.rigs.cells import slow

LAW = jc.contact.CarvalhoMartins(stiffness=1e9, restitution=0.7)
SLIP = jc.friction.CoulombTanh(mu_kinetic=0.2, transition_speed=1e-3)
WEAR = jc.Wearing(jc.wear.Archard(), cells=(9, 3))


def joints(friction):
    collar = jc.clearance.Flange(LAW, friction, clearance=1e-5)
    return {
        "PlanarJournalBearing": jc.clearance.PlanarJournalBearing(LAW, friction, bearing_wear=WEAR),
        "JournalBearing": jc.clearance.JournalBearing(
            LAW, friction, flange=collar, bearing_wear=WEAR, journal_wear=WEAR
        ),
        "BallSocket": jc.clearance.BallSocket(LAW, friction, socket_wear=WEAR),
        "SliderGuide": jc.clearance.SliderGuide(LAW, friction, clearance=1e-6),
    }


def rotation_of(vector):
    angle = jnp.sqrt(vector @ vector + 1e-300)
    k = (
        jnp.array(
            [[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]]
        )
        / angle
    )
    return jnp.eye(3) + jnp.sin(angle) * k + (1 - jnp.cos(angle)) * k @ k


def situation(name, rng):
    """Place, orientation, velocity and spin of a journal pressed into its bearing, tilted where it
    may."""
    flat = name == "PlanarJournalBearing"
    direction = rng.uniform(0, 2 * np.pi)
    offset = 1.3e-4 * np.array(
        [np.cos(direction), np.sin(direction), 0.0 if flat else rng.normal()]
    )
    lean = np.zeros(3) if flat else np.append(rng.normal(size=2) * 8e-3, rng.normal())
    if name == "SliderGuide":
        lean[[0, 2]] = 0.0
    velocity, spin = rng.normal(size=3) * 0.1, rng.normal(size=3) * 5
    if flat:
        velocity[2], spin[:2] = 0.0, 0.0
    return offset, rotation_of(jnp.asarray(lean)), velocity, spin


def report_of(joint, place, rotation, velocity, spin):
    pose = Pose(tuple(tuple(row) for row in rotation), tuple(place))
    contact_laws = tuple(
        ContactLaws(fitted(p.contact, p.shape), p.friction, p.shape, p.wears)
        for p in joint.contact_laws()
    )
    memory = tuple(PointState(jnp.asarray(0.05), ()) for _ in contact_laws)
    rng = np.random.default_rng(5)
    worn = {
        s: wear_map.reading(jnp.asarray(rng.uniform(0, 2e-6, wear_map.cells)))
        for s, (wear_map, _) in joint.maps().items()
    }
    report = evaluate(
        joint, contact_laws, Relative(pose, tuple(velocity), tuple(spin)), memory, worn
    )
    points = [
        (p.indentation, p.rate, p.normal_force, p.slip_speed, p.traction) for p in report.points
    ]
    return (
        sp.stack(report.force),
        sp.stack(report.torque),
        jnp.array(points),
        report.contact_power,
        report.friction_loss,
    )


def test_every_clearance_joint_is_tested():
    assert set(joints(None)) == {kind.__name__ for kind in members(AbstractClearance)}


@pytest.mark.parametrize("friction", [*slow(None), SLIP], ids=["frictionless", "friction"])
@pytest.mark.parametrize("name", sorted(joints(None)))
def test_power_of_the_wrench_is_the_power_of_the_contacts(name, friction):
    joint = joints(friction)[name]
    evaluate_at = jax.jit(lambda *motion: report_of(joint, *motion))
    touched = 0
    for seed in range(12):
        offset, rotation, velocity, spin = situation(name, np.random.default_rng(seed))
        force, torque, points, contact_power, friction_loss = evaluate_at(
            offset, rotation, velocity, spin
        )
        power = force @ velocity + torque @ spin
        size = np.abs(force) @ np.abs(velocity) + np.abs(torque) @ np.abs(spin) + 1e-300
        # rounding of sums of forces whose moments nearly cancel
        np.testing.assert_allclose(power, -contact_power - friction_loss, atol=1e-10 * size)
        assert friction_loss >= 0 if friction else friction_loss == 0
        step = 1e-8

        def indentations(time):
            return evaluate_at(
                offset + time * velocity, rotation_of(time * spin) @ rotation, velocity, spin
            )[2][:, 0]

        change = (indentations(step) - indentations(-step)) / (2 * step)
        # central difference: rounding of 1e-2 m over the step, 1e-18 / 1e-8, and curvature
        np.testing.assert_allclose(points[:, 1], change, rtol=1e-5, atol=1e-8)
        np.testing.assert_allclose(
            contact_power,
            points[:, 2] @ change,
            atol=1e-5 * (points[:, 2] @ np.abs(change)) + 1e-12,
        )
        assert np.all((points[:, 2] > 0) <= (points[:, 0] > 0))
        if friction:
            assert np.all(points[:, 4] <= 0.2 * points[:, 2] * (1 + 1e-9))
        touched += np.sum(points[:, 2] > 0)
    assert touched >= 5
