"""What journal bearings have in common: how they share a reaction, and the revolute joint that they
are while they always touch.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx

from jaxclear.components.clearance.base import AbstractClearance, direction
from jaxclear.components.clearance.permanent import AbstractPermanentJoint
from jaxclear.components.clearance.roundness import Lobes, leaned, touched
from jaxclear.components.joint import Revolute
from jaxclear.components.joint.rubbing import CarryingEnd, pressed_end
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.friction import AbstractFrictionLaw


class AbstractJournalBearing(AbstractClearance):
    """A journal in a bearing, both along z."""

    contact: eqx.AbstractVar[AbstractNormalLaw]
    friction: eqx.AbstractVar[AbstractFrictionLaw | None]
    bearing_radius: eqx.AbstractVar[Scalar]
    clearance: eqx.AbstractVar[Scalar]
    length: eqx.AbstractVar[Scalar]
    roundness: eqx.AbstractVar[tuple[Lobes, ...] | None]

    def touch(self, offset: sp.Vec) -> tuple[Any, Any, Any]:
        """Direction (x, y) in which a journal at `offset` [m] is nearest to the bore, and its
        overlap there [m]."""
        if self.roundness is None:
            return (*direction(offset, 2), sp.norm(offset[:2]) - self.clearance)
        return touched(self.roundness, self.clearance, offset)

    def leaned(self, lean: sp.Vec) -> sp.Vec:
        """Where a journal lies [m] that is pressed in a direction (length 1, or 0)."""
        if self.roundness is None:
            return (*sp.scale(self.clearance, lean[:2]), 0)
        return leaned(self.roundness, self.clearance, lean)

    def grown(self, outer, inner):
        bore = outer * self.bearing_radius
        gap = bore - inner * (self.bearing_radius - self.clearance)
        sizes = lambda joint: (joint.bearing_radius, joint.clearance, joint.length)
        joint = eqx.tree_at(sizes, self, (bore, gap, outer * self.length))
        return joint.grown_along(self.length, outer, inner)

    def grown_along(self, length: Scalar, outer: Scalar, inner: Scalar) -> "AbstractJournalBearing":
        """The joint with what is along its axis larger by these factors, the bearing having been
        of `length` [m]; nothing else is, unless overridden."""
        return self

    @abstractmethod
    def end_forces(self, force: sp.Vec, torque: sp.Vec) -> tuple[tuple[sp.Vec, Any], ...]:
        """(force across the axis [N], height along the bearing [m]) of each end that carries a
        reaction, a force [N] and a torque [N m] on the journal about its centre.
        """

    def permanent_form(self):
        return PermanentRevolute(self)

    def seat(self, force, torque):
        # Each end lies where the wall pushes back, on the far side.
        ends = [
            (self.leaned(tuple(sp.neg(x) for x in direction(own, 2)))[:2], height)
            for own, height in self.end_forces(force, torque)
        ]
        (first, low), (last, high) = ends[0], ends[-1]
        if len(ends) == 1 or all(map(sp.is_zero, torque[:2])):
            return (*first, self.axial_seat(force[2], (0, 0))), (0, 0)
        slope = sp.scale(1 / sp.sub(high, low), tuple(map(sp.sub, last, first)))
        middle = sp.scale(0.5, tuple(map(sp.add, first, last)))
        return (*middle, self.axial_seat(force[2], slope)), slope

    def axial_seat(self, force: Any, slope: tuple) -> Any:
        """Where along the bearing [m] a force [N] presses the journal whose axis has a slope [1];
        nowhere, unless overridden, because nothing stops it."""
        return 0


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
        return self.gap.bearing_radius - self.gap.clearance

    @property
    def goes_round(self):
        return True

    def friction_wrench(self, friction):
        return sp.ZERO, (0, 0, self.arm * friction)

    def carrying_ends(self, force, torque, ratio):
        ends = self.gap.end_forces(force, torque)
        size = (self.gap.bearing_radius, self.gap.clearance)
        found = tuple(
            pressed_end(k, own, height, ratio, *size) for k, (own, height) in enumerate(ends)
        )
        if self.gap.roundness is not None:
            leans = [direction(end.offset, 2) for end in found]
            pairs = zip(found, leans, strict=True)
            found = tuple(end._replace(offset=self.gap.leaned(lean)) for end, lean in pairs)
        along = self.gap.axial_seat(force[2], _slope(found))
        if sp.is_zero(along):
            return found
        return tuple(end._replace(offset=(*end.offset[:2], along)) for end in found)

    def friction_ratio(self, mu):
        return mu / safe_sqrt(1 + mu * mu)


def _slope(ends: tuple[CarryingEnd, ...]) -> tuple:
    """Slope (dx/dz, dy/dz) of a journal that lies so at its ends."""
    first, last = ends[0], ends[-1]
    if len(ends) == 1:
        return (0, 0)
    inverse = 1 / sp.sub(last.height, first.height)
    return tuple(sp.mul(inverse, sp.sub(last.offset[i], first.offset[i])) for i in (0, 1))
