"""Clearance joints that are always in contact: ideal joints that know where in the gap their
reaction is carried.

The clearance is small beside everything else, so the motion is that of the ideal joint; the gap
only decides which points carry, and these rub (`joint.rubbing`). Source: Li, Lyu & Ding 2022, Chin.
J. Aeronaut., no. 8, "Dynamics modeling and error analysis for antenna pointing mechanisms with
frictional spatial revolute joints on SE(3)", section 3.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance.base import AbstractClearance
from jaxclear.components.joint import AbstractJoint, AbstractVectorJoint
from jaxclear.components.joint.rubbing import AbstractRubbingJoint, CarryingEnd
from jaxclear.ground import sparse as sp

# How a joint's reaction is carried, as `situation` numbers it.
SITUATIONS = (
    "no contact",
    "one point",
    "two points on opposite sides",
    "a line (points on one side)",
)
# An end that carries less than this share of the other carries nothing.
IDLE = 1e-9


class AbstractPermanentJoint(AbstractRubbingJoint, AbstractVectorJoint):
    """An ideal joint of one coordinate with the gap of a clearance joint that always touches.

    It moves as `ideal` does.
    """

    gap: eqx.AbstractVar[AbstractClearance]

    @property
    @abstractmethod
    def ideal(self) -> AbstractJoint:
        """The joint as which it moves."""

    def maps(self) -> dict:
        """Wear map and law of each surface that wears, as of the joint with clearance."""
        return self.gap.maps()

    @property
    def gap_axes(self):
        return self.gap.axes

    def wearing_contacts(self):
        return tuple(k for k, laws in enumerate(self.gap.contact_laws()) if laws.wears)

    def wear_place(self, surface, offset, axes, contact, indentation):
        depths = (indentation,) * len(self.gap.contact_laws())
        return self.gap.features(surface, offset, axes, depths, contact)

    def indentation(self, contact, force):
        return self.gap.contact_laws()[contact].indentation_under(force)

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
