"""How hard: the normal force of a point contact from its indentation.

Indentation delta [m] is positive in contact, rate [m/s] positive while closing, impact_speed [m/s]
the closing speed at first touch, force [N] never negative. Fields left at `None` for an exponent
mean Hertz's 3/2. Every damped law with a coefficient of restitution has the form f(delta) (1 + d
rate / impact_speed); what d must be is in `hysteresis`.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx

from jaxclear.ground.numerics import positive_part, power, safe_divide, safe_sqrt, smooth_step
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws import hysteresis
from jaxclear.laws.stiffness import HERTZ_SPHERE, AbstractFit, ClearanceOf, OuterRadiusOf


def stiffness_field():
    return quantity(1e10, "N/m^exponent", "generalized contact stiffness K", above=0)


def exponent_field():
    return quantity(None, "1", "exponent of the indentation, above 1 (None: Hertz's 3/2)", above=1)


def restitution_field(default=0.9):
    return quantity(
        default, "1", "coefficient of restitution c_e, 0 < c_e <= 1", above=0, at_most=1
    )


def memory_time_field():
    return quantity(
        1e-4,
        "s",
        "time constant with which the stored impact speed follows the approach speed while open",
        above=0,
    )


def slowest_impact_field():
    return quantity(
        1e-3,
        "m/s",
        "an impact slower than this is damped as if at this speed (rest is no division by 0)",
        above=0,
    )


class AbstractNormalLaw(AbstractQuantified):
    """What happens along the normal of one contact point."""


class Rigid(AbstractNormalLaw):
    """Bodies that do not overlap: no stiffness, no function of the indentation. For
    integrator.MoreauJean only.

    An impact in which one contact closes ends with restitution times the speed before (Newton).
    Where a force is wanted as a function, take CarvalhoMartins.

    Source: Newton 1687; as a complementarity of percussion and velocity Moreau 1988, in Nonsmooth
    Mechanics and Applications, 1.
    """

    restitution: Scalar = quantity(
        0.9, "1", "coefficient of restitution c_e, 0 <= c_e <= 1", at_least=0, at_most=1
    )
    remembers_impact_speed: ClassVar[bool] = False

    def elastic_force(self, indentation: Scalar) -> Scalar:
        """Nothing is stored."""
        return 0.0


class AbstractContactLaw(AbstractNormalLaw):
    """Normal force of one contact point. Zero while open, continuous at touch, never pulling,
    dissipating or elastic.
    """

    remembers_impact_speed: eqx.AbstractClassVar[bool]
    """True: the engine must supply the speed of first touch. False: `impact_speed` is ignored and
    costs no state.
    """

    @abstractmethod
    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        """Force [N] >= 0; 0 when indentation <= 0."""

    @abstractmethod
    def elastic_force(self, indentation: Scalar) -> Scalar:
        """The conservative part [N]: its integral over the indentation is the stored energy."""


class Hertz(AbstractContactLaw):
    """F = K delta^n. No loss at all; the oracle of the family. For rebounds with loss prefer Flores
    or CarvalhoMartins.

    Source: Hertz 1882, J. reine angew. Math. 92, 156; Johnson 1985, eq. 4.23.
    """

    stiffness: Scalar | AbstractFit = stiffness_field()
    exponent: Scalar | None = exponent_field()
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return self.elastic_force(indentation)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class KelvinVoigt(AbstractContactLaw):
    """F = max(0, K delta + D s(delta) rate), s a cubic step from 0 at touch to 1 at `onset_depth`.

    The textbook law (s = 1) jumps by D rate at touch and pulls before it opens; the step and the
    clamp remove both, at the price of slightly less loss. Rebound exp(-pi zeta / sqrt(1 - zeta^2))
    with zeta = D / (2 sqrt(K m)) only while `onset_depth` is far below the deepest indentation.
    Prefer a Hertzian law for metal on metal.

    Source: Goldsmith 1960, Impact; Flores & Lankarani 2016, Contact Force Models, ch. 3.
    """

    stiffness: Scalar | AbstractFit = quantity(1e8, "N/m", "spring stiffness K", above=0)
    damping: Scalar = quantity(1e3, "N s/m", "damper coefficient D", at_least=0)
    onset_depth: Scalar = quantity(
        1e-7, "m", "indentation at which the damper acts in full", above=0
    )
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        damper = self.damping * smooth_step(indentation, 0.0, self.onset_depth) * rate
        return positive_part(self.elastic_force(indentation) + damper)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * positive_part(indentation)


class MarhefkaOrin(AbstractContactLaw):
    """F = K delta^n (1 + 3/2 a rate): Hunt and Crossley's damper with a constant a, so that nothing
    is remembered.

    The restitution falls with the impact speed, e ~ 1 - a v, as measured on metals at low speed (a
    = 0.08 ... 0.32 s/m). The cheapest damped law; where e must not depend on the speed prefer
    CarvalhoMartins.

    Source: Hunt & Crossley 1975, J. Appl. Mech. 42, 440; Marhefka & Orin 1999, IEEE Trans. SMC-A
    29, 566.
    """

    stiffness: Scalar | AbstractFit = stiffness_field()
    exponent: Scalar | None = exponent_field()
    dissipation: Scalar = quantity(
        0.2, "s/m", "a: loss of restitution per impact speed", at_least=0
    )
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        return self.elastic_force(indentation) * positive_part(1 + 3 / 2 * self.dissipation * rate)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class HuntCrossley(AbstractContactLaw):
    """F = K delta^n (1 + 3 (1 - c_e) rate / (2 impact_speed)).

    For hard contacts, c_e > 0.8: the rebound is 0.009 too high at 0.9, 0.16 at 0.5. Prefer
    CarvalhoMartins below.

    Source: Hunt & Crossley 1975, J. Appl. Mech. 42, 440; in this form Flores & Lankarani 2016, ch.
    3.
    """

    stiffness: Scalar | AbstractFit = stiffness_field()
    exponent: Scalar | None = exponent_field()
    restitution: Scalar = restitution_field()
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()
    remembers_impact_speed: ClassVar[bool] = True

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        factor = hysteresis.hunt_crossley(self.restitution)
        elastic = self.elastic_force(indentation)
        return hysteresis.with_hysteresis(elastic, factor, rate, impact_speed, self.slowest_impact)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class LankaraniNikravesh(AbstractContactLaw):
    """F = K delta^n (1 + 3 (1 - c_e^2) rate / (4 impact_speed)).

    For hard contacts, c_e > 0.8: the rebound is 0.013 too high at 0.9, 0.23 at 0.5. Prefer
    CarvalhoMartins below.

    Source: Lankarani & Nikravesh 1990, J. Mech. Des. 112, 369; four-bar paper (001), eq. 1.
    """

    stiffness: Scalar | AbstractFit = stiffness_field()
    exponent: Scalar | None = exponent_field()
    restitution: Scalar = restitution_field()
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()
    remembers_impact_speed: ClassVar[bool] = True

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        factor = hysteresis.lankarani_nikravesh(self.restitution)
        elastic = self.elastic_force(indentation)
        return hysteresis.with_hysteresis(elastic, factor, rate, impact_speed, self.slowest_impact)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class Flores(AbstractContactLaw):
    """F = K delta^n (1 + 8 (1 - c_e) rate / (5 c_e impact_speed)).

    Made for soft contacts: the rebound is at most 0.045 too low, 0.006 at 0.9. CarvalhoMartins is
    closer at the same cost.

    Source: Flores, Machado, Silva & Martins 2011, Multibody Syst. Dyn. 25, 357.
    """

    stiffness: Scalar | AbstractFit = stiffness_field()
    exponent: Scalar | None = exponent_field()
    restitution: Scalar = restitution_field()
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()
    remembers_impact_speed: ClassVar[bool] = True

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        factor = hysteresis.flores(self.restitution)
        elastic = self.elastic_force(indentation)
        return hysteresis.with_hysteresis(elastic, factor, rate, impact_speed, self.slowest_impact)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class Gonthier(AbstractContactLaw):
    """F = K delta^n (1 + d rate / impact_speed) with the d that returns exactly c_e.

    (1 + d) = (1 - d c_e) exp(d (1 + c_e)), solved at every evaluation; exact for 0.02 <= c_e <= 1.
    Dearer than CarvalhoMartins, which is its closed approximation: prefer that one inside a time
    loop.

    Source: Gonthier, McPhee, Lange & Piedboeuf 2004, Multibody Syst. Dyn. 11, 209.
    """

    stiffness: Scalar | AbstractFit = stiffness_field()
    exponent: Scalar | None = exponent_field()
    restitution: Scalar = restitution_field()
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()
    remembers_impact_speed: ClassVar[bool] = True

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        factor = hysteresis.gonthier(self.restitution)
        elastic = self.elastic_force(indentation)
        return hysteresis.with_hysteresis(elastic, factor, rate, impact_speed, self.slowest_impact)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class CarvalhoMartins(AbstractContactLaw):
    """F = K delta^n (1 + 3 (1 - c_e) (11 - c_e) rate / (2 (1 + 9 c_e) impact_speed)).

    The closest closed formula: the rebound is within 1e-5 at 0.9, 0.0002 at 0.5, 0.004 at 0.3, 0.03
    at 0.1. The law to start from.

    Source: Carvalho & Martins 2019, Mech. Mach. Theory 139, 174.
    """

    stiffness: Scalar | AbstractFit = stiffness_field()
    exponent: Scalar | None = exponent_field()
    restitution: Scalar = restitution_field()
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()
    remembers_impact_speed: ClassVar[bool] = True

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        factor = hysteresis.carvalho_martins(self.restitution)
        elastic = self.elastic_force(indentation)
        return hysteresis.with_hysteresis(elastic, factor, rate, impact_speed, self.slowest_impact)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)


class ModifiedFlores(AbstractContactLaw):
    """Ball in socket, F = K(delta) delta (1 + 8 (1 - c_e) rate / (5 c_e impact_speed)), K growing
    with the contact area.

    K(delta) = 4/3 E* R_s sqrt(delta / (c + delta)): for delta << c this is Hertz's law for a ball
    in a socket, for delta >> c the contact area stops growing and F is linear. Contact radius at
    most the socket's. For a journal in a bearing prefer `conformal.Liu`; rebound as with Flores.

    RECONSTRUCTED. The 3RSR paper (003: Hou, Deng & Zeng 2021, eq. 20 and 21, exponent n = 1) says
    that K depends on R_s, c, E* and delta, but its eq. 21 is lost in the text at hand, as is the
    distributed-spring model behind it (Liu, Zhang & Yang 2006, J. Comput. Nonlinear Dyn. 1, 160). K
    here is that model's shape, radius of contact R_s sqrt(delta / (c + delta)) under Hertz's
    pressure, its constant chosen so that small indentations are Hertz's.
    """

    modulus: Scalar | AbstractFit = quantity(
        112.9e9, "Pa", "combined modulus E* (default: steel on steel)", above=0
    )
    socket_radius: Scalar | AbstractFit = quantity(
        unit="m", meaning="socket's radius R_s", default_factory=OuterRadiusOf
    )
    clearance: Scalar | AbstractFit = quantity(
        unit="m", meaning="radial clearance c", default_factory=ClearanceOf
    )
    restitution: Scalar = restitution_field()
    memory_time: Scalar = memory_time_field()
    slowest_impact: Scalar = slowest_impact_field()
    remembers_impact_speed: ClassVar[bool] = True

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        factor = hysteresis.flores(self.restitution)
        elastic = self.elastic_force(indentation)
        return hysteresis.with_hysteresis(elastic, factor, rate, impact_speed, self.slowest_impact)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        depth = positive_part(indentation)
        area = safe_divide(power(depth, None), safe_sqrt(self.clearance + depth))
        return HERTZ_SPHERE * self.modulus * self.socket_radius * area


class AdamsImpact(AbstractContactLaw):
    """The IMPACT function of Adams: F = max(0, K delta^n + STEP(delta, 0, 0, d_max, c_max) rate).

    Loss depends on mass and speed; no restitution is prescribed. Made to run, not to predict:
    prefer CarvalhoMartins where the rebound matters.

    Source: MSC Adams/Solver, IMPACT; flap paper (002), eq. 6. Misprints there: the first case
    (delta <= 0) must be 0, not K delta^1.5, the third holds from delta = d_max on, the force must
    be clamped at 0 as Adams does, and "c_max is about one percent of the stiffness" equates N s/m
    with N/m^1.5 (a habit of numbers in N and mm, not a law).
    """

    stiffness: Scalar | AbstractFit = stiffness_field()
    exponent: Scalar | None = exponent_field()
    damping: Scalar = quantity(1e3, "N s/m", "largest damping coefficient c_max", at_least=0)
    full_damping_depth: Scalar = quantity(
        1e-5, "m", "indentation d_max at which damping is largest", above=0
    )
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        damper = smooth_step(indentation, 0.0, self.full_damping_depth, 0.0, self.damping) * rate
        return positive_part(self.elastic_force(indentation) + damper)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.stiffness * power(indentation, self.exponent)
