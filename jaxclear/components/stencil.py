"""How a map of cells is read between their centres: by quadratic B-splines."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def spline_weights(position: Float[Array, "..."]) -> tuple[Array, Float[Array, "... 3"]]:
    """Index of the nearest cell and the weights of it and its neighbours, for a position in units
    of cells.

    Quadratic B-spline: continuous slope, weights add up to one.
    """
    nearest = jnp.round(position)
    f = position - nearest
    weights = jnp.stack([0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2], axis=-1)
    return nearest.astype(int), weights


def stencil(
    column: Float[Array, "..."], row: Float[Array, "..."], cells: tuple[int, ...]
) -> tuple[Array, Array, Float[Array, "... 3 3"]]:
    """(columns, rows, weights) of the nine cells about a position in units of cells. What falls
    beyond an end is kept in the last row, so that nothing is lost.
    """
    nearest, across = spline_weights(column)
    level, upwards = spline_weights(row)
    offsets = jnp.arange(-1, 2)
    columns = (nearest[..., None] + offsets) % cells[0]
    rows = jnp.clip(level[..., None] + offsets, 0, cells[1] - 1)
    weights = across[..., :, None] * upwards[..., None, :]
    return columns[..., :, None], rows[..., None, :], weights
