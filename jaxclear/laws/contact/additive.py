"""Laws whose damper stands beside the spring: no factor of the elastic force, no prescribed
restitution.
"""

from typing import ClassVar

from jaxclear.ground.numerics import positive_part, power, smooth_step
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact.base import AbstractContactLaw, exponent_field, stiffness_field
from jaxclear.laws.stiffness import Fitted


class KelvinVoigt(AbstractContactLaw):
    r""":math:`F = \max(0, K\delta + D\,s(\delta)\,\dot\delta)`, s a cubic step from 0 at touch to 1
    at `onset_depth`.

    The textbook law (s = 1) jumps by :math:`D\dot\delta` at touch and pulls before it opens; the
    step and the clamp remove both, at the price of slightly less loss. Rebound
    :math:`\exp(-\pi\zeta/\sqrt{1 - \zeta^2})` with :math:`\zeta = D/(2\sqrt{K m})` only while
    `onset_depth` is far below the deepest indentation. Prefer a Hertzian law for metal on metal.

    Source: Goldsmith 1960, Impact; Flores & Lankarani 2016, Contact Force Models, ch. 3,
    doi:10.1007/978-3-319-30897-5.
    """

    stiffness: Fitted = quantity(1e8, "N/m", "spring stiffness K", above=0)
    damping: Scalar = quantity(1e3, "N s/m", "damper coefficient D", at_least=0)
    onset_depth: Scalar = quantity(
        1e-7, "m", "indentation at which the damper acts in full", above=0
    )
    restitution: ClassVar[None] = None
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        damper = self.damping * smooth_step(indentation, 0.0, self.onset_depth) * rate
        return positive_part(self.elastic_force(indentation) + damper)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * positive_part(indentation)


class AdamsImpact(AbstractContactLaw):
    r"""The IMPACT function of Adams: :math:`F = \max(0, K\delta^n + \mathrm{STEP}(\delta, 0, 0,
    d_{max}, c_{max})\,\dot\delta)`.

    Loss depends on mass and speed; no restitution is prescribed. Made to run, not to predict:
    prefer CarvalhoMartins where the rebound matters.

    Source: MSC Adams/Solver, IMPACT; Wan, Liu, Ma & Tong, "Investigation on Dynamic Interaction of
    Multiple Clearance Joints for Flap Actuation System", eq. 6. Misprints there: the first case
    (delta <= 0) must be 0, not K delta^1.5, the third holds from delta = d_max on, the force must
    be clamped at 0 as Adams does, and "c_max is about one percent of the stiffness" equates N s/m
    with N/m^1.5 (a habit of numbers in N and mm, not a law).
    """

    stiffness: Fitted = stiffness_field()
    exponent: Scalar | None = exponent_field()
    damping: Scalar = quantity(1e3, "N s/m", "largest damping coefficient c_max", at_least=0)
    full_damping_depth: Scalar = quantity(
        1e-5, "m", "indentation d_max at which damping is largest", above=0
    )
    restitution: ClassVar[None] = None
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        damper = smooth_step(indentation, 0.0, self.full_damping_depth, 0.0, self.damping) * rate
        return positive_part(self.elastic_force(indentation) + damper)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)
