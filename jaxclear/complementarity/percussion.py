"""Percussions of rigid contacts over a time step: what keeps bodies apart, makes them rebound, and
rubs.

Unknown are percussions r [N s] and velocities v [m/s] of the contacts at the end of the step, v = W
r + b with Delassus' matrix W; per contact the normal first (positive pushes apart; velocity
positive opening), then its tangents. Newton's law of impact asks v_n + e v_n(before) >= 0 perp r_n
>= 0 (Moreau 1988, in Nonsmooth Mechanics and Applications, 1); friction is Coulomb's. Sweeps over
the contacts, each solved exactly, then all at once by Newton's method whenever it comes nearer; of
plain operations only, so that a time loop stays one kernel.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxclear.complementarity.friction_cone import (
    REGULAR,
    law,
    one_contact,
    project_on_cone,
    saxce_residual,
)
from jaxclear.complementarity.problem import excuse

# Sweeps between two tries of Newton's method, which is left out beyond so many unknowns: its
# elimination is written out.
SWEEPS, LARGEST_ELIMINATED = 2, 24


class Percussions(NamedTuple):
    """A solution: percussions and velocities, contact after contact, residual relative to the
    largest velocity, sweeps taken.
    """

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
    guess: Sequence[Float[Array, " d"]] | None = None,
    *,
    most_sweeps: Any,
    tolerance: Any,
) -> Percussions:
    """The percussions that carry velocities over the step; `free`: those at its end without them,
    `before`: each contact's opening speed at its start.

    `delassus`: each contact's rows; one has as many as it has directions (1 without friction). A
    contact that is not `active` has no percussion. `guess`: percussions to start from. `tolerance`:
    residual of the law, relative to the largest velocity, at which sweeps end.
    """
    sizes = [len(part) for part in free]
    first = np.concatenate([[0], np.cumsum(sizes)]).tolist()
    eye = np.eye(first[-1])
    kept = jnp.concatenate([jnp.broadcast_to(active[i], (d,)) for i, d in enumerate(sizes)])
    inertias = [_diagonal(rows, first[i]) for i, rows in enumerate(delassus)]
    heaviest = jnp.max(
        jnp.concatenate([jnp.where(active[i], entries, 0.0) for i, entries in enumerate(inertias)])
    )
    weight = jnp.where(heaviest > 0, heaviest, 1.0)
    rows = [
        [jnp.where(active[i] & kept, row / weight, eye[first[i] + k]) for k, row in enumerate(part)]
        for i, part in enumerate(delassus)
    ]
    wanted = [part.at[0].add(restitution[i] * before[i]) for i, part in enumerate(free)]
    wanted = [jnp.where(active[i], part, np.eye(1, len(part))[0]) for i, part in enumerate(wanted)]
    largest = jnp.max(
        jnp.concatenate([jnp.abs(jnp.where(active[i], part, 0.0)) for i, part in enumerate(wanted)])
    )
    size = jnp.where(largest > 0, largest, 1.0)
    start = tuple(
        jnp.zeros(d) if guess is None else jnp.where(active[i], guess[i] * weight / size, 0.0)
        for i, d in enumerate(sizes)
    )
    found, residual, sweeps = _sweep_until(
        rows, [part / size for part in wanted], mu, start, most_sweeps, tolerance
    )
    percussion = jnp.where(kept, jnp.concatenate(found) * size / weight, 0.0)
    velocity = jnp.concatenate(free) + jnp.stack(
        [row @ percussion for part in delassus for row in part]
    )
    return Percussions(percussion, velocity, residual, sweeps)


def _diagonal(rows: Sequence[Array], first: int) -> Array:
    """Diagonal entries of a contact's own rows, the first of which is `first` of all."""
    return jnp.stack([row[first + k] for k, row in enumerate(rows)])


def _sweep_until(
    rows: list, wanted: list, mu: Array, start: tuple, most_sweeps: Any, tolerance: Any
) -> tuple[tuple, Array, Array]:
    """(percussions by contact, residual, sweeps). Small arrays, a row at a time: large ones do not
    fit into the registers of a kernel."""
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
        _, left, _, sweeps = carry
        return (left > tolerance) & (sweeps < most_sweeps)

    def sweep(_, r):
        for i, part in enumerate(r):
            free = velocity(i, jnp.concatenate(r)) - own[i] @ part
            r = (*r[:i], one_contact(own[i], free, mu[i]), *r[i + 1 :])
        return r

    def improve(carry):
        r, _, best, sweeps = carry
        r = jax.lax.fori_loop(0, SWEEPS, sweep, r)
        left = residual(r)
        if first[-1] > LARGEST_ELIMINATED:
            return r, left, jnp.minimum(best, left), sweeps + SWEEPS
        there = _newton(rows, [velocity(i, jnp.concatenate(r)) for i in range(len(r))], mu, rho, r)
        left_there = residual(there)
        # Steps that are no better than what was known would lead round in circles.
        nearer = left_there < 0.5 * jnp.minimum(best, left)
        r = tuple(jnp.where(nearer, a, b) for a, b in zip(there, r, strict=True))
        left = jnp.where(nearer, left_there, left)
        return r, left, jnp.minimum(best, left), sweeps + SWEEPS

    none = jnp.zeros((), int)
    if len(rows) == 1:
        # A single contact is solved by one sweep.
        still = residual(start) <= tolerance
        found = tuple(jnp.where(still, a, b) for a, b in zip(start, sweep(0, start), strict=True))
        return found, residual(found), jnp.where(still, none, none + 1)
    first_residual = residual(start)
    found, left, _, sweeps = jax.lax.while_loop(
        unfinished, improve, (start, first_residual, first_residual, none)
    )
    return found, left, sweeps


def _newton(rows: list, velocities: list, mu: Array, rho: list, r: tuple) -> tuple:
    """A step of Newton's method for all contacts in the states they are in, brought back into their
    cones.
    """
    sizes = [len(part) for part in r]
    m, lines, first = sum(sizes), [], 0
    for i, part in enumerate(r):
        found = law(part, rho[i] * velocities[i], mu[i], 0.0)
        for a in range(sizes[i]):
            through_v = sum(rho[i] * found.of_s[a, b] * row for b, row in enumerate(rows[i]))
            # Redundant contacts leave a regular system.
            direct = found.of_r[a] + REGULAR * found.of_s[a]
            padded = jnp.concatenate([jnp.zeros(first), direct, jnp.zeros(m - first - sizes[i])])
            lines.append(jnp.append(through_v + padded, found.value[a]))
        first += sizes[i]
    change = jnp.stack(_eliminate(lines))
    ends = np.cumsum(sizes).tolist()
    return tuple(
        project_on_cone(part - change[e - d : e], mu[i])
        for i, (part, e, d) in enumerate(zip(r, ends, sizes, strict=True))
    )


def _eliminate(lines: list) -> list:
    """Solution of a system of equations whose right-hand sides end its rows, by elimination with
    partial pivoting.
    """
    n = len(lines)
    for k in range(n):
        for i in range(k + 1, n):
            larger = jnp.abs(lines[i][k]) > jnp.abs(lines[k][k])
            lines[k], lines[i] = (
                jnp.where(larger, lines[i], lines[k]),
                jnp.where(larger, lines[k], lines[i]),
            )
        lines[k] = lines[k] / lines[k][k]
        lines[k + 1 :] = [line - line[k] * lines[k] for line in lines[k + 1 :]]
    for k in range(n - 1, 0, -1):
        lines[:k] = [line - line[k] * lines[k] for line in lines[:k]]
    return [line[n] for line in lines]
