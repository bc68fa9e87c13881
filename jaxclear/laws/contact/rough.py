r"""Contact of rough surfaces along a journal: asperities carry before the parts touch.

Greenwood and Tripp's pressure :math:`K F_{5/2}(h/\sigma)`, integrated around a journal whose film
thickness grows as :math:`c\varepsilon\vartheta^2/2` from its least, h, is :math:`R L K
\sqrt{2\sigma/(c\varepsilon)}\,\frac{5\pi}{16} F_3(h/\sigma)`, :math:`F_n(u) = \int_u^\infty (s -
u)^n \varphi(s)\,ds` for Gaussian heights; :math:`F_3 = (u^2 + 2)\varphi - (u^3 + 3u) Q`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact.base import AbstractContactLaw
from jaxclear.laws.contact.composed import Johnson
from jaxclear.laws.contact.cylinder import length_field
from jaxclear.laws.contact.elastic import clearance_field, modulus_field
from jaxclear.laws.stiffness import Fitted, OuterRadiusOf

# Asperities higher than so many standard deviations are left out.
HIGHEST = 5.0
# Greenwood and Tripp's 16 sqrt(2) pi / 15, and 5 pi / 16 of the integral around the journal.
AREA, AROUND = 16 * 2**0.5 * jnp.pi / 15, 5 * jnp.pi / 16
# Slope of F_3 where mean planes meet, from where on the asperities' force is continued with it.
AT_TOUCH = 1.5
# Mean film thickness over roughness of surfaces whose mean planes meet, 1/sqrt(2 pi).
MEAN_GAP = (2 * jnp.pi) ** -0.5


def third_moment(u: Any) -> Any:
    """F_3: mean cube of what normally distributed heights exceed u by [1]."""
    density = MEAN_GAP * jnp.exp(-0.5 * u * u)
    beyond = 0.5 * (1 - jax.lax.erf(2**-0.5 * u))
    return (u * u + 2) * density - u * (u * u + 3) * beyond


class Rough(AbstractContactLaw):
    r"""A law of contact of rough surfaces in a lubricated journal: :math:`R L K
    \sqrt{2\sigma/(c\varepsilon)}\,\frac{5\pi}{16} F_3(h/\sigma)` of the asperities, elastic, and
    the force of the smooth parts once they touch.

    Asperities press from 5 sigma before touch on, from where the indentation counts. Friction acts
    on this force alone, not on the film's. Within 0.45 % of the integral of Greenwood and Tripp's
    pressure; once mean planes overlap it grows linearly. The film is not taken as thinner than 0.4
    sigma, the mean gap where mean planes meet. For a `PlanarJournalBearing` with a film.

    Args:
        law: contact law of the smooth parts, an `AbstractContactLaw`; default: `Johnson()`.
        roughness: standard deviation sigma of the heights of both surfaces together [m], > 0.
        crowding: asperities per area times radius times sigma [1], > 0, eta beta sigma; usually
            0.03 to 0.05.
        sharpness: sigma over the asperities' radius [1], > 0, sigma/beta; usually 1e-4 to 1e-2.
        modulus: combined modulus E* [Pa], > 0; default: steel on steel.
        bearing_radius: radius R of the bearing [m], > 0; by default that of the pair.
        clearance: radial clearance c [m], > 0; by default that of the pair.
        length: length L of the contact along the axis [m], > 0; by default that of the pair.

    Raises:
        ValueError: if `law` is rough itself.

    Source: Greenwood & Tripp 1970, Proc. Inst. Mech. Eng. 185, 625,
    doi:10.1243/PIME_PROC_1970_185_069_02.
    """

    law: AbstractContactLaw = eqx.field(default_factory=Johnson)
    roughness: Scalar = quantity(0.5e-6, "m", above=0)
    crowding: Scalar = quantity(0.05, "1", above=0)
    sharpness: Scalar = quantity(1e-3, "1", above=0)
    modulus: Fitted = modulus_field()
    bearing_radius: Fitted = quantity(unit="m", default_factory=OuterRadiusOf, above=0)
    clearance: Fitted = clearance_field()
    length: Fitted = length_field()

    def __check_init__(self):
        if self.law.reach is not None:
            raise ValueError("contact.Rough has a law that is rough itself; give that of its law.")

    @property
    def restitution(self) -> Scalar | None:
        """Coefficient of restitution [1] of the smooth parts' law."""
        return self.law.restitution

    @property
    def remembers_impact_speed(self) -> bool:
        return self.law.remembers_impact_speed

    @property
    def lossless(self) -> bool:
        return self.law.lossless

    @property
    def reach(self) -> Scalar:
        return HIGHEST * self.roughness

    @property
    def least_film(self) -> Scalar:
        return MEAN_GAP * self.roughness

    def asperity_force(self, indentation: Scalar) -> Scalar:
        """Force of the asperities.

        Args:
            indentation: indentation [m], from the highest asperities on.

        Returns:
            the force [N].
        """
        depth = positive_part(indentation)
        offset = self.clearance - self.reach + depth
        stiffness = AREA * self.crowding * self.crowding * jnp.sqrt(self.sharpness) * self.modulus
        width = AROUND * self.bearing_radius * jnp.sqrt(2 * self.roughness / offset)
        overlap = positive_part(depth / self.roughness - HIGHEST)
        moment = third_moment(HIGHEST - depth / self.roughness + overlap) - third_moment(HIGHEST)
        moment = jnp.where(depth > 0, positive_part(moment), 0.0) + AT_TOUCH * overlap
        return width * self.length * stiffness * moment

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        smooth = self.law.normal_force(indentation - self.reach, rate, impact_speed)
        return smooth + self.asperity_force(indentation)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.law.elastic_force(indentation - self.reach) + self.asperity_force(indentation)
