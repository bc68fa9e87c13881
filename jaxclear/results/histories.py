"""What is read from the states of a run, by name: bodies, contacts, reactions, drift, energies.

Everything is computed from the saved states when asked for, so a run pays for none of it.

What a run of joints that always touch tells of them: how they carry, and when that changes.

Reactions are means over the saving intervals, so save every step where instants matter; they are
written at an interval's end, where the states stand.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.beam import on_piece
from jaxclear.components.body import Marker
from jaxclear.components.clearance import SITUATIONS, AbstractClearance, situation
from jaxclear.components.coupling import AbstractBodyCoupling
from jaxclear.components.load import AbstractJointLoad
from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import quaternion_from_rotation
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.quantity import is_traced, on_numbers
from jaxclear.ground.table import as_table
from jaxclear.ground.warning import warn
from jaxclear.ground.wording import public_name
from jaxclear.multibody import constraints, dynamics, kinematics, tree
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces, load_rows
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.rows import forces_on_drives, wrench_in_joint
from jaxclear.multibody.system import System, films_in
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.state_history import StateHistory, check_name, columns, over_time

# Vectors of a clearance joint and numbers of each of its contacts.
OF_JOINT = ("offset", "force", "torque")
OF_CONTACT = ("indentation", "normal_force", "slip_speed", "traction")
# Read as one program: by themselves its operations are fifteen.
quaternions = compiled_quickly(quaternion_from_rotation)


def measured_field(unit: str) -> Any:
    """A field of numbers over time, with their unit."""
    return eqx.field(metadata={"measured in": unit})


class AbstractHistory(AbstractShown):
    """Numbers over time: what is shown of each is its shape, and its least and largest."""

    def _summary(self):
        if is_traced(self):
            return f"a traced {public_name(type(self))}"
        units = units_of(type(self)).items()
        return (as_table([_range(name, np.asarray(getattr(self, name)), u) for name, u in units]),)


def units_of(kind: Any) -> dict[str, str]:
    """Unit of each field that has one."""
    fields = dataclasses.fields(kind)
    key = "measured in"
    return {field.name: field.metadata[key] for field in fields if key in field.metadata}


def _range(name: str, values: np.ndarray, unit: str) -> dict[str, Any]:
    least, largest = (values.min(), values.max()) if values.size else (np.nan, np.nan)
    row = {"numbers": name, "unit": unit, "shape": " x ".join(map(str, values.shape))}
    return row | {"least": float(least), "largest": float(largest)}


class BodyHistory(AbstractHistory):
    """Motion of a body in the ground frame.

    Accelerations follow from the equations of motion at the saved states. Where contact forces are
    means over the saving intervals (MoreauJean, joints that always touch), their part of an
    acceleration is such a mean, impacts included.

    Args:
        com: position of the centre of mass [m], shape (time, 3).
        rotation: axes of the body in the ground frame [1], shape (time, 3, 3).
        velocity: velocity of the centre of mass [m/s], shape (time, 3).
        spin: angular velocity [rad/s], shape (time, 3), ground axes.
        origin: position of the origin of the body frame [m], shape (time, 3).
        history: the saved states.
        name: name of the body.
    """

    com: Float[Array, "time 3"] = measured_field("m")
    rotation: Float[Array, "time 3 3"] = measured_field("1")
    velocity: Float[Array, "time 3"] = measured_field("m/s")
    spin: Float[Array, "time 3"] = measured_field("rad/s")
    origin: Float[Array, "time 3"] = measured_field("m")
    history: StateHistory = eqx.field(repr=False)  # type: ignore[misc]
    name: str = eqx.field(static=True)  # type: ignore[misc]

    @property
    def acceleration(self) -> Float[Array, "time 3"]:
        """Acceleration of the centre of mass [m/s^2], shape (time, 3), ground axes."""
        return _accelerations_by_body(self.history)[self.name][0]

    @property
    def angular_acceleration(self) -> Float[Array, "time 3"]:
        """Angular acceleration [rad/s^2], shape (time, 3), ground axes."""
        return _accelerations_by_body(self.history)[self.name][1]

    @property
    def quaternion(self) -> Float[Array, "time 4"]:
        """Orientation as unit quaternions, shape (time, 4), scalar first and not negative."""
        return quaternions(self.rotation)


class MarkerHistory(AbstractHistory):
    """Motion of a marker in the ground frame.

    For positions of a mechanism at rest only `position` and `rotation` exist.

    Args:
        position: position of its origin [m], shape (time, 3).
        rotation: its axes in the ground frame [1], shape (time, 3, 3).
        body: the motion of its body.
    """

    position: Float[Array, "time 3"] = measured_field("m")
    rotation: Float[Array, "time 3 3"] = measured_field("1")
    body: Any = eqx.field(repr=False)  # type: ignore[misc]

    @property
    def velocity(self) -> Float[Array, "time 3"]:
        """Velocity of its origin [m/s], shape (time, 3), ground axes."""
        return self.body.velocity + jnp.cross(self.body.spin, self.position - self.body.com)

    @property
    def acceleration(self) -> Float[Array, "time 3"]:
        """Acceleration of its origin [m/s^2], shape (time, 3), ground axes: the rate of `velocity`.

        It follows from the equations of motion, as that of a `BodyHistory`.
        """
        linear, angular = _accelerations_by_body(self.body.history)[self.body.name]
        spin, arm = self.body.spin, self.position - self.body.com
        return linear + jnp.cross(angular, arm) + jnp.cross(spin, jnp.cross(spin, arm))

    @property
    def specific_force(self) -> Float[Array, "time 3"]:
        """Reading of an accelerometer on the marker [m/s^2], shape (time, 3), along its own axes.

        It is the acceleration minus that of gravity: at rest it is g upwards.
        """
        gravity = sp.stack(self.body.history.model().system.gravity)
        return jnp.einsum("tji,tj->ti", self.rotation, self.acceleration - gravity)


def marker(
    read: Callable[[str], Any], mechanism: Mechanism, body: str | Marker, at: Any
) -> MarkerHistory:
    """Motion of a marker, or of a point of a body, over the saving times.

    Args:
        read: function from a body's name to its motion.
        mechanism: whose beams place the point on a piece.
        body: name, or a marker.
        at: point in the body's frame [m]; None for a marker.
    """
    if isinstance(body, Marker) and at is not None:
        raise ValueError(f'a marker on "{body.body}" has its place; leave `at` out beside it.')
    where = on_piece(mechanism.bodies, body if isinstance(body, Marker) else Marker(body, at))
    motion, (turn, at) = read(where.body), where.pose()
    return MarkerHistory(
        motion.origin + motion.rotation @ sp.stack(at),
        motion.rotation @ jnp.stack([sp.stack(row) for row in turn]),
        motion,
    )


class ContactHistory(AbstractHistory):
    """A clearance joint over time, in the bearing's axes (the parent's marker).

    Args:
        time: saving times [s], shape (time,).
        offset: from the bearing's centre to the journal's [m], shape (time, 3).
        axis: the journal's z axis [1], shape (time, 3).
        indentation: of each possible contact [m], positive in contact, shape (time, contacts).
        normal_force: of each contact [N], shape (time, contacts).
        slip_speed: sliding speed at each contact [m/s], shape (time, contacts).
        traction: magnitude of friction at each contact [N], shape (time, contacts).
        place: point of contact [m], shape (time, contacts, 3).
        force: force on the journal (the child) of its contacts and of loads in the joint
            (`load.AbstractJointLoad`) [N], shape (time, 3).
        torque: their torque on the journal about its marker [N m], shape (time, 3).
        names: names of the contacts, in the order of the columns.
    """

    time: Float[Array, " time"] = measured_field("s")
    offset: Float[Array, "time 3"] = measured_field("m")
    axis: Float[Array, "time 3"] = measured_field("1")
    indentation: Float[Array, "time contacts"] = measured_field("m")
    normal_force: Float[Array, "time contacts"] = measured_field("N")
    slip_speed: Float[Array, "time contacts"] = measured_field("m/s")
    traction: Float[Array, "time contacts"] = measured_field("N")
    place: Float[Array, "time contacts 3"] = measured_field("m")
    force: Float[Array, "time 3"] = measured_field("N")
    torque: Float[Array, "time 3"] = measured_field("N m")
    names: tuple[str, ...] = eqx.field(static=True)  # type: ignore[misc]

    @on_numbers
    def table(self) -> Any:
        """A table over time with a column for each number.

        Returns:
            A pandas table, its index the time [s], its columns labelled with units.

        Raises:
            ValueError: if numbers are being traced.
        """
        columns = {"time [s]": np.asarray(self.time)}
        units = units_of(ContactHistory)
        for field in OF_JOINT:
            for axis, values in zip("xyz", np.asarray(getattr(self, field)).T, strict=True):
                columns[f"{field} {axis} [{units[field]}]"] = values
        for field in OF_CONTACT:
            for name, values in zip(self.names, np.asarray(getattr(self, field)).T, strict=True):
                columns[f"{field.replace('_', ' ')}, {name} [{units[field]}]"] = values
        return as_table(columns, index="time [s]")


class ReactionHistory(AbstractHistory):
    """Force and torque on the child at its marker, in ground axes.

    Those of loads and couplings on the joint's own coordinate are included.

    Args:
        force: force [N], shape (time, 3).
        torque: torque [N m], shape (time, 3).
        unique: False where overconstrained loops do not determine the reaction; it is then the one
            of least norm over the joints that close loops, torques divided by the longest arm.
    """

    force: Float[Array, "time 3"] = measured_field("N")
    torque: Float[Array, "time 3"] = measured_field("N m")
    unique: bool = eqx.field(static=True, default=True)


class EnergyHistory(AbstractHistory):
    """Energy balance: kinetic + potential + contact_stored + losses = start + input + error.

    Losses and input are counted from the start of the run.

    Args:
        kinetic: kinetic energy [J], shape (time,).
        potential: potential energy of gravity and springs [J], shape (time,).
        contact_stored: elastic energy of the contacts [J], shape (time,).
        contact_loss: lost in the damping of contacts [J], shape (time,).
        friction_loss: lost in friction [J], shape (time,).
        damping_loss: lost in dampers [J], shape (time,).
        input: work of drives and loads [J], shape (time,).
        error: what the balance misses [J], shape (time,).
    """

    kinetic: Float[Array, " time"] = measured_field("J")
    potential: Float[Array, " time"] = measured_field("J")
    contact_stored: Float[Array, " time"] = measured_field("J")
    contact_loss: Float[Array, " time"] = measured_field("J")
    friction_loss: Float[Array, " time"] = measured_field("J")
    damping_loss: Float[Array, " time"] = measured_field("J")
    input: Float[Array, " time"] = measured_field("J")
    error: Float[Array, " time"] = measured_field("J")


def body(history: StateHistory, name: str) -> BodyHistory:
    """Motion of a body."""
    check_name(name, history.mechanism.bodies, "body")
    com, rotation, velocity, spin, origin = _body_columns(history, name)
    return BodyHistory(com, rotation, velocity, spin, origin, history, name)


@compiled_quickly
def _body_columns(history, name):
    com = sp.vec3(history.mechanism.bodies[name].com)

    def one(now):
        index = now.model.system.topology.index(name)
        link, motion = now.model.system.links[index], now.motions[index]
        pose = motion.pose.after(link.frame)
        inner = link.frame.point(com)
        velocity = sp.plus(motion.twist.linear, sp.cross(motion.twist.angular, inner))
        rotation = motion.pose.rotation
        return (
            pose.point(com),
            pose.rotation,
            sp.apply(rotation, velocity),
            sp.apply(rotation, motion.twist.angular),
            pose.translation,
        )

    return tuple(map(columns, over_time(history, one)))


def solve_instant(history: StateHistory, now: Instant) -> tuple[System, Forces, Solution]:
    """System, forces and the solution of the equations of motion at an instant."""
    forces = history.formulation.forces(now)
    system, stabilisation = now.model.system, now.model.stabilisation
    return system, forces, dynamics.forward_dynamics(system, forces, stabilisation)


@compiled_quickly
def _accelerations_by_body(history):
    """By body that of its centre of mass, and the angular one."""

    def one(now):
        system, _, solution = solve_instant(history, now)
        results = {}
        every = kinematics.link_accelerations(system, now.motions, solution.accelerations)
        for name, body in history.mechanism.bodies.items():
            index = system.topology.index(name)
            motion, change = now.motions[index], every[index]
            arm, spin = system.links[index].frame.point(sp.vec3(body.com)), motion.twist.angular
            velocity = sp.plus(motion.twist.linear, sp.cross(spin, arm))
            felt = (change.linear, sp.cross(change.angular, arm), sp.cross(spin, velocity))
            fallen = sp.apply(motion.pose.rotation, sp.plus(*felt))
            angular = sp.apply(motion.pose.rotation, change.angular)
            results[name] = sp.minus(fallen, kinematics.upward(system)), angular
        return results

    return {name: tuple(map(columns, pair)) for name, pair in over_time(history, one).items()}


def contact(history: StateHistory, name: str) -> ContactHistory:
    """Forces and gaps of a joint with clearance, as the formulation tells of them."""
    check_contact_joint(history, name)
    return _contact_columns(history, name)


def contact_impulse(history: StateHistory, name: str) -> Float[Array, " time"]:
    """What the normal forces of a joint's contacts have given since the start [N s]."""
    check_contact_joint(history, name)
    return _impulse_columns(history, name)


