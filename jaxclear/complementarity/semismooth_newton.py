"""Newton's method on the Fischer-Burmeister function z + w - sqrt(z^2 + w^2), zero exactly at 0 <=
z perp w >= 0.

The function is semismooth: Newton's method with any of its generalised Jacobians converges
quadratically to a solution where those are regular, from afar with a line search on half the sum of
squares. Sources: Fischer 1992, Optimization 24, 269; De Luca, Facchinei & Kanzow 1996, Math.
Program. 75, 407 (algorithm, and the Jacobian at corners).
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.complementarity.problem import (
    CORNER,
    LIMIT,
    SOLVED,
    STALLED,
    AbstractProblem,
    AbstractSolver,
    PivotingResult,
    Scaled,
    Solution,
    on_active_set,
    scaled_residual,
    solve_exactly,
)
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity

# Step lengths 1, 1/2, ... tried side by side in the line search, which costs less than one more
# factorisation.
HALVINGS = 24
# Share of the slope of the merit function that a step must gain (Armijo).
GAIN = 1e-4
# Added to the diagonal of a scaled matrix at the solution, and this share of the residual on the
# way.
REGULAR, SOFTEST = 1e-13, 1e-2
# Slope, as a share of the steepest possible, below which the Newton direction is given up for the
# steepest descent.
SLANTED = 1e-10


class SemismoothNewton(AbstractSolver):
    """Damped Newton on the Fischer-Burmeister function. Few iterations, each one linear system, so
    steady in a batch.

    Solves LCPs with P-matrices whose rows and columns are of like size, others mostly: it may stall
    where the merit function has a minimum of its own. Prefer `Lemke` where a ray must be told.
    Derivatives keep the active set; at a corner z_i = w_i = 0, z_i is taken to stay zero (the
    one-sided derivative towards larger w_i). Of redundant contacts they are the least.
    """

    tolerance: Scalar = quantity(
        1e-12, "1", "residual relative to the data at which to stop", above=0
    )
    most_steps: int = eqx.field(static=True, default=100)

    def __check_init__(self):
        if not (isinstance(self.most_steps, int) and self.most_steps > 0):
            raise ValueError(
                f"most_steps of SemismoothNewton is {self.most_steps!r}; it must be a positive "
                "whole number."
            )

    def solve(self, problem: AbstractProblem) -> Solution:
        return solve_exactly(problem, self._descend, singular=True)

    def _descend(self, problem: Scaled) -> PivotingResult:
        def running(carry):
            _, residual, moved, steps = carry
            return (residual > self.tolerance) & moved & (steps < self.most_steps)

        def improve(carry):
            z, residual, _, steps = carry
            damped, moved = _damped_step(problem, z, residual)
            basic = _on_its_active_set(problem, damped)
            reached, there = scaled_residual(problem, damped), scaled_residual(problem, basic)
            ends = there <= jnp.minimum(self.tolerance, reached)
            return jnp.where(ends, basic, damped), jnp.where(ends, there, reached), moved, steps + 1

        start = jnp.zeros_like(problem.offset)
        first = (start, scaled_residual(problem, start), jnp.asarray(True), 0)
        z, residual, moved, steps = jax.lax.while_loop(running, improve, first)
        # once more from nearby, down to rounding
        basic = _on_its_active_set(problem, z)
        there = scaled_residual(problem, basic)
        z, residual = jnp.where(there < residual, basic, z), jnp.minimum(there, residual)
        outcome = jnp.where(residual <= self.tolerance, SOLVED, jnp.where(moved, LIMIT, STALLED))
        return PivotingResult(z, z > problem.matrix @ z + problem.offset + CORNER, outcome, steps)


def fischer_burmeister(z, w):
    """z + w - sqrt(z^2 + w^2), without cancellation where both are positive."""
    size = safe_sqrt(z * z + w * w)
    return jnp.where(z + w > 0, safe_divide(2 * z * w, z + w + size), z + w - size)


def _on_its_active_set(problem: Scaled, z):
    """z put right by one linear solve, which ends the iteration where its active set is the
    solution's.
    """
    active = z > problem.matrix @ z + problem.offset
    rough = jnp.where(active, z, 0.0)
    stiffened = problem._replace(matrix=problem.matrix + REGULAR * jnp.eye(z.shape[0]))
    return jnp.maximum(
        rough - on_active_set(active, stiffened, problem.matrix @ rough + problem.offset), 0.0
    )


def _damped_step(problem: Scaled, z, residual):
    """(z after a step, whether any step lowers the merit function)."""
    w = problem.matrix @ z + problem.offset
    value = fischer_burmeister(z, w)
    size = safe_sqrt(z * z + w * w)
    corner = size == 0
    # at a corner, the limit along z_i = w_i > 0
    of_z, of_w = (jnp.where(corner, 1 - jnp.sqrt(0.5), 1 - safe_divide(x, size)) for x in (z, w))
    jacobian = jnp.diag(of_z) + of_w[:, None] * problem.matrix
    gradient = jacobian.T @ value
    # a multiple of z added to w, less the nearer the solution, keeps the system regular for every
    # P0-matrix
    added = jnp.maximum(REGULAR, SOFTEST * jnp.minimum(residual, 1.0))
    newton = -jnp.linalg.solve(jacobian + jnp.diag(added * of_w), value)
    steep = jnp.dot(gradient, newton) <= -SLANTED * jnp.linalg.norm(gradient) * jnp.linalg.norm(
        newton
    )
    direction = jnp.where(steep, newton, -gradient)
    merit, slope = 0.5 * value @ value, gradient @ direction
    shares = 0.5 ** jnp.arange(HALVINGS)
    tried = z + shares[:, None] * direction
    values = fischer_burmeister(tried, w + shares[:, None] * (problem.matrix @ direction))
    gains = 0.5 * jnp.sum(values**2, 1) <= merit + GAIN * shares * slope
    share = shares[jnp.argmax(gains)]
    moved = jnp.any(gains) & (slope < 0)
    return jnp.where(moved, z + share * direction, z), moved
