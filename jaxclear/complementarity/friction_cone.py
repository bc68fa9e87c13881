r"""Coulomb's law at one contact: the cone of its reactions, and three ways to write the law.

The reaction r (normal first, then no, one or two tangents) lies in the cone K: \|r_t\| <= mu r_n,
v + mu \|v_t\| n in the dual cone, and the two are perpendicular. So the contact is open (r = 0),
sticks (v = 0) or slides (v_n = 0, r_t against v_t). Sources: De Saxcé & Feng 1998,
doi:10.1016/S0895-7177(98)00119-8 (natural map); Bonnefon & Daviet 2011, INRIA RT-0400 (one
contact); Alart & Curnier 1991, doi:10.1016/0045-7825(91)90022-X (generalised Jacobian).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar

# Newton steps for the sliding direction of one contact; 6 reach rounding in 99 of 100
# well-conditioned contacts, 10 in 999 of 1000 ill-conditioned ones (measured).
LOCAL_STEPS = 10


def project_on_cone(r: Float[Array, " d"], mu: Scalar) -> Float[Array, " d"]:
    """The point of the cone nearest to r; of the half-line r_n >= 0 where there are no tangents."""
    if r.shape[0] == 1:
        return jnp.maximum(r, 0.0)
    size = safe_sqrt(jnp.sum(r[1:] ** 2))
    normal = jnp.maximum(r[0] + mu * size, 0.0) / (1 + mu**2)
    tangent = safe_divide(mu * normal, size) * r[1:]
    outside = jnp.concatenate([normal[None], tangent])
    return jnp.where((size <= mu * r[0]) & (r[0] >= 0), r, outside)


def natural_map(
    r: Float[Array, " d"], v: Float[Array, " d"], mu: Scalar, rho: Scalar
) -> Float[Array, " d"]:
    r"""De Saxcé's natural map r - proj_K(r - rho (v + mu \|v_t\| n)); zero exactly at a solution.

    Args:
        r: reaction of a contact, normal first.
        v: its velocity, normal first.
        mu: friction coefficient [1].
        rho: > 0 [unit of r per unit of v].
    """
    lifted = v.at[0].add(mu * safe_sqrt(jnp.sum(v[1:] ** 2)))
    return r - project_on_cone(r - rho * lifted, mu)


def one_contact(
    block: Float[Array, "d d"], free: Float[Array, " d"], mu: Scalar
) -> Float[Array, " d"]:
    r"""Reaction of a single contact with v = block r + free.

    It exists for every positive definite `block`, and is exact up to condition numbers of some 1e8.
    Sliding with v_t = -alpha r_t makes r the solution of (block + alpha on the tangents) r = -free:
    stick at alpha = 0; otherwise mu r_n / \|r_t\| - 1, nearly linear in alpha, has a root, which
    Newton's method finds between bounds.

    Args:
        block: of Delassus' operator at this contact, normal first.
        free: velocity without its reaction, normal first.
        mu: friction coefficient [1].
    """
    stiff = jnp.where(block[0, 0] > 0, block[0, 0], jnp.inf)
    pressed = free[0] < 0
    if free.shape[0] == 1:
        return jnp.where(pressed, -free / stiff, 0.0)
    coupling = block[0, 1:] / stiff
    tangents = block[1:, 1:] - jnp.outer(block[1:, 0], coupling)
    push = free[1:] - block[1:, 0] * free[0] / stiff
    normal = lambda tangent: -free[0] / stiff - coupling @ tangent
    stick = -_regularised_inverse(tangents, 0.0) @ push
    sticks = safe_sqrt(stick @ stick) <= mu * normal(stick)
    if free.shape[0] == 2:
        direction = -jnp.sign(push)
    else:
        direction = _sliding_direction(tangents, push, normal, coupling, mu)
    resistance = stiff + mu * (block[0, 1:] @ direction)
    pressure = safe_divide(-free[0], jnp.maximum(resistance, 0.0))
    slide = jnp.append(pressure, pressure * mu * direction)
    return jnp.where(pressed, jnp.where(sticks, jnp.append(normal(stick), stick), slide), 0.0)


def _regularised_inverse(matrix, alpha):
    """(matrix + alpha)^-1 for one or two rows by Cramer's rule, zero where it is singular."""
    if matrix.shape[0] == 1:
        return safe_divide(1.0, matrix + alpha)
    a, b, c, d = matrix[0, 0] + alpha, matrix[0, 1], matrix[1, 0], matrix[1, 1] + alpha
    return safe_divide(1.0, a * d - b * c) * jnp.array([[d, -b], [-c, a]])


def _sliding_direction(tangents, push, normal, coupling, mu):
    """Direction of the tangential reaction of a sliding spatial contact."""

    def improve(_, carry):
        alpha, low, high = carry
        inverse = _regularised_inverse(tangents, alpha)
        tangent = -inverse @ push
        slope = -inverse @ tangent
        size = safe_sqrt(tangent @ tangent)
        share = safe_divide(mu * normal(tangent), size)
        turning = share * safe_divide(tangent @ slope, size * size)
        rate = safe_divide(-mu * (coupling @ slope), size) - turning
        low, high = jnp.where(share < 1, alpha, low), jnp.where(share < 1, high, alpha)
        newton = alpha - safe_divide(share - 1, rate)
        middle = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2 * low + jnp.trace(tangents))
        inside = (newton >= low) & (newton <= high) & (rate > 0)
        return jnp.where(inside, newton, middle), low, high

    alpha, _, _ = jax.lax.fori_loop(0, LOCAL_STEPS, improve, (0.0, 0.0, jnp.inf))
    tangent = -_regularised_inverse(tangents, alpha) @ push
    return safe_divide(1.0, safe_sqrt(tangent @ tangent)) * tangent


def alart_curnier(
    r: Float[Array, " d"], s: Float[Array, " d"], mu: Scalar, margin: Scalar
) -> Float[Array, " d"]:
    r"""What the law of open, stick or slide misses, whichever r - s tells; s = rho v [unit of r].

    open: r; stick: s; slide: (s_n, r_t - mu r_n u), u = (r_t - s_t) / \|r_t - s_t\|. Its
    derivatives are those of this state: the generalised Jacobian. Within `margin` a contact that
    just touches without force counts as open, one on the edge of its cone without slip as sticking.

    Args:
        r: reaction, normal first, an array (d,) [N s].
        s: velocity times rho, an array (d,) [unit of r].
        mu: coefficient of friction [1].
        margin: by how much it must be beyond an edge to count as beyond it [unit of r].

    Returns:
        what is missed, an array (d,) [unit of r].
    """
    pushed = jax.lax.stop_gradient(r[0] - s[0])
    closed = s
    if r.shape[0] > 1:
        trial = r[1:] - s[1:]
        size = safe_sqrt(trial @ trial)
        slid = jnp.append(s[0], r[1:] - mu * r[0] * safe_divide(1.0, size) * trial)
        slides = jax.lax.stop_gradient((size > mu * pushed + margin) | (mu <= 0))
        closed = jnp.where(slides, slid, s)
    return jnp.where(pushed > margin, closed, r)
