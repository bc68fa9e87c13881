"""How hard, for a journal in a bearing: normal force of parallel cylinders from their indentation.

The closed theories of line contact (Johnson, Radzimovsky, Goldsmith) all give the indentation from
the load per length f = F/L as delta = q f/(pi E*) (ln(a pi E* c / f) + b), c the radial clearance;
they differ in q, a, b. They are inverted here to rounding. Each turns back, absurdly, once the
indentation is of the order of the clearance; somewhat before that (DEEPEST below; the limit is in
each docstring) the force goes on linearly with the slope reached there. Loss, when `restitution` is
given, by Carvalho and Martins' factor, which holds for any elastic law.
"""

import math
from typing import ClassVar

import jax.numpy as jnp

from jaxclear.ground.numerics import inverse_entropy, positive_part, power, safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws import hysteresis
from jaxclear.laws.contact import (
    AbstractContactLaw,
    memory_time_field,
    restitution_field,
    slowest_impact_field,
)
from jaxclear.laws.stiffness import AbstractFit, ClearanceOf, InnerRadiusOf, LengthOf, OuterRadiusOf

# In x = -w ln w (w: load, x: indentation) the law turns back at -ln w = 1; it is followed up to -ln
# w = 2, where the slope dw/dx is 1, and continued with that slope.
DEEPEST_LOGARITHM = 2.0
DEEPEST = DEEPEST_LOGARITHM * math.exp(-DEEPEST_LOGARITHM)
# Roark's rounded sqrt(8/pi) in the width of the contact, b = 1.60 sqrt(f K_D C_E).
ROARK_WIDTH = 1.60


def modulus_field():
    return quantity(112.9e9, "Pa", "combined modulus E* (default: steel on steel)", above=0)


def clearance_field():
    return quantity(unit="m", meaning="radial clearance c", default_factory=ClearanceOf)


def length_field():
    return quantity(
        unit="m", meaning="length L of the contact along the axis", default_factory=LengthOf
    )


def logarithmic_force(indentation, modulus, clearance, length, scale, ratio, offset) -> Scalar:
    """F [N] with delta = scale F/(pi E* L) (ln(ratio pi E* c L / F) + offset), continued linearly
    beyond DEEPEST.
    """
    depth = ratio * clearance * jnp.exp(offset)
    x = positive_part(indentation) / (scale * depth)
    load = inverse_entropy(jnp.minimum(x, DEEPEST)) + positive_part(x - DEEPEST) / (
        DEEPEST_LOGARITHM - 1
    )
    return jnp.pi * modulus * length * depth * load


