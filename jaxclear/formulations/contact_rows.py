r"""Contacts set apart from the equations of motion, in the middle of a step: what every step but
the explicit ones starts from.

At an instant $M \dot v = f + J^T p$, with $f$ everything but contact and $J$ one row for the
indentation and one for each sliding direction of every contact. $M$, $f$ and $J$ are taken once a
step; the forces (or percussions) $p$ along the rows are what a formulation seeks.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.state_rate import drift
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_grouped
from jaxclear.ground.numerics import positive_part
from jaxclear.ground.pose import Pose
from jaxclear.multibody import constraints, contact_point, dynamics, kinematics
from jaxclear.multibody.constraints import ClosureEquations
from jaxclear.multibody.contact_point import ActingContact, GapFunction, JointReport
from jaxclear.multibody.damped_stops import forces_at
from jaxclear.multibody.forces import Forces, relative_motions
from jaxclear.multibody.kinematics import JacobianRow
from jaxclear.multibody.rows import LinearRate
from jaxclear.multibody.state import Followed, component_count, unpack_followed, unpack_motion
from jaxclear.multibody.system import System, coordinate_loads


class TimeStep(NamedTuple):
    """A step in time.

    Args:
        start: its start [s].
        length: its length [s].
    """

    start: Any
    length: Any

    @property
    def middle(self) -> Any:
        """Its middle [s]."""
        return self.start + 0.5 * self.length

    @property
    def end(self) -> Any:
        """Its end [s]."""
        return self.start + self.length


class ContactPoint(NamedTuple):
    """One possible contact at an instant: its laws, geometry, rates of its indentation, then of its
    slips, and how many of them carry a force (without friction only the first)."""

    laws: ContactLaws
    gap_function: GapFunction
    rates: tuple[LinearRate, ...]
    active: int

    @property
    def acting(self) -> tuple[LinearRate, ...]:
        """The rates along which a force acts."""
        return self.rates[: self.active]

    @property
    def rows(self) -> tuple[JacobianRow, ...]:
        """The rows of its rates."""
        return tuple(rate.row for rate in self.rates)


class FreeMotion(NamedTuple):
    """Equations of motion at an instant with the contacts set apart: everything else that acts,
    mass matrix per subtree and generalised forces, equations of the closures, poses of the
    journals, and the contacts."""

    forces: Forces
    masses: list
    right: tuple
    closures: ClosureEquations
    poses: dict[str, Pose]
    contacts: tuple[ContactPoint, ...]

    @property
    def diagonal(self) -> list:
        """Diagonal of the mass matrix."""
        return [mass[i][i] for mass in self.masses for i in range(len(mass))]


class MiddleOfStep(NamedTuple):
    """Where a step evaluates the equations, once: coordinates and speeds at its start (`q`, `v`),
    those in its middle as far as they are known (`halfway`, `predicted`), and the free motion
    there."""

    q: list
    v: list
    halfway: list
    predicted: list
    free_motion: FreeMotion

    def change_to(self, speeds: list) -> list:
        """From the predicted speeds to others: what rates of rows must be corrected by."""
        return sp.each(sp.sub, speeds, self.predicted)

    def end(self, model: Model, mean: list, h: Any) -> list:
        """Coordinates at the end of a step, their rates taken in its middle.

        Args:
            model: of the run.
            mean: mean speeds over the step, scalars.
            h: its length [s].
        """
        middle = drift(model.system, self.q, self.halfway, mean, 0.5 * h)
        return drift(model.system, self.q, middle, mean, h)


def lightness(row: JacobianRow, diagonal: list) -> Any:
    """About the inverse of the mass that a force along a row moves [1/kg]."""
    return sp.total(entry * entry / diagonal[j] for j, entry in row.items())


def split(values: Any, counts: Sequence[int]) -> list[tuple]:
    """The parts of a list, one after the other."""
    out, start = [], 0
    for count in counts:
        out.append(tuple(values[start : start + count]))
        start += count
    return out


def by_joint(system: System, values: Any) -> list[tuple]:
    """One value per contact, as one tuple per clearance joint."""
    return split(values, [len(bearing.contact_laws) for bearing in system.bearings.values()])


def middle_of_step(
    model: Model, time_step: TimeStep, entries: list, accelerations: list
) -> MiddleOfStep:
    """The middle of a step, to which speeds and accelerations lead.

    Args:
        model: the mechanism, a `Model`.
        time_step: the step, a `TimeStep`.
        entries: numbers of the state at its start, a list.
        accelerations: accelerations [m/s^2, rad/s^2], a list with one number a speed.

    Returns:
        coordinates and speeds at start and middle, and the equations of motion in the middle, a
        `MiddleOfStep`.
    """
    layout, h = model.layout, time_step.length
    q, v = entries[: layout.coordinates], entries[layout.coordinates : layout.memory_start]
    predicted = sp.each(lambda x, a: x + 0.5 * h * a, v, accelerations)
    halfway = drift(model.system, q, q, v, 0.5 * h)
    motion = unpack_motion(model.system, [*halfway, *predicted])
    followed = unpack_followed(layout, entries)
    now = free_motion(model, time_step.middle, *motion, followed)
    now = with_implicit_springs(model.system, now, h, accelerations)
    return MiddleOfStep(q, v, halfway, predicted, now)


def with_implicit_springs(
    system: System, now: FreeMotion, h: Any, accelerations: list
) -> FreeMotion:
    """The equations of motion with stiff springs taken implicitly.

    The mass matrix becomes M + h D / 2 + h^2 K / 4, as the middle of the step is that to which the
    unknown accelerations lead, q + h v / 2 + h^2 a / 4.

    Args:
        system: with loads that state their `resistance`.
        now: equations of motion in the middle of the step.
        h: length of the step [s].
        accelerations: predicted ones, with which the middle was computed, scalars.
    """
    springs = {
        name: (0.25 * h * h * stiffness, sp.mul(0.5 * h, damping))
        for _, load in coordinate_loads(system)
        if load.resistance()
        for name, (stiffness, damping) in zip(load.coordinates(), load.resistance(), strict=True)
    }
    if not springs:
        return now
    branches, masses, right = system.topology.branches, [], list(now.right)
    for subtree, mass in zip(system.topology.subtrees, now.masses, strict=True):
        start, rows = branches[subtree[0]].speeds.start, [list(row) for row in mass]
        for branch in (branches[i] for i in subtree if branches[i].name in springs):
            at, (spring, damper) = branch.speeds.start, springs[branch.name]
            rows[at - start][at - start] += sp.add(spring, damper)
            right[at] = sp.add(right[at], sp.mul(damper, accelerations[at]))
        masses.append(tuple(map(tuple, rows)))
    return now._replace(masses=masses, right=tuple(right))


def free_motion(model: Model, time: Any, q: tuple, v: tuple, followed: Followed) -> FreeMotion:
    """The equations of motion at an instant, without contacts.

    Args:
        model: of the run.
        time: instant [s].
        q, v: coordinates and speeds, a tuple for each link.
        followed: what the state integrates beside the motion: whole-turn angles, load states,
            flanks.
    """
    system = model.system
    motions = kinematics.link_motions(system, q, v, time)
    poses, contacts = contact_points(model, motions)
    forces = forces_at(system, motions, {}, time, followed)
    masses, by_subtree = dynamics.equations_of_motion(system, forces)
    closures = ClosureEquations([], [], (), None)
    if system.closures:
        closures = constraints.acceleration_equations(system, motions, model.stabilisation)
    right = tuple(force for subtree in by_subtree for force in subtree)
    return FreeMotion(forces, masses, right, closures, poses, contacts)


def indentations(model: Model, time: Any, q: tuple, v: tuple) -> list:
    """Indentation of every possible contact, from the geometry alone.

    Args:
        model: the mechanism, a `Model`.
        time: time [s].
        q: coordinates of each link [m, rad], a tuple.
        v: speeds of each link [m/s, rad/s], a tuple.

    Returns:
        indentations [m], positive in contact, a list.
    """
    motions = kinematics.link_motions(model.system, q, v, time)
    relative = relative_motions(model.system, motions)
    calls = [
        (bearing.joint, motion.pose, model.worn.get(name, {}))
        for (name, bearing), motion in zip(model.system.bearings.items(), relative, strict=True)
    ]
    result = map_grouped(contact_point.depths, calls)
    return [indentation for joint in result for indentation in joint]


def contact_points(
    model: Model, motions: tuple
) -> tuple[dict[str, Pose], tuple[ContactPoint, ...]]:
    """Poses of the journals in their bearings, and every possible contact."""
    bearings = model.system.bearings
    poses, calls = {}, []
    relative = relative_motions(model.system, motions)
    for (name, bearing), motion in zip(bearings.items(), relative, strict=True):
        poses[name] = motion.pose
        calls.append((bearing.joint, motion, model.worn.get(name, {})))

    def geometry(joint, relative, worn):
        gap_functions = contact_point.gap_function(joint, relative.pose, worn)
        return gap_functions, row_rates(
            joint, gap_functions, relative.pose, relative.velocity, relative.spin
        )

    with jax.named_scope("gap_function"):
        result = map_grouped(geometry, calls)
    points = []
    jacobians = kinematics.relative_jacobians(
        model.system,
        motions,
        [bearing.closure for bearing in bearings.values()],
        [
            (row_rates, (bearing.joint, gap_functions), poses[name])
            for (name, bearing), (gap_functions, _) in zip(bearings.items(), result, strict=True)
        ],
    )
    each = zip(bearings.items(), result, jacobians, strict=True)
    for (name, bearing), (gap_functions, rates), jacobian in each:
        start = 0
        joint_laws = contact_point.laws_at(
            bearing.joint, bearing.contact_laws, poses[name], model.worn.get(name, {})
        )
        for laws, gap_function in zip(joint_laws, gap_functions, strict=True):
            end = start + 1 + len(gap_function.candidate.tangents)
            active = 1 if laws.friction is None else end - start
            linear = map(LinearRate, rates[start:end], jacobian[start:end])
            points.append(ContactPoint(laws, gap_function, tuple(linear), active))
            start = end
    return poses, tuple(points)


def laws_of_contacts(system: System) -> list[ContactLaws]:
    """Of every possible contact, in the order of the state."""
    return [laws for bearing in system.bearings.values() for laws in bearing.contact_laws]


def follows_depth(laws: ContactLaws) -> bool:
    """Whether a contact presses hardest where it is deepest, or by a law that follows its worn
    radius, which is not known between saving times."""
    return laws.contact.lossless or laws.unfitted is not None


def has_damping(system: System) -> bool:
    """Whether some contact's largest force is not told by its depth."""
    return not all(map(follows_depth, laws_of_contacts(system)))


