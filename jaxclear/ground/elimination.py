"""Symmetric positive definite systems too large to be written out: numbers in memory, and loops
over tables that the pattern of the matrix decides before anything runs.

Unknowns are eliminated in the order of least degree, which tells where the factors L and D of
P M P^T = L D L^T are not zero (George & Liu 1981, Computer Solution of Large Sparse Positive
Definite Systems, chapter 5). A column of L stands in memory as it comes, its pivot ahead of it;
what eliminating it takes off other columns are stretches of numbers side by side, one line of a
table each: two or three numbers in a chain, a whole column where the matrix is full. The loops are
those of a kernel (`native.linear_systems`); XLA takes a Cholesky factorisation of LAPACK.
"""

import functools
import heapq
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxclear.ground import sparse as sp


class Pattern(NamedTuple):
    """How many unknowns a symmetric matrix has, and the places (row, column) of its lower triangle
    that are not structurally zero."""

    size: int
    places: tuple[tuple[int, int], ...]


class Tables(NamedTuple):
    """The loops of an elimination. `at`: where in memory each entry of the pattern goes; `unknown`:
    the place of each unknown in the order of elimination; `columns`: where each column begins, and
    where the last ends. Stretches of `updates` belong to a column from `update_starts` on: (first
    number to change, first number of the column, which of its numbers is the factor, length);
    those of `solves`, of its rows, likewise: (first row, first number of the column, length)."""

    at: list[int]
    unknown: list[int]
    columns: list[int]
    update_starts: list[int]
    updates: list[tuple[int, int, int, int]]
    solve_starts: list[int]
    solves: list[tuple[int, int, int]]

    @property
    def numbers(self) -> int:
        """Numbers of both factors."""
        return self.columns[-1]

    @property
    def longest(self) -> int:
        """Numbers of the longest column."""
        return int(np.max(np.diff(self.columns)))


@functools.lru_cache(maxsize=64)
def tables_of(pattern: Pattern) -> Tables:
    """The loops that a pattern asks for."""
    below = _elimination_order(pattern)
    unknown = [0] * pattern.size
    for place, i in enumerate(below):
        unknown[i] = place
    rows = [sorted(unknown[i] for i in column) for column in below.values()]
    columns = [0, *np.cumsum([1 + len(lower) for lower in rows]).tolist()]
    at = {(j, j): start for j, start in enumerate(columns[:-1])}
    at |= {(i, j): columns[j] + 1 + k for j, lower in enumerate(rows) for k, i in enumerate(lower)}
    updates: list[Any] = []
    solves: list[Any] = []
    update_starts, solve_starts = [0], [0]
    for j, lower in enumerate(rows):
        first = columns[j] + 1
        for k, i in enumerate(lower):
            changed = [at[other, i] for other in lower[k:]]
            updates += [(t, first + k + s, k, n) for t, s, n in _consecutive_runs(changed)]
        update_starts.append(len(updates))
        solves += [(row, first + s, n) for row, s, n in _consecutive_runs(lower)]
        solve_starts.append(len(solves))
    places = ((unknown[i], unknown[j]) for i, j in pattern.places)
    entries = [at[max(pair), min(pair)] for pair in places]
    return Tables(entries, unknown, columns, update_starts, updates, solve_starts, solves)


def _elimination_order(pattern: Pattern) -> dict[int, set[int]]:
    """Unknowns in their order of elimination, each with those that it is then tied to; of those
    tied to equally many the first."""
    tied: list[set[int]] = [set() for _ in range(pattern.size)]
    for i, j in pattern.places:
        if i != j:
            tied[i].add(j)
            tied[j].add(i)
    waiting = [(len(near), i) for i, near in enumerate(tied)]
    heapq.heapify(waiting)
    out: dict[int, set[int]] = {}
    while waiting:
        count, i = heapq.heappop(waiting)
        if i in out or count != len(tied[i]):
            continue
        out[i] = tied[i]
        for j in tied[i]:
            tied[j] = (tied[j] | tied[i]) - {i, j}
            heapq.heappush(waiting, (len(tied[j]), j))
    return out


