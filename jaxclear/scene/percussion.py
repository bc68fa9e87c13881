"""Percussions of rigid contacts over a time step: what keeps bodies apart, makes them rebound, and rubs.

Unknown are percussions r [N s] and velocities v [m/s] of the contacts at the end of the step, v = W r + b with Delassus' matrix
W; per contact the normal first (positive pushes apart; velocity positive opening), then its tangents. Newton's law of impact
asks v_n + e v_n(before) >= 0 perp r_n >= 0 (Moreau 1988, in Nonsmooth Mechanics and Applications, 1); friction is Coulomb's.
Sweeps over the contacts, each solved exactly, of plain operations only, so that a time loop stays one kernel.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxclear.scene.projection import Contacts, contacts_of, error_of, one_contact


class Percussions(NamedTuple):
    """A solution: percussions and velocities per contact, residual relative to the largest velocity, sweeps taken."""

    percussion: Float[Array, "c d"]
    velocity: Float[Array, "c d"]
    residual: Float[Array, ""]
    sweeps: Int[Array, ""]


def impact(
    delassus: Float[Array, "m m"],
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

    A contact that is not `active` has none. `tolerance`: residual of the law, relative to the largest velocity, at which sweeps
    end.
    """
    c, d = free.shape
    kept = jnp.broadcast_to(active[:, None], (c, d)).reshape(-1)
    matrix = jnp.where(kept[:, None] & kept[None, :], delassus, jnp.eye(c * d))
    wanted = free.at[:, 0].add(restitution * before[:, 0])
    wanted = jnp.where(active[:, None], wanted, jnp.zeros((c, d)).at[:, 0].set(1.0))
    largest = jnp.max(jnp.abs(jnp.where(active[:, None], wanted, 0.0)))
    size = jnp.where(largest > 0, largest, 1.0)
    weight = jnp.max(jnp.stack([matrix[i, i] for i in range(c * d)]))
    contacts = contacts_of(matrix / weight, (wanted / size).reshape(-1), mu)
    r, residual, sweeps = sweep_until(contacts, most_sweeps, tolerance)
    percussion = jnp.where(active[:, None], r * size / weight, 0.0)
    velocity = free + (delassus @ percussion.reshape(-1)).reshape(c, d)
    return Percussions(percussion, velocity, residual, sweeps)


def sweep_until(contacts: Contacts, most_sweeps: Any, tolerance: Any) -> tuple[Array, Array, Array]:
    """(reactions, residual, sweeps) from rest, contact by contact."""

    def unfinished(carry):
        _, residual, sweeps = carry
        return (residual > tolerance) & (sweeps < most_sweeps)

    def improve(carry):
        r, _, sweeps = carry
        for i in range(r.shape[0]):
            own = contacts.own[i]
            free = contacts.rows[i] @ r.reshape(-1) + contacts.velocity[i] - own @ r[i]
            r = r.at[i].set(one_contact(own, free, contacts.mu[i]))
        return r, error_of(contacts, r), sweeps + 1

    start = jnp.zeros_like(contacts.velocity)
    return jax.lax.while_loop(unfinished, improve, (start, error_of(contacts, start), jnp.zeros((), int)))