@compiled_quickly
def _impulse_columns(history, name):
    model = history.model()
    impulses = history.formulation.normal_impulses(model.system, name)
    start = model.layout.impulse_start + model.layout.impulses_of(name).start
    return sum((history.states[:, start + k] for k in impulses), jnp.zeros_like(history.time))


def check_contact_joint(history: StateHistory, name: str) -> None:
    """Raises `ValueError` where the formulation tells of no contacts in a joint."""
    check_name(name, history.formulation.contact_joints(history.mechanism), "clearance joint")


@compiled_quickly
def _contact_columns(history, name):
    values = over_time(history, lambda now: history.formulation.contact(now, name)[:-1])
    parts = tuple(map(columns, values))
    names = _contact_names(history, name, parts[2].shape[1])
    return ContactHistory(history.time, *parts, names)


def _contact_names(history, name, count):
    """What the columns are called: as the joint says, or numbers."""
    joint = history.mechanism.connections[name].joint
    gap = getattr(joint, "gap", joint)
    labels = gap.contact_names() if isinstance(gap, AbstractClearance) else ()
    return labels if len(labels) == count else tuple(f"contact {i}" for i in range(count))


def reaction_history(history: StateHistory, name: str) -> ReactionHistory:
    """Force and torque in a connection, or of a coupling of bodies, or of a load in a joint."""
    couplings = history.mechanism.couplings
    meshing = [
        n
        for n, coupling in couplings.items()
        if isinstance(coupling, AbstractBodyCoupling) and coupling.motor is None
    ]
    loads = (history.mechanism.loads | films_in(history.mechanism)).items()
    in_joints = [n for n, load in loads if isinstance(load, AbstractJointLoad)]
    check_name(name, [*history.mechanism.connections, *meshing, *in_joints], "joint")
    kind = "coupling" if name in couplings else "joint"
    unique = is_unique(history, name, f'the reaction of {kind} "{name}"')
    return dataclasses.replace(_reaction_columns(history, name), unique=unique)


