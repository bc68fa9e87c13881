"""What a body is made of, as far as a contact law asks.

One question: which elastic modulus does a pair of surfaces press with? Sources of the numbers
beside each factory.
"""

from jaxclear.ground.argument_errors import answering, nothing_else
from jaxclear.ground.arguments import expect
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity

__all__ = ["Material", "aluminium", "combined_modulus", "steel"]
__getattr__, __dir__ = nothing_else("jaxclear.material", __all__)


# From soft rubber to diamond: Ashby 2011, Materials Selection in Mechanical Design, 4th ed., chart
# of modulus against density.
USUAL_MODULUS = (1e6, 1.3e12, "is it in GPa or MPa? Moduli are in Pa.")


class Material(AbstractQuantified):
    """Linear isotropic elasticity, small strain.

    Args:
        young_modulus: Young's modulus [Pa], > 0.
        poisson_ratio: Poisson's ratio [1], > -1 and <= 0.5.
    """

    young_modulus: Scalar = quantity(unit="Pa", above=0, usual=USUAL_MODULUS)
    poisson_ratio: Scalar = quantity(unit="1", above=-1, at_most=0.5)

    @property
    def plane_strain_modulus(self) -> Scalar:
        """E / (1 - nu^2) [Pa]: the modulus of a half-space pressed along a line."""
        return self.young_modulus / (1 - self.poisson_ratio * self.poisson_ratio)


@answering
def combined_modulus(a: Material, b: Material) -> Scalar:
    r""":math:`E^*` [Pa] of two bodies pressed together: :math:`1/E^* = (1 - \nu_a^2)/E_a +
    (1 - \nu_b^2)/E_b`.

    Symmetric in the two; below either body's plane-strain modulus.

    Args:
        a, b: materials of the two bodies.

    Returns:
        the combined modulus [Pa].

    Raises:
        ValueError: if one of them is no `Material`.

    Source: Johnson 1985, Contact Mechanics, ch. 4, doi:10.1017/CBO9781139171731.
    """
    for body in (a, b):
        expect(body, Material, "what combined_modulus presses together", "a jaxclear.Material")
    return 1 / (1 / a.plane_strain_modulus + 1 / b.plane_strain_modulus)


def steel() -> Material:
    """Bearing steel of the conference paper "Dynamic Behavior of Four-bar Mechanism with
    Three-dimensional Clearance and Wear", Table II: 206.8 GPa, 0.29."""
    return Material(206.8e9, 0.29)


def aluminium() -> Material:
    """Aluminium as in DyS's table of cylinder contact (69 GPa, 0.35)."""
    return Material(69e9, 0.35)
