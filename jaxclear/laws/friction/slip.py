"""Friction as a function of the sliding speed alone: cheap, smooth, nothing remembered. A law maps
the speed |v| >= 0 to a coefficient >= 0 that is 0 at rest; the traction is minus normal force times
coefficient times v/|v|. Under a steady side load at rest such a contact creeps.
"""

from abc import abstractmethod

import jax
import jax.numpy as jnp

from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, smooth_sign, smooth_step
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.friction.base import (
    AbstractForceFriction,
    check_static,
    mu_kinetic_field,
    mu_static_field,
)
from jaxclear.laws.law import check_increasing


class AbstractSlipFriction(AbstractForceFriction):
    """Friction as a function of the sliding speed alone, with a finite slope at rest."""

    set_valued = False
    bristles = 0

    @abstractmethod
    def coefficient(self, slip_speed: Scalar) -> Scalar:
        """Friction force over normal force.

        Args:
            slip_speed: sliding speed [m/s], >= 0.

        Returns:
            the coefficient [1], >= 0; 0 at rest.
        """

    def steady_coefficient(self, slip_speed):
        return self.coefficient(slip_speed)

    def tractions(self, normal_force, bristles, slip, slip_speed):
        share = self.coefficient(slip_speed) / slip_speed
        shares = [sp.mul(share, s) for s in slip]
        return tuple(sp.mul(-normal_force, share) for share in shares), ()

    def largest_slope(self, step):
        """By default the slope at rest; to be overridden where a law is steeper elsewhere."""
        return jax.grad(self.coefficient)(0.0)

    def acting_share(self, normal_force, traction, slip_speed):
        # Less than the law says at this slip: friction has stopped the contact and then rested.
        friction = normal_force * self.coefficient(slip_speed)
        return jnp.where(friction > 0, jnp.minimum(safe_divide(traction, friction), 2.0), 1.0)

    def linearised(self, normal_force, bristles, slip, slip_speed, unhindered, step, bias):
        value, slope = jax.jvp(self.coefficient, (slip_speed,), (jnp.ones(()),))
        secant, slope = value / slip_speed, positive_part(slope)
        # The tangent where it leads on towards the speed at which friction and inertia agree;
        # otherwise the secant through rest, a damper that cannot overshoot.
        free, strength = unhindered.speed, unhindered.yielding * normal_force
        ahead = (free - strength * (value - slope * slip_speed)) / (1 + strength * slope)
        slope = jnp.where((ahead >= 0) & (ahead <= free), slope, secant)
        forces, dampings = [], []
        for s in slip:
            # Across the slip the force turns with it.
            share = 1.0 if len(slip) == 1 else (s / slip_speed) ** 2
            forces.append(sp.mul(-normal_force * secant, s))
            dampings.append(normal_force * (secant + share * (slope - secant)))
        return forces, dampings

    def bristles_after(self, normal_force, bristles, slip, slip_speed, step, bias):
        return ()


def stribeck_level(
    slip_speed: Scalar, mu_static: Scalar, mu_kinetic: Scalar, stribeck_speed: Scalar
) -> Scalar:
    """Stribeck's curve: from the static coefficient at rest down to the kinetic one [1].

    Args:
        slip_speed: size of the sliding velocity [m/s], >= 0.
        mu_static, mu_kinetic: coefficients at rest and at high speed [1].
        stribeck_speed: speed over which the coefficient falls by 1/e of their difference [m/s].
    """
    ratio = slip_speed / stribeck_speed
    return mu_kinetic + (mu_static - mu_kinetic) * jnp.exp(-ratio * ratio)


class CoulombTanh(AbstractSlipFriction):
    r""":math:`\mu_d\tanh(|v|/v_0)`: smooth, bounded by `mu_kinetic`, analytic at rest. Creeps; for
    sticking prefer Dahl.

    Args:
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        transition_speed: speed v_0 at which three quarters of the friction act [m/s], > 0.

    Source: Andersson, Söderberg & Björklund 2007, Tribol. Int. 40, 580,
    doi:10.1016/j.triboint.2005.11.014.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    transition_speed: Scalar = quantity(1e-3, "m/s", above=0)

    def largest_slope(self, step):
        return self.mu_kinetic / self.transition_speed

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        return self.mu_kinetic * smooth_sign(slip_speed, self.transition_speed)


class Ambrosio(AbstractSlipFriction):
    r""":math:`\mu_d c_d` with :math:`c_d = 0` below :math:`v_0`, :math:`(|v| - v_0)/(v_1 - v_0)` up
    to :math:`v_1`, 1 above. Needs :math:`v_0 < v_1`.

    No friction at all below :math:`v_0`, corners at both speeds; for smooth derivatives prefer
    CoulombTanh.

    Args:
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        inner_speed: speed v_0 up to which there is no friction [m/s], >= 0.
        outer_speed: speed v_1 from which friction acts in full [m/s], > 0.

    Raises:
        ValueError: if inner_speed is not below outer_speed.

    Source: Ambrósio 2003, in Virtual Nonlinear Multibody Systems, 57,
    doi:10.1007/978-94-010-0203-5; Hou, Deng & Zeng 2021, J. Cent. South Univ. 28, 712, eq. 22 and
    23, doi:10.1007/s11771-021-4640-y.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    inner_speed: Scalar = quantity(1e-4, "m/s", at_least=0)
    outer_speed: Scalar = quantity(1e-3, "m/s", above=0)

    def __check_init__(self):
        check_increasing(self, "inner_speed", "outer_speed")

    def largest_slope(self, step):
        return self.mu_kinetic / (self.outer_speed - self.inner_speed)

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        share = (slip_speed - self.inner_speed) / (self.outer_speed - self.inner_speed)
        return self.mu_kinetic * jnp.clip(share, 0.0, 1.0)


