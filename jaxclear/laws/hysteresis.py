"""How much a contact must dissipate to rebound with a given coefficient of restitution.

For every force of the form f(delta) (1 + d rate / v0), whatever f is, a mass that strikes at v0
leaves at e v0 with (1 + d) = (1 - d e) exp(d (1 + e)): the relation between d and e is one and the
same for all elastic laws. The functions below are the published approximations of d(e), and its
solution. Range 0 < e <= 1; all are 0 at e = 1.
"""

import jax.numpy as jnp

from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import Scalar

# Gonthier et al. 2004 solve the relation numerically; steps that carry it to rounding for 0.02 <=
# e.
NEWTON_STEPS = 8
# Closer to e = 1 the two roots merge and cancel; there Carvalho & Martins' formula is already exact
# to 1e-8.
NEARLY_ELASTIC = 1e-4
# Below this d exceeds 50, the rebound is lost in the clamp at zero force, and exp(-1/e) underflows.
LEAST_RESTITUTION = 0.02


def with_hysteresis(
    elastic: Scalar, factor: Scalar, rate: Scalar, impact_speed: Scalar, slowest: Scalar
) -> Scalar:
    """max(0, elastic (1 + factor rate / max(impact_speed, slowest))) [N]: never pulls, 0 wherever
    `elastic` is.
    """
    return elastic * positive_part(1 + factor * rate / jnp.maximum(impact_speed, slowest))


def hunt_crossley(restitution: Scalar) -> Scalar:
    """3 (1 - e) / 2. Hunt & Crossley 1975; rebound too high by 0.009 at e = 0.9, 0.16 at 0.5."""
    return 3 / 2 * (1 - restitution)


def lankarani_nikravesh(restitution: Scalar) -> Scalar:
    """3 (1 - e^2) / 4. Lankarani & Nikravesh 1990; rebound too high by 0.013 at 0.9, 0.23 at
    0.5."""
    return 3 / 4 * (1 - restitution * restitution)


def flores(restitution: Scalar) -> Scalar:
    """8 (1 - e) / (5 e). Flores, Machado, Silva & Martins 2011; rebound too low by 0.006 at e =
    0.9, at most 0.045.
    """
    return 8 / 5 * (1 - restitution) / restitution


def zhu(restitution: Scalar) -> Scalar:
    """3 (1 - e^2) exp(2 (1 - e)) / 4. Zhu, Zwiebel & Bernhardt 1999; rebound too low by 0.004 at e
    = 0.9, 0.02 at 0.5.
    """
    return lankarani_nikravesh(restitution) * jnp.exp(2 * (1 - restitution))


def carvalho_martins(restitution: Scalar) -> Scalar:
    """3 (1 - e) (11 - e) / (2 (1 + 9 e)). Carvalho & Martins 2019; rebound within 1e-5 at 0.9,
    0.004 at 0.3, 0.03 at 0.1.
    """
    return 3 / 2 * (1 - restitution) * (11 - restitution) / (1 + 9 * restitution)


def gonthier(restitution: Scalar) -> Scalar:
    """The d that solves the relation at the top, by Newton's method in y = -ln(1 - d e). Gonthier
    et al. 2004.

    Exact to 1e-8 or better for 0.02 <= e <= 1; a smaller e counts as 0.02. The explicit (1 - e^2)/e
    that the same paper offers is a third too large near e = 1 and is not used.
    """
    start = carvalho_martins(restitution)
    e = jnp.clip(restitution, LEAST_RESTITUTION, 1 - NEARLY_ELASTIC)
    first = carvalho_martins(e)
    y = first * (1 + e) - jnp.log1p(first)
    for _ in range(NEWTON_STEPS):
        d = -jnp.expm1(-y) / e
        value = y - d * (1 + e) + jnp.log1p(d)
        slope = 1 + (jnp.exp(-y) / e) * (1 / (1 + d) - 1 - e)
        # The root y = 0 (no damping) is divided out: Newton on value / y^2.
        y = y - value / (slope - 2 * value / y)
    return jnp.where(restitution > 1 - NEARLY_ELASTIC, start, -jnp.expm1(-y) / e)
