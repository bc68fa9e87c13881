"""Lemke's path through the bases of an LCP: the exact solution in finitely many pivots, or a ray.

The artificial variable z0 relaxes every row alike, w = M z + q + e z0, and is driven out. Ties of
the ratio test are broken as if q were q + (t, t^2, ...) for infinitesimal t, so degenerate problems
end too. The tableau holds x_B + T x_N = right for basic x_B and the n + 1 others x_N. Sources:
Lemke 1965, Manag. Sci. 11, 681, doi:10.1287/mnsc.11.7.681; Cottle, Pang & Stone 2009,
doi:10.1137/1.9780898719000, sections 4.4 and 4.9."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxclear.complementarity.interior_point import Scaled, scaled
from jaxclear.complementarity.problem import (
    AbstractLinearProblem,
    AbstractSolver,
    Outcome,
    Solution,
    natural_residual,
    posed,
    size_of,
)
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import count

# A scaled solution whose scaled residual is below this counts as exact; sixteen digits less those
# lost in a small system.
EXACT = 1e-12
# Share of a column's largest entry (at least of 1) below which an entry is rounding: no pivot.
SMALLEST_PIVOT = 1e-11
# Ratios that differ by less than this (relative, or absolute below 1) are a tie: far above the
# rounding of a few dozen pivots.
TIE = 1e-12
# Solves that refine the final z: the first leaves the square of the tableau's rounding.
REFINEMENTS = 2
RUNNING = -1


def scaled_residual(problem: Scaled, z: Float[Array, " n"]) -> Float[Array, ""]:
    """Natural residual of a scaled problem relative to its data or the size of its solution [1];
    infinite where z is not finite."""
    w = problem.matrix @ z + problem.offset
    return jnp.where(jnp.all(jnp.isfinite(z + w)), natural_residual(z, w) / size_of(z), jnp.inf)


class Tableau(NamedTuple):
    """x_B + T x_N = right, the last column of `entries` [1]; variables are numbered w_i: i, z_i: n
    + i, z0: 2 n."""

    entries: Float[Array, "n n+2"]
    basic: Int[Array, " n"]
    others: Int[Array, " n+1"]
    entering: Int[Array, ""]  # column
    outcome: Int[Array, ""]
    pivots: Int[Array, ""]


class Lemke(AbstractSolver):
    """Lemke's method with lexicographic pivoting. The choice for small problems and for exact
    answers.

    Solves every LCP with a P-matrix, and decides every one with a copositive-plus matrix; the
    number of pivots is of the order of n, but grows as 2^n in contrived cases. A wrong turn by
    rounding ends in an outcome, never in a wrong z. Derivatives are those of the final basis: at
    degenerate points one-sided, towards the q for which that basis stays feasible (q + (t, t^2,
    ...), t > 0, unless z0 left in a tie). `most_pivots=None` allows 100 + 20 n."""

    most_pivots: int | None = count(None, "most pivots")

    def solve(self, problem: AbstractLinearProblem) -> Solution:
        check_double_precision()
        lcp = posed(problem)
        small = scaled(lcp)
        z, active, outcome, pivots = jax.lax.stop_gradient(self._pivot(small))
        outcome = jnp.where(small.finite, outcome, Outcome.NOT_FINITE)
        kept = jnp.where(jnp.isfinite(z) & small.finite, z * small.z_scale, 0.0)
        active = active & (outcome == Outcome.SOLVED)
        scales = (small.z_scale, small.w_scale)
        own = problem.from_lcp(_keep_active_set(kept, active, scales, lcp.matrix, lcp.offset))
        return Solution(*own, problem.residual(*own), outcome, pivots)

    def _pivot(self, problem: Scaled):
        """(z, which of it is basic, outcome, pivots)."""
        n = problem.offset.shape[0]
        most = 100 + 20 * n if self.most_pivots is None else self.most_pivots
        running = lambda t: (t.outcome == RUNNING) & (t.pivots < most)
        end = jax.lax.while_loop(running, _step, _start(problem))
        z, active = _read(problem, end)
        exact = scaled_residual(problem, z) <= EXACT
        reached = jnp.where(exact, Outcome.SOLVED, Outcome.STALLED)
        ended = jnp.where(end.outcome == RUNNING, Outcome.LIMIT, end.outcome)
        return z, active, jnp.where(end.outcome == Outcome.SOLVED, reached, ended), end.pivots


@jax.custom_jvp
def _keep_active_set(
    z: Float[Array, " n"],
    active: Bool[Array, " n"],
    scales: tuple[Float[Array, " n"], Float[Array, " n"]],
    matrix: Float[Array, "n n"],
    offset: Float[Array, " n"],
) -> Float[Array, " n"]:
    """z unchanged, with the derivatives of the solution that keeps its active set (w_i = 0 there,
    z_i = 0 elsewhere): M_AA dz_A = -(dM z + dq)_A.

    Exact where z + w > 0. At a corner z_i = w_i = 0 it is the derivative of the piece that `active`
    names."""
    return z


@_keep_active_set.defjvp
def _keep_active_set_jvp(primals, tangents):
    _, active, (z_scale, w_scale), matrix, _ = primals
    # the solution itself, not its copy without derivatives: then higher derivatives are right too
    out = _keep_active_set(*primals)
    small = matrix * z_scale / w_scale[:, None]
    held = jnp.where(active[:, None], small, jnp.eye(active.shape[0]))
    moved = jnp.where(active, -(tangents[3] @ out + tangents[4]) / w_scale, 0.0)
    return out, z_scale * jnp.linalg.solve(held, moved)


def _start(problem: Scaled) -> Tableau:
    n = problem.offset.shape[0]
    lowest = jnp.min(problem.offset)
    # of equal lowest rows the last leaves: then all rows that stay are lexicographically positive
    row = n - 1 - jnp.argmin(problem.offset[::-1])
    entries = jnp.concatenate([-problem.matrix, -jnp.ones((n, 1)), problem.offset[:, None]], 1)
    first = Tableau(
        entries,
        jnp.arange(n),
        jnp.append(n + jnp.arange(n), 2 * n),
        jnp.asarray(n),
        jnp.where(lowest >= 0, Outcome.SOLVED, RUNNING),
        jnp.where(lowest >= 0, -1, 0),
    )
    return _exchange(first, row)


def _read(problem: Scaled, tableau: Tableau):
    """(z, which of it is basic). The columns of the w_k outside the basis hold the inverse of the
    basic part of M: solves with it, for what the data say remains, take the rounding of all pivots
    out of z."""
    n = tableau.basic.shape[0]
    place = tableau.basic == n + jnp.arange(n)[:, None]
    active = jnp.any(place, 1)
    on_path = place @ tableau.entries[:, -1]
    z = on_path
    for _ in range(REFINEMENTS):
        remains = jnp.append(
            jnp.where(active, problem.matrix @ z + problem.offset, 0.0), jnp.zeros(n + 1)
        )
        z = z + place @ (tableau.entries[:, :-1] @ remains[tableau.others])
    return jnp.where(tableau.outcome == Outcome.SOLVED, jnp.maximum(z, 0.0), on_path), active


def _step(tableau: Tableau) -> Tableau:
    row, ends = _leaving(tableau)
    stopped = tableau._replace(outcome=jnp.asarray(Outcome.RAY))
    return jax.tree.map(lambda a, b: jnp.where(ends, a, b), stopped, _exchange(tableau, row))


def _leaving(tableau: Tableau):
    """(row that leaves, whether none does): the lexicographically least ratio, z0 first."""
    n = tableau.basic.shape[0]
    column = tableau.entries[:, tableau.entering]
    smallest = SMALLEST_PIVOT * jnp.maximum(jnp.max(jnp.abs(column)), 1.0)
    able = column > smallest
    divisor = jnp.maximum(column, smallest)

    def least(candidates, values):
        ratios = jnp.where(candidates, values / divisor, jnp.inf)
        best = jnp.min(ratios)
        return candidates & (ratios <= best + TIE * jnp.maximum(jnp.abs(best), 1.0))

    def next_column(carry):
        k, candidates = carry
        place = tableau.others == k
        values = jnp.where(
            jnp.any(place), tableau.entries[:, jnp.argmax(place)], 1.0 * (tableau.basic == k)
        )
        return k + 1, least(candidates, values)

    def tied(carry):
        return (jnp.sum(carry[1]) > 1) & (carry[0] < n)

    candidates = least(able, tableau.entries[:, -1])
    last = candidates & (tableau.basic == 2 * n)
    candidates = jnp.where(jnp.any(last), last, candidates)
    _, candidates = jax.lax.while_loop(tied, next_column, (0, candidates))
    return jnp.argmax(candidates), ~jnp.any(able)


def _exchange(tableau: Tableau, row) -> Tableau:
    """Pivot on (row, entering); next enters the complement of what left, unless that was z0.

    Written with masks: scattered updates are several times slower in a batch."""
    n = tableau.basic.shape[0]
    in_row, in_column = jnp.arange(n) == row, jnp.arange(n + 2) == tableau.entering
    left, entered = tableau.basic[row], tableau.others[tableau.entering]
    column = tableau.entries[:, tableau.entering]
    pivot_row = jnp.where(in_column, 1.0, tableau.entries[row]) / column[row]
    entries = jnp.where(in_column, 1.0 * in_row[:, None], tableau.entries)
    others = jnp.where(in_column[:-1], left, tableau.others)
    complement = jnp.where(left < n, left + n, left - n)
    return Tableau(
        entries - jnp.outer(column - in_row, pivot_row),
        jnp.where(in_row, entered, tableau.basic),
        others,
        jnp.argmax(others == complement),
        jnp.where(left == 2 * n, Outcome.SOLVED, tableau.outcome),
        tableau.pivots + 1,
    )
