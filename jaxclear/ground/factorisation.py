r"""Small linear systems, written out: the one place where a kernel of machine code factorises.

Symmetric positive definite matrices (masses, Schur complements, Delassus matrices): L D L^T without
roots or pivots, on sparse scalars, so that structural zeros cost nothing. A call to LAPACK costs
more than the whole arithmetic of a 4 x 4 system inside a compiled loop, and hides these zeros;
where writing out takes more than `MOST_PRODUCTS` it is done by loops over tables in memory, of the
same kernel (`elimination`). Matrices without symmetry (the generalised Jacobian of contacts that
slide) cannot do without pivots: `eliminate`. Source: Golub & Van Loan 2013, Matrix Computations,
sections 3.4, 4.1.

Semidefinite matrices of known rank, $S \approx L L^T$ with so many columns, by pivots from the
largest down (Higham 2002, Accuracy and Stability of Numerical Algorithms, section 10.3,
doi:10.1137/1.9780898718027); then $L = Q R$, and $x = Q R^{-T} R^{-1} Q^T b$ is the least of all x
that come nearest to $S x = b$. The smallest change that meets linear equations, the first of which
count most: rows are made orthogonal one after the other (Gram and Schmidt, each twice: Giraud,
Langou & Rozloznik 2005, Comput. Math. Appl. 50, 1069, doi:10.1016/j.camwa.2005.08.009), and one
that says nothing new is left out. Elementary operations only: factorisations of LAPACK wait for
each other in a batch on several threads.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.ground import sparse as sp
from jaxclear.ground.elimination import Pattern, solved
from jaxclear.ground.grouping import unstacked
from jaxclear.ground.numerics import OFF_THE_TIES, safe_divide, safe_sqrt

# Products of a factorisation that is written out: n (n^2 - 1) / 6 of a full matrix of 40 unknowns.
# A step of rk4 of an arm of 30 ideal joints takes 13 us so and 17 by loops; of 40 joints 25 and 24,
# and loops take half as long to compile.
MOST_PRODUCTS = 40 * (40**2 - 1) // 6

Rows = Sequence[Sequence[Any]]


class Unsolved(NamedTuple):
    """A system that is factorised in loops, where it is solved."""

    pattern: Pattern
    entries: Any
    least: Any


def is_written_out(matrix: Rows) -> bool:
    """Whether a symmetric matrix, given by its sparse scalars, is factorised in scalars: its zeros
    and those that the factorisation keeps cost nothing."""
    n = len(matrix)
    if n * (n * n - 1) // 6 <= MOST_PRODUCTS:
        return True
    filled = np.array([[not sp.is_zero(x) for x in row] for row in matrix])
    products = 0
    for j in range(n):
        below = np.flatnonzero(filled[j + 1 :, j]) + j + 1
        filled[np.ix_(below, below)] = True
        products += len(below) * (len(below) + 1) // 2
    return products <= MOST_PRODUCTS


def factor(matrix: Rows, least: Sequence[Any | None] | None = None) -> Any:
    """L D L^T of a symmetric positive definite matrix M [any unit] given as rows of sparse scalars:
    the lower triangle L and the inverse pivots 1 / D_i, which `solve` takes. Where a pivot is
    not above the `least` of its row the unknown is 0, for the row follows from those before (None:
    nowhere, or not of that row).
    """
    n = len(matrix)
    if not is_written_out(matrix):
        places = [(i, j) for i in range(n) for j in range(i + 1) if not sp.is_zero(matrix[i][j])]
        entries = sp.stack([matrix[i][j] for i, j in places])
        bounds = None
        if least is not None:
            bounds = sp.stack([-jnp.inf if each is None else each for each in least])
        return Unsolved(Pattern(n, tuple(places)), entries, bounds)
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
    if isinstance(factored, Unsolved):
        return tuple(unstacked(solved(*factored, sp.stack(right))))
    lower, inverse_pivots = factored
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


def eliminate(matrix: Sequence[Any], right: Any) -> list[Any]:
    """Solution of a system of equations, rows of a matrix (arrays, or sparse scalars one by one)
    with their right-hand sides, by Gauss's elimination with partial pivoting.

    For matrices that are not symmetric, as those of contacts that slide. Of pivots that are alike
    but for rounding the first is taken, always: in a batch XLA may ask twice. A pivot costs a
    select for every row below it, which is twenty times what `factor` takes: prefer that one.
    """
    lines: list[Any] = [
        jnp.append(row, x) if isinstance(row, jax.Array) else sp.stack([*row, x])
        for row, x in zip(matrix, right, strict=True)
    ]
    eliminated: list[Any] = []
    while lines:
        # What is left of the lines: unknowns that are not yet eliminated, and the right-hand sides.
        _pivot_to_line(lines, 0)
        first = lines[0][1:] / lines[0][0]
        lines = [line[1:] - line[0] * first for line in lines[1:]]
        eliminated.append(first)
    solution: list[Any] = []
    for first in reversed(eliminated):
        value = first[-1]
        for k in range(len(solution)):
            value = value - first[len(solution) - 1 - k] * solution[k]
        solution.append(value)
    return solution[::-1]


def _pivot_to_line(lines: list[Any], k: int) -> list[Any]:
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
        for exchanged in _pivot_to_line(lines, k):
            sign = jnp.where(exchanged, -sign, sign)
        sign = sign * jnp.sign(lines[k][k])
        pivot_row = lines[k] / lines[k][k]
        lines[k + 1 :] = [line - line[k] * pivot_row for line in lines[k + 1 :]]
    return sign


def sign_of_determinant(matrix: Any) -> Any:
    """The same of an array, in a loop: for matrices of any size that are looked at once."""
    count = matrix.shape[0]

    def cleared(k, carry):
        rows, sign = carry
        is_remaining = jnp.arange(count) >= k
        pivot = jnp.argmax(jnp.where(is_remaining, jnp.abs(rows[:, k]), -1.0))
        first, pivot_row = rows[k], rows[pivot]
        rows = rows.at[pivot].set(first).at[k].set(pivot_row)
        sign = jnp.where(pivot == k, sign, -sign) * jnp.sign(pivot_row[k])
        shares = jnp.where(jnp.arange(count) > k, rows[:, k] * safe_divide(1.0, pivot_row[k]), 0.0)
        return rows - shares[:, None] * pivot_row, sign

    return jax.lax.fori_loop(0, count, cleared, (matrix, jnp.ones(())))[1]


def to_array(rows: Rows) -> jnp.ndarray:
    """Rows of sparse scalars as an array."""
    entries = {(i, j): x for i, row in enumerate(rows) for j, x in enumerate(row)}
    return dense_array(entries, (len(rows), len(rows[0]) if rows else 0))


def dense_array(entries: dict[tuple[int, int], Any], shape: tuple[int, int]) -> jnp.ndarray:
    """An array of sparse scalars at these places; entries that are structurally zero are filled in,
    not stacked."""
    filled = {place: x for place, x in entries.items() if not sp.is_zero(x)}
    if not filled:
        return jnp.zeros(shape)
    (i, j), values = (np.array(part) for part in zip(*filled, strict=True)), list(filled.values())
    if all(isinstance(x, (int, float)) for x in values):
        constants = np.zeros(shape)
        constants[i, j] = values
        return jnp.asarray(constants)
    if shape[1] >= MANY_COLUMNS:
        # XLA compiles what is looked up faster than what is put into place.
        numbers = [0.0, *{float(x) for x in values if isinstance(x, (int, float))}]
        others = [x for x in values if not isinstance(x, (int, float))]
        further = itertools.count(len(numbers))
        looked_up = np.zeros(shape, np.int32)
        looked_up[i, j] = [
            numbers.index(x) if isinstance(x, (int, float)) else next(further) for x in values
        ]
        return jnp.concatenate([jnp.array(numbers), sp.stack(others)])[looked_up]
    return jnp.zeros(shape).at[i, j].set(sp.stack(values), unique_indices=True)


# Of this many columns on.
MANY_COLUMNS = 36
# A pivot that is this share of the largest, or less, is rounding: the matrix has lost rank here (a
# linkage stretched flat), and the row waits until it says something again.
VANISHED = 1e-13


def factor_of_rank(matrix: Rows, rank: int) -> tuple[list, list, list]:
    """Factors of a symmetric semidefinite matrix, given as rows of sparse scalars, with so many
    independent rows; 0 at least: orthogonal columns Q (m,), the columns of R above its diagonal,
    and the inverses of its diagonal; all zero where the matrix has lost rank."""
    m = len(matrix)
    ahead = OFF_THE_TIES ** np.arange(m, 0, -1)

    def add(carry, _):
        rest, free, first, columns, above, inverses, place = carry
        diagonal = jnp.sum(jnp.where(jnp.eye(m, dtype=bool), rest, 0.0), axis=1)
        # Of pivots that are alike but for rounding the first, always: in a batch XLA may ask twice.
        at = _mask_of_largest(jnp.where(free > 0, diagonal * ahead, -jnp.inf)).astype(float)
        pivot = jnp.sum(at * diagonal)
        first = jnp.where(place == 0, pivot, first)
        root = safe_sqrt(jnp.where(pivot > VANISHED * first, pivot, 0.0))
        column = safe_divide(1.0, root) * jnp.sum(rest * at, axis=1)
        rest, shares = rest - column[:, None] * column, jnp.zeros(rank)
        for _ in range(2):
            share = jnp.sum(columns * column, axis=1)
            column = column - jnp.sum(share[:, None] * columns, axis=0)
            shares = shares + share
        inverse = safe_divide(1.0, safe_sqrt(jnp.sum(column * column)))
        here = place == jnp.arange(rank)
        columns = jnp.where(here[:, None], column * inverse, columns)
        above = jnp.where(here[:, None], shares, above)
        inverses = jnp.where(here, inverse, inverses)
        return (rest, free - at, first, columns, above, inverses, place + 1), None

    matrices = to_array(matrix), jnp.ones(m), jnp.zeros(()), jnp.zeros((rank, m))
    begin = *matrices, jnp.zeros((rank, rank)), jnp.zeros(rank), jnp.zeros((), int)
    *_, columns, above, inverses, _ = jax.lax.scan(add, begin, length=rank)[0]
    return list(columns), [list(above[j][:j]) for j in range(rank)], list(inverses)


def solve_least(factors: tuple, right: tuple) -> tuple:
    """The least x that comes nearest to S x = right."""
    columns, above, inverses = factors
    b = sp.stack(right)
    y = [jnp.sum(column * b) for column in columns]
    for j in reversed(range(len(y))):
        y[j] = y[j] * inverses[j]
        y[:j] = [x - share * y[j] for x, share in zip(y[:j], above[j], strict=True)]
    for j in range(len(y)):
        y[j] = (y[j] - sp.dot(above[j], y[:j])) * inverses[j]
    x = sum((part * column for part, column in zip(y, columns, strict=True)), jnp.zeros_like(b))
    return tuple(x[i] for i in range(len(right)))


def _mask_of_largest(values: Float[Array, " m"]) -> Bool[Array, " m"]:
    """True at the first of the largest values; by what kernels know."""
    places = jnp.arange(len(values))
    return places == jnp.min(jnp.where(values >= jnp.max(values), places, len(values) - 1))


# A row whose part across the rows before it is this share of it, or less, follows from them: far
# above rounding (1e-16 times the rows), far below what tells a position from a singular one.
DEPENDENT = 1e-9


class Change(NamedTuple):
    """The smallest change, and which equations it meets; the rest follow from those before."""

    change: Float[Array, " n"]
    exact: Bool[Array, " rows"]


def least_change(
    rows: Float[Array, "rows n"], targets: Float[Array, " rows"], scales: Float[Array, " n"]
) -> Change:
    """Smallest x, measured as x / scales, with rows @ x = targets.

    A row that follows from earlier ones is left out, whether it holds or not. All derivatives are
    finite, also where x is zero.

    Args:
        rows: coefficients; earlier rows have priority.
        targets: right side.
        scales: size of each unknown.
    """
    scaled = rows * scales
    m = rows.shape[0]

    def across(row, basis):
        along = jnp.sum(basis * row, axis=1)
        return along, row - jnp.sum(along[:, None] * basis, axis=0)

    def add(carry, entry):
        basis, parts, exact, place = carry
        row, target = entry
        first, rest = across(row, basis)
        second, rest = across(rest, basis)
        length = safe_sqrt(jnp.sum(rest * rest))
        new = length > DEPENDENT * safe_sqrt(jnp.sum(row * row))
        inverse = safe_divide(1.0, jnp.where(new, length, 0.0))
        part = (target - jnp.sum((first + second) * parts)) * inverse
        here = place == jnp.arange(m)
        basis = jnp.where(here[:, None], rest * inverse, basis)
        return (basis, jnp.where(here, part, parts), jnp.where(here, new, exact), place + 1), None

    # All is carried: kernels leave nothing by turns within a loop.
    start = jnp.zeros_like(scaled), jnp.zeros_like(targets), jnp.zeros(m, bool), jnp.zeros((), int)
    (basis, parts, exact, _), _ = jax.lax.scan(add, start, (scaled, targets))
    return Change(scales * jnp.sum(parts[:, None] * basis, axis=0), exact)


def reduce_to_rank(
    rows: Float[Array, "rows n"],
    targets: Float[Array, " rows"],
    scales: Float[Array, " n"],
    rank: int,
) -> tuple[Float[Array, "rank n"], Float[Array, " rank"]]:
    """Equations equivalent to rows @ x = targets, of which only `rank` are independent.

    They are chosen by pivoting: each is the largest remainder of the rows. A row is zero where
    fewer are
    independent.

    Args:
        rows: coefficients, more than `rank`.
        targets: right side.
        scales: size of each unknown, by which rows are compared.
        rank: number of equations returned.
    """
    scaled = rows * scales
    largest = jnp.max(jnp.sum(scaled * scaled, axis=1), initial=0.0)

    def choose(carry, _):
        scaled, targets, chosen, parts, place = carry
        squares = jnp.sum(scaled * scaled, axis=1)
        here = _mask_of_largest(squares)
        square, target = jnp.max(squares), jnp.sum(jnp.where(here, targets, 0.0))
        square = jnp.where(square > DEPENDENT**2 * largest, square, 0.0)
        inverse = safe_divide(1.0, safe_sqrt(square))
        row = jnp.sum(jnp.where(here[:, None], scaled, 0.0), axis=0)
        direction, part = row * inverse, target * inverse
        along = scaled @ direction
        rest = scaled - along[:, None] * direction, targets - along * part
        now = place == jnp.arange(rank)
        chosen = jnp.where(now[:, None], direction / scales, chosen)
        return (*rest, chosen, jnp.where(now, part, parts), place + 1), None

    none = jnp.zeros((rank, len(scales))), jnp.zeros(rank), jnp.zeros((), int)
    return jax.lax.scan(choose, (scaled, targets, *none), length=rank)[0][2:4]
