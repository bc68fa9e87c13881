"""The relaxed problem z_i w_i = kappa, z, w > 0: smooth in its data, and within about kappa /
max(z_i, w_i) of the exact one.

Mehrotra's predictor and corrector follow the central path down to the given kappa and stay there.
Because the relaxed solution has no corners, its derivatives exist everywhere and are those of the
relaxed problem, not of the exact one. Sources: Mehrotra 1992, SIAM J. Optim. 2, 575,
doi:10.1137/0802028; Wright 1997, Primal-Dual Interior-Point Methods, doi:10.1137/1.9781611971453,
chapters 8 and 10.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxclear.complementarity.problem import (
    LCP,
    AbstractLinearProblem,
    AbstractSolver,
    Outcome,
    Solution,
    as_linear_problem,
)
from jaxclear.ground.numerics import OFF_THE_TIES
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import Scalar, count, quantity

# Passes of the scaling; its errors halve with each.
SCALING_PASSES = 3


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


def scale_problem(problem: LCP) -> Scaled:
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


# Products z_i w_i / kappa_i stay above this share of their mean, and above this; steps are
# shortened by this factor, this often at most, to keep them there. Without it, one boundary in a
# hundred problems stops all further steps (measured).
NEAR, LEAST, SHORTENED, TRIES = 1e-2, 0.2, 0.7, 16
# Share of the way to the nearest boundary that a step may go.
SHORT_OF_BOUNDARY = 0.995
# A number that falls by less in a whole step never reaches zero.
LEAST_FALL = 1e-300
# Products within this share of kappa, and the linear equations to this in scaled units, end the
# iteration.
CENTRED = 1e-11
BALANCED = 1e-13
# Start z = w, in units of the data: large, so that the path is reached before a boundary is.
START = 10.0
# Steps shorter than this lead nowhere.
SHORTEST = 1e-10


class InteriorPoint(AbstractSolver):
    """Primal-dual interior point to a given relaxation. For derivatives through changes of contact,
    or as a smooth model.

    Solves monotone problems (positive semidefinite matrices) that some z > 0 with w > 0 satisfies,
    in 10 to 30 iterations whatever their size, and most with P-matrices. `residual` is that of the
    exact problem: it tells how far the relaxed solution is from contact. Where contact must be
    exact, pose a `FrictionContact` and take `ProjectedGaussSeidel`. Below about 1e-12 of the data's
    product, redundant contacts leave the relaxed solution undetermined, and the iterations are used
    up.

    Args:
        kappa: product z_i w_i of the relaxed problem [unit of z times unit of w], > 0.
        max_steps: largest number of iterations, a count, >= 1.
    """

    kappa: Scalar = quantity(1e-8, "1", above=0)
    max_steps: int = count(100)

    def solve(self, problem: AbstractLinearProblem) -> Solution:
        check_double_precision()
        lcp = as_linear_problem(problem)
        small = scale_problem(lcp)
        kappa = jax.lax.stop_gradient(self.kappa) / (small.z_scale * small.w_scale)
        finite = small.finite & jnp.all(jnp.isfinite(kappa))
        scaled_z, outcome, steps = _follow_path(
            small.matrix, small.offset, jnp.where(finite, kappa, 1.0), self.max_steps
        )
        outcome = jnp.where(finite, outcome, Outcome.NOT_FINITE)
        relaxed_z = jax.lax.stop_gradient(jnp.where(small.finite, scaled_z, 0.0) * small.z_scale)
        z = _keep_relaxation(
            relaxed_z,
            outcome == Outcome.SOLVED,
            (small.z_scale, small.w_scale),
            lcp.matrix,
            lcp.offset,
            self.kappa,
        )
        solution = problem.from_lcp(z)
        return Solution(*solution, problem.residual(*solution), outcome, steps)


@jax.custom_jvp
def _keep_relaxation(z, solved, scale, matrix, offset, kappa):
    """z unchanged, with the derivatives of the relaxed solution; zero where not `solved`."""
    return z


@_keep_relaxation.defjvp
def _keep_relaxation_jvp(primals, tangents):
    _, solved, (z_scale, w_scale), matrix, _, kappa = primals
    _, _, _, d_matrix, d_offset, d_kappa = tangents
    out = _keep_relaxation(*primals)
    w = jnp.where(solved, kappa, 1.0) / jnp.where(solved, out, 1.0)
    # w dz + z dw = dkappa with dw = M dz + moved, in scaled units, each row divided by the sum of
    # its two weights
    weight = w * z_scale + out * w_scale
    share = jnp.where(solved, out * w_scale / weight, 0.0)
    matrix_of_dz = (
        jnp.diag(1 - share)
        + share[:, None] * jnp.where(solved, matrix, 0.0) * z_scale / w_scale[:, None]
    )
    right = d_kappa / weight - share * (d_matrix @ out + d_offset) / w_scale
    return out, z_scale * jnp.linalg.solve(matrix_of_dz, jnp.where(solved, right, 0.0))


def _follow_path(matrix, offset, kappa, max_steps):
    """(z, outcome, steps) of a scaled problem with a kappa for every row."""

    def running(carry):
        z, w, moved, steps = carry
        return ~_has_converged(matrix, offset, kappa, z, w) & moved & (steps < max_steps)

    def improve(carry):
        z, w, _, steps = carry
        dz, dw, length = _newton_direction(matrix, offset, kappa, z, w)
        moved = (length > SHORTEST) & jnp.all(jnp.isfinite(dz + dw))
        return (
            jnp.where(moved, z + length * dz, z),
            jnp.where(moved, w + length * dw, w),
            moved,
            steps + 1,
        )

    start = START * jnp.maximum(1.0, jnp.sqrt(kappa))
    first = (start, start, jnp.asarray(True), 0)
    z, w, moved, steps = jax.lax.while_loop(running, improve, first)
    arrived = _has_converged(matrix, offset, kappa, z, w)
    ended = jnp.where(moved, Outcome.LIMIT, Outcome.STALLED)
    return z, jnp.where(arrived, Outcome.SOLVED, ended), steps


def _has_converged(matrix, offset, kappa, z, w):
    balanced = jnp.max(jnp.abs(matrix @ z + offset - w)) <= BALANCED * (1 + jnp.max(z))
    return balanced & (jnp.max(jnp.abs(z * w / kappa - 1)) <= CENTRED)


def _newton_direction(matrix, offset, kappa, z, w):
    """Direction (dz, dw) towards the path, and how far along it to go."""
    total = z + w
    factored = jax.scipy.linalg.lu_factor(jnp.diag(w / total) + (z / total)[:, None] * matrix)
    balance = matrix @ z + offset - w

    def towards(gap, balance):
        """dz, dw with w dz + z dw = gap to rounding of the smaller of the two, and dw = M dz +
        balance.
        """
        dz = jax.scipy.linalg.lu_solve(factored, (gap - z * balance) / total)
        dw = jnp.where(z > w, (gap - w * dz) / z, matrix @ dz + balance)
        return jnp.where(z > w, dz, (gap - z * dw) / w), dw

    # Mehrotra's heuristic: the better the step straight to kappa, the nearer to it the step aims
    # that is taken
    mean = jnp.mean(z * w / kappa)
    dz, dw = towards(kappa - z * w, balance)
    length = _length(z, w, dz, dw)
    predicted = jnp.mean((z + length * dz) * (w + length * dw) / kappa)
    share = jnp.where(length < 1, (predicted / mean) ** 3, 0.0)
    target = kappa * jnp.maximum(1.0, share * mean)
    # the correction for a whole step misleads where only part of it can be taken
    dz, dw = towards(target - z * w - length**2 * dz * dw, (1 - share) * balance)
    return dz, dw, _longest_central_step(kappa, z, w, dz, dw)


def _length(z, w, dz, dw):
    """The longest step up to 1 that keeps z and w positive."""
    ratios = [
        jnp.where(d < 0, x / jnp.maximum(-d, LEAST_FALL), jnp.inf) for x, d in ((z, dz), (w, dw))
    ]
    return jnp.minimum(1.0, SHORT_OF_BOUNDARY * jnp.min(jnp.minimum(*ratios)))


def _longest_central_step(kappa, z, w, dz, dw):
    """The longest of some steps that keeps every product above a share of their mean, so that no
    boundary stops the next.
    """
    lengths = _length(z, w, dz, dw) * SHORTENED ** jnp.arange(TRIES)
    products = (z + lengths[:, None] * dz) * (w + lengths[:, None] * dw) / kappa
    near = jnp.min(products, 1) >= jnp.maximum(NEAR * jnp.mean(products, 1), LEAST)
    return jnp.where(jnp.any(near), lengths[jnp.argmax(near)], lengths[-1])
