r"""How much is lost: dissipation factors, by which an elastic force grows while closing and falls
while opening.

For every force :math:`F_{el}(\delta)\,(1 + d\,\dot\delta/\dot\delta^{(-)})`, whatever
:math:`F_{el}`, a mass that strikes at :math:`\dot\delta^{(-)}` leaves at e times that speed with
:math:`1 + d = (1 - d e)\,e^{d(1 + e)}`. Gonthier solves this; the others are published
approximations of d for a prescribed coefficient of restitution :math:`c_e`. Each says by how much
its rebound e misses :math:`c_e`, here and, in a warning, where it is built. Prefer CarvalhoMartins.
"""

import math
from abc import abstractmethod
from typing import Any, ClassVar

import jax.numpy as jnp

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.quantity import Scalar, concrete, on_host, quantity
from jaxclear.ground.warning import warn
from jaxclear.ground.wording import public_name
from jaxclear.laws.contact.base import AbstractDissipation

__all__ = [
    "AbstractRestitutionFactor",
    "CarvalhoMartins",
    "Flores",
    "Gonthier",
    "HerbertMcWhannell",
    "HuGuo",
    "HuntCrossley",
    "LankaraniNikravesh",
    "MarhefkaOrin",
    "RestitutionMissed",
    "ZhiyingQishao",
]
__getattr__, __dir__ = nothing_else("jaxclear.contact.dissipation", __all__)

# Gonthier et al. 2004 solve the relation numerically; steps that carry it to rounding for 0.02 <=
# e.
NEWTON_STEPS = 8
# Closer to e = 1 the two roots merge and cancel; there Carvalho & Martins' formula is already exact
# to 1e-8.
NEARLY_ELASTIC = 1e-4
# Below this d exceeds 50, the rebound is lost in the clamp at zero force, and exp(-1/e) underflows.
LEAST_RESTITUTION = 0.02
# A rebound that misses c_e by this share of it is told: what studies ask of a response.
MISSED = 0.02
# Below this d the rebound is 1 - 2 d / 3 to rounding, and the relation's terms cancel.
NO_LOSS = 1e-6


class RestitutionMissed(UserWarning):
    """A law that does not rebound by the coefficient of restitution that it is given."""


def restitution_field() -> Any:
    """Field of a prescribed coefficient of restitution [1]."""
    return quantity(0.9, "1", above=0, at_most=1)


