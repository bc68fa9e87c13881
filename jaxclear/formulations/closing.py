"""Bringing a state back onto the loop closures: the least change of coordinates and speeds in the
metric of the masses.
"""

from typing import Any

from jaxclear.formulations.compliant import drift
from jaxclear.formulations.contact_rows import ContactJacobianRow, along
from jaxclear.formulations.contact_solve import by_subtrees
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.multibody import constraints, kinematics, tree
from jaxclear.multibody.state import Layout, unpack_motion
from jaxclear.multibody.system import System


def close(system: System, layout: Layout, time: Any, entries: list) -> list:
    """The state's entries with coordinates and speeds on the closures, to the square of how far off
    they were.
    """
    q, v = entries[: layout.coordinates], entries[layout.coordinates : layout.memory_start]
    motions = kinematics.link_motions(system, *unpack_motion(system, [*q, *v]), time)
    found = [constraints.constraint_rows(system, motions, closure) for closure in system.closures]
    rows: list[ContactJacobianRow] = [row for closure in found for row in closure.jacobian]
    subtrees = (
        kinematics.by_subtree(subtree, system.links, motions)
        for subtree in system.topology.subtrees
    )
    respond = by_subtrees([tree.mass_matrix(*subtree) for subtree in subtrees])
    answers = [respond([row.get(j, 0) for j in range(len(v))]) for row in rows]
    schur = factorisation.factor([[along(row, answer) for answer in answers] for row in rows])

    def change(residuals):
        multipliers = factorisation.solve(schur, tuple(residuals))
        return [sp.neg(sp.dot(multipliers, column)) for column in zip(*answers, strict=True)]

    values, rates = (
        [x for closure in found for x in part(closure)]
        for part in (lambda c: c.residuals, lambda c: c.rates)
    )
    v = [sp.add(x, d) for x, d in zip(v, change(rates), strict=True)]
    return [*drift(system, q, q, change(values), 1.0), *v, *entries[layout.memory_start :]]
