"""Everything that acts at an instant: contacts and loads, as a wrench on every link and a force on
every coordinate.

Alike clearance joints are traced once. Constraint reactions are not forces here: they follow from
the accelerations (`dynamics`).
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.coupling import AbstractForceCoupling
from jaxclear.components.load import (
    AbstractBodyLoad,
    AbstractStateLoad,
    Action,
    CoordinateEffect,
    Effect,
    MarkerMotion,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_grouped, map_many
from jaxclear.ground.pose import Pose
from jaxclear.laws.transmission import holding
from jaxclear.multibody import closure_coordinates, contact_point, kinematics, transmissions, tree
from jaxclear.multibody.contact_point import JointReport
from jaxclear.multibody.loops import Closure, Relative
from jaxclear.multibody.state import Followed
from jaxclear.multibody.system import System, body_loads, coordinate_loads
from jaxclear.multibody.transmissions import Pressing
from jaxclear.multibody.tree import NOTHING, Motion, Wrench

AXIS: sp.Vec = (0, 0, 1)


class Forces(NamedTuple):
    """Everything that acts, at one instant: wrenches by link, in its axes, and forces on its
    coordinates; `stored` energy [J] of the loads, their `damping_loss` and `external_power` [W].
    `on_joints`: wrenches of loads on coordinates outside the tree, by joint, on its child about its
    marker in the parent marker's axes; `followed`: what of the state such coordinates were read by;
    `state_rates` of loads and flanks, by load or coupling; `pressing`: what couplings with play or
    stiffness do; `on_drives`: forces of couplings on coordinates that drives prescribe, by link.
    """

    motions: tuple[Motion, ...]
    reports: dict[str, JointReport]
    wrenches: tuple[Wrench, ...]
    coordinate_forces: tuple
    stored: Any
    damping_loss: Any
    external_power: Any
    on_joints: dict[str, Wrench]
    followed: Followed
    state_rates: dict[str, tuple]
    pressing: dict[str, Pressing]
    on_drives: dict[int, Any]


def contact_reports(
    system: System, motions: tuple[Motion, ...], memories: dict, worn: dict
) -> dict[str, JointReport]:
    """Report of every clearance joint; `worn` are depth maps by joint and surface."""
    relative = relative_motions(system, motions)
    calls = [
        (bearing.joint, bearing.contact_laws, own, memories[name], worn.get(name, {}))
        for (name, bearing), own in zip(system.bearings.items(), relative, strict=True)
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
    q: tuple,
    v: tuple,
    time: Any,
    followed: Followed = NOTHING_FOLLOWED,
) -> Forces:
    """Wrench of contacts, loads and couplings that give on every link, and forces on coordinates;
    `followed`: what the state follows beside the motion."""
    wrenches = _of_bearings(system, motions, reports)
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
                    _add(wrenches, link, _in_link(action, motions[link], marker))
            stored, damping = sp.add(stored, effect.stored), sp.add(damping, effect.dissipated)
            external = sp.add(external, effect.external)
    acting = Acting(wrenches, [(0,) * len(motion.columns) for motion in motions], {}, {})
    rates: dict[str, tuple] = {}
    for label, held in coordinate_loads(system):
        seen = [seen_at(system, motions, name, followed) for name in held.coordinates()]
        states, now = (
            states_of(label, held, followed),
            as_pressed(system, motions, held, time, followed),
        )
        found = now.effect(
            time, tuple(one.position for one in seen), tuple(one.speed for one in seen), states
        )
        for one, force in zip(seen, found.forces, strict=True):
            one.push(acting, force)
        rates |= {label: found.rates} if found.rates else {}
        stored, damping = sp.add(stored, found.stored), sp.add(damping, found.dissipated)
        external = sp.add(external, found.external)
    pressed = pressing_of(system, motions, followed)
    for name, giving in system.transmissions.items():
        torque = pressed[name].torque
        give(system, motions, giving, torque, acting)
        moved = (pressed[name].end_rate,) if giving.has_twist else ()
        rubbed = _rubbed(system, motions, name, torque, followed, acting)
        if moved or rubbed is not None:
            rates[name] = moved if rubbed is None else (*moved, rubbed.rate)
        damping = damping if rubbed is None else sp.add(damping, rubbed.lost)
        stored, damping = (
            sp.add(stored, pressed[name].stored),
            sp.add(damping, pressed[name].dissipated),
        )
    for link, force in acting.on_drives.items():
        external = sp.sub(external, sp.mul(force, motions[link].speeds[0]))
    links = (tuple(acting.wrenches), tuple(acting.forces))
    return Forces(
        motions,
        reports,
        *links,
        stored,
        damping,
        external,
        acting.on_joints,
        followed,
        rates,
        pressed,
        acting.on_drives,
    )


def _of_bearings(
    system: System, motions: tuple[Motion, ...], reports: dict[str, JointReport]
) -> list[Wrench]:
    """Wrench of the clearance joints on every link."""
    own: list[list[Wrench]] = [[] for _ in system.links]
    closures = [system.bearings[name].closure for name in reports]
    relative = kinematics.relative_motions(closures, motions)
    pairs = zip(closures, relative, reports.values(), strict=True)
    calls = [
        (
            None if closure.parent_link is None else closure.parent,
            None if closure.child_link is None else closure.child,
            *(seen.pose, report.force, report.torque),
        )
        for closure, seen, report in pairs
    ]
    for closure, (on_child, on_parent) in zip(
        closures, map_many(_action_and_reaction, calls), strict=True
    ):
        if closure.child_link is not None:
            own[closure.child_link].append(on_child)
        if closure.parent_link is not None:
            own[closure.parent_link].append(on_parent)
    total = lambda *each: functools.reduce(_sum, each, NOTHING)
    return map_many(total, [tuple(each) for each in own])


class _Rubbed(NamedTuple):
    """Rate of a deflection that holds, and what is lost [W]."""

    rate: Any
    lost: Any


def _rubbed(
    system: System,
    motions: tuple[Motion, ...],
    name: str,
    torque: Any,
    followed: Followed,
    acting: "Acting",
) -> _Rubbed | None:
    """Adds the friction of a coupling that transmits a torque against its twist; None of one
    without."""
    own = system.transmissions[name]
    end, thread = own.driving, own.coupling.thread
    if end is None and thread is None:
        return None
    known = followed.states.get(name)
    deflection = jnp.zeros(()) if known is None else known[-1]
    if end is not None:
        seen = seen_at(system, motions, end.coordinate, followed)
        held = holding(deflection, seen.speed, end.loses.presliding, end.loses.settling_time)
        friction = end.loses.loss(torque * end.slope, held.share)
        seen.push(acting, -friction)
        return _Rubbed(held.rate, friction * seen.speed)
    assert thread is not None
    _, pose, relative = kinematics.relative_motion(own.closure, motions)
    helix = thread.helix
    slip = sp.add(sp.mul(helix.axial, relative.velocity[2]), sp.mul(helix.lever, relative.spin[2]))
    slip = jnp.asarray(slip, float)
    held = holding(deflection, slip, thread.presliding, thread.settling_time)
    friction = -thread.coefficient * helix.normal * jnp.abs(torque) * held.share
    force, turned = sp.scale(friction * helix.axial, AXIS), sp.scale(friction * helix.lever, AXIS)
    add_action_and_reaction(acting.wrenches, own.closure, pose, force, turned)
    return _Rubbed(held.rate, -friction * slip)


def pressing_of(
    system: System, motions: tuple[Motion, ...], followed: Followed
) -> dict[str, Pressing]:
    """What couplings with play or stiffness do, by name; alike ones are traced once."""
    calls = []
    for name, own in system.transmissions.items():
        twist, end = transmissions.twist_of(system, motions, own), None
        if own.has_twist:
            known = followed.states.get(name)
            end = transmissions.end_at_start(own, twist) if known is None else known[0]
        calls.append((transmissions.compliance_of(own), twist, end, followed.shares.get(name)))
    found = map_grouped(transmissions.pressing, calls)
    return dict(zip(system.transmissions, found, strict=True))


def states_of(name: str, load: AbstractStateLoad, followed: Followed) -> tuple:
    """The states of a load; those with which it starts where none are followed."""
    known = followed.states.get(name)
    return tuple(jnp.asarray(x.start, float) for x in load.states()) if known is None else known


class Acting(NamedTuple):
    """What acts so far: wrenches on links, forces on their coordinates, wrenches of loads on
    coordinates outside the tree, by joint, and forces on coordinates that drives prescribe, by
    link."""

    wrenches: list[Wrench]
    forces: list[tuple]
    on_joints: dict[str, Wrench]
    on_drives: dict[int, Any]

    def along(self, link: int, force: Any) -> None:
        """Adds a force on the single coordinate of a link."""
        if self.forces[link]:
            self.forces[link] = (sp.add(self.forces[link][0], force),)
        else:
            self.on_drives[link] = sp.add(self.on_drives.get(link, 0), force)


class _Seen(NamedTuple):
    """A coordinate as a load reads it, and what `push`es it: (what acts so far, force)."""

    position: Any
    speed: Any
    push: Callable[[Acting, Any], None]


def seen_coordinates(
    system: System, motions: tuple[Motion, ...], load: AbstractStateLoad, followed: Followed
) -> tuple[tuple, tuple]:
    """Positions and speeds of the coordinates that a load reads."""
    seen = [seen_at(system, motions, name, followed) for name in load.coordinates()]
    return tuple(own.position for own in seen), tuple(own.speed for own in seen)


def seen_at(system: System, motions: tuple[Motion, ...], name: str, followed: Followed) -> _Seen:
    """The coordinate of a joint, or of a motor."""
    if name in system.geared:
        own = system.geared[name]
        joint = seen_at(system, motions, own.joint, followed)
        position = sp.mul(own.ratio, joint.position)
        position = position if own.offset is None else position + own.offset
        turned = lambda acting, force: joint.push(acting, sp.mul(own.ratio, force))
        return _Seen(position, sp.mul(own.ratio, joint.speed), turned)
    branch = system.topology.branch_of(name)
    if branch is not None:
        index = system.topology.branches.index(branch)
        along = lambda acting, force: acting.along(index, force)
        return _Seen(motions[index].coordinates[0], motions[index].speeds[0], along)
    coordinate = system.measured[name]
    now = closure_coordinates.read(coordinate, motions, followed.angles.get(name))

    def between(acting, force):
        own = Wrench(*(sp.scale(force, part) for part in now.wrench))
        add_action_and_reaction(acting.wrenches, coordinate.closure, now.pose, *own)
        acting.on_joints[name] = _sum(acting.on_joints.get(name, NOTHING), own)

    return _Seen(now.position, now.speed, between)


def give(system, motions, own, torque, acting) -> None:
    """Adds the torque of a coupling."""
    for link, force in transmissions.on_coordinates(motions, own, torque):
        acting.along(link, force)
    for closure, pose, wrench, joint in transmissions.on_closures(motions, own, torque):
        add_action_and_reaction(acting.wrenches, closure, pose, *wrench)
        if joint is not None:
            acting.on_joints[joint] = _sum(acting.on_joints.get(joint, NOTHING), wrench)


def as_pressed(
    system: System,
    motions: tuple[Motion, ...],
    load: AbstractStateLoad,
    time: Any,
    followed: Followed,
) -> AbstractStateLoad:
    """A load as the force that presses it makes it at an instant."""
    name = load.pressed_by()
    if name is None:
        return load
    return load.under(force_of(system, motions, name, time, followed))


def coordinate_effect(
    system: System, motions: tuple[Motion, ...], name: str, time: Any, followed: Followed
) -> CoordinateEffect:
    """What a load on coordinates, or a coupling that is a force, does at an instant."""
    load: Any = system.loads[name]
    seen = seen_coordinates(system, motions, load, followed)
    pressed = as_pressed(system, motions, load, time, followed)
    return pressed.effect(time, *seen, states_of(name, load, followed))


def force_of(
    system: System, motions: tuple[Motion, ...], name: str, time: Any, followed: Followed
) -> Any:
    """What a load gives along its first coordinate, or a coupling that is no row transmits
    [N m, N]."""
    if name in system.transmissions:
        return -jnp.asarray(pressing_of(system, motions, followed)[name].torque, float)
    load = system.loads[name]
    effect = coordinate_effect(system, motions, name, time, followed)
    coupled = isinstance(load, AbstractForceCoupling)
    return jnp.asarray(load.transmitted(effect) if coupled else effect.forces[0], float)


def effect_of(
    system: System, name: str, load: AbstractBodyLoad, motions: tuple[Motion, ...], time: Any
) -> Effect:
    """What a load does on its markers."""
    places = system.load_markers[name]
    seen = tuple(_marker_motion(link, marker, motions) for link, marker in places)
    return load.effect(time, seen)


def add_action_and_reaction(
    wrenches: list[Wrench], closure: Closure, pose: Pose, force: sp.Vec, torque: sp.Vec
) -> None:
    """Add a wrench on the closure's child about its marker, in the parent marker's axes, and its
    opposite on the parent.
    """
    parent = None if closure.parent_link is None else closure.parent
    child = None if closure.child_link is None else closure.child
    on_child, on_parent = _action_and_reaction(parent, child, pose, force, torque)
    if closure.child_link is not None:
        _add(wrenches, closure.child_link, on_child)
    if closure.parent_link is not None:
        _add(wrenches, closure.parent_link, on_parent)


def _action_and_reaction(
    parent: Pose | None, child: Pose | None, pose: Pose, force: sp.Vec, torque: sp.Vec
) -> tuple[Any, Any]:
    """Wrenches on the links of the child's marker and of the parent's, in their axes; None where
    that is the ground."""
    on_child = on_parent = None
    if child is not None:
        turned = (
            sp.apply_transposed(pose.rotation, force),
            sp.apply_transposed(pose.rotation, torque),
        )
        on_child = tree.transform_wrench(child, Wrench(*turned))
    if parent is not None:
        moment = sp.plus(torque, sp.cross(pose.translation, force))
        back = Wrench(tuple(sp.neg(x) for x in force), tuple(sp.neg(x) for x in moment))
        on_parent = tree.transform_wrench(parent, back)
    return on_child, on_parent


def _add(wrenches: list[Wrench], link: int, wrench: Wrench) -> None:
    wrenches[link] = _sum(wrenches[link], wrench)


def _sum(a: Wrench, b: Wrench) -> Wrench:
    return Wrench(sp.plus(a.force, b.force), sp.plus(a.torque, b.torque))


def _marker_motion(link: int | None, marker: Pose, motions: tuple[Motion, ...]) -> MarkerMotion:
    """A load's marker in ground axes."""
    if link is None:
        return MarkerMotion(marker, sp.ZERO, sp.ZERO)
    pose = motions[link].pose.after(marker)
    twist = tree.transform_twist(marker, motions[link].twist)
    return MarkerMotion(
        pose, sp.apply(pose.rotation, twist.linear), sp.apply(pose.rotation, twist.angular)
    )


def _in_link(action: Action, motion: Motion, marker: Pose) -> Wrench:
    """An action on a marker as a wrench in the axes of its link."""
    rotation = motion.pose.after(marker).rotation
    local = Wrench(
        sp.apply_transposed(rotation, action.force), sp.apply_transposed(rotation, action.torque)
    )
    return tree.transform_wrench(marker, local)
