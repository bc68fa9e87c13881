"""Bringing a state back onto the loop closures: the least change of coordinates and speeds in the
metric of the masses.

At a singular position the rows of loops depend on each other, and the least change that closes them
grows without bound. A change beyond `MOST` of a step's way, or of the speeds, is no error of the
step and hardly taken: a linkage goes on through such a position by its inertia, and the next steps
close it.
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.formulations.model import Model, State
from jaxclear.formulations.state_rate import drift
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import constant
from jaxclear.multibody import constraints, dynamics, kinematics, tree
from jaxclear.multibody.state import unpack_motion, within_bounds

# Of a step's way, and of the speeds: a step that is off by a fifth does not resolve the motion.
MOST = 0.2


def closed(model: Model, time: Any, state: State, length: Any = None) -> State:
    """The state at the end of a step with its loops closed anew, where the mechanism's loops are to
    be.

    The residual falls to its square. States that are at a bound stay there.

    Args:
        model: the mechanism, a `Model`.
        time: time at the end of the step [s].
        state: the state, an array (n,).
        length: length of the step [s], which limits what counts as an error of the step; None: no
            limit, also at a singular position.

    Returns:
        the state, an array (n,).
    """
    state = within_bounds(model.system, model.layout, state)
    if not model.projects:
        return state
    system, layout, entries = model.system, model.layout, model.entries(state)
    q, v = entries[: layout.coordinates], entries[layout.coordinates : layout.memory_start]
    motions = kinematics.link_motions(system, *unpack_motion(system, [*q, *v]), time)
    result = [constraints.constraint_rows(system, motions, closure) for closure in system.closures]
    rows = [row for closure in result for row in closure.jacobian]
    subtrees = (
        kinematics.by_subtree(subtree, system.links, motions)
        for subtree in system.topology.subtrees
    )
    masses = [tree.mass_matrix(*subtree) for subtree in subtrees]
    same = constraints.row_kinds(system, result)
    depend = constraints.dependence(system, result)
    _, constrain = dynamics.constrained_inverse(masses, rows, same, depend)

    fast = None if length is None else MOST * safe_sqrt(_squared_norm(masses, v))

    def change(residuals, time):
        """The least that closes them, as far as it is below what is made at the speeds in such a
        time, in the metric of the masses."""
        moves, multipliers = constrain([0] * len(v), [sp.neg(x) for x in residuals])
        if fast is None:
            return moves
        most = sp.mul(time, fast)
        # Twice the energy of a change is what it closes times its multipliers.
        relative = safe_divide(abs(sp.dot(multipliers, residuals)), most * most)
        share = constant(1.0 / (1.0 + relative * relative))
        # At the position itself nothing is a number.
        return [jnp.where(share > 0, sp.mul(share, x), 0.0) for x in moves]

    residuals = [x for closure in result for x in closure.residuals]
    rates = [x for closure in result for x in closure.rates]
    v = [sp.add(x, d) for x, d in zip(v, change(rates, 1), strict=True)]
    q = drift(system, q, q, change(residuals, length), 1.0)
    return sp.stack([*q, *v, *entries[layout.memory_start :]])


def _squared_norm(masses: list, v: list) -> Any:
    """The square of speeds in the metric of the masses, twice their kinetic energy [J]."""
    result, first = [], 0
    for mass in masses:
        part = v[first : first + len(mass)]
        first += len(mass)
        result += [sp.mul(x, sp.dot(row, part)) for x, row in zip(part, mass, strict=True)]
    return sp.total(result)
