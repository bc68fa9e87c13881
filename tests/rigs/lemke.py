"""Lemke's path through the bases of an LCP, in NumPy: the exact solution in finitely many pivots.

The artificial variable z0 relaxes every row alike, w = M z + q + e z0, and is driven out. Ties of
the ratio test go to the lexicographically least row, so degenerate problems end too. Sources:
Lemke 1965, Manag. Sci. 11, 681, doi:10.1287/mnsc.11.7.681; Cottle, Pang & Stone 2009,
doi:10.1137/1.9780898719000, sections 4.4 and 4.9.
"""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from jaxclear.complementarity.problem import AbstractLinearProblem, as_linear_problem

# An entry beside the largest of its column that is rounding; ratios that differ by less are a tie.
SMALLEST_PIVOT, TIE = 1e-11, 1e-12


class Found(NamedTuple):
    """A solution in the problem's own variables, and its residual."""

    z: np.ndarray
    w: np.ndarray
    residual: float


# One program for each size of a problem, in the place of one for each operation.
_as_linear_problem = eqx.filter_jit(as_linear_problem)


@eqx.filter_jit
def _solution_and_residual(problem: AbstractLinearProblem, solution: np.ndarray) -> tuple:
    z, w = problem.from_lcp(solution)
    return z, w, problem.residual(z, w)


def lemke(problem: AbstractLinearProblem) -> Found:
    """The solution of a problem; `ValueError` where the path ends in a ray."""
    lcp = _as_linear_problem(problem)
    solution = pivoted(np.array(lcp.matrix), np.array(lcp.offset))
    z, w, residual = _solution_and_residual(problem, solution)
    return Found(np.asarray(z), np.asarray(w), float(residual))


def pivoted(matrix: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """z with 0 <= z perpendicular to M z + q >= 0."""
    n = len(offset)
    if offset.min() >= 0:
        return np.zeros(n)
    # Columns: right-hand side, w, z, z0; the basis is named by the last three, from 0 on.
    rows = np.hstack([offset[:, None], np.eye(n), -matrix, -np.ones((n, 1))])
    basis, entering, row = list(range(n)), 2 * n, n - 1 - int(np.argmin(offset[::-1]))
    while True:
        rows[row] /= rows[row, 1 + entering]
        others = np.arange(n) != row
        rows[others] -= np.outer(rows[others, 1 + entering], rows[row])
        left, basis[row] = basis[row], entering
        if left == 2 * n:
            break
        entering = (left + n) % (2 * n)
        row = _leaving(rows[:, : n + 1], rows[:, 1 + entering], basis)
    z, active = np.zeros(n), sorted(place - n for place in basis if place >= n)
    z[active] = np.linalg.solve(matrix[np.ix_(active, active)], -offset[active])
    return z


def _leaving(rows: np.ndarray, column: np.ndarray, basis: list[int]) -> int:
    """The row of the lexicographically least ratio, z0 first."""
    least = np.flatnonzero(column > SMALLEST_PIVOT * max(np.abs(column).max(), 1.0))
    if not least.size:
        raise ValueError("the path ends in a ray")
    for k in range(rows.shape[1]):
        ratios = rows[least, k] / column[least]
        least = least[ratios <= ratios.min() + TIE * max(abs(ratios.min()), 1.0)]
        last = [i for i in least if basis[i] == 2 * len(basis)]
        if last or len(least) == 1:
            return int((last or least)[0])
    return int(least[0])
