"""Ideal joints whose coordinates are angles and displacements: turning, sliding, welded."""

from typing import ClassVar

import jax.numpy as jnp

from jaxclear.components.drive import AbstractDrive
from jaxclear.components.joint.base import (
    ANGULAR,
    LINEAR,
    AbstractDrivenJoint,
    AbstractVectorJoint,
    angle,
    turn_rate,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import FLIP, REST, Pose, Twist, rotation_x, rotation_y, rotation_z

# A universal joint that starts at the child turns about the child's y axis first, then about the
# parent's x axis.
EXCHANGE: sp.Mat = ((0, -1, 0), (1, 0, 0), (0, 0, 1))


class Revolute(AbstractDrivenJoint):
    """Turns about z; its coordinate is the angle [rad].

    Args:
        drive: prescribed motion of the coordinate, one of `jaxclear.drive`; none by default.
    """

    home: ClassVar = (0.0,)
    units: ClassVar = ("rad",)
    rows: ClassVar = ("x", "y", "z", "x.z", "y.z")
    reversal: ClassVar = FLIP
    drive: AbstractDrive | None = None

    def motion(self, q):
        return Pose(rotation_z(q[0]), sp.ZERO)

    def columns(self, q):
        return (ANGULAR[2],)

    def bias(self, q, v):
        return None

    def coordinates_at(self, pose):
        return (angle(pose.rotation[1][0], pose.rotation[0][0]),)

    def speeds_at(self, pose, velocity, spin):
        return (turn_rate(pose, spin),)


class Prismatic(AbstractDrivenJoint):
    """Slides along z; its coordinate is the displacement [m].

    Args:
        drive: prescribed motion of the coordinate, one of `jaxclear.drive`; none by default.
    """

    home: ClassVar = (0.0,)
    units: ClassVar = ("m",)
    rows: ClassVar = ("x", "y", "x.z", "y.z", "x.y")
    reversal: ClassVar = FLIP
    drive: AbstractDrive | None = None

    def motion(self, q):
        return Pose(sp.IDENTITY, (0, 0, q[0]))

    def columns(self, q):
        return (LINEAR[2],)

    def bias(self, q, v):
        return None

    def coordinates_at(self, pose):
        return (pose.translation[2],)

    def speeds_at(self, pose, velocity, spin):
        return (velocity[2],)


class Cylindrical(AbstractVectorJoint):
    """Slides along z and turns about it; its coordinates are displacement [m] and angle [rad]."""

    home: ClassVar = (0.0, 0.0)
    units: ClassVar = ("m", "rad")
    rows: ClassVar = ("x", "y", "x.z", "y.z")
    reversal: ClassVar = FLIP

    def motion(self, q):
        return Pose(rotation_z(q[1]), (0, 0, q[0]))

    def columns(self, q):
        return (LINEAR[2], ANGULAR[2])

    def bias(self, q, v):
        return None

    def coordinates_at(self, pose):
        return (pose.translation[2], angle(pose.rotation[1][0], pose.rotation[0][0]))

    def speeds_at(self, pose, velocity, spin):
        return (velocity[2], turn_rate(pose, spin))


class Universal(AbstractVectorJoint):
    """Turns about the parent's x axis, then about the child's y axis; its coordinates are two
    angles [rad].
    """

    home: ClassVar = (0.0, 0.0)
    units: ClassVar = ("rad", "rad")
    rows: ClassVar = ("x", "y", "z", "x.y")
    reversal: ClassVar = EXCHANGE

    def motion(self, q):
        return Pose(sp.product(rotation_x(q[0]), rotation_y(q[1])), sp.ZERO)

    def columns(self, q):
        return (Twist(sp.ZERO, (jnp.cos(q[1]), 0, jnp.sin(q[1]))), ANGULAR[1])

    def bias(self, q, v):
        spin = v[0] * v[1]
        return Twist(sp.ZERO, (-jnp.sin(q[1]) * spin, 0, jnp.cos(q[1]) * spin))

    def coordinates_at(self, pose):
        first, _, last = pose.rotation
        return (angle(last[1], pose.rotation[1][1]), angle(first[2], first[0]))

    def speeds_at(self, pose, velocity, spin):
        # The second axis is the child's y, which lies across the parent's x.
        return (spin[0], sp.dot(sp.transpose(pose.rotation)[1], spin))


class Fixed(AbstractVectorJoint):
    """Welds the child to the parent."""

    home: ClassVar = ()
    units: ClassVar = ()
    rows: ClassVar = ("x", "y", "z", "x.z", "y.z", "x.y")
    reversal: ClassVar = FLIP

    def motion(self, q):
        return REST

    def columns(self, q):
        return ()

    def bias(self, q, v):
        return None

    def coordinates_at(self, pose):
        return ()

    def speeds_at(self, pose, velocity, spin):
        return ()