def is_unique(history: StateHistory, name: str, what: str) -> bool:
    """Whether overconstrained loops determine the reaction of a joint; warns where they do not.

    Args:
        history: of a mechanism whose redundancy is known.
        name: joint or coupling.
        what: begins the warning: what is read of it.
    """
    mechanism = history.mechanism
    redundancy = mechanism.topology.redundancy
    if redundancy is None or name not in redundancy.joints:
        return True
    # A force in equilibrium with itself has no power in any motion, nor along a drive.
    drive = f' What its drive gives is: run.transmitted("{name}").'
    remedy = "A body that gives, or a joint with clearance in place of one of them,"
    remedy = "Stiffness of the couplings" if name in mechanism.couplings else remedy
    warn(
        f"{what} is not unique: the loops are {redundancy} {remedy} would tell which."
        f"{drive if name in mechanism.driven else ''}",
    )
    return False


@compiled_quickly
def _reaction_columns(history, name):
    def one(now):
        system, forces, solution = solve_instant(history, now)
        forces = dynamics.with_closures(system, forces, solution)
        if name not in history.mechanism.connections:
            rows = [row for row in forces.rows if row.owner == name]
            place = next(place for row in rows for place in row.direction.places)
            return _wrench_in_ground(now, place.closure, rows, place.joint)
        if system.topology.branch_of(name) is not None:
            return _reaction_of_branch(now, forces, solution, name)
        closures = dict(zip(system.topology.loops, system.closures, strict=True))
        closures |= {joint: bearing.closure for joint, bearing in system.bearings.items()}
        return _wrench_in_ground(now, closures[name], forces.rows, name)

    return ReactionHistory(*map(columns, over_time(history, one)))


