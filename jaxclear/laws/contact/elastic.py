"""How hard: elastic forces of a ball in a socket, and the general power laws.

Each answers which force [N] an indentation [m] costs; for a journal in a bearing see `cylinder`.
"""

from typing import Any

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.numerics import positive_part, power, safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact.base import AbstractElasticForce, exponent_field, stiffness_field
from jaxclear.laws.material import USUAL_MODULUS
from jaxclear.laws.stiffness import HERTZ_SPHERE, ClearanceOf, Fitted, OuterRadiusOf

__all__ = ["BallInSocket", "Hertz", "Linear"]
__getattr__, __dir__ = nothing_else("jaxclear.contact.elastic", __all__)


def modulus_field() -> Any:
    """Field of a combined modulus [Pa]."""
    return quantity(112.9e9, "Pa", above=0, usual=USUAL_MODULUS)


def clearance_field() -> Any:
    """Field of a radial clearance [m], by default the pair's."""
    return quantity(unit="m", default_factory=ClearanceOf, above=0)


class Linear(AbstractElasticForce):
    r""":math:`F = K\delta`: a spring.

    For rubber, coatings and comparison with closed solutions; for metal on metal prefer Hertz.

    Args:
        stiffness: spring stiffness K [N/m], > 0.

    Source: Hooke 1678, De potentia restitutiva; in contact Goldsmith 1960, Impact.
    """

    stiffness: Fitted = quantity(1e8, "N/m", above=0)

    def force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * positive_part(indentation)


class Hertz(AbstractElasticForce):
    r""":math:`F = K\delta^n`, n = 3/2 for two spheres.

    For contact areas small beside the radii; for a journal in a bearing prefer the laws of
    `cylinder`, for an indentation near the clearance BallInSocket.

    Args:
        stiffness: generalized contact stiffness K [N/m^exponent], > 0.
        exponent: exponent of the indentation [1], > 1; None: Hertz's 3/2.

    Source: Hertz 1882, J. reine angew. Math. 92, 156, doi:10.1515/crll.1882.92.156; Johnson 1985,
    Contact Mechanics, eq. 4.23, doi:10.1017/CBO9781139171731.
    """

    stiffness: Fitted = stiffness_field()
    exponent: Scalar | None = exponent_field()

    def force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class BallInSocket(AbstractElasticForce):
    r""":math:`F = K(\delta)\,\delta`, :math:`K = \frac43 E^* R_s\sqrt{\delta/(c + \delta)}` growing
    with the contact area.

    For :math:`\delta \ll c` this is Hertz's law for a ball in a socket, for :math:`\delta \gg c`
    the contact area stops growing and F is linear. Contact radius at most the socket's. For a
    journal in a bearing prefer Liu.

    RECONSTRUCTED. Hou, Deng & Zeng (eq. 20 and 21, exponent n = 1) say that K depends on
    :math:`R_s`, c, :math:`E^*` and :math:`\delta`, but their eq. 21 is lost in the text at hand, as
    is the distributed-spring model behind it. K here is that model's shape, radius of contact
    :math:`R_s\sqrt{\delta/(c + \delta)}` under Hertz's pressure, its constant chosen so that small
    indentations are Hertz's.

    Args:
        modulus: combined modulus E* [Pa], > 0; default: steel on steel.
        socket_radius: socket's radius R_s [m], > 0; by default that of the pair.
        clearance: radial clearance c [m], > 0; by default that of the pair.

    Source: Hou, Deng & Zeng 2021, J. Cent. South Univ. 28, 712, doi:10.1007/s11771-021-4640-y;
    Liu, Zhang & Yang 2006, J. Comput. Nonlinear Dyn. 1, 160.
    """

    modulus: Fitted = modulus_field()
    socket_radius: Fitted = quantity(unit="m", default_factory=OuterRadiusOf, above=0)
    clearance: Fitted = clearance_field()

    def force(self, indentation: Scalar) -> Scalar:
        depth = positive_part(indentation)
        area = safe_divide(power(depth, None), safe_sqrt(self.clearance + depth))
        return HERTZ_SPHERE * self.modulus * self.socket_radius * area