class ThreeZone(AbstractSlipFriction):
    r""":math:`\mu_s\sin(\pi|v|/(2V_s))` up to :math:`V_s`, a cosine from :math:`\mu_s` down to
    :math:`\mu_d` up to :math:`V_d`, :math:`\mu_d` above. Needs :math:`V_s < V_d`.

    Once differentiable everywhere. Near AdamsStep in value; for sticking prefer LuGre.

    Args:
        mu_static: static friction coefficient mu_s [1], >= 0.
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        static_speed: speed V_s at which friction is largest [m/s], > 0.
        kinetic_speed: speed V_d from which friction is kinetic [m/s], > 0.

    Raises:
        ValueError: if mu_static is below mu_kinetic, or static_speed not below kinetic_speed.

    Source: conference paper "Dynamic Behavior of Four-bar Mechanism with Three-dimensional
    Clearance and Wear", eq. 4; a form of the velocity-dependent friction of Bai & Zhao 2013, Int.
    J. Non-Linear Mech. 48, 15, doi:10.1016/j.ijnonlinmec.2012.07.003.
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    static_speed: Scalar = quantity(1e-3, "m/s", above=0)
    kinetic_speed: Scalar = quantity(1e-2, "m/s", above=0)

    def __check_init__(self):
        check_static(self)
        check_increasing(self, "static_speed", "kinetic_speed")

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        rise = jnp.sin(jnp.pi / 2 * jnp.minimum(slip_speed / self.static_speed, 1.0))
        share = jnp.clip(
            (slip_speed - self.static_speed) / (self.kinetic_speed - self.static_speed), 0.0, 1.0
        )
        fall = (1 - jnp.cos(jnp.pi * share)) / 2
        return self.mu_static * rise + (self.mu_kinetic - self.mu_static) * fall


class AdamsStep(AbstractSlipFriction):
    r"""The friction of Adams' IMPACT: :math:`\mathrm{STEP}(v, -v_s, -\mu_s, v_s, \mu_s)` up to
    :math:`v_s`, :math:`\mathrm{STEP}(|v|, v_s, \mu_s, v_d, \mu_d)` above. Needs :math:`v_s < v_d`.

    Once differentiable. Near ThreeZone in value; for sticking prefer LuGre.

    Args:
        mu_static: static friction coefficient mu_s [1], >= 0.
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        static_speed: stiction transition speed v_s [m/s], > 0.
        kinetic_speed: friction transition speed v_d [m/s], > 0.

    Raises:
        ValueError: if mu_static is below mu_kinetic, or static_speed not below kinetic_speed.

    Source: MSC Adams/Solver, CONTACT; Wan, Liu, Ma & Tong, "Investigation on Dynamic Interaction of
    Multiple Clearance Joints for Flap Actuation System", eq. 8. Misprints there: F_n is missing
    from the second and third case, and the second STEP runs from v_d to v_s, where Adams asks for
    increasing arguments.
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    static_speed: Scalar = quantity(1e-4, "m/s", above=0)
    kinetic_speed: Scalar = quantity(1e-2, "m/s", above=0)

    def __check_init__(self):
        check_static(self)
        check_increasing(self, "static_speed", "kinetic_speed")

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        # STEP from -v_s to v_s, written about 0 so that it cancels nothing: mu_s x (3 - x^2) / 2
        share = jnp.minimum(slip_speed / self.static_speed, 1.0)
        rise = self.mu_static * share * (3 - share * share) / 2
        fall = smooth_step(
            slip_speed, self.static_speed, self.kinetic_speed, 0.0, self.mu_kinetic - self.mu_static
        )
        return rise + fall