@compiled_quickly
def film_loss(history: StateHistory, name: str) -> Any:
    """Mean power [W] that a film takes: that of all steps, or of the saving times where the motion
    is the ideal one."""
    duration, layout = history.time[-1] - history.time[0], history.model().layout
    if name not in dict(layout.impulses):
        return jnp.trapezoid(load_loss(history, name), history.time) / duration
    lost = history.states[:, layout.impulse_start + layout.impulses_of(name).start]
    return (lost[-1] - lost[0]) / duration


def load_loss(history: StateHistory, name: str) -> Any:
    """Power [W] that a load takes, shape (time,)."""

    def one(now):
        place = now.model.system, now.motions, name, now.time, now.followed
        return (load_rows(*place)[0].dissipated,)

    return over_time(history, one)[0]


def _reaction_of_branch(now, forces, solution, name):
    """Of a connection of the tree."""
    system = now.model.system
    branch = system.topology.branch_of(name)
    index = system.topology.branches.index(branch)
    wrench = dynamics.joint_wrenches(system, forces, solution)[index]
    rotation = now.motions[index].pose.rotation
    force, torque = sp.apply(rotation, wrench.force), sp.apply(rotation, wrench.torque)
    if branch.reversed:
        force, torque = (tuple(sp.neg(x) for x in part) for part in (force, torque))
    loads = [load for load in system.load_closures if system.loads[load].connection == name]
    if not loads:
        return force, torque
    more, moment = _wrench_in_ground(now, system.load_closures[loads[0]], forces.rows, name)
    return sp.plus(force, more), sp.plus(torque, moment)


