r"""Clearance joints that are always in contact: ideal joints that know where in the gap their
reaction is carried.

The clearance is small beside everything else, so the motion is that of the ideal joint; the gap
only decides which points carry, and these rub. Reactions are those on the child about its marker,
in the parent marker's axes. Friction is counted into the reaction's resultant: at angle
:math:`\varphi = \arctan\mu` to the normal, a resultant R on a journal rubs with
:math:`\sin\varphi\,|R|`. Source: Li, Lyu & Ding 2022,
Chin. J. Aeronaut., no. 8, "Dynamics modeling and error analysis for antenna pointing mechanisms
with frictional spatial revolute joints on SE(3)", section 3.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance.base import AbstractClearance
from jaxclear.components.joint import AbstractJoint, AbstractVectorJoint
from jaxclear.ground import sparse as sp
from jaxclear.laws.friction import AbstractFrictionLaw

# How a joint's reaction is carried, as `situation` numbers it.
SITUATIONS = (
    "no contact",
    "one point",
    "two points on opposite sides",
    "a line (points on one side)",
)
# An end that carries less than this share of the other carries nothing.
IDLE = 1e-9


class CarriedContact(NamedTuple):
    """A contact of the clearance joint, by its number there, while it carries: normal force and
    (signed) friction [N], and its place in the bearing's frame [m]."""

    number: int
    normal_force: Any
    friction: Any
    place: sp.Vec


class CarryingEnd(NamedTuple):
    """One end of the gap that may carry: its height along the bearing [m], the force on the child
    there across the sliding direction [N], friction's part of it included where it has one, the
    offset of that end within the gap [m], and the contacts there."""

    height: Any
    force: sp.Vec
    offset: sp.Vec
    contacts: tuple[CarriedContact, ...]


class AbstractPermanentJoint(AbstractVectorJoint):
    """An ideal joint of one coordinate with the gap of a clearance joint that always touches.

    It moves as `ideal` does.
    """

    gap: eqx.AbstractVar[AbstractClearance]

    @property
    @abstractmethod
    def ideal(self) -> AbstractJoint:
        """The joint as which it moves."""

    @property
    @abstractmethod
    def friction(self) -> AbstractFrictionLaw | None:
        """The law between the parts."""

    @property
    @abstractmethod
    def arm(self) -> Any:
        """Sliding speed [m/s] per unit of the joint's speed, and generalised force per unit of
        friction [N]."""

    @abstractmethod
    def friction_wrench(self, friction: Any) -> tuple[sp.Vec, sp.Vec]:
        """Force [N] and torque [N m] of friction [N] on the child about its marker, in the parent
        marker's axes.
        """

    @abstractmethod
    def carrying_ends(self, force: sp.Vec, torque: sp.Vec, ratio: Any) -> tuple[CarryingEnd, ...]:
        """Where a reaction is carried; `ratio`: (signed) friction over the sum of the carried
        forces' sizes.
        """

    @abstractmethod
    def friction_ratio(self, mu: Any) -> Any:
        """Largest friction over the sum of the sizes of the carried forces, for a coefficient of
        friction.
        """

    def maps(self) -> dict:
        """Wear map and law of each surface that wears, as of the joint with clearance."""
        return self.gap.maps()

    def motion(self, q):
        return self.ideal.motion(q)

    def columns(self, q):
        return self.ideal.columns(q)

    def bias(self, q, v):
        return self.ideal.bias(q, v)

    def coordinates_at(self, pose):
        return self.ideal.coordinates_at(pose)

    def speeds_at(self, pose, velocity, spin):
        return self.ideal.speeds_at(pose, velocity, spin)


def carried_load(ends: tuple[CarryingEnd, ...]) -> Any:
    """Sum of the sizes of the carried forces [N], of which friction is a share."""
    return sp.total(sp.norm(end.force) for end in ends)


def situation(ends: tuple[CarryingEnd, ...]) -> Any:
    """Index into `SITUATIONS`."""
    sizes = [sp.norm(end.force) for end in ends]
    carries = [size > IDLE * sp.total(sizes) for size in sizes]
    if len(ends) == 1:
        return carries[0].astype(int)
    opposite = sp.dot(ends[0].force, ends[1].force) < 0
    return jnp.where(
        carries[0] & carries[1], jnp.where(opposite, 2, 3), (carries[0] | carries[1]).astype(int)
    )
