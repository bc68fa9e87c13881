"""A clearance joint of a stranger, for forces and in permanent contact; and a floor, which leaves
no gap where its parts stand as drawn."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.extension.test_contact_law import Cushion


class FloorAndCeiling(jc.clearance.AbstractClearance):
    """A point between two planes y = -c and y = c."""

    ideal_rows: ClassVar = ("y",)
    contact: jc.contact.AbstractContactLaw
    friction: Any = None
    clearance: Scalar = quantity(1e-2, "m", "room on either side")

    @property
    def axes(self):
        return ()

    def contact_laws(self):
        shape = jc.stiffness.Shape(1e-2, 1.0, None)
        return (jc.clearance.ContactLaws(self.contact, self.friction, shape, False),) * 2

    def indentations(self, offset, axes, worn):
        return tuple(side * offset[1] - self.clearance for side in (-1, 1))

    def contact_candidates(self, offset, axes, indentations):
        return tuple(
            jc.clearance.ContactCandidate(
                (offset[0], side * self.clearance, 0), (0, side, 0), ((1, 0, 0),)
            )
            for side in (-1, 1)
        )

    def permanent_form(self):
        return Skid(self)


class AlongX(jc.joint.AbstractVectorJoint):
    """Slides along x: q displacement [m]."""

    home: ClassVar = (0.0,)
    units: ClassVar = ("m",)
    rows: ClassVar = ("y", "z", "x.y", "x.z", "y.z")
    reversal: ClassVar = ((-1, 0, 0), (0, -1, 0), (0, 0, 1))

    def motion(self, q):
        return jc.pose.Pose(jc.pose.REST.rotation, (q[0], 0, 0))

    def columns(self, q):
        return (jc.pose.Twist((1, 0, 0), (0, 0, 0)),)

    def bias(self, q, v):
        return None

    def coordinates_at(self, pose):
        return (pose.translation[0],)

    def speeds_at(self, pose, velocity, spin):
        return (velocity[0],)


class Skid(jc.clearance.AbstractPermanentJoint):
    """The point between the planes while it always touches one of them, on a body that keeps its
    orientation."""

    home: ClassVar = AlongX.home
    units: ClassVar = AlongX.units
    rows: ClassVar = AlongX.rows
    reversal: ClassVar = AlongX.reversal
    gap: FloorAndCeiling

    @property
    def ideal(self):
        return AlongX()

    @property
    def friction(self):
        return self.gap.friction

    @property
    def arm(self):
        return 1

    def friction_wrench(self, friction):
        return (friction, 0, 0), (0, 0, 0)

    def carrying_ends(self, force, torque, ratio):
        contacts = []
        for index, side in enumerate((-1, 1)):
            normal = jc.numerics.positive_part(-side * force[1])
            place = (0, side * self.gap.clearance, 0)
            contact = jc.clearance.CarriedContact(index, normal, ratio * normal, place)
            contacts.append(contact)
        offset = (0, -jnp.sign(force[1]) * self.gap.clearance, 0)
        return (jc.clearance.CarryingEnd(0, (0, force[1], 0), offset, tuple(contacts)),)

    def friction_ratio(self, mu):
        return mu


def dropped(friction=None, mass=2.0, **start):
    joint = FloorAndCeiling(jc.contact.ContactForce(Cushion(stiffness=1e7)), friction)
    gap = {"gap": jc.Connection(joint, "ground", "ball")}
    return jc.Mechanism({"ball": jc.Body(mass, 1e-3)}, gap, {"g": jc.load.Gravity()}, **start)


def test_clearance_joint_from_outside_bounces_as_a_parabola():
    fall = np.sqrt(2 * 1e-2 / 9.81)
    end = jc.simulate(dropped(mass=1.0), 2 * fall, save=201)
    assert float(end.contact("gap").normal_force.max()) > 0
    # an elastic bounce delays the top of the parabola by T < pi sqrt(m/K) = 1e-3 s, which is g T^2
    # / 2 below it
    np.testing.assert_allclose(end.body("ball").com[-1, 1], 0.0, atol=1e-5)
    np.testing.assert_allclose(
        end.time[np.argmin(end.body("ball").com[:, 1])], fall, atol=2 * fall / 200
    )


def test_clearance_joint_from_outside_slides_to_rest_in_permanent_contact():
    mu, speed = 0.2, 1.0
    rub, slides = jc.friction.Coulomb(mu_kinetic=mu), {"speeds": {"ball": (speed, 0, 0)}}
    sled = dropped(rub, 1.0, **slides)
    run = jc.simulate(sled, 1.0, save=11, integrator=jc.integrator.NonColliding(1e-2))
    left = np.maximum(speed - mu * 9.81 * np.asarray(run.time), 0.0)
    # constant deceleration is exact for the step; where it stops is known to a step
    slid = (speed**2 - left**2) / (2 * mu * 9.81)
    np.testing.assert_allclose(run.body("ball").com[:, 0], slid, atol=mu * 9.81 * 1e-4)
    contact = run.contact("gap")
    np.testing.assert_allclose(contact.normal_force[1:, 0], 9.81, rtol=1e-9)
    np.testing.assert_allclose(contact.normal_force[:, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(contact.traction[1:6, 0], mu * 9.81, rtol=1e-6)


class Floor(jc.clearance.AbstractClearance):
    """A point above the plane y = 0."""

    ideal_rows: ClassVar = ("y",)
    contact: jc.contact.AbstractContactLaw

    @property
    def axes(self):
        return ()

    def contact_laws(self):
        shape = jc.stiffness.Shape(1e-2, 1.0, None)
        return (jc.clearance.ContactLaws(self.contact, None, shape, False),)

    def indentations(self, offset, axes, worn):
        return (-offset[1],)

    def contact_candidates(self, offset, axes, indentations):
        return (jc.clearance.ContactCandidate((offset[0], 0, 0), (0, -1, 0), ((1, 0, 0),)),)


HEIGHT, RESTITUTION = 0.05, 0.6


def above_the_floor(mass=1.0, height=HEIGHT):
    law = jc.contact.CarvalhoMartins(stiffness=1e9, restitution=RESTITUTION)
    return jc.Mechanism(
        {"ball": jc.Body(mass, 1e-3)},
        {"floor": jc.Connection(Floor(law), "ground", "ball")},
        {"g": jc.load.Gravity((0.0, -9.81))},
        start={"ball": (0.0, height, 0.0)},
    )


def test_a_floor_is_met_under_error_control_and_its_rebound_is_the_laws():
    """Where no gap is there to judge errors by: speed e v less g times what is left, for which
    Hertz's contact, of 0.8 ms, leaves less time."""
    fall = np.sqrt(2 * HEIGHT / 9.81)
    run = jc.simulate(above_the_floor(), 1.3 * fall, save=14, verify=True)
    wanted = 9.81 * (RESTITUTION * fall - 0.3 * fall)
    np.testing.assert_allclose(run.body("ball").velocity[-1, 1], wanted, atol=9.81e-3)
    rows = str(run)
    assert "Not verified" not in rows and "places in the gap" not in rows


def test_a_derivative_passes_through_a_bounce_off_a_floor():
    def ends(height):
        run = jc.simulate(above_the_floor(height=height), 0.13, save=2, throw=False)
        return run.body("ball").com[-1, 1]

    step = 1e-4
    differences = (ends(HEIGHT + step) - ends(HEIGHT - step)) / (2 * step)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(ends))(HEIGHT), differences, rtol=1e-3)
