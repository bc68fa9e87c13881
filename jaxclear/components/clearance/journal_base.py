"""What journal bearings have in common: how they share a reaction, and the revolute joint that they
are while they always touch.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx

from jaxclear.components.clearance.base import AbstractClearance
from jaxclear.components.clearance.permanent import (
    AbstractPermanentJoint,
    CarriedContact,
    CarryingEnd,
)
from jaxclear.components.joint import Revolute
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.friction import AbstractFrictionLaw


class AbstractJournalBearing(AbstractClearance):
    """A journal in a bearing, both along z."""

    contact: eqx.AbstractVar[AbstractNormalLaw]
    friction: eqx.AbstractVar[AbstractFrictionLaw | None]
    bearing_radius: eqx.AbstractVar[Scalar]
    clearance: eqx.AbstractVar[Scalar]

    @abstractmethod
    def end_forces(self, force: sp.Vec, torque: sp.Vec) -> tuple[tuple[sp.Vec, Any], ...]:
        """(force across the axis [N], height along the bearing [m]) of each end that carries a
        reaction, a force [N] and a torque [N m] on the journal about its centre.
        """

    def permanent_form(self):
        return PermanentRevolute(self)


class PermanentRevolute(AbstractPermanentJoint):
    """A journal that turns in its bearing and always touches: planar at one point, spatial at
    either end.

    The two ends share force and moment; on opposite sides they are two points, on one side a line.
    Axial force is carried by the collars and rubs without a torque.
    """

    home: ClassVar = Revolute.home
    units: ClassVar = Revolute.units
    rows: ClassVar = Revolute.rows
    reversal: ClassVar = Revolute.reversal
    gap: AbstractJournalBearing

    @property
    def ideal(self):
        return Revolute()

    @property
    def friction(self):
        return self.gap.friction

    @property
    def clearance(self) -> Scalar:
        """Radial clearance of the gap [m]."""
        return self.gap.clearance

    @property
    def arm(self):
        return self.gap.bearing_radius

    def friction_wrench(self, friction):
        return sp.ZERO, (0, 0, self.arm * friction)

    def carrying_ends(self, force, torque, ratio):
        ends = self.gap.end_forces(force, torque)
        return tuple(self._end(k, own, height, ratio) for k, (own, height) in enumerate(ends))

    def _end(self, index, force, height, ratio):
        """force = -N n + T t with t a quarter turn ahead of n, the direction in which the journal
        leans; T = ratio |force|.
        """
        size = sp.norm(force)
        normal = safe_sqrt(1 - ratio * ratio) * size
        x, y = (safe_divide(part, size * size) for part in force[:2])
        friction = ratio * size
        lean = (friction * y - normal * x, -normal * y - friction * x)
        place = (*sp.scale(self.gap.bearing_radius, lean), height)
        offset = (*sp.scale(self.gap.clearance, lean), 0)
        return CarryingEnd(height, force, offset, (CarriedContact(index, normal, friction, place),))

    def friction_ratio(self, mu):
        return mu / safe_sqrt(1 + mu * mu)
