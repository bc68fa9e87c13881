"""Friction that remembers: one deflection [m] per sliding direction, 0 when the surfaces are fresh.

A deflected bristle holds a contact at rest; a sliding one yields. Bristles of a contact that has
opened straighten within RELEASE_TIME.
"""

from abc import abstractmethod

import jax
import jax.numpy as jnp

from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.friction.base import (
    AbstractForceFriction,
    check_static,
    mu_kinetic_field,
    mu_static_field,
)
from jaxclear.laws.friction.slip import stribeck_level

# Time [s] in which the bristles of an open contact straighten.
RELEASE_TIME = 1e-4
# LuGre's bristles yield at a deflection in proportion to the friction level: to no less than this
# share of the largest, and a largest coefficient below LEAST_FRICTION is no friction.
LEAST_SHARE = 1e-3
LEAST_FRICTION = 1e-12
# a z^2 + t a z w + t w^2 >= 0 for all z, w while t a <= 4: the damping of a bristle that cannot
# give energy.
PASSIVE_DAMPING = 4.0
# Up to which decay in a step it is told by a series: what is left out is rounding beside it.
SERIES = 1e-3


class AbstractBristleFriction(AbstractForceFriction):
    """Friction with one deflection per sliding direction as state.

    A law says how the deflection moves and which coefficient goes with it; both must be linear in
    the deflection.
    """

    set_valued = False
    bristles = 1

    @abstractmethod
    def deflection_rate(self, deflection: Scalar, slip: Scalar, slip_speed: Scalar) -> Scalar:
        """Rate of the deflection along one sliding direction.

        Args:
            deflection: deflection of the bristles along this direction [m].
            slip: component of the sliding velocity along this direction [m/s].
            slip_speed: norm of the sliding velocity [m/s].

        Returns:
            the rate [m/s].
        """

    @abstractmethod
    def coefficient(self, deflection: Scalar, deflection_rate: Scalar, slip: Scalar) -> Scalar:
        """Friction force over normal force along one sliding direction, positive against positive
        slip.

        Args:
            deflection: deflection of the bristles along this direction [m].
            deflection_rate: its rate [m/s].
            slip: component of the sliding velocity along this direction [m/s].

        Returns:
            the signed coefficient [1].
        """

    def steady_coefficient(self, slip_speed):
        # Laws are linear in the deflection.
        rate, decay = jax.jvp(
            lambda z: self.deflection_rate(z, slip_speed, slip_speed), (0.0,), (1.0,)
        )
        return self.coefficient(safe_divide(-rate, decay), 0.0, slip_speed)

    def tractions(self, normal_force, bristles, slip, slip_speed):
        rates = [
            self.deflection_rate(z, s, slip_speed) for z, s in zip(bristles, slip, strict=True)
        ]
        shares = [self.coefficient(z, r, s) for z, r, s in zip(bristles, rates, slip, strict=True)]
        rates = tuple(
            jnp.where(normal_force > 0, r, -z / RELEASE_TIME)
            for z, r in zip(bristles, rates, strict=True)
        )
        return tuple(sp.mul(-normal_force, share) for share in shares), rates

    def largest_slope(self, step):
        def share(slip):
            return self._average_over_step(0.0, slip, 0.0, step, 0.0)[0]

        return jax.grad(share)(0.0)

    def acting_share(self, normal_force, traction, slip_speed):
        # Friction at rest may be anything below the yield of the bristles.
        return jnp.ones(())

    def linearised(self, normal_force, bristles, slip, slip_speed, unhindered, step, bias):
        forces, dampings = [], []
        for z, s in zip(bristles, slip, strict=True):
            mean = lambda s, z=z: self._average_over_step(z, s, slip_speed, step, bias)[0]
            share, slope = jax.jvp(mean, (jnp.asarray(s, float),), (jnp.ones(()),))
            forces.append(-normal_force * share)
            dampings.append(positive_part(normal_force * slope))
        return forces, dampings

    def bristles_after(self, normal_force, bristles, slip, slip_speed, step, bias):
        moved = [
            self._average_over_step(z, s, slip_speed, step, bias)[1]
            for z, s in zip(bristles, slip, strict=True)
        ]
        straightened = [z / (1 + step / RELEASE_TIME) for z in bristles]
        return tuple(
            jnp.where(normal_force > 0, m, z) for m, z in zip(moved, straightened, strict=True)
        )

    def _average_over_step(self, start, slip, slip_speed, step, bias):
        """Mean coefficient over a step, and the deflection at its end, which stays in bounds: at a
        constant slip exact to second order for laws linear in the deflection (`_decay_factors`)."""
        rate, decay = jax.jvp(
            lambda z: self.deflection_rate(z, slip, slip_speed), (start,), (jnp.ones(()),)
        )
        grown, mean = _decay_factors(step * jnp.minimum(decay, 0.0))
        moved, middle = step * rate * grown, step * rate * mean
        end = start + moved
        middle = middle + bias * (moved - middle)
        return self.coefficient(start + middle, rate * grown, slip), end


