r"""Least squares with a symmetric semidefinite matrix of known rank.

Of $S = A A^T$ only `rank` rows are independent. $S \approx L L^T$ with so many columns, by pivots
taken from the largest down (Higham 2002, Accuracy and Stability of Numerical Algorithms, section
10.3, doi:10.1137/1.9780898718027): what rounding leaves of the other rows is never divided by. Then
$L = Q R$, and $x = Q R^{-T} R^{-1} Q^T b$ is the least of all x that come nearest to $S x = b$ in
the sense that $A^T x$ does to $A\,a = b$. Elementary operations only, so that a kernel of machine
code may hold them.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground import sparse as sp
from jaxclear.ground.factorisation import LARGEST_WRITTEN_OUT, Rows, to_array
from jaxclear.ground.numerics import OFF_THE_TIES, safe_divide, safe_sqrt

__all__ = ["KnownRank", "factor_of_rank", "solve_least"]

# A pivot that is this share of the largest, or less, is rounding: the matrix has lost rank here (a
# linkage stretched flat), and the row waits until it says something again.
VANISHED = 1e-13


class KnownRank(NamedTuple):
    """Orthogonal columns Q, the columns of R above its diagonal, and the inverses of its
    diagonal; all zero where the matrix has lost rank."""

    columns: list[Float[Array, " m"]]
    above: list[list[Any]]
    inverses: list[Any]


def factor_of_rank(matrix: Rows, rank: int) -> KnownRank:
    """Factors of a symmetric semidefinite matrix, given as rows of sparse scalars, with so many
    independent rows; 0 at least."""
    found = KnownRank([], [], [])
    for column in _roots(matrix, rank):
        above: list[Any] = [0.0] * len(found.columns)
        # The second time for what rounding has left.
        for _ in range(2):
            shares = [jnp.sum(other * column) for other in found.columns]
            for share, other in zip(shares, found.columns, strict=True):
                column = column - share * other
            above = [a + share for a, share in zip(above, shares, strict=True)]
        inverse = safe_divide(1.0, safe_sqrt(jnp.sum(column * column)))
        found.columns.append(column * inverse)
        found.above.append(above)
        found.inverses.append(inverse)
    return found


def solve_least(factors: KnownRank, right: tuple) -> tuple:
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


def _roots(matrix: Rows, rank: int) -> list[Float[Array, " m"]]:
    """The columns of L."""
    m = len(matrix)
    rest, free = to_array(matrix), jnp.ones(m)
    largest: Any = None
    columns = []
    for _ in range(rank):
        diagonal = [rest[i, i] for i in range(m)]
        place = _first_largest(diagonal, free)
        free = free - place
        pivot = jnp.sum(place * sp.stack(diagonal))
        largest = pivot if largest is None else largest
        root = safe_sqrt(jnp.where(pivot > VANISHED * largest, pivot, 0.0))
        column = safe_divide(1.0, root) * jnp.sum(rest * place, axis=1)
        rest = rest - column[:, None] * column
        columns.append(column)
    return columns


def _first_largest(values: list, free: Float[Array, " m"]) -> Float[Array, " m"]:
    """1 at the largest of the values that are free, 0 elsewhere. Of values that are alike but for
    rounding the first is taken, always: in a batch XLA may ask twice."""
    m = len(values)
    if m > LARGEST_WRITTEN_OUT:
        ahead = OFF_THE_TIES ** jnp.arange(m, 0, -1)
        best = jnp.argmax(jnp.where(free > 0, sp.stack(values) * ahead, -jnp.inf))
        return (jnp.arange(m) == best).astype(float)
    held = [jnp.where(free[i] > 0, value, -jnp.inf) for i, value in enumerate(values)]
    largest, best = held[0], jnp.zeros((), int)
    for i in range(1, m):
        larger = held[i] > jnp.where(largest > 0, OFF_THE_TIES, 1.0) * largest
        largest = jnp.where(larger, held[i], largest)
        best = jnp.where(larger, i, best)
    return (jnp.arange(m) == best).astype(float)
