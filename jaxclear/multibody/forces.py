"""Everything that acts at an instant: contacts and loads, as a wrench on every link and a force on
every coordinate.

Alike clearance joints are traced once. Constraint reactions are not forces here: they follow from
the accelerations (`dynamics`).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.coupling import AbstractForceCoupling
from jaxclear.components.load import (
    AbstractBodyLoad,
    AbstractJointLoad,
    AbstractStateLoad,
    Action,
    CoordinateEffect,
    Effect,
    JointMotion,
    MarkerMotion,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_grouped
from jaxclear.ground.pose import Pose
from jaxclear.laws.transmission import holding
from jaxclear.multibody import closure_coordinates, contact_point, kinematics, transmissions, tree
from jaxclear.multibody.contact_point import JointReport
from jaxclear.multibody.loops import Relative
from jaxclear.multibody.rows import (
    CoordinateReading,
    Direction,
    OnClosure,
    OnLink,
    Row,
    add_wrenches,
    forces_on_drives,
    row_of_wrench,
    sum_wrenches,
)
from jaxclear.multibody.state import Followed
from jaxclear.multibody.system import System, body_loads, coordinate_loads
from jaxclear.multibody.transmissions import Pressing, twist_direction
from jaxclear.multibody.tree import NOTHING, Motion, Wrench

AXIS: sp.Vec = (0, 0, 1)


class Forces(NamedTuple):
    """Everything that acts, at one instant: wrenches by link, in its axes, and forces on its
    coordinates; `stored` energy [J] of the loads, their `damping_loss` and `external_power` [W].
    `rows`: contacts, and loads and couplings on coordinates, in joints and between bodies;
    `followed`: what of the state coordinates outside the tree were read by; `state_rates` of loads
    and flanks, by load or coupling; `pressing`: what couplings with play or stiffness do.
    """

    motions: tuple[Motion, ...]
    reports: dict[str, JointReport]
    wrenches: tuple[Wrench, ...]
    coordinate_forces: tuple
    stored: Any
    damping_loss: Any
    external_power: Any
    rows: tuple[Row, ...]
    followed: Followed
    state_rates: dict[str, tuple]
    pressing: dict[str, Pressing]


def contact_reports(
    system: System, motions: tuple[Motion, ...], memories: dict, worn: dict
) -> dict[str, JointReport]:
    """Report of every clearance joint, by joint; alike joints are traced once.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        memories: for each joint, memory of each possible contact.
        worn: depth maps [m] by joint and surface.
    """
    relative = relative_motions(system, motions)
    calls = [
        (bearing.joint, bearing.contact_laws, motion, memories[name], worn.get(name, {}))
        for (name, bearing), motion in zip(system.bearings.items(), relative, strict=True)
    ]
    with jax.named_scope("contact"):
        reports = map_grouped(contact_point.evaluate, calls)
    return dict(zip(system.bearings, reports, strict=True))


def relative_motions(system: System, motions: tuple[Motion, ...]) -> list[Relative]:
    """Of every clearance joint."""
    closures = (bearing.closure for bearing in system.bearings.values())
    return kinematics.relative_motions(closures, motions)


NOTHING_FOLLOWED = Followed()


def applied_forces(
    system: System,
    motions: tuple[Motion, ...],
    reports: dict[str, JointReport],
    time: Any,
    followed: Followed = NOTHING_FOLLOWED,
) -> Forces:
    """All forces at an instant but those of closures: contacts, loads, flexible couplings.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        reports: of clearance joints, by joint; empty where contacts are solved elsewhere.
        time: instant [s] of the loads.
        followed: what the state integrates beside the motion: whole-turn angles, load states,
            flanks.
    """
    relative = relative_motions(system, motions) if reports else []
    poses = {name: motion.pose for name, motion in zip(reports, relative, strict=True)}
    of_contacts, wrenches = contact_rows(system, poses, reports), [NOTHING] * len(system.links)
    add_wrenches(wrenches, of_contacts)
    stored: Any
    damping: Any
    external: Any
    stored, damping, external = 0, 0, 0
    with jax.named_scope("loads"):
        for name, load in body_loads(system):
            effect, markers = effect_of(system, name, load, motions, time), load.markers()
            for order, action in enumerate(effect.actions):
                link, marker = system.load_markers[name][action.place_among(markers, order)]
                if link is not None:
                    wrench = _wrench_in_link(action, motions[link], marker)
                    wrenches[link] = sum_wrenches(wrenches[link], wrench)
            stored, damping = sp.add(stored, effect.stored), sp.add(damping, effect.dissipated)
            external = sp.add(external, effect.external)
    acting: list[Row] = []
    rates: dict[str, tuple] = {}
    for name, _ in coordinate_loads(system):
        sums, rows = load_rows(system, motions, name, time, followed)
        acting += rows
        rates |= {name: sums.rates} if sums.rates else {}
        stored, damping = sp.add(stored, sums.stored), sp.add(damping, sums.dissipated)
        external = sp.add(external, sums.external)
    pressed = pressing_of(system, motions, followed)
    for name, giving in system.transmissions.items():
        torque = pressed[name].torque
        acting.append(Row(name, twist_direction(motions, giving), -torque / giving.scale))
        moved = (pressed[name].end_rate,) if giving.has_twist else ()
        rubbed = _friction_of_coupling(system, motions, name, torque, followed)
        if rubbed is not None:
            direction, friction, speed, rate = rubbed
            acting.append(Row(name, direction, friction))
            moved, damping = (*moved, rate), sp.add(damping, -friction * speed)
        rates |= {name: moved} if moved else {}
        stored, damping = (
            sp.add(stored, pressed[name].stored),
            sp.add(damping, pressed[name].dissipated),
        )
    without_rows = Forces(
        motions,
        reports,
        tuple(wrenches),
        tuple((0,) * len(motion.columns) for motion in motions),
        stored,
        damping,
        external,
        tuple(of_contacts),
        followed,
        rates,
        pressed,
    )
    return with_rows(without_rows, acting)


def with_rows(forces: Forces, rows: Sequence[Row]) -> Forces:
    """The forces with more rows; of what acts on coordinates that drives prescribe, these give the
    power."""
    wrenches, coordinate_forces = list(forces.wrenches), list(map(list, forces.coordinate_forces))
    add_wrenches(wrenches, rows)
    for row in rows:
        for place in row.direction.places:
            if isinstance(place, OnLink) and coordinate_forces[place.link]:
                on_link, size = coordinate_forces[place.link], sp.mul(place.factor, row.force)
                on_link[place.component] = sp.add(on_link[place.component], size)
    external = forces.external_power
    for link, force in forces_on_drives(forces.motions, rows).items():
        external = sp.sub(external, sp.mul(force, forces.motions[link].speeds[0]))
    return forces._replace(
        wrenches=tuple(wrenches),
        coordinate_forces=tuple(map(tuple, coordinate_forces)),
        rows=(*forces.rows, *rows),
        external_power=external,
    )


def contact_rows(
    system: System, poses: dict[str, Pose], reports: dict[str, JointReport]
) -> list[Row]:
    """Forces of the contacts of clearance joints, a row for each joint.

    Args:
        system: with the joints' closures.
        poses: journal's marker in the bearing's frame, by joint.
        reports: wrench on each journal, by joint.
    """
    return [
        row_of_wrench(
            name, system.bearings[name].closure, poses[name], Wrench(r.force, r.torque), name
        )
        for name, r in reports.items()
    ]


def _friction_of_coupling(
    system: System, motions: tuple[Motion, ...], name: str, torque: Any, followed: Followed
) -> tuple[Direction, Any, Any, Any] | None:
    """Of a coupling that transmits a torque against its twist: direction of its friction, force
    along it, speed there, and the rate of the deflection that holds; None without friction."""
    train = system.transmissions[name]
    end, thread = train.driving, train.coupling.thread
    if end is None and thread is None:
        return None
    states = followed.states.get(name)
    deflection = jnp.zeros(()) if states is None else states[-1]
    if end is not None:
        reading = read_coordinate(system, motions, end.coordinate, followed)
        loses = end.loses
        share, rate = holding(deflection, reading.speed, loses.presliding, loses.settling_time)
        friction = -loses.loss(torque * end.slope, share)
        return reading.direction, friction, reading.speed, rate
    assert thread is not None
    _, pose, relative = kinematics.relative_motion(train.closure, motions)
    helix = thread.helix
    slip = sp.add(sp.mul(helix.axial, relative.velocity[2]), sp.mul(helix.lever, relative.spin[2]))
    slip = jnp.asarray(slip, float)
    share, rate = holding(deflection, slip, thread.presliding, thread.settling_time)
    friction = -thread.coefficient * helix.normal * jnp.abs(torque) * share
    along = Wrench(sp.scale(helix.axial, AXIS), sp.scale(helix.lever, AXIS))
    return Direction((OnClosure(train.closure, pose, along),)), friction, slip, rate


def pressing_of(
    system: System, motions: tuple[Motion, ...], followed: Followed
) -> dict[str, Pressing]:
    """Torque, energy and flanks of couplings with play or stiffness, by name.

    Alike couplings are traced once.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        followed: with the far ends of shafts and which flanks count as touching.
    """
    calls = []
    for name, train in system.transmissions.items():
        twist, end = transmissions.twist_of(motions, train), None
        if train.has_twist:
            states = followed.states.get(name)
            end = transmissions.end_at_start(train, twist) if states is None else states[0]
        calls.append((transmissions.compliance_of(train), twist, end, followed.shares.get(name)))
    result = map_grouped(transmissions.press_flanks, calls)
    return dict(zip(system.transmissions, result, strict=True))


def states_of(name: str, load: AbstractStateLoad, followed: Followed) -> tuple:
    """The states of a load; those with which it starts where none are followed.

    Args:
        name: of the load.
        load: declares its states and their initial values.
        followed: current states by load.
    """
    states = followed.states.get(name)
    return tuple(jnp.asarray(x.start, float) for x in load.states()) if states is None else states


def read_coordinate(
    system: System, motions: tuple[Motion, ...], name: str, followed: Followed
) -> CoordinateReading:
    """Position, speed and direction of the coordinate of a joint or motor.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        name: joint in the tree or outside it, or motor.
        followed: angles over whole turns of joints outside the tree.
    """
    if name in system.geared:
        geared = system.geared[name]
        joint = read_coordinate(system, motions, geared.joint, followed)
        position = sp.mul(geared.ratio, joint.position)
        position = position if geared.offset is None else position + geared.offset
        direction = joint.direction.times(geared.ratio)
        return CoordinateReading(position, sp.mul(geared.ratio, joint.speed), direction)
    branch = system.topology.branch_of(name)
    if branch is None:
        return closure_coordinates.read(system, name, motions, followed.angles.get(name))
    link = system.topology.branches.index(branch)
    place = Direction((OnLink(link),))
    return CoordinateReading(motions[link].coordinates[0], motions[link].speeds[0], place)


def as_pressed(
    system: System,
    motions: tuple[Motion, ...],
    load: AbstractStateLoad,
    time: Any,
    followed: Followed,
) -> AbstractStateLoad:
    """A load whose dry friction depends on the force of another element, at that force.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        load: itself where no element presses it (`load.pressed_by`).
        time: instant [s].
        followed: what the state integrates beside the motion: whole-turn angles, load states,
            flanks.
    """
    name = load.pressed_by()
    if name is None:
        return load
    return load.under(force_of(system, motions, name, time, followed))


def load_rows(
    system: System, motions: tuple[Motion, ...], name: str, time: Any, followed: Followed
) -> tuple[CoordinateEffect, list[Row]]:
    """Effect of a load on coordinates or in a joint, or of a force coupling, and its rows.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        name: of the load or coupling.
        time: instant [s].
        followed: whole-turn angles and the load's states.
    """
    load = system.loads[name]
    states = states_of(name, load, followed)
    pressed = as_pressed(system, motions, load, time, followed)
    positions, speeds, directions = read_load(system, motions, load, name, followed)
    effect = pressed.effect(time, positions, speeds, states)
    if isinstance(load, AbstractJointLoad):
        closure, (motion,) = system.load_closures[name], positions
        wrench = Wrench(*effect.forces)
        return effect, [row_of_wrench(name, closure, motion.pose, wrench, load.connection)]
    forces = zip(directions, effect.forces, strict=True)
    return effect, [Row(name, direction, force) for direction, force in forces]


def read_load(
    system: System,
    motions: tuple[Motion, ...],
    load: AbstractStateLoad,
    name: str,
    followed: Followed,
) -> tuple[tuple, tuple, tuple]:
    """Positions and speeds that a load reads, and the directions of its forces.

    For a load in a joint, the joint's motion is the only position; speeds and directions are empty.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        load: says which coordinates it reads.
        name: of this load.
        followed: angles over whole turns of joints outside the tree.
    """
    if isinstance(load, AbstractJointLoad):
        relative = kinematics.relative_motion(system.load_closures[name], motions)[2]
        return (JointMotion(*relative),), (), ()
    every = [read_coordinate(system, motions, place, followed) for place in load.coordinates()]
    positions, speeds, directions = (tuple(reading[part] for reading in every) for part in range(3))
    return positions, speeds, directions


def force_of(
    system: System, motions: tuple[Motion, ...], name: str, time: Any, followed: Followed
) -> Any:
    """Force [N m, N] of a load along its first coordinate, or that a flexible coupling transmits.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        name: of the load or coupling.
        time: instant [s].
        followed: whole-turn angles, load states and flanks.
    """
    if name in system.transmissions:
        return -jnp.asarray(pressing_of(system, motions, followed)[name].torque, float)
    load = system.loads[name]
    effect, _ = load_rows(system, motions, name, time, followed)
    coupled = isinstance(load, AbstractForceCoupling)
    return jnp.asarray(load.transmitted(effect) if coupled else effect.forces[0], float)


def forces_of_load(
    system: System, motions: tuple[Motion, ...], name: str, time: Any, followed: Followed
) -> Any:
    """All that a load or force coupling gives at an instant [N, N m], nested tuples of numbers.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        name: of the load or coupling.
        time: instant [s].
        followed: whole-turn angles, load states and flanks.
    """
    load = system.loads[name]
    if isinstance(load, AbstractBodyLoad):
        actions = effect_of(system, name, load, motions, time).actions
        return tuple((action.force, action.torque) for action in actions)
    return load_rows(system, motions, name, time, followed)[0].forces


def transmitting(system: System) -> tuple[str, ...]:
    """The couplings whose force follows from the state."""
    loads = (n for n, load in coordinate_loads(system) if isinstance(load, AbstractForceCoupling))
    return (*system.transmissions, *loads)


def effect_of(
    system: System, name: str, load: AbstractBodyLoad, motions: tuple[Motion, ...], time: Any
) -> Effect:
    """Forces of a load on its markers, with the energies it stores and dissipates.

    Args:
        system: with the places of the load's markers.
        name: of the load.
        load: acts on markers of bodies.
        motions: motion of every link, from which those of the markers follow.
        time: instant [s].
    """
    places = system.load_markers[name]
    marker_motions = tuple(_motion_of_marker(link, marker, motions) for link, marker in places)
    return load.effect(time, marker_motions)


def _motion_of_marker(link: int | None, marker: Pose, motions: tuple[Motion, ...]) -> MarkerMotion:
    """A load's marker in ground axes."""
    if link is None:
        return MarkerMotion(marker, sp.ZERO, sp.ZERO)
    pose = motions[link].pose.after(marker)
    twist = tree.transform_twist(marker, motions[link].twist)
    return MarkerMotion(
        pose, sp.apply(pose.rotation, twist.linear), sp.apply(pose.rotation, twist.angular)
    )


def _wrench_in_link(action: Action, motion: Motion, marker: Pose) -> Wrench:
    """An action on a marker as a wrench in the axes of its link."""
    rotation = motion.pose.after(marker).rotation
    local = Wrench(
        sp.apply_transposed(rotation, action.force), sp.apply_transposed(rotation, action.torque)
    )
    return tree.transform_wrench(marker, local)