def _consecutive_runs(numbers: Sequence[int]) -> list[tuple[int, int, int]]:
    """Numbers that follow each other without a gap: (the first, its place, how many)."""
    out: list[Any] = []
    for place, number in enumerate(numbers):
        if out and number == out[-1][0] + out[-1][2]:
            out[-1] = (*out[-1][:2], out[-1][2] + 1)
        else:
            out.append((number, place, 1))
    return out


solve_p = Primitive("jaxclear_symmetric_solve")


def solved(pattern: Pattern, entries: Any, least: Any, right: Any) -> Any:
    """x of M x = right, for a symmetric positive definite matrix.

    Args:
        pattern: of the non-zero entries of M.
        entries: of M, in the order of the pattern.
        least: smallest pivot of each row, at or below which its unknown is 0 (in a kernel);
            None: no
            limit.
        right: right side, shape (n,).
    """
    return solve_p.bind(entries, *([] if least is None else [least]), right, pattern=pattern)


def _by_lapack(entries, *further, pattern):
    """Whole matrices, leading axes side by side."""
    *_, right = further
    lead = jnp.broadcast_shapes(entries.shape[:-1], right.shape[:-1])
    rows, columns = np.array(pattern.places).T
    lower = jnp.zeros((*lead, pattern.size, pattern.size)).at[..., rows, columns].set(entries)
    right = jnp.broadcast_to(right, (*lead, pattern.size))
    return jsl.cho_solve(
        (jnp.linalg.cholesky(lower, symmetrize_input=False), True), right[..., None]
    )[..., 0]


def _differentiate(primals, tangents, *, pattern):
    """M dx = db - dM x."""
    *matrix, _ = primals
    solution = solve_p.bind(*primals, pattern=pattern)
    changed, right_tangent = tangents[0], tangents[-1]
    if isinstance(changed, ad.Zero):
        moved = ad.instantiate_zeros(right_tangent)
    else:
        x, entries = _split_last_axis(solution), _split_last_axis(changed)
        taken: list[Any] = [0] * pattern.size
        for (i, j), entry in zip(pattern.places, entries, strict=True):
            taken[i] = sp.add(taken[i], entry * x[j])
            if i != j:
                taken[j] = sp.add(taken[j], entry * x[i])
        taken = jnp.stack(taken, -1)
        moved = -taken if isinstance(right_tangent, ad.Zero) else right_tangent - taken
    return solution, solve_p.bind(*matrix, moved, pattern=pattern)


def _split_last_axis(array: Any) -> list:
    return [array[..., i] for i in range(array.shape[-1])]


def _transpose_solve(cotangent, *operands, pattern):
    *matrix, _ = operands
    out = (
        None
        if isinstance(cotangent, ad.Zero)
        else solve_p.bind(*matrix, cotangent, pattern=pattern)
    )
    return [*[None] * len(matrix), out]


def _batch_solve(operands, dims, *, pattern):
    """New axes come first; the right-hand sides have all that the matrices have."""
    size = next(v.shape[d] for v, d in zip(operands, dims, strict=True) if d is not None)
    first = [v if d is None else jnp.moveaxis(v, d, 0) for v, d in zip(operands, dims, strict=True)]
    if any(dim is not None for dim in dims[:-1]):
        matrices = [
            v if d is not None else jnp.broadcast_to(v, (size, *v.shape))
            for v, d in zip(first, dims, strict=True)
        ]
        lead = matrices[-1].ndim - matrices[0].ndim
        first = [v.reshape(size, *(1,) * lead, *v.shape[1:]) for v in matrices[:-1]] + matrices[-1:]
    return solve_p.bind(*first, pattern=pattern), 0


solve_p.def_impl(lambda *v, pattern: jax.jit(functools.partial(_by_lapack, pattern=pattern))(*v))
solve_p.def_abstract_eval(
    lambda *avals, pattern: jax.core.ShapedArray(avals[-1].shape, avals[-1].dtype)
)
ad.primitive_jvps[solve_p] = _differentiate
ad.primitive_transposes[solve_p] = _transpose_solve
batching.primitive_batchers[solve_p] = _batch_solve
mlir.register_lowering(solve_p, mlir.lower_fun(_by_lapack, multiple_results=False))
