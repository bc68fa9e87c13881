"""Contacts set apart from the equations of motion, and their laws made linear: what an implicit
step solves.

At an instant M k = f + J^T p with k the free accelerations, f everything but contact, and J one row
for the indentation and one for each sliding direction of every contact. M, f and J are taken once;
the forces p along the rows, which are what is stiff, are iterated upon as functions of the rows'
mean rates over the step: p = forces - dampings (rates - rates there).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import map_alike
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.ground.pose import STILL, Pose
from jaxclear.multibody import constraints, contact_point, dynamics, kinematics, loops
from jaxclear.multibody.contact_point import GapFunction, PointState
from jaxclear.multibody.forces import Forces, applied_forces
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.system import System

ContactJacobianRow = dict[int, Any]


class ContactPoint(NamedTuple):
    """One possible contact at an instant: geometry, rates of its rows (indentation, then slip), the
    rows, and how many of them carry a force (without friction only the first)."""

    gap_function: GapFunction
    rates: tuple
    rows: tuple[ContactJacobianRow, ...]
    active: int


class FreeMotion(NamedTuple):
    """Equations of motion at an instant with the contacts set apart: everything else that acts,
    mass matrix per subtree and generalised forces, closure rows with the accelerations they ask
    for, poses of the journals, and the contacts."""

    forces: Forces
    masses: list
    right: tuple
    closure_rows: list[ContactJacobianRow]
    wanted: list
    poses: dict[str, Pose]
    contacts: tuple[ContactPoint, ...]

    @property
    def diagonal(self) -> list:
        """Diagonal of the mass matrix."""
        return [mass[i][i] for mass in self.masses for i in range(len(mass))]


class TimeStep(NamedTuple):
    """A step: its start [s], its length [s], and its bias: 0 averages contact forces over the step,
    1 takes them at its end.
    """

    start: Any
    length: Any
    bias: Any


class Tangent(NamedTuple):
    """A contact's laws about given rates: force along each row, and how it falls with that row's
    rate [N s/m].
    """

    forces: tuple
    dampings: tuple


def along(row: ContactJacobianRow, values) -> Any:
    """The row times a vector of speeds."""
    return sp.total(sp.mul(entry, values[j]) for j, entry in row.items())


def free_motion(
    system: System, stabilisation: Baumgarte | None, worn: dict, time: Any, q: tuple, v: tuple
) -> FreeMotion:
    """The equations of motion at an instant, contacts apart."""
    motions = kinematics.link_motions(system, q, v, time)
    poses, contacts = contact_points(system, motions, worn)
    forces = applied_forces(system, motions, {}, q, v, time)
    masses, right = dynamics.equations_of_motion(system, forces)
    rows, wanted = (
        constraints.acceleration_equations(system, motions, stabilisation)
        if system.closures
        else ([], [])
    )
    return FreeMotion(
        forces, masses, tuple(x for part in right for x in part), rows, wanted, poses, contacts
    )


def depths(system: System, worn: dict, time: Any, q: tuple, v: tuple) -> list:
    """Indentation of every possible contact [m], from the geometry alone."""
    motions = kinematics.link_motions(system, q, v, time)
    calls = []
    for name, bearing in system.bearings.items():
        pose = kinematics.relative_motion(bearing.closure, motions)[1]
        calls.append((bearing.joint, pose, worn.get(name, {})))
    return [depth for joint in map_alike(contact_point.depths, calls) for depth in joint]


def contact_points(
    system: System, motions: tuple, worn: dict
) -> tuple[dict[str, Pose], tuple[ContactPoint, ...]]:
    """Poses of the journals in their bearings, and every possible contact."""
    names = list(system.bearings)
    poses, calls = {}, []
    for name in names:
        bearing = system.bearings[name]
        relative = kinematics.relative_motion(bearing.closure, motions)[2]
        poses[name] = relative.pose
        calls.append((bearing.joint, relative, worn.get(name, {})))

    def geometry(joint, relative, worn):
        gap_functions = contact_point.gap_function(joint, relative.pose, worn)
        return gap_functions, tuple(
            contact_point.contact_speeds(joint, relative.pose, o, relative.velocity, relative.spin)
            for o in gap_functions
        )

    with jax.named_scope("outline"):
        found = dict(zip(names, map_alike(geometry, calls), strict=True))
    out = []
    for name, (gap_functions, speeds) in found.items():
        bearing = system.bearings[name]
        rows = _rows(system, motions, bearing, poses[name], gap_functions)
        for pairing, own, (rate, slip), gap_function in zip(
            bearing.contact_laws, rows, speeds, gap_functions, strict=True
        ):
            out.append(
                ContactPoint(
                    gap_function, (rate, *slip), own, 1 if pairing.friction is None else len(own)
                )
            )
    return poses, tuple(out)


def _rows(system, motions, bearing, pose, gap_functions):
    """Jacobian rows of each contact: rate of the indentation and components of slip for each free
    unit speed.
    """
    closure = bearing.closure
    rows: list[list[ContactJacobianRow]] = [
        [{} for _ in range(1 + len(o.touch.tangents))] for o in gap_functions
    ]
    ends = ((closure.parent_link, closure.parent), (closure.child_link, closure.child))
    for side, (link, marker) in enumerate(ends):
        for j, column in kinematics.jacobian_columns(system, motions, link).items():
            twist = loops.marker_twist(column, marker)
            pair = (twist, STILL) if side == 0 else (STILL, twist)
            velocity, spin = loops.relative_velocity(pose, *pair)
            for gap_function, own in zip(gap_functions, rows, strict=True):
                rate, slip = contact_point.contact_speeds(
                    bearing.joint, pose, gap_function, velocity, spin
                )
                for row, entry in zip(own, (rate, *slip), strict=True):
                    if not sp.is_zero(entry):
                        row[j] = sp.add(row.get(j, 0), entry)
    return [tuple(own) for own in rows]


def mean_force(
    pairing: ContactLaws, memory: PointState, time_step: TimeStep, depth: Any, rate: Any
) -> Any:
    """Normal force that, over the step from the indentation `depth` on, does the work of the law
    along the way.

    The mean of the law over the indentations passed through, by Radau's rule (right end and a third
    before the left), times the share of the way in contact; moved towards the force at the end by
    `span.bias`, which can only take energy out.
    """
    end = depth + time_step.length * rate
    low, high = positive_part(depth), positive_part(end)
    inside = (depth > 0) & (end > 0)
    share = jnp.where(inside, 1.0, safe_divide(high - low, jnp.where(inside, 1.0, end - depth)))
    early, late = (
        pairing.contact.normal_force(d, rate, memory.impact_speed)
        for d in (low + (high - low) / 3, high)
    )
    return share * (late + 3 / 4 * (1 - time_step.bias) * (early - late))


def deepest(pairing: ContactLaws, mass: Any, approach: Any, free: Any) -> Any:
    """About the indentation at which a mass that arrives with speed `approach` comes to rest, if
    less than the `free` one to which it would go unhindered: where Newton's iteration does well to
    set out."""
    work = pairing.contact.elastic_force(free) * positive_part(free)
    # Hertz: m v^2 / 2 = F(d) d / (5/2), so d / free = (5/4 m v^2 / work)^(2/5); by square roots, to
    # the power 3/8.
    quarter = safe_sqrt(safe_sqrt(safe_divide(5 / 4 * mass * positive_part(approach) ** 2, work)))
    return jnp.where(work > 0, free * jnp.minimum(quarter * safe_sqrt(quarter), 1.0), free)


def tangent(
    pairing: ContactLaws, memory: PointState, time_step: TimeStep, depth: Any, rates: tuple
) -> Tangent:
    """The laws of a contact about mean rates of its rows over a step from the indentation `depth`
    on.

    The normal force is linear in its own row (Newton); what friction is, its law says.
    """
    force, slope = jax.value_and_grad(
        lambda rate: mean_force(pairing, memory, time_step, depth, rate)
    )(jnp.asarray(rates[0], float))
    forces, dampings = [-force], [positive_part(slope)]
    if pairing.friction is not None:
        slip = rates[1:]
        rubbing, resisting = pairing.friction.linearised(
            force,
            memory.bristles,
            slip,
            contact_point.slip_speed(slip),
            time_step.length,
            time_step.bias,
        )
        forces, dampings = forces + rubbing, dampings + resisting
    return Tangent(tuple(forces), tuple(dampings))


def approached(
    pairing: ContactLaws, speed: Any, time_step: TimeStep, captured: bool, depth: Any, rate: Any
) -> Any:
    """Impact speed that a contact remembers in a step that starts with `depth` and `rate`: frozen
    where closed; where open it follows the approach speed, exponentially in `memory_time`, or at
    once where it is `captured`."""
    if speed is None:
        return None
    share = 1.0 if captured else -jnp.expm1(-time_step.length / pairing.contact.memory_time)
    return jnp.where(depth < 0, speed + share * (positive_part(rate) - speed), speed)


def bristles_after(
    pairing: ContactLaws, bristles: tuple, time_step: TimeStep, rates: tuple, normal: Any
) -> tuple:
    """Deflections at the end of a step; those of an open contact straighten."""
    if not bristles:
        return ()
    slip = rates[1:]
    speed = contact_point.slip_speed(slip)
    return pairing.friction.bristles_after(
        normal, bristles, slip, speed, time_step.length, time_step.bias
    )