def row_rates(joint, gap_functions, pose, velocity, spin) -> tuple:
    """Rate of indentation and components of slip of each contact, one after the other [m/s].

    Args:
        joint: geometry of the clearance.
        gap_functions: of its possible contacts at this pose.
        pose: journal's marker in the bearing's frame.
        velocity, spin: of the journal as seen from the bearing, in its axes [m/s, rad/s].
    """
    rates: list[Any] = []
    for gap_function in gap_functions:
        rate, slip = contact_point.contact_speeds(joint, pose, gap_function, velocity, spin)
        rates += [rate, *slip]
    return tuple(rates)


# Indentation [m] at which the extent of a contact is read that no law tells: its wear needs some.
TOUCHING = 1e-9


def joint_reports(
    system: System, poses: dict[str, Pose], contacts: list[ActingContact]
) -> dict[str, JointReport]:
    """Report of every clearance joint, by joint.

    Args:
        system: with the joints.
        poses: journal's marker in the bearing's frame, by joint.
        contacts: of all joints, in the order of `system.bearings`.
    """
    each = zip(system.bearings.items(), by_joint(system, contacts), strict=True)
    return {
        name: contact_point.assemble(bearing.joint, poses[name], acting)
        for (name, bearing), acting in each
    }


def rigid_reports(
    system: System,
    poses: dict[str, Pose],
    contacts: tuple[ContactPoint, ...],
    forces: list[tuple],
    change: list | None = None,
) -> dict[str, JointReport]:
    """Reports for given forces of contacts without stiffness.

    Args:
        system: with the joints.
        poses: journal's marker in the bearing's frame, by joint.
        contacts: of all joints, in the order of `system.bearings`.
        forces: of each contact, normal [N], then friction along each sliding direction.
        change: of the free speeds at which rates are taken; None: the speeds of `contacts`.
    """
    acting = []
    for contact, (normal, *tractions) in zip(contacts, forces, strict=True):
        laws, gap = contact.laws, contact.gap_function
        pressed = jnp.maximum(gap.indentation, _indentation_under(laws, normal))
        rates = tuple(x.value if change is None else x.at(change) for x in contact.rates)
        values = laws, gap, rates, normal, tuple(tractions), 0.0
        acting.append(ActingContact(*values, pressed=pressed))
    return joint_reports(system, poses, acting)


def _indentation_under(laws: ContactLaws, force: Any) -> Any:
    """Indentation [m] at which the extent of a contact under a normal force [N] is read: its law's,
    where it has one."""
    if not laws.wears:
        return TOUCHING
    return jnp.maximum(laws.indentation_under(positive_part(force)), TOUCHING)


def reports_of_means(instant: Instant) -> dict[str, JointReport]:
    """Reports of the clearance joints at a saved instant whose state holds the impulses of every
    contact: normal, then one for each slip direction where it rubs.

    Args:
        instant: the saved state, an `Instant`.

    Returns:
        a dict of `JointReport` by name.
    """
    poses, contacts = contact_points(instant.model, instant.motions)
    counts = [component_count(c.laws, c.gap_function.candidate) for c in contacts]
    forces = split(instant.means, counts)
    return rigid_reports(instant.model.system, poses, contacts, forces)
