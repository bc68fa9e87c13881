r"""The equations of motion solved: from what acts to accelerations and reactions.

:math:`M \dot v = f + \Phi_q^T \lambda`, :math:`\Phi_q \dot v = \gamma`, with one mass matrix
for each subtree of the spanning tree and the multipliers :math:`\lambda` of the closed loops from
:math:`\Phi_q M^{-1} \Phi_q^T \lambda = \gamma - \Phi_q M^{-1} f` (Featherstone 2008, Rigid Body
Dynamics Algorithms, chapters 6 and 8, doi:10.1007/978-1-4899-7560-7).

Energy of a mechanism and what flows in and out of it, so that the balance can be closed.
"""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.joint.base import drive_of
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_grouped, map_many
from jaxclear.ground.grouping import MANY
from jaxclear.ground.quantity import constant
from jaxclear.multibody import constraints, kinematics, transmissions, tree
from jaxclear.multibody.constraints import ClosureEquations, Dependence
from jaxclear.multibody.forces import Forces, with_rows
from jaxclear.multibody.kinematics import JacobianRow, along
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.rows import Direction, Row
from jaxclear.multibody.system import System
from jaxclear.multibody.tree import Wrench

# A row of the loops follows from others, or vanishes, where what is left of its square in the
# metric of the masses is no more than this share of the sum of those that count alike: 1e-5 rad
# from a singular position, where what closes loops grows without bound. Without it a linkage goes
# on by its inertia.
SINGULAR = 1e-10


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
        result = map_grouped(subtree_equations, calls)
    masses, right = [], []
    for subtree, (mass, bias) in zip(system.topology.subtrees, result, strict=True):
        applied = [force for i in subtree for force in forces.coordinate_forces[i]]
        right.append(tuple(sp.sub(f, b) for f, b in zip(applied, bias, strict=True)))
        masses.append(mass)
    return masses, right


def forward_dynamics(system: System, forces: Forces, stabilisation: Baumgarte | None) -> Solution:
    """Free accelerations under the forces, with the loops closed, and the multipliers.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        forces: all that acts, with the motions at which it does.
        stabilisation: Baumgarte's terms of the loops; None: without.
    """
    masses, right = equations_of_motion(system, forces)
    loops = ClosureEquations([], [], (), None)
    if system.closures:
        with jax.named_scope("constraints"):
            loops = constraints.acceleration_equations(system, forces.motions, stabilisation)
    respond, constrain = constrained_inverse(masses, loops.rows, loops.kinds, loops.dependence)
    (free,) = respond([[x for part in right for x in part]])
    accelerations, multipliers = constrain(free, loops.targets)
    return Solution(
        tuple(tuple(accelerations[branch.speeds]) for branch in system.topology.branches),
        multipliers,
    )


def constrained_inverse(
    masses: list, rows: list[JacobianRow], same: tuple, dependence: Dependence | None
) -> tuple[Callable[[list[list]], list[list]], Callable[[list, list], tuple[list, tuple]]]:
    """Functions that apply M^-1 and that correct accelerations to satisfy constraint rows.

    Of rows that depend on each other, the multipliers are the least ones, torques divided by the
    longest arm; of rows that follow from others at a singular position only, they are 0.

    Args:
        masses: mass matrix of each subtree, rows of entries; empty without free speeds.
        rows: Jacobian rows of all closures, by speed index.
        same: kind of each row, as `ClosureEquations.kinds`.
        dependence: rank of rows that depend on each other; None: they are independent.

    Returns:
        `respond`: columns of generalised forces to columns of accelerations, structurally zero
        where no
            force acts; `constrain`: accelerations and targets of the rows to corrected
        accelerations and
        multipliers.
    """
    result = iter(map_many(factorisation.factor, [(mass,) for mass in masses if mass]))
    factors = [next(result) if mass else None for mass in masses]
    size = sum(len(mass) for mass in masses)

    def respond(columns):
        if len(columns) < MANY:
            return [_respond_to_columns([column], masses, factors)[0] for column in columns]
        return _respond_to_columns(columns, masses, factors)

    columns = respond([[row.get(j, 0) for j in range(size)] for row in rows])
    schur = [[along(row, column) for column in columns] for row in rows]
    closed = _make_multiplier_solver(schur, same, dependence) if rows else None

    def constrain(accelerations, needed):
        if closed is None:
            return accelerations, ()
        lacking = []
        for target, row in zip(needed, rows, strict=True):
            lacking.append(sp.sub(target, along(row, accelerations)))
        multipliers = closed(tuple(lacking))
        changed = []
        for acceleration, entries in zip(accelerations, zip(*columns, strict=True), strict=True):
            changed.append(sp.add(acceleration, sp.dot(multipliers, entries)))
        return changed, multipliers

    return respond, constrain


def _respond_to_columns(columns: list[list], masses: list, factors: list) -> list[list]:
    """Accelerations by columns of generalised forces; alike ones are traced once."""
    parts = []
    for forces in columns:
        rest = iter(forces)
        parts.append([tuple(itertools.islice(rest, len(mass))) for mass in masses])
    moved = [
        (k, i)
        for k, part in enumerate(parts)
        for i, each in enumerate(part)
        if not all(map(sp.is_zero, each))
    ]
    result = map_many(factorisation.solve, [(factors[i], parts[k][i]) for k, i in moved])
    for (k, i), part in zip(moved, result, strict=True):
        parts[k][i] = part
    return [[x for each in part for x in each] for part in parts]