def damped(law, elastic: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
    """The elastic force itself where the law has no restitution, else with the loss that returns
    it.
    """
    if law.restitution is None:
        return elastic
    factor = hysteresis.carvalho_martins(law.restitution)
    return hysteresis.with_hysteresis(elastic, factor, rate, impact_speed, law.slowest_impact)


class Johnson(AbstractContactLaw):
    """delta = f/(pi E*) (ln(4 pi E* c / f) - 1): two elastic half-spaces, approach measured at the
    cylinders' centres.

    Valid for delta < 0.40 c. The usual choice for a journal with ample clearance; for delta near or
    above the clearance prefer Liu.

    Source: Johnson 1985, Contact Mechanics, sect. 5.6, applied to both bodies; Pereira, Ramalho &
    Ambrosio 2011, Nonlinear Dyn. 63, 681.
    """

    modulus: Scalar | AbstractFit = modulus_field()
    clearance: Scalar | AbstractFit = clearance_field()
    length: Scalar | AbstractFit = length_field()
    restitution: Scalar | None = restitution_field(None)
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()

    @property
    def remembers_impact_speed(self) -> bool:
        return self.restitution is not None

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return damped(self, self.elastic_force(indentation), rate, impact_speed)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return logarithmic_force(
            indentation, self.modulus, self.clearance, self.length, 1.0, 4.0, -1.0
        )


class TwoSidedJohnson(AbstractContactLaw):
    """delta = 2 f/(pi E*) (ln(pi E* c / f) - 1): the line contact that the program DyS tabulates
    for a pin in a hole.

    Johnson's form with twice his compliance and pi E* c in place of 4 pi E* c in the logarithm (E*
    as here, of both bodies), as if the pair's compliance had been counted on either side. Half to
    two thirds as stiff as Johnson. Valid for delta < 0.20 c. For comparison with DyS; otherwise
    prefer Johnson.

    Source: Skrinjar, Slavic & Boltezar 2017, Nonlinear Dyn. 88, 131; program DyS.
    """

    modulus: Scalar | AbstractFit = modulus_field()
    clearance: Scalar | AbstractFit = clearance_field()
    length: Scalar | AbstractFit = length_field()
    restitution: Scalar | None = restitution_field(None)
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()

    @property
    def remembers_impact_speed(self) -> bool:
        return self.restitution is not None

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return damped(self, self.elastic_force(indentation), rate, impact_speed)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return logarithmic_force(
            indentation, self.modulus, self.clearance, self.length, 2.0, 1.0, -1.0
        )


class Radzimovsky(AbstractContactLaw):
    """delta = f/(pi E*) (2/3 + ln(4 R_i / w) + ln(4 R_j / w)), w = 1.60 sqrt(2 f R_i R_j / ((R_j -
    R_i) E*)).

    w is the full width of contact; the radii cancel, so delta = f/(pi E*) (ln(16 E* c / (2 1.60^2
    f)) + 2/3). Valid for delta < 0.52 c; 2 to 8 per cent softer than Johnson up to delta = 0.1 c
    (2/3 against ln 4 - 1 = 0.39).

    Source: Radzimovsky 1953, Univ. Illinois Bull. 408; Roark, Formulas for Stress and Strain, line
    contact of cylinders; Pereira, Ramalho & Ambrosio 2011.
    """

    modulus: Scalar | AbstractFit = modulus_field()
    clearance: Scalar | AbstractFit = clearance_field()
    length: Scalar | AbstractFit = length_field()
    restitution: Scalar | None = restitution_field(None)
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()

    @property
    def remembers_impact_speed(self) -> bool:
        return self.restitution is not None

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return damped(self, self.elastic_force(indentation), rate, impact_speed)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        ratio = 16 / (2 * ROARK_WIDTH**2 * jnp.pi)
        return logarithmic_force(
            indentation, self.modulus, self.clearance, self.length, 1.0, ratio, 2 / 3
        )


class Goldsmith(AbstractContactLaw):
    """delta = f/(pi E*) (ln(L^3 c pi E* / (F R_i R_j)) + 1), as repaired by Dubowsky and
    Freudenstein.

    Goldsmith prints L where L^3 must stand (the logarithm had a dimension). The contact length
    enters the logarithm itself, so two halves of a bearing do not add up to the whole: use only for
    L near the radii, and prefer Johnson. Valid for delta < 0.74 c L^2 / (R_i R_j).

    Source: Goldsmith 1960, Impact, ch. 4; Dubowsky & Freudenstein 1971, J. Eng. Ind. 93, 305;
    Flores, Ambrosio, Claro & Lankarani 2006, Proc. IMechE K 220, 21.
    """

    modulus: Scalar | AbstractFit = modulus_field()
    inner_radius: Scalar | AbstractFit = quantity(
        unit="m", meaning="journal's radius R_i", default_factory=InnerRadiusOf
    )
    outer_radius: Scalar | AbstractFit = quantity(
        unit="m", meaning="bearing's radius R_j", default_factory=OuterRadiusOf
    )
    length: Scalar | AbstractFit = length_field()
    restitution: Scalar | None = restitution_field(None)
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()

    @property
    def remembers_impact_speed(self) -> bool:
        return self.restitution is not None

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return damped(self, self.elastic_force(indentation), rate, impact_speed)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        clearance = self.outer_radius - self.inner_radius
        ratio = self.length * self.length / (self.inner_radius * self.outer_radius)
        return logarithmic_force(indentation, self.modulus, clearance, self.length, 1.0, ratio, 1.0)


class Liu(AbstractContactLaw):
    """F = 1/2 pi E* L delta sqrt(delta / (2 (c + delta))): distributed springs over the overlap of
    two circles.

    Explicit, and good where the others end: small clearance, large loads, delta of the order of c.
    For delta far below c its F ~ delta^1.5 is too soft; there prefer Johnson.

    Source: Liu, Zhang & Yang 2007, Mech. Mach. Theory 42, 183.
    """

    modulus: Scalar | AbstractFit = modulus_field()
    clearance: Scalar | AbstractFit = clearance_field()
    length: Scalar | AbstractFit = length_field()
    restitution: Scalar | None = restitution_field(None)
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()

    @property
    def remembers_impact_speed(self) -> bool:
        return self.restitution is not None

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return damped(self, self.elastic_force(indentation), rate, impact_speed)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        depth = positive_part(indentation)
        area = safe_divide(power(depth, None), safe_sqrt(2 * (self.clearance + depth)))
        return 1 / 2 * jnp.pi * self.modulus * self.length * area


class BaiZhao(AbstractContactLaw):
    """F = K(delta) delta (1 + 3 (1 - c_e^2) exp(2 (1 - c_e)) rate / (4 impact_speed)), K the slope
    dF/ddelta of Liu's law.

    K = 1/8 pi E* L sqrt(2 delta (3 c + 2 delta)^2 / (c + delta)^3). Slope times indentation is up
    to 3/2 of Liu's own force; the rebound is 0.004 too low at c_e = 0.9, 0.02 at 0.5. Prefer Liu
    with a restitution.

    Source: Bai & Zhao 2013, Int. J. Non-Linear Mech. 48, 15, where K is written without L.
    """

    modulus: Scalar | AbstractFit = modulus_field()
    clearance: Scalar | AbstractFit = clearance_field()
    length: Scalar | AbstractFit = length_field()
    restitution: Scalar = restitution_field()
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()
    remembers_impact_speed: ClassVar[bool] = True

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        factor = hysteresis.zhu(self.restitution)
        elastic = self.elastic_force(indentation)
        return hysteresis.with_hysteresis(elastic, factor, rate, impact_speed, self.slowest_impact)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        depth = positive_part(indentation)
        widened = self.clearance + depth
        shape = (3 * self.clearance + 2 * depth) * safe_divide(
            power(depth, None), widened * safe_sqrt(widened)
        )
        return math.sqrt(2) / 8 * jnp.pi * self.modulus * self.length * shape
