"""Sideways: the friction coefficient of one contact point from its sliding.

Three kinds. A slip law maps the speed |v| >= 0 to a coefficient >= 0 that is 0 at rest; the engine
forms traction = -F_n coefficient(|v|) v/|v|. A bristle law carries a deflection per tangential
component and gives a signed coefficient per component; traction = -F_n coefficient. A set-valued
law has no function at all and only serves the complementarity formulation. Slip laws creep under a
steady side load at rest; a bristle or set-valued law sticks.
"""

from abc import abstractmethod

import jax.numpy as jnp

from jaxclear.ground.numerics import smooth_sign, smooth_step
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete, quantity

# LuGre's bristles yield at a deflection in proportion to the friction level: to no less than this
# share of the largest, and a largest coefficient below LEAST_FRICTION is no friction.
LEAST_SHARE = 1e-3
LEAST_FRICTION = 1e-12
# Sliding slower than this [m/s] is rounding of a contact that sticks.
STICKING_SPEED = 1e-10
# a z^2 + t a z w + t w^2 >= 0 for all z, w while t a <= 4: the damping of a bristle that cannot
# give energy.
PASSIVE_DAMPING = 4.0


def mu_static_field():
    return quantity(0.15, "1", "static friction coefficient mu_s", at_least=0)


def mu_kinetic_field():
    return quantity(0.1, "1", "kinetic friction coefficient mu_d", at_least=0)


class AbstractFrictionLaw(AbstractQuantified):
    """Friction of one contact point. Opposes sliding, never gives energy, in proportion to the
    normal force.
    """


class AbstractSlipFriction(AbstractFrictionLaw):
    """A function of the sliding speed alone; slope at rest finite."""

    @abstractmethod
    def coefficient(self, slip_speed: Scalar) -> Scalar:
        """Traction over normal force, >= 0, from the sliding speed [m/s] >= 0."""


class AbstractBristleFriction(AbstractFrictionLaw):
    """Friction with one deflection [m] per tangential component as state, 0 when the surfaces are
    fresh.
    """

    @abstractmethod
    def deflection_rate(self, deflection: Scalar, slip: Scalar, slip_speed: Scalar) -> Scalar:
        """Rate [m/s] of one component's deflection; slip: that component's velocity, slip_speed:
        all components' norm.
        """

    @abstractmethod
    def coefficient(self, deflection: Scalar, deflection_rate: Scalar, slip: Scalar) -> Scalar:
        """Signed component of (minus traction) over normal force."""


class AbstractSetValuedFriction(AbstractFrictionLaw):
    """Friction that at rest is any force up to a bound: for the complementarity formulation
    only."""


class Coulomb(AbstractSetValuedFriction):
    """|F_t| <= mu_s F_n at rest, F_t = -mu_d F_n v/|v| sliding: true sticking, no function of the
    speed.

    Where the formulation needs a function take CoulombTanh (cheap, creeps) or Dahl (sticks).

    Source: Coulomb 1785; as a complementarity problem Pfeiffer & Glocker 1996, Multibody Dynamics
    with Unilateral Contacts.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    mu_static: Scalar | None = quantity(
        None, "1", "static friction coefficient mu_s (None: as the kinetic one)", at_least=0
    )

    def __check_init__(self):
        kinetic, static = concrete(self.mu_kinetic), concrete(self.mu_static)
        if kinetic is not None and static is not None and static < kinetic:
            raise ValueError(
                f"friction.Coulomb has mu_static {static} below mu_kinetic {kinetic}; at rest it "
                "is at least that of sliding."
            )

    def bound(self, slip_speed: Scalar) -> Scalar:
        """Largest friction over normal force, for the sliding speed [m/s] with which an instant
        begins.
        """
        if self.mu_static is None:
            return self.mu_kinetic
        return jnp.where(slip_speed < STICKING_SPEED, self.mu_static, self.mu_kinetic)


class CoulombTanh(AbstractSlipFriction):
    """mu tanh(|v| / v_0): smooth, bounded by mu_kinetic, analytic at rest. Creeps; for sticking
    prefer Dahl.

    Source: Andersson, Soderberg & Bjorklund 2007, Tribol. Int. 40, 580.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    transition_speed: Scalar = quantity(
        1e-3, "m/s", "speed v_0 at which three quarters of the friction act", above=0
    )

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        return self.mu_kinetic * smooth_sign(slip_speed, self.transition_speed)