def _make_multiplier_solver(
    schur: list[list], same: tuple, dependence: Dependence | None
) -> Callable[[tuple], tuple]:
    """From what the rows lack to multipliers; `same`: of each row which count alike (None: it is
    taken as it is)."""
    if dependence is None:
        total: dict[Any, Any] = {}
        for i, kind in enumerate(same):
            total[kind] = sp.add(total.get(kind, 0), schur[i][i])
        least = {kind: constant(SINGULAR * x) for kind, x in total.items()} | {None: None}
        factors = factorisation.factor(schur, [least[kind] for kind in same])
        return lambda lacking: factorisation.solve(factors, lacking)
    measured = dependence.measures

    def scaled(values):
        return tuple(sp.mul(x, w) for x, w in zip(values, measured, strict=True))

    lengths = [scaled(sp.mul(x, w) for x in row) for row, w in zip(schur, measured, strict=True)]
    present = factorisation.factor_of_rank(lengths, dependence.rank)
    return lambda lacking: scaled(factorisation.solve_least(present, scaled(lacking)))


def with_closures(system: System, forces: Forces, solution: Solution) -> Forces:
    """The forces with those of closures added: joints that close loops, rigid couplings.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        forces: all that acts but the closures.
        solution: with the multipliers at these forces.
    """
    every = list(constraints.multipliers_by_closure(system, forces.motions, solution.multipliers))
    meshes = [
        (transmission.closure, forces.pressing[name].torque / transmission.scale)
        for name, transmission in system.transmissions.items()
    ]
    meshes += [(closure, values.get(0, 0.0)) for closure, values in every]
    pulls = transmissions.pulls_of_centres(forces.motions, meshes)
    rows = constraints.closing_rows(system, forces.motions, every)
    return with_rows(forces, [*rows, *(Row("", Direction((pull,)), 1) for pull in pulls)])


def joint_wrenches(system: System, forces: Forces, solution: Solution) -> tuple[Wrench, ...]:
    """Wrench that each link receives through its inboard joint, in the link's frame.

    Drives and loads on coordinates are part of it.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        forces: all that acts, closures included (`with_closures`).
        solution: free accelerations under these forces.
    """
    accelerations = kinematics.link_accelerations(system, forces.motions, solution.accelerations)
    out: list[Wrench] = []
    for subtree in system.topology.subtrees:
        parts: tuple = (system.links, forces.motions, accelerations, forces.wrenches)
        out.extend(tree.joint_wrenches(*kinematics.by_subtree(subtree, *parts)))
    return tuple(out)


def powers(system: System, forces: Forces, solution: Solution) -> list:
    """Rates [W] of the energies of the balance, in the order of `state.ENERGIES`.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        forces: all that acts but the closures, which are added.
        solution: accelerations and multipliers under these forces.
    """
    driven, forces = 0, with_closures(system, forces, solution)
    wrenches = joint_wrenches(system, forces, solution)
    for index, link in enumerate(system.links):
        if drive_of(link.joint) is not None:
            twist = kinematics.joint_twist(system, forces.motions, index)
            driven = sp.add(driven, tree.power(twist, wrenches[index]))
    reports = forces.reports.values()
    return [
        sp.add(driven, forces.external_power),
        sp.total(r.contact_power for r in reports),
        sp.total(r.contact_loss for r in reports),
        sp.total(r.friction_loss for r in reports),
        forces.damping_loss,
    ]


def mechanical_energy(system: System, forces: Forces) -> tuple[Any, Any]:
    """(kinetic energy, potential energy of gravity and springs) [J]; gravity's is zero at the
    ground's origin.
    """
    kinetic, potential = 0.0, forces.stored

    def energies(mass, moment, inertia, pose, twist):
        v, w = twist
        moving = 0.5 * (
            sp.add(sp.mul(mass, sp.dot(v, v)), sp.dot(w, sp.apply(inertia, w)))
            + sp.mul(2.0, sp.dot(v, sp.cross(w, moment)))
        )
        weighted = sp.plus(sp.scale(mass, pose.translation), sp.apply(pose.rotation, moment))
        return moving, sp.dot(system.gravity, weighted)

    pairs = list(zip(system.links, forces.motions, strict=True))
    calls = [(part.mass, part.first_moment, part.inertia, m.pose, m.twist) for part, m in pairs]
    for index, (moving, lifted) in enumerate(map_many(energies, calls)):
        rotor = system.links[index].rotor
        if rotor is not None:
            kinetic = kinetic + 0.5 * rotor * _joint_speed(system, forces, index) ** 2
        kinetic = kinetic + moving
        potential = sp.sub(potential, lifted)
    return kinetic, jnp.asarray(potential, float)


def _joint_speed(system: System, forces: Forces, index: int) -> Any:
    """Speed [rad/s, m/s] of the single coordinate of a link's joint."""
    (column,) = forces.motions[index].columns
    twist = kinematics.joint_twist(system, forces.motions, index)
    along = sp.add(sp.dot(column.linear, twist.linear), sp.dot(column.angular, twist.angular))
    square = sp.add(sp.dot(column.linear, column.linear), sp.dot(column.angular, column.angular))
    return along / square
