"""Small linear systems, written out: the one place where a kernel of machine code factorises.

Symmetric positive definite matrices (masses, Schur complements, Delassus matrices): L D L^T without
roots or pivots, on sparse scalars, so that structural zeros cost nothing. A call to LAPACK costs
more than the whole arithmetic of a 4 x 4 system inside a compiled loop, and hides these zeros;
beyond `LARGEST_WRITTEN_OUT` unknowns (three free bodies) its Cholesky factorisation takes over, for
which kernels have no rule: an implicit step of a floating mechanism is then several hundred times
slower. Matrices without symmetry (the generalised Jacobian of contacts that slide) cannot do
without pivots: `eliminate`. Source: Golub & Van Loan 2013, Matrix Computations, sections 3.4, 4.1.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np

from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import OFF_THE_TIES, safe_divide

__all__ = [
    "LARGEST_WRITTEN_OUT",
    "Rows",
    "eliminate",
    "factor",
    "sign_of_determinant",
    "solve",
    "to_array",
]

LARGEST_WRITTEN_OUT = 18

Rows = Sequence[Sequence[Any]]


def factor(matrix: Rows, least: Sequence[Any | None] | None = None) -> Any:
    """L D L^T of a symmetric positive definite matrix M [any unit] given as rows of sparse scalars:
    the lower triangle L and the inverse pivots 1 / D_i, which `solve` takes. Where a pivot is
    not above the `least` of its row the unknown is 0, for the row follows from those before (None:
    nowhere, or not of that row; beyond `LARGEST_WRITTEN_OUT` unknowns neither).
    """
    n = len(matrix)
    if n > LARGEST_WRITTEN_OUT:
        return jsl.cho_factor(
            sp.stack([x for row in matrix for x in row]).reshape(n, n), lower=True
        )
    lower = [[0] * n for _ in range(n)]
    inverse_pivots: list[Any] = []
    for i in range(n):
        row: list[Any] = []  # row i of L D
        for j in range(i):
            entry = matrix[i][j]
            for k in range(j):
                entry = sp.sub(entry, sp.mul(row[k], lower[j][k]))
            row.append(entry)
        lower[i][:i] = [
            sp.mul(entry, pivot) for entry, pivot in zip(row, inverse_pivots, strict=True)
        ]
        pivot = sp.sub(matrix[i][i], sp.dot(row, lower[i][:i]))
        if least is not None and least[i] is not None:
            pivot = jnp.where(pivot > least[i], pivot, jnp.inf)
        inverse_pivots.append(1.0 / pivot)
    return lower, inverse_pivots


def solve(factored: Any, right: tuple) -> tuple:
    """x of M x = right, for what `factor` makes of M."""
    lower, inverse_pivots = factored
    if not isinstance(lower, list):
        solution = jsl.cho_solve(factored, sp.stack(right))
        return tuple(solution[i] for i in range(len(right)))
    n = len(right)
    x = list(right)
    for i in range(n):
        for j in range(i):
            x[i] = sp.sub(x[i], sp.mul(lower[i][j], x[j]))
    x = [sp.mul(value, pivot) for value, pivot in zip(x, inverse_pivots, strict=True)]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] = sp.sub(x[i], sp.mul(lower[j][i], x[j]))
    return tuple(x)


def eliminate(equations: list[Any]) -> list[Any]:
    """Solution of a system of equations, rows with their right-hand sides at the end, by Gauss's
    elimination with partial pivoting.

    For matrices that are not symmetric, as those of contacts that slide. Of pivots that are alike
    but for rounding the first is taken, always: in a batch XLA may ask twice. A pivot costs a
    select for every row below it, which is twenty times what `factor` takes: prefer that one.
    """
    lines, eliminated = list(equations), []
    while lines:
        # What is left of the lines: unknowns that are not yet eliminated, and the right-hand sides.
        _bring_up(lines, 0)
        first = lines[0][1:] / lines[0][0]
        lines = [line[1:] - line[0] * first for line in lines[1:]]
        eliminated.append(first)
    found: list[Any] = []
    for first in reversed(eliminated):
        value = first[-1]
        for k in range(len(found)):
            value = value - first[len(found) - 1 - k] * found[k]
        found.append(value)
    return found[::-1]


def _bring_up(lines: list[Any], k: int) -> list[Any]:
    """Exchanges lines so that the k-th has the pivot; whether each below it was exchanged with
    it."""
    exchanged = []
    for i in range(k + 1, len(lines)):
        larger = jnp.abs(lines[i][k]) > OFF_THE_TIES * jnp.abs(lines[k][k])
        lines[k], lines[i] = (
            jnp.where(larger, lines[i], lines[k]),
            jnp.where(larger, lines[k], lines[i]),
        )
        exchanged.append(larger)
    return exchanged


def orientation(matrix: list[list]) -> Any:
    """Sign of the determinant of a square matrix, rows of scalars; by Gauss's elimination with
    partial pivoting."""
    lines = [jnp.stack([jnp.asarray(x, float) for x in row]) for row in matrix]
    n, sign = len(lines), jnp.ones(())
    for k in range(n):
        for exchanged in _bring_up(lines, k):
            sign = jnp.where(exchanged, -sign, sign)
        sign = sign * jnp.sign(lines[k][k])
        own = lines[k] / lines[k][k]
        lines[k + 1 :] = [line - line[k] * own for line in lines[k + 1 :]]
    return sign


def sign_of_determinant(matrix: Any) -> Any:
    """The same of an array, in a loop: for matrices of any size that are looked at once."""
    count = matrix.shape[0]

    def cleared(k, carry):
        rows, sign = carry
        left = jnp.arange(count) >= k
        pivot = jnp.argmax(jnp.where(left, jnp.abs(rows[:, k]), -1.0))
        first, own = rows[k], rows[pivot]
        rows = rows.at[pivot].set(first).at[k].set(own)
        sign = jnp.where(pivot == k, sign, -sign) * jnp.sign(own[k])
        shares = jnp.where(jnp.arange(count) > k, rows[:, k] * safe_divide(1.0, own[k]), 0.0)
        return rows - shares[:, None] * own, sign

    return jax.lax.fori_loop(0, count, cleared, (matrix, jnp.ones(())))[1]


def to_array(rows: Rows) -> jnp.ndarray:
    """Rows of sparse scalars as an array; entries that are structurally zero are filled in, not
    stacked.
    """
    places = [(i, j) for i, row in enumerate(rows) for j, x in enumerate(row) if not sp.is_zero(x)]
    shape = (len(rows), len(rows[0]) if rows else 0)
    if not places:
        return jnp.zeros(shape)
    i, j = zip(*places, strict=True)
    entries = sp.stack([rows[a][b] for a, b in places])
    return jnp.zeros(shape).at[np.array(i), np.array(j)].set(entries, unique_indices=True)
