"""Bringing a state back onto the loop closures: the least change of coordinates and speeds in the
metric of the masses.
"""

from typing import Any

from jaxclear.formulations.model import Model, State
from jaxclear.formulations.state_rate import drift
from jaxclear.ground import sparse as sp
from jaxclear.multibody import constraints, dynamics, kinematics, tree
from jaxclear.multibody.state import unpack_motion


def closed(model: Model, time: Any, state: State) -> State:
    """The state at the end of a step, its loops closed anew where they are to be: to the square of
    how far off they were.
    """
    if not model.projects:
        return state
    system, layout, entries = model.system, model.layout, model.entries(state)
    q, v = entries[: layout.coordinates], entries[layout.coordinates : layout.memory_start]
    motions = kinematics.link_motions(system, *unpack_motion(system, [*q, *v]), time)
    found = [constraints.constraint_rows(system, motions, closure) for closure in system.closures]
    rows = [row for closure in found for row in closure.jacobian]
    subtrees = (
        kinematics.by_subtree(subtree, system.links, motions)
        for subtree in system.topology.subtrees
    )
    masses = [tree.mass_matrix(*subtree) for subtree in subtrees]
    _, constrain = dynamics.constrained_inverse(masses, rows, constraints.dependence(system, found))

    def change(residuals):
        return constrain([0] * len(v), [sp.neg(x) for x in residuals])[0]

    residuals = [x for closure in found for x in closure.residuals]
    rates = [x for closure in found for x in closure.rates]
    v = [sp.add(x, d) for x, d in zip(v, change(rates), strict=True)]
    q = drift(system, q, q, change(residuals), 1.0)
    return sp.stack([*q, *v, *entries[layout.memory_start :]])
