"""Energy of a mechanism and what flows in and out of it, so that the balance can be closed."""

from typing import Any

import jax.numpy as jnp

from jaxclear.components.joint.base import drive_of
from jaxclear.ground import sparse as sp
from jaxclear.multibody import constraints, coordinate_sums, dynamics, kinematics, tree
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces
from jaxclear.multibody.system import System


def powers(system: System, forces: Forces, solution: Solution) -> list:
    """Rates [W] of the energies of the balance, in the order of `state.ENERGIES`."""
    driven = 0
    wrenches = dynamics.joint_wrenches(system, forces, solution)
    for index, link in enumerate(system.links):
        if drive_of(link.joint) is not None:
            twist = kinematics.joint_twist(system, forces.motions, index)
            driven = sp.add(driven, tree.power(twist, wrenches[index]))
    for closure, own in constraints.coupled(system, forces.motions, solution.multipliers):
        given = coordinate_sums.driven_power(forces.motions, closure.reading, own[0])
        driven = sp.sub(driven, given)
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
    for index, (link, motion) in enumerate(zip(system.links, forces.motions, strict=True)):
        v, w = motion.twist
        if link.rotor is not None:
            kinetic = kinetic + 0.5 * link.rotor * _speed(system, forces, index) ** 2
        kinetic = kinetic + 0.5 * (
            sp.add(sp.mul(link.mass, sp.dot(v, v)), sp.dot(w, sp.apply(link.inertia, w)))
            + sp.mul(2.0, sp.dot(v, sp.cross(w, link.first_moment)))
        )
        weighted = sp.plus(
            sp.scale(link.mass, motion.pose.translation),
            sp.apply(motion.pose.rotation, link.first_moment),
        )
        potential = sp.sub(potential, sp.dot(system.gravity, weighted))
    return kinetic, jnp.asarray(potential, float)


def _speed(system: System, forces: Forces, index: int) -> Any:
    """Speed [rad/s, m/s] of the single coordinate of a link's joint."""
    (column,) = forces.motions[index].columns
    twist = kinematics.joint_twist(system, forces.motions, index)
    along = sp.add(sp.dot(column.linear, twist.linear), sp.dot(column.angular, twist.angular))
    square = sp.add(sp.dot(column.linear, column.linear), sp.dot(column.angular, column.angular))
    return along / square
