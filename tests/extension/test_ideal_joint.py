"""An ideal joint of a stranger."""

from typing import ClassVar

import numpy as np
import pytest

import jaxclear as jc
from jaxclear import Scalar, quantity


class Screw(jc.joint.AbstractVectorJoint):
    """Turns about z and advances by `pitch` per radian: q angle [rad]."""

    home: ClassVar = (0.0,)
    units: ClassVar = ("rad",)
    reversal: ClassVar = jc.pose.FLIP
    pitch: Scalar = quantity(unit="m/rad", meaning="advance per radian")

    def motion(self, q):
        return jc.pose.Pose(jc.pose.rotation_z(q[0]), (0, 0, self.pitch * q[0]))

    def columns(self, q):
        return (jc.pose.Twist((0, 0, self.pitch), (0, 0, 1)),)

    def bias(self, q, v):
        return None

    def coordinates_at(self, pose):
        return (pose.translation[2] / self.pitch,)

    def speeds_at(self, pose, velocity, spin):
        return (spin[2],)


@pytest.mark.parametrize("turned_round", [False, True], ids=["from parent", "from child"])
def test_screw_from_outside_falls_as_its_formula(turned_round):
    pitch, mass, inertia = 0.01, 2.0, 3e-4
    ends = ("nut", "ground") if turned_round else ("ground", "nut")
    rig = jc.Mechanism(
        {"nut": jc.Body(mass, (2e-4, 2e-4, inertia))},
        {"thread": jc.Connection(Screw(pitch), *ends)},
        {"g": jc.load.Gravity((0.0, 0.0, -9.81))},
    )
    end = jc.simulate(rig, 0.5, save=6)
    acceleration = -mass * 9.81 * pitch / (inertia + mass * pitch**2)
    height = pitch * 0.5 * acceleration * np.asarray(end.time) ** 2
    # a parabola is exact for the integrator: rounding
    np.testing.assert_allclose(end.body("nut").com[:, 2], height, rtol=1e-9, atol=1e-12)