class Ambrosio(AbstractSlipFriction):
    """c_f c_d: c_d = 0 below v_0, (|v| - v_0)/(v_1 - v_0) up to v_1, 1 above. Needs v_0 < v_1.

    No friction at all below v_0, corners at both speeds; for smooth derivatives prefer CoulombTanh.

    Source: Ambrosio 2003, in Virtual Nonlinear Multibody Systems, 57; 3RSR paper (003), eq. 22 and
    23.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    inner_speed: Scalar = quantity(
        1e-4, "m/s", "speed v_0 up to which there is no friction", at_least=0
    )
    outer_speed: Scalar = quantity(
        1e-3, "m/s", "speed v_1 from which friction acts in full", above=0
    )

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        share = (slip_speed - self.inner_speed) / (self.outer_speed - self.inner_speed)
        return self.mu_kinetic * jnp.clip(share, 0.0, 1.0)


class ThreeZone(AbstractSlipFriction):
    """mu_s sin(pi |v| / (2 V_s)) up to V_s, a cosine from mu_s down to mu_d up to V_d, mu_d above.
    Needs V_s < V_d.

    Once differentiable everywhere. Near AdamsStep in value; for sticking prefer LuGre.

    Source: four-bar paper (001), eq. 4.
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    static_speed: Scalar = quantity(1e-3, "m/s", "speed V_s at which friction is largest", above=0)
    kinetic_speed: Scalar = quantity(
        1e-2, "m/s", "speed V_d from which friction is kinetic", above=0
    )

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        rise = jnp.sin(jnp.pi / 2 * jnp.minimum(slip_speed / self.static_speed, 1.0))
        share = jnp.clip(
            (slip_speed - self.static_speed) / (self.kinetic_speed - self.static_speed), 0.0, 1.0
        )
        fall = (1 - jnp.cos(jnp.pi * share)) / 2
        return self.mu_static * rise + (self.mu_kinetic - self.mu_static) * fall


class AdamsStep(AbstractSlipFriction):
    """The friction of Adams' IMPACT: STEP(v, -v_s, -mu_s, v_s, mu_s) up to v_s, STEP(|v|, v_s,
    mu_s, v_d, mu_d) above.

    Needs v_s < v_d. Once differentiable. Near ThreeZone in value; for sticking prefer LuGre.

    Source: MSC Adams/Solver, CONTACT; flap paper (002), eq. 8. Misprints there: F_n is missing from
    the second and third case, and the second STEP runs from v_d to v_s, where Adams asks for
    increasing arguments.
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    static_speed: Scalar = quantity(1e-4, "m/s", "stiction transition speed v_s", above=0)
    kinetic_speed: Scalar = quantity(1e-2, "m/s", "friction transition speed v_d", above=0)

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        # STEP from -v_s to v_s, written about 0 so that it cancels nothing: mu_s x (3 - x^2) / 2
        share = jnp.minimum(slip_speed / self.static_speed, 1.0)
        rise = self.mu_static * share * (3 - share * share) / 2
        fall = smooth_step(
            slip_speed, self.static_speed, self.kinetic_speed, 0.0, self.mu_kinetic - self.mu_static
        )
        return rise + fall


class Threlfall(AbstractSlipFriction):
    """mu (1 - exp(-3 |v| / v_r)) / (1 - exp(-3)) up to v_r, mu above.

    Continuous with a small corner at v_r. For smooth derivatives prefer CoulombTanh.

    Source: Threlfall 1978, Mech. Mach. Theory 13, 475, where 0.95 stands for 1 - exp(-3) and leaves
    a jump of 2e-4.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    transition_speed: Scalar = quantity(
        1e-3, "m/s", "speed v_r from which friction is kinetic", above=0
    )
    steepness: Scalar = quantity(3.0, "1", "Threlfall's 3: exponent reached at v_r", above=0)

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        share = jnp.minimum(slip_speed / self.transition_speed, 1.0)
        return self.mu_kinetic * jnp.expm1(-self.steepness * share) / jnp.expm1(-self.steepness)


class BengisuAkay(AbstractSlipFriction):
    """mu_s (1 - (1 - |v|/v_0)^2) up to v_0, mu_d + (mu_s - mu_d) exp(-xi (|v| - v_0)) above.

    Continuous with a corner at v_0 for mu_s > mu_d. Same picture as Stribeck, with a peak at a
    chosen speed.

    Source: Bengisu & Akay 1994, J. Sound Vib. 171, 557; Marques et al. 2016, Nonlinear Dyn. 86,
    1407.
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    peak_speed: Scalar = quantity(1e-3, "m/s", "speed v_0 at which friction is largest", above=0)
    decay: Scalar = quantity(
        1e3, "s/m", "rate xi at which friction falls from static to kinetic", at_least=0
    )

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        missing = 1 - jnp.minimum(slip_speed / self.peak_speed, 1.0)
        beyond = jnp.maximum(slip_speed - self.peak_speed, 0.0)
        fall = (self.mu_kinetic - self.mu_static) * -jnp.expm1(-self.decay * beyond)
        return self.mu_static * (1 - missing * missing) + fall


class Stribeck(AbstractSlipFriction):
    """(mu_d + (mu_s - mu_d) exp(-(|v|/v_S)^2)) tanh(|v|/v_0) + viscous |v|: grease, boundary film
    and ramp in one curve.

    Smooth. Needs v_0 well below v_S, or the peak stays under mu_s. Without `viscous` bounded by the
    larger mu. For sticking prefer LuGre, which has this curve for sliding.

    Source: Stribeck 1902; Armstrong-Helouvry, Dupont & Canudas de Wit 1994, Automatica 30, 1083
    (exponent 2).
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    stribeck_speed: Scalar = quantity(
        1e-2, "m/s", "speed v_S over which friction falls from static to kinetic", above=0
    )
    transition_speed: Scalar = quantity(1e-4, "m/s", "speed v_0 of the ramp through rest", above=0)
    viscous: Scalar | None = quantity(
        None, "s/m", "viscous coefficient per sliding speed (None: absent)"
    )

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        level = _stribeck_level(slip_speed, self.mu_static, self.mu_kinetic, self.stribeck_speed)
        friction = level * smooth_sign(slip_speed, self.transition_speed)
        return friction if self.viscous is None else friction + self.viscous * slip_speed


