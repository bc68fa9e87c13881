"""Linear complementarity problems in units of their own, so that no tolerance has a unit.

Rows and columns of M are scaled by turns until their largest entries are near 1, by powers of two,
which round nothing: ties stay ties. Source: Ruiz 2001, A scaling algorithm to equilibrate both rows
and columns norms in matrices, RAL-TR-2001-034.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxclear.complementarity.problem import LCP, natural_residual
from jaxclear.ground.numerics import OFF_THE_TIES

__all__ = ["Scaled", "scaled", "scaled_residual", "size_of"]

# Passes of the scaling; its errors halve with each.
SCALING_PASSES = 3
# Solutions larger than the data (scaled to 1) carry rounding in proportion; beyond this size it is
# not excused.
LARGEST_EXCUSED = 1e4


class Scaled(NamedTuple):
    """An LCP with entries near 1 [1]: z = z_scale z', w = w_scale w', for `z_scale` [unit of z] and
    `w_scale` [unit of w], `matrix` and `offset` [1]. `finite` False: the data were not, and stand
    replaced.
    """

    matrix: Float[Array, "n n"]
    offset: Float[Array, " n"]
    z_scale: Float[Array, " n"]
    w_scale: Float[Array, " n"]
    finite: Bool[Array, ""]


def _power_of_two(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """A power of two above |x|, the next or (just below it) the one after, and 1 at zero."""
    exponent = jnp.frexp(jnp.where(x == 0, 0.5, OFF_THE_TIES * x))[1]
    return jnp.ldexp(jnp.ones_like(x), exponent)


def scaled(problem: LCP) -> Scaled:
    """The problem in units of its own, without derivatives."""
    matrix, offset = jax.lax.stop_gradient((problem.matrix, problem.offset))
    finite = jnp.all(jnp.isfinite(matrix)) & jnp.all(jnp.isfinite(offset))
    matrix = jnp.where(finite, matrix, jnp.eye(offset.shape[0]))
    rows = columns = jnp.ones_like(offset)
    for _ in range(SCALING_PASSES):
        size = jnp.abs(rows[:, None] * matrix * columns)
        rows = rows / _power_of_two(jnp.sqrt(jnp.max(size, 1)))
        columns = columns / _power_of_two(jnp.sqrt(jnp.max(size, 0)))
    offset = rows * jnp.where(finite, offset, 0.0)
    size = _power_of_two(jnp.max(jnp.abs(offset)))
    return Scaled(
        rows[:, None] * matrix * columns, offset / size, columns * size, size / rows, finite
    )


def size_of(z: Float[Array, "..."]) -> Float[Array, ""]:
    """What a scaled residual is measured by: 1, or the size of a large solution."""
    return jnp.clip(jnp.max(jnp.abs(z)), 1.0, LARGEST_EXCUSED)


def scaled_residual(problem: Scaled, z: Float[Array, " n"]) -> Float[Array, ""]:
    """Natural residual of a scaled problem relative to its data or the size of its solution [1];
    infinite where z is not finite.
    """
    w = problem.matrix @ z + problem.offset
    return jnp.where(jnp.all(jnp.isfinite(z + w)), natural_residual(z, w) / size_of(z), jnp.inf)
