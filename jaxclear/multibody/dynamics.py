r"""The equations of motion solved: from what acts to accelerations and reactions.

:math:`M \dot v = f + \Phi_q^T \lambda`, :math:`\Phi_q \dot v = \gamma`, with one mass matrix
for each subtree of the spanning tree and the multipliers :math:`\lambda` of the closed loops from
:math:`\Phi_q M^{-1} \Phi_q^T \lambda = \gamma - \Phi_q M^{-1} f` (Featherstone 2008, Rigid Body
Dynamics Algorithms, chapters 6 and 8, doi:10.1007/978-1-4899-7560-7).
"""

from typing import Any, NamedTuple

import jax

from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import map_alike
from jaxclear.multibody import constraints, kinematics, tree
from jaxclear.multibody.forces import Forces, add_action_and_reaction
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.system import System
from jaxclear.multibody.tree import Wrench


class Solution(NamedTuple):
    """Free accelerations per link, and multipliers of the constraint rows."""

    accelerations: tuple[tuple, ...]
    multipliers: tuple


def equations_of_motion(system: System, forces: Forces) -> tuple[list, list]:
    """By subtree its mass matrix, and the generalised forces less those that hold zero free
    accelerations.
    """
    ground = kinematics.upward(system)

    def subtree_equations(links, motions, wrenches):
        bias = tree.bias_forces(links, motions, ground, wrenches)
        return tree.mass_matrix(links, motions), bias

    calls = [
        kinematics.by_subtree(subtree, system.links, forces.motions, forces.wrenches)
        for subtree in system.topology.subtrees
    ]
    with jax.named_scope("equations of motion"):
        found = map_alike(subtree_equations, calls)
    masses, right = [], []
    for subtree, (mass, bias) in zip(system.topology.subtrees, found, strict=True):
        applied = [force for i in subtree for force in forces.coordinate_forces[i]]
        right.append(tuple(sp.sub(f, b) for f, b in zip(applied, bias, strict=True)))
        masses.append(mass)
    return masses, right


def forward_dynamics(system: System, forces: Forces, stabilisation: Baumgarte | None) -> Solution:
    """Free accelerations under the forces, with the loops closed."""
    masses, right = equations_of_motion(system, forces)
    factors = [factorisation.factor(mass) if mass else None for mass in masses]
    multipliers: tuple = ()
    if system.closures:
        with jax.named_scope("constraints"):
            free = [
                factorisation.solve(f, r) if f else () for f, r in zip(factors, right, strict=True)
            ]
            rows, gamma = constraints.acceleration_equations(system, forces.motions, stabilisation)
            multipliers, reactions = _multipliers(rows, gamma, factors, free)
            right = [
                tuple(sp.add(r, p) for r, p in zip(own, extra, strict=True))
                for own, extra in zip(right, reactions, strict=True)
            ]
    accelerations: list[tuple] = [()] * len(forces.motions)
    for subtree, factored, own in zip(system.topology.subtrees, factors, right, strict=True):
        values = factorisation.solve(factored, own) if factored else ()
        for i in subtree:
            count = len(forces.motions[i].columns)
            accelerations[i], values = tuple(values[:count]), values[count:]
    return Solution(tuple(accelerations), multipliers)


def _multipliers(
    rows: list[dict[int, Any]], gamma: list, factors: list, free: list[tuple]
) -> tuple[tuple, list[tuple]]:
    """The multipliers lambda from J M^-1 J^T lambda = gamma - J a_free, by subtrees, and
    J^T lambda."""
    count, ranges = 0, []
    for values in free:
        ranges.append(range(count, count + len(values)))
        count += len(values)
    free_flat = [x for values in free for x in values]
    inverse_rows = []
    for row in rows:
        responses: dict[int, Any] = {}
        for own, factored in zip(ranges, factors, strict=True):
            if any(j in own for j in row):
                column = tuple(row.get(j, 0) for j in own)
                responses |= zip(own, factorisation.solve(factored, column), strict=True)
        inverse_rows.append(responses)
    schur = [
        [sp.total(sp.mul(a, other.get(j, 0)) for j, a in row.items()) for other in inverse_rows]
        for row in rows
    ]
    right = [
        sp.sub(target, sp.total(sp.mul(a, free_flat[j]) for j, a in row.items()))
        for row, target in zip(rows, gamma, strict=True)
    ]
    multipliers = factorisation.solve(factorisation.factor(schur), tuple(right))
    reactions: list[Any] = [0] * count
    for row, multiplier in zip(rows, multipliers, strict=True):
        for j, entry in row.items():
            reactions[j] = sp.add(reactions[j], sp.mul(entry, multiplier))
    return multipliers, [tuple(reactions[j] for j in own) for own in ranges]


def joint_wrenches(system: System, forces: Forces, solution: Solution) -> tuple[Wrench, ...]:
    """Wrench that each link receives through its inboard joint (drive and coordinate loads
    included), in the link's frame.

    Reactions of loop closures act as loads here.
    """
    wrenches = list(forces.wrenches)
    for closure, force, torque, pose in constraints.constraint_wrenches(
        system, forces.motions, solution.multipliers
    ):
        add_action_and_reaction(wrenches, closure, pose, force, torque)
    accelerations = kinematics.link_accelerations(system, forces.motions, solution.accelerations)
    out: list[Wrench] = []
    for subtree in system.topology.subtrees:
        parts: tuple = (system.links, forces.motions, accelerations, wrenches)
        out.extend(tree.joint_wrenches(*kinematics.by_subtree(subtree, *parts)))
    return tuple(out)