class Dahl(AbstractBristleFriction):
    """z' = v - |v| z / z_0, coefficient mu z / z_0: a spring that yields at the deflection z_0.
    Sticks, no damping.

    |z| <= z_0, so the coefficient never exceeds mu. Rate-independent; where friction falls with
    speed prefer LuGre.

    Source: Dahl 1968, Aerospace Corp. TOR-0158, with exponent 1; z_0 = mu / sigma_0 of the usual
    notation, so that mu = 0 is no friction rather than a division by zero.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    presliding: Scalar = quantity(1e-6, "m", "deflection z_0 at which the bristles yield", above=0)

    def deflection_rate(self, deflection: Scalar, slip: Scalar, slip_speed: Scalar) -> Scalar:
        return slip - slip_speed * deflection / self.presliding

    def coefficient(self, deflection: Scalar, deflection_rate: Scalar, slip: Scalar) -> Scalar:
        return self.mu_kinetic * deflection / self.presliding


class LuGre(AbstractBristleFriction):
    """z' = v - |v| z / (z_0 s(|v|)), coefficient mu (z + t(v) z') / z_0 + viscous v, mu the larger
    of mu_s and mu_d.

    s = (mu_d + (mu_s - mu_d) exp(-(v/v_S)^2)) / mu; in the usual notation sigma_0 = mu/z_0, sigma_1
    = t sigma_0. The damping time fades with speed, t(v) = t_0 / (1 + t_0 |v| / (4 z_0 s)), which
    makes every motion along one line dissipate (with constant t the original can return energy at
    high speed). Sticks, hysteresis, break-away; stiff: where sliding dominates prefer Stribeck.

    Source: Canudas de Wit, Olsson, Astrom & Lischinsky 1995, IEEE Trans. Autom. Control 40, 419;
    damping that fades with speed after Olsson 1996, thesis, Lund, with a fading chosen here for
    passivity.
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    stribeck_speed: Scalar = quantity(
        1e-2, "m/s", "speed v_S over which friction falls from static to kinetic", above=0
    )
    presliding: Scalar = quantity(
        1e-6, "m", "deflection z_0 at which the bristles yield from rest", above=0
    )
    settling_time: Scalar = quantity(
        1e-4, "s", "damping time t_0 of the bristles at rest", at_least=0
    )
    viscous: Scalar | None = quantity(
        None, "s/m", "viscous coefficient per sliding speed (None: absent)"
    )

    def deflection_rate(self, deflection: Scalar, slip: Scalar, slip_speed: Scalar) -> Scalar:
        return slip - slip_speed * deflection / self._yield_deflection(slip_speed)

    def coefficient(self, deflection: Scalar, deflection_rate: Scalar, slip: Scalar) -> Scalar:
        relaxation = jnp.abs(slip) / self._yield_deflection(jnp.abs(slip))
        time = self.settling_time / (1 + self.settling_time * relaxation / PASSIVE_DAMPING)
        friction = self._peak() * (deflection + time * deflection_rate) / self.presliding
        return friction if self.viscous is None else friction + self.viscous * slip

    def _peak(self) -> Scalar:
        return jnp.maximum(self.mu_static, self.mu_kinetic)

    def _yield_deflection(self, slip_speed: Scalar) -> Scalar:
        level = _stribeck_level(slip_speed, self.mu_static, self.mu_kinetic, self.stribeck_speed)
        return self.presliding * jnp.maximum(
            level / jnp.maximum(self._peak(), LEAST_FRICTION), LEAST_SHARE
        )


def _stribeck_level(slip_speed, static, kinetic, stribeck_speed) -> Scalar:
    ratio = slip_speed / stribeck_speed
    return kinetic + (static - kinetic) * jnp.exp(-ratio * ratio)


def set_valued(law: AbstractFrictionLaw) -> Coulomb | None:
    """Coulomb's law with the coefficients of a law that regularises it; None for a law that does
    not say of which.

    Viscous parts are left out.
    """
    if isinstance(law, Coulomb):
        return law
    if isinstance(law, (ThreeZone, AdamsStep, BengisuAkay, Stribeck, LuGre)):
        return Coulomb(mu_kinetic=law.mu_kinetic, mu_static=law.mu_static)
    if isinstance(law, (CoulombTanh, Ambrosio, Threlfall, Dahl)):
        return Coulomb(mu_kinetic=law.mu_kinetic)
    return None
