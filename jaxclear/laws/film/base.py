r"""What a film law says of itself, and how viscous an oil is.

The journal of eccentricity e moves with velocity :math:`\dot e` in a bearing of radius R, radial
clearance c and length L. A film depends on the squeeze velocity alone, :math:`v = \dot e -
\tfrac12 \omega\,k \times e` (in the bearing's axes, :math:`\omega` the relative spin), and the
force on the journal is :math:`-12\mu R (R/c)^3 W(\varepsilon, v, L/D)`, W homogeneous of degree 1
in v. Source: Booker 1965, J. Basic Eng. 87, 168, doi:10.1115/1.3650461; Childs, Moes & van Leeuwen
1977, J. Lubr. Technol. 99, 198, doi:10.1115/1.3453016.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.law import AbstractLaw, check_increasing
from jaxclear.laws.stiffness import AbstractFit, Fitted

# From light gases to gear oil in the cold.
USUAL_VISCOSITY = (1e-6, 1e2, "is it in mPa s, or kinematic? It is dynamic, in Pa s.")


class Vogel(AbstractFit):
    r"""Viscosity of an oil at a temperature, :math:`\mu = a\,e^{b/(T - T_0)}`.

    It takes the place of the number `viscosity` of a film. The temperature is given: films make no
    heat here.

    Args:
        scale: viscosity a that hot oil approaches [Pa s], > 0.
        slope: temperature b by which it thickens [K], > 0.
        pole: temperature T_0 at which it would be solid [K].
        temperature: temperature of the film [K], > 0, above the pole.

    Raises:
        ValueError: if the temperature is not above the pole.

    Source: Vogel 1921, Physik. Z. 22, 645; Stachowiak & Batchelor 2014, Engineering Tribology, 4th
    ed., sec. 2.3.
    """

    scale: Scalar = quantity(unit="Pa s", above=0)
    slope: Scalar = quantity(unit="K", above=0)
    pole: Scalar = quantity(unit="K")
    temperature: Scalar = quantity(unit="K", above=0)

    def __check_init__(self):
        check_increasing(self, "pole", "temperature")

    def value(self, shape: Any = None) -> Scalar:
        return self.scale * jnp.exp(self.slope / (self.temperature - self.pole))


class AbstractFilm(AbstractLaw):
    """A lubricant film in the gap of a journal bearing, round and upright, fed at the pressure of
    its surroundings."""

    viscosity: eqx.AbstractVar[Fitted]
    thinnest: eqx.AbstractVar[Scalar]
    slenderness: ClassVar[tuple[float, float]] = (0.0, float("inf"))
    """Ratios of length to diameter for which the law is made."""

    @abstractmethod
    def force(
        self, eccentricity_ratio: Scalar, closing: Scalar, across: Scalar, slenderness: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Force with which a film resists, over 12 mu R (R/c)^3.

        Args:
            eccentricity_ratio: eccentricity over clearance [1], >= 0 and < 1.
            closing: squeeze velocity along the line of centres [m/s], positive while closing.
            across: squeeze velocity across it [m/s], a quarter turn on.
            slenderness: length of the bearing over its diameter [1], > 0.

        Returns:
            force against `closing` and against `across` [m/s].
        """

    def floored(self, eccentricity_ratio: Scalar) -> Scalar:
        """Eccentricity ratio at which the film is evaluated: from twice the least thickness down a
        parabola leads to it.

        Args:
            eccentricity_ratio: eccentricity over clearance [1], >= 0; above 1 where parts overlap.

        Returns:
            the ratio [1], at most 1 - `thinnest`.
        """
        film, least = 1 - eccentricity_ratio, self.thinnest
        inside = positive_part(film)
        return 1 - jnp.where(film > 2 * least, film, least + inside * inside / (4 * least))


def viscosity_field() -> Any:
    """Field of a viscosity."""
    return quantity(0.04, "Pa s", above=0, usual=USUAL_VISCOSITY)


def thinnest_field() -> Any:
    """Field of the least thickness of a film."""
    return quantity(1e-3, "1", at_least=5e-4, below=0.5)