class AbstractRestitutionFactor(AbstractDissipation):
    r"""Damping that aims at a prescribed coefficient of restitution: :math:`\lambda =
    d(c_e)/\dot\delta^{(-)}`.
    """

    remembers_impact_speed = True

    @abstractmethod
    def factor(self) -> Scalar:
        """d [1] >= 0, 0 at restitution 1."""

    def __check_init__(self):
        prescribed, factor = concrete(self.restitution), concrete(on_host(self).factor())
        if prescribed is None or factor is None:
            return
        rebound = restitution_for(factor)
        off = rebound / prescribed - 1
        if abs(off) > MISSED:
            side = "high" if off > 0 else "low"
            warn(
                f"{public_name(type(self))} with restitution {prescribed:g} rebounds with "
                f"{rebound:.3g}, {abs(100 * off):.2g} % too {side}, in compliant contact. "
                "CarvalhoMartins is the closest closed formula, Gonthier exact.",
                RestitutionMissed,
            )

    def relative_damping(self, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return self.factor() * rate / impact_speed


def restitution_for(factor: float) -> float:
    """e [1] of the relation above for the factor d: in y = -ln(1 - d e) it is y = d (1 + e) -
    ln(1 + d), whose residual is convex; Newton's method comes down to its root from d + 1."""
    if factor < NO_LOSS:
        return 1 - 2 * factor / 3
    y, before = factor + 1, math.inf
    while y < before:
        before = y
        residual = y - factor + math.expm1(-y) + math.log1p(factor)
        y -= residual / -math.expm1(-y)
    return -math.expm1(-y) / factor


class HuntCrossley(AbstractRestitutionFactor):
    r""":math:`d = \frac32(1 - c_e)`. For hard contacts, :math:`c_e > 0.8`: the rebound is 0.009 too
    high at 0.9, 0.16 at 0.5.

    Args:
        restitution: coefficient of restitution c_e [1], > 0 and <= 1.

    Source: Hunt & Crossley 1975, J. Appl. Mech. 42, 440, doi:10.1115/1.3423596; in this form Flores
    & Lankarani 2016, Contact Force Models, ch. 3, doi:10.1007/978-3-319-30897-5.
    """

    restitution: Scalar = restitution_field()

    def factor(self) -> Scalar:
        return 3 / 2 * (1 - self.restitution)


class LankaraniNikravesh(AbstractRestitutionFactor):
    r""":math:`d = \frac34(1 - c_e^2)`. For hard contacts, :math:`c_e > 0.8`: the rebound is 0.013
    too high at 0.9, 0.23 at 0.5.

    Args:
        restitution: coefficient of restitution c_e [1], > 0 and <= 1.

    Source: Lankarani & Nikravesh 1990, J. Mech. Des. 112, 369, doi:10.1115/1.2912617.
    """

    restitution: Scalar = restitution_field()

    def factor(self) -> Scalar:
        return 3 / 4 * (1 - self.restitution * self.restitution)


class HerbertMcWhannell(AbstractRestitutionFactor):
    """:math:`d = 6(1 - c_e)/((2c_e - 1)^2 + 3)`. For hard contacts: the rebound is 0.0009 too high
    at 0.9, 0.094 at 0.5.

    Args:
        restitution: coefficient of restitution c_e [1], > 0 and <= 1.

    Source: Herbert & McWhannell 1977, J. Eng. Ind. 99, 513, doi:10.1115/1.3439270.
    """

    restitution: Scalar = restitution_field()

    def factor(self) -> Scalar:
        skew = 2 * self.restitution - 1
        return 6 * (1 - self.restitution) / (skew * skew + 3)


class Flores(AbstractRestitutionFactor):
    r""":math:`d = \frac85(1 - c_e)/c_e`. Made for soft contacts: the rebound is at most 0.046 too
    low, 0.006 at 0.9, 0.030 at 0.5.

    Args:
        restitution: coefficient of restitution c_e [1], > 0 and <= 1.

    Source: Flores, Machado, Silva & Martins 2011, Multibody Syst. Dyn. 25, 357,
    doi:10.1007/s11044-010-9237-4.
    """

    restitution: Scalar = restitution_field()

    def factor(self) -> Scalar:
        return 8 / 5 * (1 - self.restitution) / self.restitution


class HuGuo(AbstractRestitutionFactor):
    r""":math:`d = \frac32(1 - c_e)/c_e`. The rebound is at most 0.035 too low, 0.0001 at 0.9, 0.012
    at 0.5.

    Args:
        restitution: coefficient of restitution c_e [1], > 0 and <= 1.

    Source: Hu & Guo 2015, Multibody Syst. Dyn. 35, 131, doi:10.1007/s11044-015-9453-z.
    """

    restitution: Scalar = restitution_field()

    def factor(self) -> Scalar:
        return 3 / 2 * (1 - self.restitution) / self.restitution


class ZhiyingQishao(AbstractRestitutionFactor):
    r""":math:`d = \frac34(1 - c_e^2)\,e^{2(1 - c_e)}`. The rebound is 0.004 too low at 0.9, 0.017
    at 0.5, and too high below 0.4. The factor of Bai and Zhao's law.

    Args:
        restitution: coefficient of restitution c_e [1], > 0 and <= 1.

    Source: Zhiying Qin & Qishao Lu 2006, Analysis of impact process based on restitution
    coefficient, J. Dyn. Control 4, 294; Bai & Zhao 2013, Int. J. Non-Linear Mech. 48, 15,
    doi:10.1016/j.ijnonlinmec.2012.07.003.
    """

    restitution: Scalar = restitution_field()

    def factor(self) -> Scalar:
        e = self.restitution
        return 3 / 4 * (1 - e * e) * jnp.exp(2 * (1 - e))


class CarvalhoMartins(AbstractRestitutionFactor):
    r""":math:`d = \frac32(1 - c_e)(11 - c_e)/(1 + 9c_e)`. The closest closed formula and the one to
    start from: the rebound is within 1e-5 at 0.9, 0.0002 at 0.5, 0.004 at 0.3, 0.03 at 0.1.

    Args:
        restitution: coefficient of restitution c_e [1], > 0 and <= 1.

    Source: Carvalho & Martins 2019, Mech. Mach. Theory 139, 174,
    doi:10.1016/j.mechmachtheory.2019.03.028.
    """

    restitution: Scalar = restitution_field()

    def factor(self) -> Scalar:
        return _carvalho_martins(self.restitution)


class Gonthier(AbstractRestitutionFactor):
    r"""The d that returns exactly :math:`c_e`, by Newton's method in :math:`y = -\ln(1 - d e)` at
    every evaluation.

    Exact to 1e-8 or better for 0.02 <= c_e <= 1, 0.9 and 0.5 included; a smaller one counts as
    0.02. The explicit :math:`(1 - e^2)/e` that the same paper offers is a third too large near 1
    and is not used. Dearer than CarvalhoMartins, its closed approximation: prefer that one inside a
    time loop.

    Args:
        restitution: coefficient of restitution c_e [1], > 0 and <= 1.

    Source: Gonthier, McPhee, Lange & Piedbœuf 2004, Multibody Syst. Dyn. 11, 209,
    doi:10.1023/B:MUBO.0000029392.21648.bc.
    """

    restitution: Scalar = restitution_field()

    def factor(self) -> Scalar:
        start = _carvalho_martins(self.restitution)
        e = jnp.clip(self.restitution, LEAST_RESTITUTION, 1 - NEARLY_ELASTIC)
        first = _carvalho_martins(e)
        y = first * (1 + e) - jnp.log1p(first)
        for _ in range(NEWTON_STEPS):
            d = -jnp.expm1(-y) / e
            value = y - d * (1 + e) + jnp.log1p(d)
            slope = 1 + (jnp.exp(-y) / e) * (1 / (1 + d) - 1 - e)
            # The root y = 0 (no damping) is divided out: Newton on value / y^2.
            y = y - value / (slope - 2 * value / y)
        return jnp.where(self.restitution > 1 - NEARLY_ELASTIC, start, -jnp.expm1(-y) / e)


class MarhefkaOrin(AbstractDissipation):
    r""":math:`\lambda = \frac32 a`, a constant, so that nothing is remembered.

    The restitution falls with the impact speed, :math:`e \approx 1 - a v`, as measured on metals at
    low speed (a = 0.08 ... 0.32 s/m): 0.91 for a v = 0.1, 0.66 for 0.5. The cheapest loss; where e
    must not depend on the speed prefer CarvalhoMartins.

    Args:
        loss_per_speed: loss a of restitution per impact speed [s/m], >= 0.

    Source: Hunt & Crossley 1975, J. Appl. Mech. 42, 440, doi:10.1115/1.3423596; Marhefka & Orin
    1999, IEEE Trans. SMC-A 29, 566, doi:10.1109/3468.798060.
    """

    loss_per_speed: Scalar = quantity(0.2, "s/m", at_least=0)
    restitution: ClassVar[None] = None
    remembers_impact_speed: ClassVar[bool] = False

    def relative_damping(self, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return 3 / 2 * self.loss_per_speed * rate


def _carvalho_martins(restitution: Scalar) -> Scalar:
    return 3 / 2 * (1 - restitution) * (11 - restitution) / (1 + 9 * restitution)
