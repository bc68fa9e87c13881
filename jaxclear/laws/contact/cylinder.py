r"""How hard, for a journal in a bearing: elastic forces of parallel cylinders.

The closed theories of line contact (Johnson, Radzimovsky, Goldsmith) all give the indentation from
the load per length f = F/L as :math:`\delta = \frac{q f}{\pi E^*}(\ln(a\pi E^* c/f) + b)`, c the
radial clearance; they differ in q, a, b. They are inverted here to rounding. Each turns back,
absurdly, once the indentation is of the order of the clearance; somewhat before that (DEEPEST
below; the limit is in each docstring) the force goes on linearly with the slope reached there.
"""

import math
from typing import Any

import jax.numpy as jnp

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.numerics import inverse_entropy, positive_part, power, safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact.base import AbstractElasticForce
from jaxclear.laws.contact.elastic import clearance_field, modulus_field
from jaxclear.laws.law import check_increasing
from jaxclear.laws.stiffness import Fitted, InnerRadiusOf, LengthOf, OuterRadiusOf

__all__ = ["BaiZhao", "Goldsmith", "Johnson", "Liu", "Radzimovsky", "TwoSidedJohnson"]
__getattr__, __dir__ = nothing_else("jaxclear.contact.cylinder", __all__)

# In x = -w ln w (w: load, x: indentation) the law turns back at -ln w = 1; it is followed up to -ln
# w = 2, where the slope dw/dx is 1, and continued with that slope.
DEEPEST_LOGARITHM = 2.0
DEEPEST = DEEPEST_LOGARITHM * math.exp(-DEEPEST_LOGARITHM)
# Roark's rounded sqrt(8/pi) in the width of the contact, b = 1.60 sqrt(f K_D C_E).
ROARK_WIDTH = 1.60


def length_field() -> Any:
    """Field of a contact's length [m], by default the pair's."""
    return quantity(unit="m", default_factory=LengthOf, above=0)


def logarithmic_force(indentation, modulus, clearance, length, scale, ratio, offset) -> Scalar:
    """F [N] with delta = scale F/(pi E* L) (ln(ratio pi E* c L / F) + offset).

    It is continued linearly beyond DEEPEST.

    Args:
        indentation: delta [m]; the force is 0 where it is negative.
        modulus: combined modulus E* [Pa].
        clearance: radial clearance c [m].
        length: of the line of contact L [m].
        scale, ratio, offset: numbers of the particular law [1].
    """
    depth = ratio * clearance * jnp.exp(offset)
    x = positive_part(indentation) / (scale * depth)
    load = inverse_entropy(jnp.minimum(x, DEEPEST)) + positive_part(x - DEEPEST) / (
        DEEPEST_LOGARITHM - 1
    )
    return jnp.pi * modulus * length * depth * load


class Johnson(AbstractElasticForce):
    r""":math:`\delta = \frac{f}{\pi E^*}(\ln(4\pi E^* c/f) - 1)`: two elastic half-spaces, approach
    measured at the cylinders' centres.

    Valid for :math:`\delta < 0.40\,c`. The usual choice for a journal with ample clearance; for
    indentations near or above the clearance prefer Liu.

    Args:
        modulus: combined modulus E* [Pa], > 0; default: steel on steel.
        clearance: radial clearance c [m], > 0; by default that of the pair.
        length: length L of the contact along the axis [m], > 0; by default that of the pair.

    Source: Johnson 1985, Contact Mechanics, sect. 5.6, doi:10.1017/CBO9781139171731, applied to
    both bodies; Pereira, Ramalho & Ambrósio 2011, Nonlinear Dyn. 63, 681,
    doi:10.1007/s11071-010-9830-3.
    """

    modulus: Fitted = modulus_field()
    clearance: Fitted = clearance_field()
    length: Fitted = length_field()

    def force(self, indentation: Scalar) -> Scalar:
        return logarithmic_force(
            indentation, self.modulus, self.clearance, self.length, 1.0, 4.0, -1.0
        )


class TwoSidedJohnson(AbstractElasticForce):
    r""":math:`\delta = \frac{2f}{\pi E^*}(\ln(\pi E^* c/f) - 1)`: the line contact that the program
    DyS tabulates for a pin in a hole.

    Johnson's form with twice his compliance and :math:`\pi E^* c` in place of :math:`4\pi E^* c` in
    the logarithm (:math:`E^*` as here, of both bodies), as if the pair's compliance had been
    counted on either side. Half to two thirds as stiff as Johnson. Valid for :math:`\delta <
    0.20\,c`. For comparison with DyS; otherwise prefer Johnson.

    Args:
        modulus: combined modulus E* [Pa], > 0; default: steel on steel.
        clearance: radial clearance c [m], > 0; by default that of the pair.
        length: length L of the contact along the axis [m], > 0; by default that of the pair.

    Source: Skrinjar, Slavič & Boltežar 2017, Nonlinear Dyn. 88, 131,
    doi:10.1007/s11071-016-3234-y; program DyS.
    """

    modulus: Fitted = modulus_field()
    clearance: Fitted = clearance_field()
    length: Fitted = length_field()

    def force(self, indentation: Scalar) -> Scalar:
        return logarithmic_force(
            indentation, self.modulus, self.clearance, self.length, 2.0, 1.0, -1.0
        )


