"""Contacts of a `FrictionContact` in units of their own, and how a solution moves with its data
while every contact keeps its state: open, sticking or sliding.

Between two states a derivative is one-sided: a contact that touches without force stays open, one
at the edge of its cone without slip sticks.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.complementarity.friction_cone import alart_curnier
from jaxclear.complementarity.friction_contact import FrictionContact
from jaxclear.ground.factorisation import eliminate
from jaxclear.ground.tangents import derived, pushed

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
    starts = problem.starts
    spans = list(pairwise(starts))
    # A contact without a normal (concentric parts) answers nothing.
    answers = [jnp.broadcast_to(problem.delassus[a][a] > 0, (b - a,)) for a, b in spans]
    acts = problem.acts & jnp.concatenate(answers)
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


def linearise_laws(problem: Scaled, r: tuple, damping: Any) -> tuple[Array, list[Array]]:
    """What the laws of all contacts miss, and how that changes with the reactions.

    Args:
        problem: contacts in units of their own.
        r: reaction of each contact, a tuple of arrays [1].
        damping: change of velocities by that of reactions that is added [1].

    Returns:
        what is missed, and the rows of its Jacobian [1].
    """
    values, lines, m, first = [], [], sum(map(len, r)), 0
    for i, part in enumerate(r):
        d, rho, mu = len(part), problem.rho[i], problem.mu[i]
        s = rho * problem.velocity(i, jnp.concatenate(r))
        law = lambda r, s, mu=mu: alart_curnier(r, s, mu, 0.0)
        value, push = jax.linearize(law, part, s)
        still, units = jnp.zeros(d), [jnp.asarray(unit) for unit in np.eye(d)]
        of_r, of_s = [push(e, still) for e in units], [push(still, e) for e in units]
        for a in range(d):
            through_v = sum(rho * of_s[b][a] * row for b, row in enumerate(problem.rows[i]))
            direct = jnp.stack([of_r[b][a] + damping * of_s[b][a] for b in range(d)])
            padded = [jnp.zeros(first), direct, jnp.zeros(m - first - d)]
            lines.append(through_v + jnp.concatenate(padded))
        values.append(value)
        first += d
    return jnp.concatenate(values), lines


def laws_missed(problem: FrictionContact, r: Array, regular: float = REGULAR) -> Array:
    """What reactions miss of the laws in the states that they are in, for derivatives at a
    solution.

    Args:
        problem: the contacts.
        r: reactions, an array (m,) [as the problem's z].
        regular: keeps redundant contacts that stick from leaving derivatives undetermined [1].

    Returns:
        what is missed, an array (m,) [1].
    """
    scaled = scaled_contacts(problem)
    parts = problem.split(r / (scaled.size / scaled.weight))
    flat = jnp.concatenate(parts)
    laws = [
        (
            part,
            rho * scaled.velocity(i, flat) + regular * (part - jax.lax.stop_gradient(part)),
            scaled.mu[i],
        )
        for i, (part, rho) in enumerate(zip(parts, scaled.rho, strict=True))
    ]
    largest = jnp.max(jnp.abs(jnp.concatenate([flat, *(s for _, s, _ in laws)])))
    margin = CORNER * jax.lax.stop_gradient(largest)
    return jnp.concatenate([alart_curnier(*law, margin) for law in laws])


def least_solution(lines: list[Array], right: Array) -> Array:
    """Of redundant contacts the least change."""
    return jnp.linalg.pinv(jnp.stack(lines), rtol=REDUNDANT) @ right


def with_derivatives(
    misses: Callable[[Array], Array], root: Array, solve: Callable = eliminate
) -> Array:
    """A root of a function, with the derivatives that it has as such (implicit function theorem).

    Args:
        misses: what arguments (n,) miss of the equations, an array (n,).
        root: where that is zero, an array (n,).
        solve: solves linear equations given by rows and right-hand sides; by default by operations
            that kernels have.

    Returns:
        the root, an array (n,).
    """
    function, numbers = jax.closure_convert(misses, root)

    def tangent(arguments, tangents):
        root, *numbers = arguments
        _, push = jax.linearize(lambda root: function(root, *numbers), root)
        columns = jnp.stack([push(jnp.asarray(unit)) for unit in np.eye(len(root))])
        at_root = lambda *numbers: function(root, *numbers)
        change = pushed(at_root, numbers, tangents[1:])[1]
        solution = solve([columns[:, i] for i in range(len(root))], -change)
        return jnp.stack([solution[i] for i in range(len(root))])

    # What the root was found from is not cut off: by that loops know what moves.
    return derived(lambda root, *_: root, tangent)(root, *numbers)
