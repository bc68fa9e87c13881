"""Ideal joints whose coordinates form a group: rotations as unit quaternions, positions with an
orientation. Speeds are in the child's axes.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import jaxlie

from jaxclear.components.joint.base import (
    ANGULAR,
    LINEAR,
    AbstractGroupJoint,
    angle,
    complete,
)
from jaxclear.ground import group
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Pose, quaternion_rate, rotation_from_quaternion, rotation_z
from jaxclear.ground.quantity import concrete

NO_TURN = (1.0, 0.0, 0.0, 0.0)


@jax.jit
def _turned_by(x: Any, y: Any, z: Any) -> tuple:
    """Quaternion of a rotation vector [rad]."""
    return tuple(jaxlie.SO3.exp(jnp.stack([x, y, z])).wxyz)


class Spherical(AbstractGroupJoint):
    """Turns freely about a point: q unit quaternion (w, x, y, z), v angular velocity [rad/s] in the
    child's axes.
    """

    home: ClassVar = NO_TURN
    units: ClassVar = ("1", "1", "1", "1")
    rows: ClassVar = ("x", "y", "z")
    reversal: ClassVar = sp.IDENTITY

    def motion(self, q):
        return Pose(rotation_from_quaternion(q), sp.ZERO)

    def columns(self, q):
        return ANGULAR

    def rate(self, q, v):
        return quaternion_rate(q, v)

    def bias(self, q, v):
        return None

    def moved(self, q, increment):
        return group.turned(q, increment)

    def retracted(self, q, increment):
        return _unit([a + b for a, b in zip(q, self.rate(q, increment), strict=True)])

    def bracket(self, a, b):
        return sp.cross(a, b)

    def coordinates_at(self, pose):
        return _quaternion(pose.rotation)

    def speeds_at(self, pose, velocity, spin):
        return sp.apply_transposed(pose.rotation, spin)

    def start(self, given):
        if len(given) in (1, 3):
            # A rotation vector [rad]; one number turns about z.
            return _turned_by(*[0.0] * (3 - len(given)), *given)
        return complete(self, _with_rotation(given))


class Planar(AbstractGroupJoint):
    """Moves in the x-y plane and turns about z: q (x [m], y [m], angle [rad]), v in the child's
    axes.
    """

    home: ClassVar = (0.0, 0.0, 0.0)
    units: ClassVar = ("m", "m", "rad")
    rows: ClassVar = ("z", "x.z", "y.z")
    reversal: ClassVar = sp.IDENTITY

    def motion(self, q):
        return Pose(rotation_z(q[2]), (q[0], q[1], 0))

    def columns(self, q):
        return (LINEAR[0], LINEAR[1], ANGULAR[2])

    def rate(self, q, v):
        cosine, sine = jnp.cos(q[2]), jnp.sin(q[2])
        return (cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1], v[2])

    def bias(self, q, v):
        return None

    def moved(self, q, increment):
        return group.slid(q, increment)

    def retracted(self, q, increment):
        return tuple(a + b for a, b in zip(q, self.rate(q, increment), strict=True))

    def bracket(self, a, b):
        return group.planar_bracket(a, b)

    def coordinates_at(self, pose):
        x, y, _ = pose.translation
        return (x, y, angle(pose.rotation[1][0], pose.rotation[0][0]))

    def speeds_at(self, pose, velocity, spin):
        x, y, _ = sp.apply_transposed(pose.rotation, velocity)
        return (x, y, spin[2])

    def start(self, given):
        return complete(self, given)


class Free(AbstractGroupJoint):
    """No constraint: q (x, y, z [m], quaternion w, x, y, z), v twist in the child's axes, linear
    then angular.
    """

    home: ClassVar = (0.0, 0.0, 0.0, *NO_TURN)
    units: ClassVar = ("m", "m", "m", "1", "1", "1", "1")
    rows: ClassVar = ()
    reversal: ClassVar = sp.IDENTITY

    def motion(self, q):
        return Pose(rotation_from_quaternion(q[3:]), tuple(q[:3]))

    def columns(self, q):
        return LINEAR + ANGULAR

    def rate(self, q, v):
        return (
            *sp.apply(rotation_from_quaternion(q[3:]), tuple(v[:3])),
            *quaternion_rate(q[3:], v[3:]),
        )

    def bias(self, q, v):
        return None

    def moved(self, q, increment):
        return group.displaced(q, increment)

    def retracted(self, q, increment):
        place = [a + b for a, b in zip(q, self.rate(q, increment), strict=True)]
        return (*place[:3], *_unit(place[3:]))

    def bracket(self, a, b):
        return group.twist_bracket(a, b)

    def coordinates_at(self, pose):
        return (*pose.translation, *_quaternion(pose.rotation))

    def speeds_at(self, pose, velocity, spin):
        return (
            *sp.apply_transposed(pose.rotation, velocity),
            *sp.apply_transposed(pose.rotation, spin),
        )

    def start(self, given):
        if len(given) == 3:
            return (*given, *NO_TURN)
        return complete(self, _with_rotation(given))

    def told(self, given):
        return (True,) * 3 + (len(given) != 3,) * 3


def _with_rotation(given: tuple) -> tuple:
    """Coordinates that end in a quaternion, which must not be zero."""
    if len(given) >= 4 and all(concrete(x) == 0 for x in given[-4:]):
        raise ValueError(f"ends in a quaternion (w, x, y, z) of zeros; no rotation is {NO_TURN}.")
    return given


def _unit(quaternion: list) -> tuple:
    length = jnp.sqrt(sum(x * x for x in quaternion))
    return tuple(x / length for x in quaternion)


def _quaternion(rotation: sp.Mat) -> tuple:
    matrix = jnp.stack([sp.stack(row) for row in rotation])
    return tuple(jaxlie.SO3.from_matrix(matrix).wxyz)