class Radzimovsky(AbstractElasticForce):
    r""":math:`\delta = \frac{f}{\pi E^*}(\frac23 + \ln(4R_i/w) + \ln(4R_j/w))` with the full width
    of contact :math:`w = 1.60\sqrt{2 f R_i R_j/((R_j - R_i)E^*)}`.

    The radii cancel: :math:`\delta = \frac{f}{\pi E^*}(\ln(16 E^* c/(2\cdot1.60^2 f)) + \frac23)`.
    Valid for :math:`\delta < 0.52\,c`; 2 to 8 per cent softer than Johnson up to :math:`\delta =
    0.1\,c` (2/3 against ln 4 - 1 = 0.39).

    Args:
        modulus: combined modulus E* [Pa], > 0; default: steel on steel.
        clearance: radial clearance c [m], > 0; by default that of the pair.
        length: length L of the contact along the axis [m], > 0; by default that of the pair.

    Source: Radzimovsky 1953, Univ. Illinois Eng. Exp. Station Bull. 408; Roark, Formulas for Stress
    and Strain, line contact of cylinders; Pereira, Ramalho & Ambrósio 2011, Nonlinear Dyn. 63, 681,
    doi:10.1007/s11071-010-9830-3.
    """

    modulus: Fitted = modulus_field()
    clearance: Fitted = clearance_field()
    length: Fitted = length_field()

    def force(self, indentation: Scalar) -> Scalar:
        ratio = 16 / (2 * ROARK_WIDTH**2 * jnp.pi)
        return logarithmic_force(
            indentation, self.modulus, self.clearance, self.length, 1.0, ratio, 2 / 3
        )


class Goldsmith(AbstractElasticForce):
    r""":math:`\delta = \frac{f}{\pi E^*}(\ln(L^3 c\,\pi E^*/(F R_i R_j)) + 1)`, as repaired by
    Dubowsky and Freudenstein.

    Goldsmith prints L where :math:`L^3` must stand (the logarithm had a dimension). The contact
    length enters the logarithm itself, so two halves of a bearing do not add up to the whole: use
    only for L near the radii, and prefer Johnson. Valid for :math:`\delta < 0.74\,c L^2/(R_i R_j)`.

    Args:
        modulus: combined modulus E* [Pa], > 0; default: steel on steel.
        inner_radius: journal's radius R_i [m], > 0; by default that of the pair.
        outer_radius: bearing's radius R_j [m], > 0; by default that of the pair.
        length: length L of the contact along the axis [m], > 0; by default that of the pair.

    Raises:
        ValueError: if inner_radius is not below outer_radius.

    Source: Goldsmith 1960, Impact, ch. 4; Dubowsky & Freudenstein 1971, J. Eng. Ind. 93, 305,
    doi:10.1115/1.3427895; Flores, Ambrósio, Claro & Lankarani 2006, Proc. IMechE K 220, 21,
    doi:10.1243/146441906X77722.
    """

    modulus: Fitted = modulus_field()
    inner_radius: Fitted = quantity(unit="m", default_factory=InnerRadiusOf, above=0)
    outer_radius: Fitted = quantity(unit="m", default_factory=OuterRadiusOf, above=0)
    length: Fitted = length_field()

    def __check_init__(self):
        check_increasing(self, "inner_radius", "outer_radius")

    def force(self, indentation: Scalar) -> Scalar:
        clearance = self.outer_radius - self.inner_radius
        ratio = self.length * self.length / (self.inner_radius * self.outer_radius)
        return logarithmic_force(indentation, self.modulus, clearance, self.length, 1.0, ratio, 1.0)


class Liu(AbstractElasticForce):
    r""":math:`F = \frac\pi2 E^* L\,\delta\sqrt{\delta/(2(c + \delta))}`: distributed springs over
    the overlap of two circles.

    Explicit, and good where the others end: small clearance, large loads, indentations of the order
    of c. Far below c its :math:`F \sim \delta^{3/2}` is too soft; there prefer Johnson.

    Args:
        modulus: combined modulus E* [Pa], > 0; default: steel on steel.
        clearance: radial clearance c [m], > 0; by default that of the pair.
        length: length L of the contact along the axis [m], > 0; by default that of the pair.

    Source: Liu, Zhang & Yang 2007, Mech. Mach. Theory 42, 183,
    doi:10.1016/j.mechmachtheory.2006.02.006.
    """

    modulus: Fitted = modulus_field()
    clearance: Fitted = clearance_field()
    length: Fitted = length_field()

    def force(self, indentation: Scalar) -> Scalar:
        depth = positive_part(indentation)
        area = safe_divide(power(depth, None), safe_sqrt(2 * (self.clearance + depth)))
        return 1 / 2 * jnp.pi * self.modulus * self.length * area


class BaiZhao(AbstractElasticForce):
    r""":math:`F = K(\delta)\,\delta`, K the slope of Liu's law: :math:`K = \frac18\pi E^* L
    \sqrt{2\delta(3c + 2\delta)^2/(c + \delta)^3}`.

    Slope times indentation is up to 3/2 of Liu's own force; prefer Liu.

    Args:
        modulus: combined modulus E* [Pa], > 0; default: steel on steel.
        clearance: radial clearance c [m], > 0; by default that of the pair.
        length: length L of the contact along the axis [m], > 0; by default that of the pair.

    Source: Bai & Zhao 2013, Int. J. Non-Linear Mech. 48, 15,
    doi:10.1016/j.ijnonlinmec.2012.07.003, where K is written without L.
    """

    modulus: Fitted = modulus_field()
    clearance: Fitted = clearance_field()
    length: Fitted = length_field()

    def force(self, indentation: Scalar) -> Scalar:
        depth = positive_part(indentation)
        widened = self.clearance + depth
        shape = (3 * self.clearance + 2 * depth) * safe_divide(
            power(depth, None), widened * safe_sqrt(widened)
        )
        return math.sqrt(2) / 8 * jnp.pi * self.modulus * self.length * shape
