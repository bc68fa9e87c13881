"""Contacts of a `FrictionContact` in units of their own, and how a solution moves with its data
while every contact keeps its state: open, sticking or sliding.

Between two states a derivative is one-sided: a contact that touches without force stays open, one
at the edge of its cone without slip sticks.
"""

from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.complementarity.friction_cone import LinearisedLaw, alart_curnier
from jaxclear.complementarity.friction_contact import FrictionContact
from jaxclear.ground.factorisation import eliminate
from jaxclear.ground.tangents import derived, moved

# States are told apart by this share of the largest reaction where derivatives are taken: a contact
# nearer to a corner stays in the state that `alart_curnier` names.
CORNER = 1e-9
# Singular values below this share of the largest are redundancy, not stiffness.
REDUNDANT = 1e-11
# Added to scaled sticking rows where equations are eliminated, so that redundant contacts leave a
# regular system.
REGULAR = 1e-12


class Scaled(NamedTuple):
    """A problem whose largest diagonal entry and largest velocity are 1, contact by contact:
    v_i = rows_i r + free_i, `own` the block of the contact itself, r_i - rho_i v_i a sum of like
    units. Reactions are r size / weight.
    """

    rows: list[list[Array]]
    free: list[Array]
    blocks_of_contacts: list[Array]
    mu: Array
    rho: list[Array]
    weight: Array
    size: Array

    def velocity(self, i: int, flat: Array) -> Array:
        """v of contact i."""
        return jnp.stack([row @ flat for row in self.rows[i]]) + self.free[i]


def scaled_contacts(problem: FrictionContact) -> Scaled:
    """A problem in units of its own."""
    starts, acts = problem.starts, problem.acts
    spans = list(pairwise(starts))
    diagonal = jnp.stack([row[k] for k, row in enumerate(problem.delassus)])
    heaviest = jnp.max(jnp.where(acts, diagonal, 0.0))
    weight = jnp.where(heaviest > 0, heaviest, 1.0)
    largest = jnp.max(jnp.abs(jnp.where(acts, problem.free_velocity, 0.0)))
    size = jnp.where(largest > 0, largest, 1.0)
    # A contact that may not act stands there as an open one by itself.
    eye, open_velocity = np.eye(starts[-1]), np.isin(np.arange(starts[-1]), starts).astype(float)
    rows = [
        jnp.where(acts[k] & acts, row / weight, eye[k]) for k, row in enumerate(problem.delassus)
    ]
    free = jnp.where(acts, problem.free_velocity / size, open_velocity)
    blocks_of_contacts = [jnp.stack([row[a:b] for row in rows[a:b]]) for a, b in spans]
    rho = [1 / jnp.max(jnp.stack([rows[k][k] for k in range(a, b)])) for a, b in spans]
    blocks = [rows[a:b] for a, b in spans]
    return Scaled(blocks, problem.split(free), blocks_of_contacts, problem.mu, rho, weight, size)


def linearise_laws(
    problem: Scaled, r: tuple, margin: Any, regular: float
) -> tuple[list[LinearisedLaw], list[Array]]:
    """The contact laws linearised about a solution, and the Jacobian of their residual by r.

    The residual is F(r, rho (W r + b)).

    Args:
        problem: contacts in units of their own.
        r: reactions, an array for each contact.
        margin: within which a contact at an edge of two states counts as open or sticking.
        regular: added to the rows of contacts that stick [1].
    """
    laws, lines, m, first = [], [], sum(map(len, r)), 0
    for i, part in enumerate(r):
        d, rho = len(part), problem.rho[i]
        velocity = problem.velocity(i, jnp.concatenate(r))
        law = alart_curnier(part, rho * velocity, problem.mu[i], margin)
        for a in range(d):
            through_v = sum(rho * law.of_s[a, b] * row for b, row in enumerate(problem.rows[i]))
            direct = law.of_r[a] + regular * law.of_s[a]
            padded = [jnp.zeros(first), direct, jnp.zeros(m - first - d)]
            lines.append(through_v + jnp.concatenate(padded))
        laws.append(law)
        first += d
    return laws, lines


@partial(jax.custom_jvp, nondiff_argnums=(5,))
def keep_states(r, solved, matrix, offset, mu, sizes: tuple[int, ...]) -> Array:
    r"""unchanged, with the derivatives of the solution whose contacts keep their states.

    They are zero where it is not solved, and of the least change of r where contacts are redundant.

    Args:
        r: reactions of all contacts, shape (m,).
        solved: whether r is a solution.
        matrix, offset, mu: W (m, m), b (m,) and friction coefficients of the problem.
        sizes: number of components of each contact.
    """
    return r


@keep_states.defjvp
def _keep_states_jvp(sizes, primals, tangents):
    r, solved, matrix, offset, mu = primals
    _, _, d_matrix, d_offset, d_mu = tangents
    out = keep_states(*primals, sizes)
    # What is not solved is made harmless before it is differentiated.
    posed = FrictionContact(
        jnp.where(solved, matrix, jnp.eye(len(r))), jnp.where(solved, offset, 0.0), mu, sizes
    )
    unit, lines, change = _moved(posed, out, (d_matrix @ out + d_offset, d_mu), 0.0)
    change = unit * jnp.where(solved, change, 0.0)
    return out, -jnp.linalg.pinv(jnp.stack(lines), rtol=REDUNDANT) @ change


def with_state_derivatives(problem: FrictionContact, r: Array) -> Array:
    """r, a solution, with the derivatives of the solution whose contacts keep their states, by
    operations that kernels have."""

    def tangent(numbers, tangents):
        (matrix, offset, mu, active), r = numbers
        d_matrix, d_offset, d_mu = jax.tree.map(moved, tangents[0][:3])
        # A contact without a normal (concentric parts) answers nothing.
        answers = jnp.stack([matrix[k][k] > 0 for k in problem.starts[:-1]])
        active = answers if active is None else active & answers
        posed = FrictionContact(matrix, offset, mu, problem.sizes, active)
        drift = jnp.stack([row @ r for row in d_matrix]) + d_offset
        unit, lines, change = _moved(posed, r, (jnp.where(posed.acts, drift, 0.0), d_mu), REGULAR)
        solution = eliminate(lines, -change)
        return unit * jnp.stack(solution)

    data = problem.delassus, problem.free_velocity, problem.mu, problem.active
    return derived(lambda _, r: r, tangent)(data, r)


def _moved(
    problem: FrictionContact, r: Array, tangents: tuple[Array, Array], regular: float
) -> tuple[Array, list[Array], Array]:
    """(unit of reactions, rows of the Jacobian of the laws at a solution r, by how much `ways` of
    the velocities with these reactions and of mu move the laws)."""
    scaled = scaled_contacts(problem)
    unit, sizes = scaled.size / scaled.weight, problem.sizes
    blocks = tuple(problem.split(r / unit))
    flat = jnp.concatenate(blocks)
    s = [scaled.rho[i] * scaled.velocity(i, flat) for i in range(len(sizes))]
    largest = jnp.maximum(jnp.max(jnp.abs(flat)), jnp.max(jnp.abs(jnp.concatenate(s))))
    laws, lines = linearise_laws(scaled, blocks, CORNER * jax.lax.stop_gradient(largest), regular)
    drifts = problem.split(tangents[0] / scaled.size)
    change = [
        law.of_s @ (scaled.rho[i] * drifts[i]) + law.of_mu * tangents[1][i]
        for i, law in enumerate(laws)
    ]
    return unit, lines, jnp.concatenate(change)
