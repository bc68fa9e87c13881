r"""What a spring with a damper that is bounded by it gives back of an impact.

The force of a stop is :math:`k\delta + d\dot\delta` between 0 and :math:`2k\delta`
(`flank.ElastoBacklash`). It is of first degree in place and speed, so that a mass m comes back
with a share e of its speed that hangs on :math:`\zeta = d/(2\sqrt{km})` alone. The damper is first
at its bound, so that the mass sees the stiffness 2 k until :math:`k\delta = d\dot\delta`;
from there it is a damped oscillator until the force is 0, and with :math:`s = \sqrt{1 - \zeta^2}`

.. math:: e = \exp\!\left(-\frac{\zeta}{s}\,\operatorname{atan2}(4\zeta s,\ 4\zeta^2 - 1)\right),

with the hyperbolic functions for :math:`\zeta > 1`. The same without the bound: Schwager & Pöschel
2007, Granular Matter 9, 465, doi:10.1007/s10035-007-0065-z, eq. 21.
"""

import jax
import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar

# Halvings until the damping is known to rounding; damping ratios that are looked among: at the
# largest a thousandth of the speed comes back.
HALVINGS, LEAST, LARGEST = 60, 1e-12, 350.0
# Of 1 - damping ratio^2, beside 1: there the formula is a quotient of zeros, and is taken at this.
CRITICAL = 1e-6


def restitution_of(damping_ratio: Scalar) -> Scalar:
    """Share [1] of its speed with which a mass comes back, by the damping ratio [1]."""
    z = jnp.asarray(damping_ratio, float)
    remainder = 1 - z * z
    remainder = jnp.where(jnp.abs(remainder) < CRITICAL, CRITICAL, remainder)
    slow = remainder > 0
    s = jnp.sqrt(jnp.where(slow, remainder, 0.5))
    under = jnp.arctan2(4 * z * s, 4 * z * z - 1) / s
    r = jnp.sqrt(jnp.where(slow, 0.5, -remainder))
    past = jnp.where(slow, 2.0, z)
    over = jnp.arctanh(4 * past * r / (4 * past * past - 1)) / r
    return jnp.exp(-z * jnp.where(slow, under, over))


def damping_ratio_of(restitution: Scalar) -> Scalar:
    """The damping ratio [1] by which a share [1] of the speed comes back; that of a thousandth for
    less."""
    target = jnp.asarray(restitution, float)

    def halved(_, ends):
        middle = 0.5 * (ends[0] + ends[1])
        more = restitution_of(jnp.exp(middle)) > jax.lax.stop_gradient(target)
        return jnp.where(more, middle, ends[0]), jnp.where(more, ends[1], middle)

    first = (jnp.full(target.shape, jnp.log(LEAST)), jnp.full(target.shape, jnp.log(LARGEST)))
    low, high = jax.lax.fori_loop(0, HALVINGS, halved, first)
    near = jnp.exp(0.5 * (low + high))
    # A step of Newton's method, by which the derivative is that of the inverse.
    value, slope = jax.jvp(restitution_of, (near,), (jnp.ones_like(near),))
    target = jnp.clip(target, restitution_of(LARGEST), 1.0)
    return near - (value - target) / slope
