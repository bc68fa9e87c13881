"""Ideal joints as data: how the child's marker moves in the parent's, and which rows close a loop
through the joint.

A joint of a spanning tree contributes coordinates q and speeds v; a joint that closes a loop
contributes constraint rows. Twists are in the child's axes, linear then angular. Row "x" says that
the child's origin stays at x = 0 of the parent's marker, row "x.z" that the parent's x axis stays
perpendicular to the child's z axis.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.drive import AbstractDrive
from jaxclear.ground import group
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import (
    REST,
    Pose,
    Twist,
    quaternion_rate,
    rotation_from_quaternion,
    rotation_x,
    rotation_y,
    rotation_z,
)
from jaxclear.ground.quantity import AbstractQuantified

LINEAR = tuple(Twist(axis, sp.ZERO) for axis in sp.IDENTITY)
ANGULAR = tuple(Twist(sp.ZERO, axis) for axis in sp.IDENTITY)


class AbstractJoint(AbstractQuantified):
    """An ideal joint: `home` are its coordinates in the drawing, `columns` the twist of each speed,
    `rows` its rows.
    """

    home: eqx.AbstractClassVar[tuple[float, ...]]
    units: eqx.AbstractClassVar[tuple[str, ...]]
    rows: eqx.AbstractClassVar[tuple[str, ...]]
    reversible: eqx.AbstractClassVar[bool]

    @abstractmethod
    def motion(self, q: tuple) -> Pose:
        """Pose of the child's marker in the parent's."""

    @abstractmethod
    def columns(self, q: tuple) -> tuple[Twist, ...]:
        """Twist of the child relative to the parent, in the child's axes, for each unit speed."""

    @abstractmethod
    def rate(self, q: tuple, v: tuple) -> tuple:
        """dq/dt."""

    @abstractmethod
    def bias(self, q: tuple, v: tuple) -> Twist | None:
        """Derivative of the columns along the motion, times the speeds; `None` where the columns
        are constant.
        """


class AbstractDrivenJoint(AbstractJoint):
    """A joint with one coordinate, which a drive may prescribe."""

    drive: eqx.AbstractVar[AbstractDrive | None]


class AbstractGroupJoint(AbstractJoint):
    """A joint whose coordinates are no vector but a group: a quaternion, a position with a
    quaternion.

    Integrators on groups (`jaxclear.integrator.MuntheKaas`) move it by increments, the speeds held
    for a time; the coordinates of every other joint they add up.
    """

    @abstractmethod
    def moved(self, q: tuple, increment: tuple) -> tuple:
        """Coordinates after the speeds `increment` have been held for unit time: the group's
        exponential map, from q.
        """

    @abstractmethod
    def bracket(self, a: tuple, b: tuple) -> tuple:
        """Lie bracket of two increments: what a then b moves more than b then a, to second
        order."""


class Revolute(AbstractDrivenJoint):
    """Turns about z: q angle [rad]."""

    home: ClassVar = (0.0,)
    units: ClassVar = ("rad",)
    rows: ClassVar = ("x", "y", "z", "x.z", "y.z")
    reversible: ClassVar = True
    drive: AbstractDrive | None = None

    def motion(self, q):
        return Pose(rotation_z(q[0]), sp.ZERO)

    def columns(self, q):
        return (ANGULAR[2],)

    def rate(self, q, v):
        return v

    def bias(self, q, v):
        return None


class Prismatic(AbstractDrivenJoint):
    """Slides along z: q displacement [m]."""

    home: ClassVar = (0.0,)
    units: ClassVar = ("m",)
    rows: ClassVar = ("x", "y", "x.z", "y.z", "x.y")
    reversible: ClassVar = True
    drive: AbstractDrive | None = None

    def motion(self, q):
        return Pose(sp.IDENTITY, (0, 0, q[0]))

    def columns(self, q):
        return (LINEAR[2],)

    def rate(self, q, v):
        return v

    def bias(self, q, v):
        return None


class Cylindrical(AbstractJoint):
    """Slides along z and turns about it: q (displacement [m], angle [rad])."""

    home: ClassVar = (0.0, 0.0)
    units: ClassVar = ("m", "rad")
    rows: ClassVar = ("x", "y", "x.z", "y.z")
    reversible: ClassVar = True

    def motion(self, q):
        return Pose(rotation_z(q[1]), (0, 0, q[0]))

    def columns(self, q):
        return (LINEAR[2], ANGULAR[2])

    def rate(self, q, v):
        return v

    def bias(self, q, v):
        return None


class Universal(AbstractJoint):
    """Turns about the parent's x axis, then about the child's y axis: q two angles [rad]."""

    home: ClassVar = (0.0, 0.0)
    units: ClassVar = ("rad", "rad")
    rows: ClassVar = ("x", "y", "z", "x.y")
    reversible: ClassVar = False

    def motion(self, q):
        return Pose(sp.product(rotation_x(q[0]), rotation_y(q[1])), sp.ZERO)

    def columns(self, q):
        return (Twist(sp.ZERO, (jnp.cos(q[1]), 0, jnp.sin(q[1]))), ANGULAR[1])

    def rate(self, q, v):
        return v

    def bias(self, q, v):
        spin = v[0] * v[1]
        return Twist(sp.ZERO, (-jnp.sin(q[1]) * spin, 0, jnp.cos(q[1]) * spin))


class Spherical(AbstractGroupJoint):
    """Turns freely about a point: q unit quaternion (w, x, y, z), v angular velocity [rad/s] in the
    child's axes.
    """

    home: ClassVar = (1.0, 0.0, 0.0, 0.0)
    units: ClassVar = ("1", "1", "1", "1")
    rows: ClassVar = ("x", "y", "z")
    reversible: ClassVar = False

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

    def bracket(self, a, b):
        return sp.cross(a, b)


class Planar(AbstractGroupJoint):
    """Moves in the x-y plane and turns about z: q (x [m], y [m], angle [rad]), v in the child's
    axes.
    """

    home: ClassVar = (0.0, 0.0, 0.0)
    units: ClassVar = ("m", "m", "rad")
    rows: ClassVar = ("z", "x.z", "y.z")
    reversible: ClassVar = False

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

    def bracket(self, a, b):
        return group.planar_bracket(a, b)


class Free(AbstractGroupJoint):
    """No constraint: q (x, y, z [m], quaternion w, x, y, z), v twist in the child's axes, linear
    then angular.
    """

    home: ClassVar = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    units: ClassVar = ("m", "m", "m", "1", "1", "1", "1")
    rows: ClassVar = ()
    reversible: ClassVar = False

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

    def bracket(self, a, b):
        return group.twist_bracket(a, b)


class Fixed(AbstractJoint):
    """Welds the child to the parent."""

    home: ClassVar = ()
    units: ClassVar = ()
    rows: ClassVar = ("x", "y", "z", "x.z", "y.z", "x.y")
    reversible: ClassVar = True

    def motion(self, q):
        return REST

    def columns(self, q):
        return ()

    def rate(self, q, v):
        return ()

    def bias(self, q, v):
        return None


def drive_of(joint: Any) -> AbstractDrive | None:
    """The joint's drive, or `None` for a joint that is free or cannot be driven."""
    return joint.drive if isinstance(joint, AbstractDrivenJoint) else None