def _decay_factors(x: Scalar) -> tuple[Scalar, Scalar]:
    """(exp(x) - 1) / x and (exp(x) - 1 - x) / x^2 for x <= 0: what a rate that decays so in a step
    makes of it at its end, and in the mean. Where x is large implicit Euler's instead, which damps:
    exact ones let slip ring that reverses within a step."""
    near = x > -SERIES
    far = jnp.where(near, -SERIES, x)
    grown = (jnp.exp(far) - 1) / far
    grown = jnp.where(near, 1 + x / 2 * (1 + x / 3 * (1 + x / 4)), grown)
    mean = (grown - 1) / far
    mean = jnp.where(near, 0.5 * (1 + x / 3 * (1 + x / 4 * (1 + x / 5))), mean)
    weight, euler = 1 / (1 + x * x), 1 / (1 - x)
    return euler + weight * (grown - euler), 0.5 * euler + weight * (mean - 0.5 * euler)


class Dahl(AbstractBristleFriction):
    r""":math:`\dot z = v - |v|\,z/z_0`, coefficient :math:`\mu z/z_0`: a spring that yields at the
    deflection :math:`z_0`. Sticks, no damping.

    :math:`|z| \le z_0`, so the coefficient never exceeds :math:`\mu`. Rate-independent; where
    friction falls with speed prefer LuGre.

    Args:
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        presliding: deflection z_0 at which the bristles yield [m], > 0.

    Source: Dahl 1968, A solid friction model, Aerospace Corp. TOR-0158(3107-18)-1,
    doi:10.21236/ADA041920, with exponent 1; :math:`z_0 = \mu/\sigma_0` of the usual notation, so
    that :math:`\mu = 0` is no friction rather than a division by zero.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    presliding: Scalar = quantity(1e-6, "m", above=0)

    def deflection_rate(self, deflection: Scalar, slip: Scalar, slip_speed: Scalar) -> Scalar:
        return slip - slip_speed * deflection / self.presliding

    def coefficient(self, deflection: Scalar, deflection_rate: Scalar, slip: Scalar) -> Scalar:
        return self.mu_kinetic * deflection / self.presliding


class LuGre(AbstractBristleFriction):
    r""":math:`\dot z = v - |v|\,z/(z_0 s(|v|))`, coefficient :math:`\mu\,(z + t(v)\,\dot z)/z_0 +
    \beta v`, :math:`\mu` the larger of :math:`\mu_s` and :math:`\mu_d`, :math:`\beta` `viscous`.

    :math:`s = (\mu_d + (\mu_s - \mu_d)\exp(-(v/v_S)^2))/\mu`; in the usual notation
    :math:`\sigma_0 = \mu/z_0`, :math:`\sigma_1 = t\sigma_0`. The damping time fades with speed,
    :math:`t(v) = t_0/(1 + t_0|v|/(4 z_0 s))`, which makes every motion along one line dissipate
    (with constant t the original can return energy at high speed). Sticks, hysteresis, break-away;
    stiff: where sliding dominates prefer Stribeck.

    Args:
        mu_static: static friction coefficient mu_s [1], >= 0.
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        stribeck_speed: speed v_S over which friction falls from static to kinetic [m/s], > 0.
        presliding: deflection z_0 at which the bristles yield from rest [m], > 0.
        settling_time: damping time t_0 of the bristles at rest [s], >= 0.
        viscous: viscous coefficient per sliding speed [s/m], >= 0; None: absent.

    Raises:
        ValueError: if mu_static is below mu_kinetic.

    Source: Canudas de Wit, Olsson, Åström & Lischinsky 1995, IEEE Trans. Autom. Control 40, 419,
    doi:10.1109/9.376053; damping that fades with speed after Olsson 1996, Control Systems with
    Friction, thesis, Lund, with a fading chosen here for passivity.
    """

    mu_static: Scalar = mu_static_field()
    mu_kinetic: Scalar = mu_kinetic_field()
    stribeck_speed: Scalar = quantity(1e-2, "m/s", above=0)
    presliding: Scalar = quantity(1e-6, "m", above=0)
    settling_time: Scalar = quantity(1e-4, "s", at_least=0)
    viscous: Scalar | None = quantity(None, "s/m", at_least=0)

    def __check_init__(self):
        check_static(self)

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
        level = stribeck_level(slip_speed, self.mu_static, self.mu_kinetic, self.stribeck_speed)
        return self.presliding * jnp.maximum(
            level / jnp.maximum(self._peak(), LEAST_FRICTION), LEAST_SHARE
        )
