"""Everything that acts at an instant: contacts and loads, as a wrench on every link and a force on
every coordinate.

Alike clearance joints are traced once. Constraint reactions are not forces here: they follow from
the accelerations (`dynamics`).
"""

from typing import Any, NamedTuple

import jax

from jaxclear.components.load import AbstractBodyLoad, Action, Effect, MarkerMotion
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_alike
from jaxclear.ground.pose import Pose
from jaxclear.multibody import closure_coordinates, contact_point, kinematics, tree
from jaxclear.multibody.contact_point import JointReport
from jaxclear.multibody.loops import Closure
from jaxclear.multibody.system import System, body_loads, coordinate_loads
from jaxclear.multibody.tree import NOTHING, Motion, Wrench


class Forces(NamedTuple):
    """Everything that acts, at one instant: wrenches by link, in its axes, and forces on its
    coordinates; `stored` energy [J] of the loads, their `damping_loss` and `external_power` [W].
    `on_joints`: wrenches of loads on coordinates outside the tree, by joint, on its child about its
    marker in the parent marker's axes; `angles` [rad]: those near which such coordinates were read.
    """

    motions: tuple[Motion, ...]
    reports: dict[str, JointReport]
    wrenches: tuple[Wrench, ...]
    coordinate_forces: tuple
    stored: Any
    damping_loss: Any
    external_power: Any
    on_joints: dict[str, Wrench]
    angles: dict[str, Any]


def contact_reports(
    system: System, motions: tuple[Motion, ...], memories: dict, worn: dict
) -> dict[str, JointReport]:
    """Report of every clearance joint; `worn` are depth maps by joint and surface."""
    calls = []
    for name, bearing in system.bearings.items():
        relative = kinematics.relative_motion(bearing.closure, motions)[2]
        calls.append(
            (bearing.joint, bearing.contact_laws, relative, memories[name], worn.get(name, {}))
        )
    with jax.named_scope("contact"):
        reports = map_alike(contact_point.evaluate, calls)
    return dict(zip(system.bearings, reports, strict=True))


def applied_forces(
    system: System,
    motions: tuple[Motion, ...],
    reports: dict[str, JointReport],
    q: tuple,
    v: tuple,
    time: Any,
    angles: dict[str, Any],
) -> Forces:
    """Wrench of contacts and loads on every link, and forces on coordinates; `angles` that the
    state follows, by joint."""
    wrenches = [NOTHING] * len(system.links)
    for name, report in reports.items():
        closure = system.bearings[name].closure
        pose = kinematics.relative_motion(closure, motions)[1]
        add_action_and_reaction(wrenches, closure, pose, report.force, report.torque)
    stored, damping, external = 0, 0, 0
    with jax.named_scope("loads"):
        for name, load in body_loads(system):
            effect, markers = (
                effect_of(system, name, load, motions, time),
                system.load_markers[name],
            )
            for action, (link, marker) in zip(effect.actions, markers, strict=True):
                if link is not None:
                    _add(wrenches, link, _in_link(action, motions[link], marker))
            stored, damping = sp.add(stored, effect.stored), sp.add(damping, effect.dissipated)
            external = sp.add(external, effect.external)
    forces = [(0,) * len(motion.columns) for motion in motions]
    on_joints: dict[str, Wrench] = {}
    for _, held in coordinate_loads(system):
        name, branch = held.connection, system.topology.branch_of(held.connection)
        if branch is not None:
            index = system.topology.branches.index(branch)
            force, energy, loss, power = held.force(time, q[index][0], v[index][0])
            forces[index] = (sp.add(forces[index][0], force),)
        else:
            coordinate = system.measured[name]
            now = closure_coordinates.read(coordinate, motions, angles.get(name))
            force, energy, loss, power = held.force(time, now.position, now.speed)
            own = Wrench(*(sp.scale(force, part) for part in now.wrench))
            add_action_and_reaction(wrenches, coordinate.closure, now.pose, *own)
            on_joints[name] = _sum(on_joints.get(name, NOTHING), own)
        stored, damping = sp.add(stored, energy), sp.add(damping, loss)
        external = sp.add(external, power)
    links = (tuple(wrenches), tuple(forces))
    return Forces(motions, reports, *links, stored, damping, external, on_joints, angles)


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
    if closure.child_link is not None:
        on_child = Wrench(
            sp.apply_transposed(pose.rotation, force), sp.apply_transposed(pose.rotation, torque)
        )
        _add(wrenches, closure.child_link, tree.transform_wrench(closure.child, on_child))
    if closure.parent_link is not None:
        moment = sp.plus(torque, sp.cross(pose.translation, force))
        on_parent = Wrench(tuple(sp.neg(x) for x in force), tuple(sp.neg(x) for x in moment))
        _add(wrenches, closure.parent_link, tree.transform_wrench(closure.parent, on_parent))


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