def _wrench_in_ground(now, closure, rows, joint):
    """The sum of rows in a joint between the markers of a closure."""
    wrench = wrench_in_joint(rows, joint)
    rotation = kinematics.relative_motion(closure, now.motions)[0].parent_pose.rotation
    return sp.apply(rotation, wrench.force), sp.apply(rotation, wrench.torque)


@compiled_quickly
def drive_history(history: StateHistory, name: str) -> Float[Array, " time"]:
    """What a drive gives over time [N m, N]."""

    def one(now):
        system, forces, solution = solve_instant(history, now)
        forces = dynamics.with_closures(system, forces, solution)
        index = system.topology.branches.index(system.topology.branch_of(name))
        wrench = dynamics.joint_wrenches(system, forces, solution)[index]
        joint = system.links[index].joint
        (column,) = joint.columns((joint.drive.motion(now.time)[0],))
        along = tree.power(column, wrench)
        # What couplings do along its coordinate comes through no body.
        along = sp.sub(along, forces_on_drives(now.motions, forces.rows).get(index, 0))
        return jnp.asarray(along, float)

    return over_time(history, one)


@compiled_quickly
def drift_history(history: StateHistory) -> dict[str, Float[Array, " time"]]:
    """Largest residual [m, 1] of each loop closure, by the joint that closes the loop."""

    def one(now):
        system = now.model.system
        largest = {}
        for name, closure in zip(system.topology.loops, system.closures, strict=True):
            rows = constraints.constraint_rows(system, now.motions, closure)
            largest[name] = jnp.max(jnp.abs(sp.stack(rows.residuals)), initial=0.0)
        return largest

    return over_time(history, one)


