r"""Laws of the flanks of play: what presses where a shaft or a tooth, of stiffness k and damping d,
has gone through its gap.

Of a flank :math:`\delta` is how far the parts are beyond the touch, :math:`\dot\delta` its rate;
the torque [N m] (a force [N] of what slides) pushes them apart and never pulls. k and d are those
of the coupling that has the play.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.quantity import Scalar
from jaxclear.laws.law import AbstractLaw
from jaxclear.laws.transmission import bounded_damper

__all__ = ["AbstractFlankLaw", "ElastoBacklash", "Nordin", "Stop"]


class AbstractFlankLaw(AbstractLaw):
    """How a flank presses.

    Class attributes of a member: `has_twist`, whether the position of the shaft's far end in the
    gap is a state; `separates_by_torque`, whether the parts separate where the torque would pull
    (else where they are no longer beyond the touch); `needs_damping`, whether the law has no
    meaning without damping.
    """

    has_twist: eqx.AbstractClassVar[bool]
    separates_by_torque: eqx.AbstractClassVar[bool]
    needs_damping: eqx.AbstractClassVar[bool]

    @abstractmethod
    def torque(self, elastic: Scalar, viscous: Any) -> Scalar:
        """Torque of a flank that presses.

        Args:
            elastic: stiffness times depth beyond the touch [N m] (of what slides [N]).
            viscous: damping times rate of that depth [N m] (of what slides [N]); 0 without damping.

        Returns:
            the torque [N m] (a force [N] of what slides) that pushes the parts apart.
        """


class Nordin(AbstractFlankLaw):
    r"""A shaft of stiffness k and damping d in series with a gap, in which it relaxes.

    Its far end is at :math:`\theta` in the gap, :math:`|\theta - m| \le b` (b half the play, m its
    middle), the parts are s apart, and the torque is :math:`k(s - \theta) + d(\dot s -
    \dot\theta)`. Between the flanks it is 0, so that :math:`\dot\theta = \dot s + (k/d)(s -
    \theta)`; on a flank :math:`\theta` stands still, and leaves it where the torque would pull.
    Prefer it where the damping is that of the shaft; `Stop` where it is that of the flanks.

    Source: Nordin, Galić & Gutman 1997, Int. J. Adapt. Control Signal Process. 11, 49, eq. 8,
    doi:10.1002/(SICI)1099-1115(199702)11:1<49::AID-ACS394>3.0.CO;2-X.
    """

    has_twist = True
    separates_by_torque = True
    needs_damping = True

    def torque(self, elastic, viscous):
        return elastic + viscous


class Stop(AbstractFlankLaw):
    r"""A spring and a damper on each flank, :math:`\max(0, k\delta + d\dot\delta)`: the damper acts
    in full from the touch on, and neither pulls: a flank is left where the torque would.

    `load.JointStop` lets the damper set in over a depth.
    """

    has_twist = False
    separates_by_torque = True
    needs_damping = False

    def torque(self, elastic, viscous):
        return elastic + viscous


class ElastoBacklash(AbstractFlankLaw):
    r"""A spring and a damper on each flank, the damper bounded by the spring:
    :math:`k\delta + d\dot\delta` between 0 and :math:`2k\delta`, so that the torque begins at 0
    however fast the flank is met.

    Source: Modelica Standard Library 4.0, Rotational.Components.ElastoBacklash2.
    """

    has_twist = False
    separates_by_torque = False
    needs_damping = False

    def torque(self, elastic, viscous):
        return elastic + bounded_damper(elastic, viscous)


__getattr__, __dir__ = nothing_else("jaxclear.flank", __all__)
