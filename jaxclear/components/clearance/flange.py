"""Where the collars of a journal touch the faces of its bearing: on the axis of one that stands
upright, at the rim of one that is tilted.

A flat face would let the contact point, and with it the torque of the axial force, jump from one
side of the rim to the other where the tilt passes through zero. A face that is crowned by less than
a turned one runs out lets it cross within a small tilt; its gap and its contact point go together
(the support function of an ellipsoid and its gradient), so that no energy comes of it.
"""

from collections.abc import Iterator

from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import rounded_norm
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.friction import AbstractFrictionLaw

# Height of the crown over the rim, as a share of the axial clearance: 0.2 um at 0.2 mm, where
# faces run out by several um. Up to ten times as much changes no mean force by 1e-3, and halves the
# steps of a journal that stands on its collar.
CROWN = 1e-3


class Flange(AbstractQuantified):
    """Collars on the journal that stop it along the bearing: the point of their face that is
    nearest the bearing's may touch it.

    A face is crowned, an ellipsoid whose height is a thousandth of the axial clearance: an upright
    journal is carried on its axis, and from a tilt of a few times that height over the radius on by
    the collar's rim. A stiffness fitted from materials takes the radii of journal and bore, for
    want of better; give a number where the axial stiffness matters.
    """

    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    radius: Scalar = quantity(14e-3, "m", "outer radius of the collar", above=0, kw_only=True)
    clearance: Scalar = quantity(
        0.2e-3, "m", "axial clearance at each collar, journal centred", above=0, kw_only=True
    )

    def contacts(self, offset: tuple, axis: tuple, length: Scalar) -> Iterator[tuple]:
        """(indentation, place) [m] of the collars at the lower and the upper face of a bearing of a
        length, for a journal's middle and axis."""
        crown = self._crown
        square = sp.dot(axis[:2], axis[:2])
        support = self._support(axis[:2], axis[2])
        across = self.radius * self.radius / support
        reach = 0.5 * length + self.clearance + crown - crown * crown * axis[2] / support
        sideways = (*(sp.mul(axis[2], axis[i]) for i in (0, 1)), sp.mul(-1, square))
        for end in (-1, 1):
            middle = sp.plus(offset, sp.scale(end * reach, axis))
            place = sp.plus(middle, sp.scale(end * across, sideways))
            yield 0.5 * length - end * place[2], place

    def lowered(self, slope: tuple) -> Scalar:
        """How much nearer the face [m] a collar comes that leans by a small slope [1]."""
        return self._support(slope, 1) - self._crown

    @property
    def _crown(self) -> Scalar:
        return CROWN * self.clearance

    def _support(self, lean: tuple, along) -> Scalar:
        """From the ellipsoid's middle to its lowest point [m]; never 0."""
        leaning = (sp.mul(self.radius, part) for part in lean)
        return rounded_norm(*leaning, width=sp.mul(self._crown, along))