def energy_history(history: StateHistory) -> EnergyHistory:
    """Energies over time; of a run with `balance=True`."""
    if not history.balanced:
        raise ValueError("this run did not track energies; simulate with balance=True.")
    return _energy_columns(history)


@compiled_quickly
def _energy_columns(history):
    def one(now):
        return (
            *dynamics.mechanical_energy(now.model.system, history.formulation.forces(now)),
            *now.entries[now.model.layout.energy_start :],
        )

    kinetic, potential, supplied, contact_work, contact_loss, friction_loss, damping_loss = (
        over_time(history, one)
    )
    stored = contact_work - contact_loss
    total = kinetic + potential + contact_work + friction_loss + damping_loss
    error = total - total[0] - supplied
    return EnergyHistory(
        kinetic, potential, stored, contact_loss, friction_loss, damping_loss, supplied, error
    )


def worn_volume(history: StateHistory, joint: str, surface: str) -> Float[Array, " time"]:
    """Volume lost by a surface over time [m3]; 0 where it does not wear.

    Args:
        history: states of the run.
        joint: name of the clearance joint.
        surface: name of one of its surfaces, such as "bearing".
    """
    slots = [s for s in history.layout().wear if (s.bearing, s.surface) == (joint, surface)]
    return sum((history.states[:, slot.start] for slot in slots), jnp.zeros_like(history.time))


LINE = SITUATIONS.index("a line (points on one side)")


def _map_over_ends(history: StateHistory, name: str, function: Any) -> Any:
    """Maps a function of where the gap carries over the saving times."""
    check_contact_joint(history, name)

    def one(now):
        ends = history.formulation.contact(now, name).ends
        if not ends:
            raise ValueError(
                f'how joint "{name}" carries is known of joints that always touch: run '
                "integrator.NonColliding."
            )
        return function(ends)

    return over_time(history, one)


@compiled_quickly
def situations(history: StateHistory, name: str) -> Int[Array, " time"]:
    """How a joint carries at every saving time: index into `SITUATIONS`."""
    return _map_over_ends(history, name, situation)


@compiled_quickly
def _sides(history: StateHistory, name: str):
    """Product of the two ends' forces: below zero while they press on opposite sides; and their
    sum.
    """

    def one(ends):
        first, last = ends[0].force, ends[-1].force
        return sp.dot(first, last), sp.stack(sp.plus(first, last))

    return _map_over_ends(history, name, one)


def switchings(history: StateHistory, name: str) -> Any:
    """Instants at which a joint begins to carry in another way, as a pandas table (time [s], from,
    to).

    Between two ways of two points the instant is where the forces of the ends change sign against
    each other, read off a straight line between the middles of the saving intervals; others are
    known to an interval. A line that changes sides within an interval becomes a line again, at the
    instant of no force.
    """
    codes, products, sums, time = (
        np.asarray(x) for x in (situations(history, name), *_sides(history, name), history.time)
    )
    middles = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1])])
    rows = []
    for i in range(2, len(codes)):
        product = sums[i] @ sums[i - 1]
        if codes[i] == codes[i - 1] and (codes[i] != LINE or product >= 0):
            continue
        instant = 0.5 * (middles[i] + middles[i - 1])
        if products[i] * products[i - 1] < 0:
            instant = middles[i - 1] + (middles[i] - middles[i - 1]) * products[i - 1] / (
                products[i - 1] - products[i]
            )
        elif codes[i] == codes[i - 1]:
            before = sums[i - 1] @ sums[i - 1]
            instant = middles[i - 1] + (middles[i] - middles[i - 1]) * before / (before - product)
        other = ", on the other side" if codes[i] == codes[i - 1] else ""
        rows.append((instant, SITUATIONS[codes[i - 1]], SITUATIONS[codes[i]] + other))
    return as_table(rows, columns=["time [s]", "from", "to"])
