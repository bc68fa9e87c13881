"""The smallest change that meets linear equations, the first of which count most.

Rows are made orthogonal one after the other (Gram and Schmidt, each twice: Giraud, Langou &
Rozloznik 2005, Comput. Math. Appl. 50, 1069, doi:10.1016/j.camwa.2005.08.009). A row that says
nothing new is left out, so those before it decide. Written in elementary operations: it may run in
a batch on several threads, where factorisations of LAPACK wait for each other for ever.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxclear.ground.numerics import safe_divide, safe_sqrt

# A row whose part across the rows before it is this share of it, or less, follows from them: far
# above rounding (1e-16 times the rows), far below what tells a position from a singular one.
DEPENDENT = 1e-9


class Change(NamedTuple):
    """The smallest change, and which equations it meets; the rest follow from those before."""

    change: Float[Array, " n"]
    met: Bool[Array, " rows"]


def least_change(
    rows: Float[Array, "rows n"], targets: Float[Array, " rows"], scales: Float[Array, " n"]
) -> Change:
    """Smallest x, measured as x / scales, with rows @ x = targets; a row that follows from earlier
    ones is left out, met or not. All derivatives are finite, also where x is zero.
    """
    scaled = rows * scales
    m = rows.shape[0]

    def across(row, basis):
        along = jnp.sum(basis * row, axis=1)
        return along, row - jnp.sum(along[:, None] * basis, axis=0)

    def add(carry, entry):
        basis, parts = carry
        row, target, place = entry
        first, rest = across(row, basis)
        second, rest = across(rest, basis)
        length = safe_sqrt(jnp.sum(rest * rest))
        new = length > DEPENDENT * safe_sqrt(jnp.sum(row * row))
        inverse = safe_divide(1.0, jnp.where(new, length, 0.0))
        part = (target - jnp.sum((first + second) * parts)) * inverse
        here = place == jnp.arange(m)
        basis = jnp.where(here[:, None], rest * inverse, basis)
        return (basis, jnp.where(here, part, parts)), new

    start = (jnp.zeros_like(scaled), jnp.zeros_like(targets))
    (basis, parts), new = jax.lax.scan(add, start, (scaled, targets, jnp.arange(m)))
    return Change(scales * jnp.sum(parts[:, None] * basis, axis=0), new)


def of_rank(
    rows: Float[Array, "rows n"],
    targets: Float[Array, " rows"],
    scales: Float[Array, " n"],
    rank: int,
) -> tuple[Float[Array, "rank n"], Float[Array, " rank"]]:
    """Equations, so many, that say the same as `rows @ x = targets` where only that many of them
    are independent: the rows that stand out most, one after the other; the rest is not looked at. A
    row is zero where fewer are independent."""
    scaled = rows * scales
    largest = jnp.max(jnp.sum(scaled * scaled, axis=1), initial=0.0)
    chosen, parts = [], []
    for _ in range(rank):
        squares = jnp.sum(scaled * scaled, axis=1)
        here = jnp.argmax(squares)
        new = squares[here] > DEPENDENT**2 * largest
        inverse = safe_divide(1.0, safe_sqrt(jnp.where(new, squares[here], 0.0)))
        direction, part = scaled[here] * inverse, targets[here] * inverse
        along = scaled @ direction
        scaled = scaled - along[:, None] * direction
        targets = targets - along * part
        chosen.append(direction / scales)
        parts.append(part)
    if not chosen:
        return rows[:0], targets[:0]
    return jnp.stack(chosen), jnp.stack(parts)
