"""What joints carry that always touch, where statics does not tell it: rows of a loop that no
motion changes (of forces along parallel axes, say) carry nothing in the joint that closes it,
though contacts would share what they can.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.base import ContactReport
from jaxclear.formulations.model import Instant
from jaxclear.formulations.permanent_reactions import Reaction, touching
from jaxclear.formulations.unique_reactions import reactions_without_motion
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.mechanism import Mechanism

# Beside the sum of the squares that rows add to forces: what keeps rows apart that add the same.
DAMPING = 1e-9


def shared(
    now: Instant, report: Callable[[str], ContactReport], mechanism: Mechanism
) -> Float[Array, "2 joints"] | None:
    """Of each joint that always touches, at a look: the sum of the forces on its ends [N], and by
    how much they are others where these rows carry what makes the squares of the forces on all ends
    least, as equal contacts between rigid bodies would. None where there are no such rows.
    `report`: what is told of a joint."""
    held = touching(now.model.system)
    rows = unmoved(now, mechanism) if held else []
    if not rows:
        return None
    reports = [report(one.name) for one in held]
    acting = [Reaction(tuple(one.force), tuple(one.torque)) for one in reports]
    forces = [_on_ends(one, own) for one, own in zip(held, acting, strict=True)]
    added = [
        [
            _on_ends(one, _sum(own, extra)) - force
            for one, own, extra, force in zip(held, acting, row, forces, strict=True)
        ]
        for row in rows
    ]
    share = _least_squares(forces, added)
    columns = []
    for k, force in enumerate(forces):
        others = force + sum(x * row[k] for x, row in zip(share, added, strict=True))
        sizes, changed = _sizes(force), _sizes(others)
        columns.append(jnp.stack([jnp.sum(sizes), jnp.sum(abs(changed - sizes))]))
    return jnp.stack(columns, axis=1)


def unmoved(now: Instant, mechanism: Mechanism) -> list[tuple[Reaction, ...]]:
    """For each row of a loop that no motion changes: what a force 1 in it adds to the reactions of
    the joints that always touch [N, N m]."""
    system = now.model.system
    in_space = any(len(body.inertia) > 1 for body in mechanism.bodies.values())
    return reactions_without_motion(system, now.motions, now.q, touching(system), in_space)


def _on_ends(one: Any, reaction: Reaction) -> Float[Array, "ends 3"]:
    """The forces on a joint's ends [N] by its reaction alone, which are linear in it."""
    none = 0.0 if one.joint.components == 1 else (0.0,) * one.joint.components
    return jnp.stack([sp.stack(end.force) for end in one.joint.carrying_ends(*reaction, none)])


def _sum(a: Reaction, b: Reaction) -> Reaction:
    return Reaction(sp.plus(a.force, b.force), sp.plus(a.torque, b.torque))


def _sizes(forces: Float[Array, "ends 3"]) -> Float[Array, " ends"]:
    return jnp.stack([sp.norm(tuple(own)) for own in forces])


def _least_squares(forces: list[Array], added: list[list[Array]]) -> tuple:
    """How much of each row [N, N m] makes the sum of squares of the forces least."""
    flat = [jnp.concatenate([own.ravel() for own in row]) for row in added]
    acting = jnp.concatenate([own.ravel() for own in forces])
    damping = DAMPING * sum(row @ row for row in flat) + jnp.finfo(float).tiny
    matrix = [[a @ b + (damping if a is b else 0.0) for b in flat] for a in flat]
    return factorisation.solve(factorisation.factor(matrix), tuple(-(a @ acting) for a in flat))


def indeterminate_forces(found: Float[Array, "looks 2 joints"]) -> Float[Array, " joints"]:
    """By joint how much its forces would be others, beside those of the joint that carries most."""
    carried, others = jnp.sum(found, axis=0)
    return safe_divide(others, jnp.max(carried, initial=0.0))
