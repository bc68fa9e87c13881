"""Ideal joints as data: how the child's marker moves in the parent's, and which rows close a loop
through the joint.

A joint of a spanning tree contributes coordinates q and speeds v; a joint that closes a loop
contributes constraint rows. Twists are in the child's axes, linear then angular. Row "x" says that
the child's origin stays at x = 0 of the parent's marker, row "x.z" that the parent's x axis stays
perpendicular to the child's z axis; a joint that states no rows gets them from its motion. A joint
from outside derives from `AbstractVectorJoint` where
coordinates are angles and displacements, from `AbstractGroupJoint` where rotations are free.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.drive import AbstractDrive
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.pose import Pose, Twist
from jaxclear.ground.quantity import AbstractQuantified

LINEAR = tuple(Twist(axis, sp.ZERO) for axis in sp.IDENTITY)
ANGULAR = tuple(Twist(sp.ZERO, axis) for axis in sp.IDENTITY)


class AbstractJoint(AbstractQuantified):
    """An ideal joint: `home` are its coordinates in the drawing, `units` theirs, `rows` its
    constraint rows where it closes a loop; a joint that states none is held there by what departs
    from its `motion`, in ways that its home tells apart. `reversal`: turn of both markers (columns:
    new axes in the old) with which the joint, read from child to parent, is one of its kind again.
    """

    home: eqx.AbstractClassVar[tuple[float, ...]]
    units: eqx.AbstractClassVar[tuple[str, ...]]
    rows: ClassVar[tuple[str, ...] | None] = None
    reversal: eqx.AbstractClassVar[sp.Mat]

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

    @abstractmethod
    def moved(self, q: tuple, increment: tuple) -> tuple:
        """Coordinates after the speeds `increment` have been held for unit time: the exponential
        map, from q.
        """

    @abstractmethod
    def retracted(self, q: tuple, increment: tuple) -> tuple:
        """`moved` to first order in the increment, and on the joint's group."""

    @abstractmethod
    def bracket(self, a: tuple, b: tuple) -> tuple:
        """Lie bracket of two increments: what a then b moves more than b then a, to second
        order."""

    @abstractmethod
    def coordinates_at(self, pose: Pose) -> tuple:
        """Coordinates at which the child's marker has this pose in the parent's, of a pose that the
        joint allows: the inverse of `motion`."""

    @abstractmethod
    def speeds_at(self, pose: Pose, velocity: sp.Vec, spin: sp.Vec) -> tuple:
        """Speeds at which the child's marker has this relative velocity and spin, both in the
        parent marker's axes. Of a pose beside those that the joint allows (of a journal that leans)
        the rate of the coordinate that `coordinates_at` tells, so that loads on it do its work.
        """

    @abstractmethod
    def start(self, given: tuple) -> tuple:
        """All coordinates from those given for a start. Raises `ValueError`, with a sentence that
        goes behind the joint's name, where these do not tell them."""

    def told(self, given: tuple) -> tuple[bool, ...]:
        """For each of the joint's speeds whether the coordinates that it changes are told by those
        given for a start; all are, unless overridden."""
        return (True,) * len(self.columns(self.home))


class AbstractVectorJoint(AbstractJoint):
    """A joint whose coordinates are a vector: their rates are the speeds, and motions add up."""

    def rate(self, q, v):
        return v

    def moved(self, q, increment):
        return tuple(a + b for a, b in zip(q, increment, strict=True))

    def retracted(self, q, increment):
        return self.moved(q, increment)

    def bracket(self, a, b):
        return (0,) * len(a)

    def start(self, given):
        return complete(self, given)


class AbstractDrivenJoint(AbstractVectorJoint):
    """A joint with one coordinate, which a drive may prescribe."""

    drive: eqx.AbstractVar[AbstractDrive | None]


class AbstractGroupJoint(AbstractJoint):
    """A joint whose coordinates are no vector but a group: a quaternion, a position with a
    quaternion. Integrators on groups (`jaxclear.integrator.MuntheKaas`) move it by increments, the
    speeds held for a time.
    """


def drive_of(joint: Any) -> AbstractDrive | None:
    """The joint's drive, or `None` for a joint that is free or cannot be driven."""
    return joint.drive if isinstance(joint, AbstractDrivenJoint) else None


def complete(joint: AbstractJoint, given: tuple) -> tuple:
    """The coordinates given, if there is one for each of the joint's."""
    if len(given) != len(joint.home):
        many = len(joint.home)
        units = f" [{', '.join(joint.units)}]" if many else ""
        raise ValueError(f"needs {many} number{'s' * (many != 1)}{units}, not {len(given)}.")
    return given


def turning(pose: Pose, spin: sp.Vec) -> Any:
    """Rate [rad/s] of the angle about the parent's z axis at which the child's x axis is seen, for
    a relative spin in the parent's axes; that about z where the z axes agree."""
    x, y, lean = (row[0] for row in pose.rotation)
    across = sp.add(sp.mul(x, spin[0]), sp.mul(y, spin[1]))
    if sp.is_zero(lean) or sp.is_zero(across):
        return spin[2]
    flat = sp.add(sp.mul(x, x), sp.mul(y, y))
    return sp.sub(spin[2], sp.mul(lean, safe_divide(across, flat)))


def angle(sine: Any, cosine: Any) -> Any:
    """Angle [rad] from its sine and cosine, which may be structural."""
    return jnp.arctan2(jnp.asarray(sine, float), jnp.asarray(cosine, float))
