r"""The short film of which only the closing half carries, in closed form.

With P = 0 where the film opens, pressure is that of a short bearing, :math:`v \cdot n / H^3`, over
the half turn in which v closes. In Sommerfeld's angle psi this half turn measures :math:`\pi + 2
\arctan(\varepsilon c/\sqrt{q})`, :math:`q = 1 - \varepsilon^2`, (c, s) the direction of v.
"""

import jax.numpy as jnp

from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.laws.film.base import AbstractFilm, thinnest_field, viscosity_field
from jaxclear.laws.stiffness import Fitted


class ShortHalfFilm(AbstractFilm):
    r"""Film of a short bearing, pressure only where it closes (Ocvirk's, half Sommerfeld).

    For L/D up to 0.25 near the wall and 0.5 elsewhere; beyond it is too stiff, at L/D 1 by a factor
    of 2 and more. Prefer `Reynolds`, which is as cheap; this one has the closed forms of textbooks.

    Args:
        viscosity: dynamic viscosity [Pa s], > 0; a number or a `Vogel`.
        thinnest: least film thickness over clearance [1], >= 0.0005 and < 0.5; below it it is taken
            as this.

    Source: Ocvirk 1952, NACA TN 2808; as impedance Childs, Moes & van Leeuwen 1977, J. Lubr.
    Technol. 99, 198, doi:10.1115/1.3453016.
    """

    viscosity: Fitted = viscosity_field()
    thinnest: Scalar = thinnest_field()

    def force(self, eccentricity_ratio, closing, across, slenderness):
        e, q = eccentricity_ratio, (1 - eccentricity_ratio) * (1 + eccentricity_ratio)
        speed, root = safe_sqrt(closing * closing + across * across), jnp.sqrt(q)
        c, s = safe_divide(closing, speed), safe_divide(across, speed)
        half = 0.5 * jnp.pi + jnp.arctan(e * c / root)
        ends = q + e * e * c * c  # product of the heights where the film begins and ends
        bend = root * c * e * (2 * s * s - 1 - e * e * s * s) / (ends * ends)
        along = (1 + 2 * e * e) * half + 4 * e * root * c / ends + bend
        along, beside = along / (q * q * root), (half - bend) / (q * root)
        mixed = 2 * e * s * s * s / (ends * ends)
        scale = 2 / 3 * slenderness * slenderness * slenderness
        return scale * (closing * along + across * mixed), scale * (
            closing * mixed + across * beside
        )
