"""Percussions of rigid contacts over a time step: what keeps bodies apart, makes them rebound, and rubs.

Unknown are percussions r [N s] and velocities v [m/s] of the contacts at the end of the step, v = W r + b with Delassus' matrix
W; per contact the normal first (positive pushes apart; velocity positive opening), then its tangents. Newton's law of impact
asks v_n + e v_n(before) >= 0 perp r_n >= 0 (Moreau 1988, in Nonsmooth Mechanics and Applications, 1); friction is Coulomb's.
Sweeps over the contacts, each solved exactly, of plain operations only, so that a time loop stays one kernel.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxclear.scene.complementarity_problem import excuse
from jaxclear.scene.projection import one_contact, saxce_residual


class Percussions(NamedTuple):
    """A solution: percussions and velocities per contact, residual relative to the largest velocity, sweeps taken."""

    percussion: Float[Array, "c d"]
    velocity: Float[Array, "c d"]
    residual: Float[Array, ""]
    sweeps: Int[Array, ""]


def impact(
    delassus: Sequence[Float[Array, "d m"]],
    free: Float[Array, "c d"],
    before: Float[Array, "c d"],
    active: Bool[Array, " c"],
    restitution: Float[Array, " c"],
    mu: Float[Array, " c"],
    *,
    most_sweeps: Any,
    tolerance: Any,
) -> Percussions:
    """The percussions that carry velocities from `before` over the step; `free`: velocities at its end without them.

    `delassus`: its rows contact by contact. A contact that is not `active` has no percussion. `tolerance`: residual of the law,
    relative to the largest velocity, at which sweeps end.
    """
    c, d = free.shape
    kept = jnp.broadcast_to(active[:, None], (c, d)).reshape(-1)
    heaviest = jnp.max(jnp.stack([jnp.where(active[i], _diagonal(delassus[i], i), 0.0) for i in range(c)]))
    weight = jnp.where(heaviest > 0, heaviest, 1.0)
    eye = np.eye(c * d)
    rows = [jnp.where(active[i] & kept, delassus[i] / weight, eye[i * d : (i + 1) * d]) for i in range(c)]
    wanted = free.at[:, 0].add(restitution * before[:, 0])
    wanted = jnp.where(active[:, None], wanted, np.eye(1, d))
    largest = jnp.max(jnp.abs(jnp.where(active[:, None], wanted, 0.0)))
    size = jnp.where(largest > 0, largest, 1.0)
    r, residual, sweeps = _sweep_until(rows, wanted / size, mu, most_sweeps, tolerance)
    percussion = jnp.where(active[:, None], r * size / weight, 0.0)
    velocity = free + jnp.stack([block @ percussion.reshape(-1) for block in delassus])
    return Percussions(percussion, velocity, residual, sweeps)


def _diagonal(block: Array, i: int) -> Array:
    """Diagonal entries of the contact's own part of its rows."""
    d = block.shape[0]
    return jnp.stack([block[k, i * d + k] for k in range(d)])


def _sweep_until(rows: list, wanted: Array, mu: Array, most_sweeps: Any, tolerance: Any) -> tuple[Array, Array, Array]:
    """(percussions, residual, sweeps) from rest. Small arrays, one contact after the other: large ones do not fit into the
    registers of a kernel."""
    c, d = wanted.shape
    own = [block[:, i * d : (i + 1) * d] for i, block in enumerate(rows)]
    rho = [1 / jnp.max(_diagonal(block, i)) for i, block in enumerate(rows)]

    def residual(r):
        sizes = []
        for i, block in enumerate(rows):
            velocity = block @ r.reshape(-1) + wanted[i]
            left = saxce_residual(r[i][None], velocity[None], mu[i][None], rho[i][None])
            sizes.append(jnp.max(jnp.abs(left)) / rho[i])
        worst = jnp.max(jnp.stack(sizes)) / excuse(r)
        return jnp.where(jnp.isfinite(worst), worst, jnp.inf)

    def unfinished(carry):
        _, left, sweeps = carry
        return (left > tolerance) & (sweeps < most_sweeps)

    def improve(carry):
        r, _, sweeps = carry
        for i, block in enumerate(rows):
            free = block @ r.reshape(-1) + wanted[i] - own[i] @ r[i]
            r = r.at[i].set(one_contact(own[i], free, mu[i]))
        return r, residual(r), sweeps + 1

    start = jnp.zeros((c, d))
    return jax.lax.while_loop(unfinished, improve, (start, residual(start), jnp.zeros((), int)))
