r"""Coulomb friction in joints that always touch, as a problem: bounds that follow the reactions.

The sliding speeds s [m/s] at the end of a step are linear in the friction T [N] of the joints, s =
W T + s_0. Joint k rubs with T_k in [-a_k N_k, b_k N_k] and holds there: s_k > 0 needs T_k at the
lower end, s_k < 0 at the upper one, between them s_k = 0. N_k, the sum of the sizes of the forces
that the joint carries, moves with T. Where these forces have known directions (a guide) this is a
horizontal LCP; a journal's turn with T, and the problem is a quasi-variational inequality. Source:
Pfeiffer & Glocker 1996, doi:10.1002/9783527618385, chapter 5 (bounds that reactions move); sweeps
with the bounds of the last ones: Jourdan, Alart & Jean 1998, doi:10.1016/S0045-7825(97)00137-0.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.complementarity.outcome import Outcome
from jaxclear.complementarity.problem import AbstractProblem, AbstractSolver, Solution
from jaxclear.complementarity.projected_gauss_seidel import Iterate
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import Scalar, quantity

__all__ = ["BoxedGaussSeidel", "JointFriction"]


class JointFriction(AbstractProblem):
    """z = T, w = s = W T + s_0: `delassus` rows of W [m/s per N], `free_velocity` s_0 [m/s].

    `ratios`: (a_k, b_k) of each joint [1], `None` for one without friction. `carried(k, T, ratio)`:
    the forces that joint k carries at friction T, vectors [N], where `ratio` [1] is T_k over the
    sum of their sizes as last known. `softest` [m/s per N]: a diagonal entry of W below this is
    rounding: a drive moves that joint whatever friction does.
    """

    delassus: Sequence[Any]
    free_velocity: Any
    ratios: tuple[tuple[Any, Any] | None, ...]
    carried: Callable[[int, Array, Any], Sequence[sp.Vec]]
    softest: Any

    def load(self, k: int, friction: Float[Array, " k"], ratio: Any) -> Any:
        """N_k [N], of which friction is a share."""
        return sp.total(sp.norm(force) for force in self.carried(k, friction, ratio))

    def slip(self, k: int, friction: Float[Array, " k"]) -> Any:
        """s_k [m/s]."""
        return self.free_velocity[k] + sp.dot(self.delassus[k], friction)

    def residual(self, z, w):
        """Largest entry of the natural map of the boxes, T - proj(T - s / W_kk) [N]."""
        total = jnp.zeros_like(z)
        for _ in range(2):  # the second with the shares of friction that the first finds
            loads = [self.load(k, z, safe_divide(z[k], total[k])) for k in range(len(self.ratios))]
            total = sp.stack(loads)
        left = [jnp.zeros(())]
        for k, pair in enumerate(self.ratios):
            if pair is not None:
                wanted = z[k] - w[k] / jnp.maximum(self.delassus[k][k], self.softest[k])
                left.append(z[k] - jnp.clip(wanted, -pair[0] * total[k], pair[1] * total[k]))
        return jnp.max(jnp.abs(jnp.stack(left)))


class BoxedGaussSeidel(AbstractSolver):
    """Sweeps over the joints, each put into its box with the newest friction of the others, until
    friction changes by less than `tolerance` of its bound.

    `relaxation` rounds the corners of the boxes over that share of their width (Chen & Harker 1993,
    SIAM J. Matrix Anal. Appl. 14, 1168, doi:10.1137/0614081): exact as it vanishes. Plain
    operations only, so that a time loop with these sweeps stays one kernel; derivatives (forward)
    are those of the sweeps.
    """

    tolerance: Scalar = quantity(
        1e-13, "1", "change of friction relative to its bound at which to stop", above=0
    )
    most_sweeps: Scalar = quantity(1000.0, "1", "most sweeps over the joints", above=0)
    relaxation: Scalar | None = quantity(
        None, "1", "share of the bound over which friction is rounded (None: exact)", above=0
    )

    def solve(self, problem: JointFriction) -> Solution:
        check_double_precision()
        found = self.iterate(problem)
        slips = sp.stack([problem.slip(k, found.z) for k in range(len(problem.ratios))])
        solved = jnp.where(found.residual <= self.tolerance, Outcome.SOLVED, Outcome.LIMIT)
        outcome = jnp.where(jnp.isfinite(found.residual), solved, Outcome.NOT_FINITE)
        return Solution(found.z, slips, problem.residual(found.z, slips), outcome, found.sweeps)

    def iterate(self, problem: JointFriction) -> Iterate:
        """Friction, its last change relative to the largest bound, and sweeps taken."""
        start = jnp.zeros(len(problem.ratios))
        if all(pair is None for pair in problem.ratios):
            return Iterate(start, jnp.zeros(()), jnp.zeros((), int))

        def unfinished(carry):
            return (carry[2] > self.tolerance) & (carry[3] < self.most_sweeps)

        def improve(carry):
            before, total, _, sweeps = carry
            friction, total, largest = self._sweep(problem, before, total)
            change = jnp.max(jnp.abs(friction - before)) / jnp.where(largest > 0, largest, 1.0)
            return friction, total, change, sweeps + 1

        first = (start, start, jnp.asarray(jnp.inf), jnp.zeros((), int))
        friction, _, change, sweeps = jax.lax.while_loop(unfinished, improve, first)
        return Iterate(friction, change, sweeps)

    def _sweep(self, problem: JointFriction, friction: Array, total: Array):
        """(friction, loads, the largest bound) after a sweep."""
        largest = jnp.zeros(())
        for k, pair in enumerate(problem.ratios):
            if pair is None:
                continue
            load = problem.load(k, friction, safe_divide(friction[k], total[k]))
            total = total.at[k].set(load)
            low, high = (share * load for share in pair)
            stiff = jnp.maximum(problem.delassus[k][k], problem.softest[k])
            wanted = friction[k] - problem.slip(k, friction) / stiff
            friction = friction.at[k].set(_within(wanted, low, high, self.relaxation))
            largest = jnp.maximum(largest, jnp.maximum(low, high))
        return friction, total, largest


def _within(x, low, high, relaxation):
    """x moved into [-low, high]; with `relaxation`, rounded over that share of the bounds."""
    if relaxation is None:
        return jnp.clip(x, -low, high)
    width = relaxation * 0.5 * (low + high)
    root = lambda y: safe_sqrt(y * y + width * width)
    return 0.5 * (root(x + low) - root(x - high) + high - low)
