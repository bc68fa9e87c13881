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
    """A solution: percussions and velocities, contact after contact, residual relative to the largest velocity, sweeps taken."""

    percussion: Float[Array, " m"]
    velocity: Float[Array, " m"]
    residual: Float[Array, ""]
    sweeps: Int[Array, ""]


def impact(
    delassus: Sequence[Sequence[Float[Array, " m"]]],
    free: Sequence[Float[Array, " d"]],
    before: Sequence[Any],
    active: Bool[Array, " c"],
    restitution: Float[Array, " c"],
    mu: Float[Array, " c"],
    *,
    most_sweeps: Any,
    tolerance: Any,
) -> Percussions:
    """The percussions that carry velocities over the step; `free`: those at its end without them, `before`: each contact's
    opening speed at its start.

    `delassus`: each contact's rows; one has as many as it has directions (1 without friction). A contact that is not `active`
    has no percussion. `tolerance`: residual of the law, relative to the largest velocity, at which sweeps end.
    """
    sizes = [len(part) for part in free]
    first = np.concatenate([[0], np.cumsum(sizes)]).tolist()
    eye = np.eye(first[-1])
    kept = jnp.concatenate([jnp.broadcast_to(active[i], (d,)) for i, d in enumerate(sizes)])
    inertias = [_diagonal(rows, first[i]) for i, rows in enumerate(delassus)]
    heaviest = jnp.max(jnp.concatenate([jnp.where(active[i], entries, 0.0) for i, entries in enumerate(inertias)]))
    weight = jnp.where(heaviest > 0, heaviest, 1.0)
    rows = [
        [jnp.where(active[i] & kept, row / weight, eye[first[i] + k]) for k, row in enumerate(part)]
        for i, part in enumerate(delassus)
    ]
    wanted = [part.at[0].add(restitution[i] * before[i]) for i, part in enumerate(free)]
    wanted = [jnp.where(active[i], part, np.eye(1, len(part))[0]) for i, part in enumerate(wanted)]
    largest = jnp.max(jnp.concatenate([jnp.abs(jnp.where(active[i], part, 0.0)) for i, part in enumerate(wanted)]))
    size = jnp.where(largest > 0, largest, 1.0)
    found, residual, sweeps = _sweep_until(rows, [part / size for part in wanted], mu, most_sweeps, tolerance)
    percussion = jnp.where(kept, jnp.concatenate(found) * size / weight, 0.0)
    velocity = jnp.concatenate(free) + jnp.stack([row @ percussion for part in delassus for row in part])
    return Percussions(percussion, velocity, residual, sweeps)


def _diagonal(rows: Sequence[Array], first: int) -> Array:
    """Diagonal entries of a contact's own rows, the first of which is `first` of all."""
    return jnp.stack([row[first + k] for k, row in enumerate(rows)])


def _sweep_until(rows: list, wanted: list, mu: Array, most_sweeps: Any, tolerance: Any) -> tuple[tuple, Array, Array]:
    """(percussions by contact, residual, sweeps) from rest. Small arrays, a row at a time: large ones do not fit into the
    registers of a kernel."""
    first = np.concatenate([[0], np.cumsum([len(part) for part in rows])]).tolist()
    own = [jnp.stack([row[first[i] : first[i + 1]] for row in part]) for i, part in enumerate(rows)]
    rho = [1 / jnp.max(_diagonal(part, first[i])) for i, part in enumerate(rows)]

    def velocity(i, flat):
        return jnp.stack([row @ flat for row in rows[i]]) + wanted[i]

    def residual(r):
        flat = jnp.concatenate(r)
        sizes = []
        for i, part in enumerate(r):
            left = saxce_residual(part[None], velocity(i, flat)[None], mu[i][None], rho[i][None])
            sizes.append(jnp.max(jnp.abs(left)) / rho[i])
        worst = jnp.max(jnp.stack(sizes)) / excuse(flat)
        return jnp.where(jnp.isfinite(worst), worst, jnp.inf)

    def unfinished(carry):
        _, left, sweeps = carry
        return (left > tolerance) & (sweeps < most_sweeps)

    def improve(carry):
        r, _, sweeps = carry
        for i, part in enumerate(r):
            free = velocity(i, jnp.concatenate(r)) - own[i] @ part
            r = (*r[:i], one_contact(own[i], free, mu[i]), *r[i + 1 :])
        return r, residual(r), sweeps + 1

    start = tuple(jnp.zeros(len(part)) for part in rows)
    return jax.lax.while_loop(unfinished, improve, (start, residual(start), jnp.zeros((), int)))