class Threlfall(AbstractSlipFriction):
    r""":math:`\mu_d\,(1 - e^{-3|v|/v_r})/(1 - e^{-3})` up to :math:`v_r`, :math:`\mu_d` above.

    Continuous with a small corner at :math:`v_r`. For smooth derivatives prefer CoulombTanh.

    Args:
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        transition_speed: speed v_r from which friction is kinetic [m/s], > 0.
        steepness: exponent reached at v_r [1], > 0; 3 in Threlfall's paper.

    Source: Threlfall 1978, Mech. Mach. Theory 13, 475, doi:10.1016/0094-114X(78)90020-4, where 0.95
    stands for :math:`1 - e^{-3}` and leaves a jump of 2e-4.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    transition_speed: Scalar = quantity(1e-3, "m/s", above=0)
    steepness: Scalar = quantity(3.0, "1", above=0)

    def largest_slope(self, step):
        return (
            self.mu_kinetic * self.steepness / (-jnp.expm1(-self.steepness) * self.transition_speed)
        )

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        share = jnp.minimum(slip_speed / self.transition_speed, 1.0)
        return self.mu_kinetic * jnp.expm1(-self.steepness * share) / jnp.expm1(-self.steepness)


class BengisuAkay(AbstractSlipFriction):
    r""":math:`\mu_s(1 - (1 - |v|/v_0)^2)` up to :math:`v_0`, :math:`\mu_d + (\mu_s - \mu_d)
    e^{-\xi(|v| - v_0)}` above.

    Continuous with a corner at :math:`v_0` for :math:`\mu_s > \mu_d`. Same picture as Stribeck,
    with a peak at a chosen speed.

    Args:
        mu_static: static friction coefficient mu_s [1], >= 0.
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        peak_speed: speed v_0 at which friction is largest [m/s], > 0.
        decay: rate xi at which friction falls from static to kinetic [s/m], >= 0.

    Raises:
        ValueError: if mu_static is below mu_kinetic.

    Source: Bengisu & Akay 1994, J. Sound Vib. 171, 557, doi:10.1006/jsvi.1994.1140; Marques,
    Flores, Claro & Lankarani 2016, Nonlinear Dyn. 86, 1407, doi:10.1007/s11071-016-2999-3.
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    peak_speed: Scalar = quantity(1e-3, "m/s", above=0)
    decay: Scalar = quantity(1e3, "s/m", at_least=0)

    def __check_init__(self):
        check_static(self)

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        missing = 1 - jnp.minimum(slip_speed / self.peak_speed, 1.0)
        beyond = jnp.maximum(slip_speed - self.peak_speed, 0.0)
        fall = (self.mu_kinetic - self.mu_static) * -jnp.expm1(-self.decay * beyond)
        return self.mu_static * (1 - missing * missing) + fall


class Stribeck(AbstractSlipFriction):
    r""":math:`(\mu_d + (\mu_s - \mu_d)\,e^{-(|v|/v_S)^2})\tanh(|v|/v_0) + \beta|v|`: grease,
    boundary film and ramp in one curve, :math:`\beta` `viscous`.

    Smooth. Needs :math:`v_0 < v_S`, well below, or the peak stays under :math:`\mu_s`. Without
    `viscous` bounded by the larger coefficient. For sticking prefer LuGre, which has this curve for
    sliding.

    Args:
        mu_static: static friction coefficient mu_s [1], >= 0.
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        stribeck_speed: speed v_S over which friction falls from static to kinetic [m/s], > 0.
        transition_speed: speed v_0 of the ramp through rest [m/s], > 0.
        viscous: viscous coefficient per sliding speed [s/m], >= 0; None: absent.

    Raises:
        ValueError: if mu_static is below mu_kinetic, or transition_speed not below stribeck_speed.

    Source: Stribeck 1902, Z. VDI 46, 1341; Armstrong-Hélouvry, Dupont & Canudas de Wit 1994,
    Automatica 30, 1083, doi:10.1016/0005-1098(94)90209-7 (exponent 2).
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    stribeck_speed: Scalar = quantity(1e-2, "m/s", above=0)
    transition_speed: Scalar = quantity(1e-4, "m/s", above=0)
    viscous: Scalar | None = quantity(None, "s/m", at_least=0)

    def __check_init__(self):
        check_static(self)
        check_increasing(self, "transition_speed", "stribeck_speed")

    def largest_slope(self, step):
        return self.mu_static / self.transition_speed + (
            0.0 if self.viscous is None else self.viscous
        )

    def coefficient(self, slip_speed: Scalar) -> Scalar:
        level = stribeck_level(slip_speed, self.mu_static, self.mu_kinetic, self.stribeck_speed)
        friction = level * smooth_sign(slip_speed, self.transition_speed)
        return friction if self.viscous is None else friction + self.viscous * slip_speed
