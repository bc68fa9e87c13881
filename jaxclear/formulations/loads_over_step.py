"""Loads on coordinates whose force a step finds itself: rigid stops, and dry friction that sticks.

Where forces are percussions, or friction is set-valued, these loads have no force at an instant
(`OverStep`); they push or rub along the row of their coordinate, as contacts and joints do along
theirs. A stop with a stiffness and no restitution is a spring where steps resolve it, and rigid
where they do not: it then gives way by less than what acts moves it within a step.

Nothing here is evaluated in a mechanism without such loads.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.acting import AbstractCoordinateLoad, AbstractStateLoad, Side
from jaxclear.formulations.contact_rows import ContactJacobianRow
from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.laws.rebound import restitution_of
from jaxclear.multibody import closure_coordinates, kinematics
from jaxclear.multibody.forces import Forces, add_action_and_reaction
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System, coordinate_loads
from jaxclear.multibody.tree import Motion

# Explicit steps h follow a spring up to h omega = 2 and a damper up to h d / m = 2; they are left
# to them up to a quarter of that.
FOLLOWED = 0.5


class OverStep(AbstractCoordinateLoad):
    """A load whose force steps find themselves."""

    connection: str = eqx.field(static=True)
    load: AbstractStateLoad

    def force(self, time, position, speed):
        return 0, 0, 0, 0

    def reads_position(self):
        return self.load.reads_position()

    def sides(self):
        return self.load.sides()

    def dry_friction(self):
        return self.load.dry_friction()


def found_over_steps(system: System) -> System:
    """The system with stops and dry friction as loads whose force steps find."""
    found = {
        name: OverStep(load.coordinates()[0], load)
        for name, load in coordinate_loads(system)
        if load.sides() or load.dry_friction() is not None
    }
    return dataclasses.replace(system, loads=system.loads | found) if found else system


def over_step(system: System) -> dict[str, OverStep]:
    """The loads of a system whose force steps find, by name."""
    return {name: load for name, load in coordinate_loads(system) if isinstance(load, OverStep)}


def may_strike(system: System) -> bool:
    """Whether something may strike: a contact, or a coordinate its stop."""
    return bool(system.bearings) or any(load.sides() for load in over_step(system).values())


def load_components(system: System) -> tuple[tuple[str, int], ...]:
    """By load whose force steps find, how many components it has in states that hold impulses."""
    return tuple((impulse_of(name), 1) for name in over_step(system))


def impulse_of(name: str) -> str:
    """What states call the impulse of a load: joints have names of their own."""
    return f"load {name}"


class Coordinate(NamedTuple):
    """The coordinate of a joint at an instant: its `position` [rad, m] and `speed`, and the row of
    its speed by the speeds of the mechanism."""

    position: Any
    speed: Any
    row: ContactJacobianRow


def coordinates_of(
    system: System, motions: tuple[Motion, ...], q: tuple, v: tuple, angles: Mapping[str, Any]
) -> dict[str, Coordinate]:
    """The coordinates on which loads act whose force steps find, by joint or motor."""
    names = dict.fromkeys(load.connection for load in over_step(system).values())
    return {name: _coordinate(system, motions, name, (q, v), angles) for name in names}


def _coordinate(
    system: System, motions: tuple[Motion, ...], name: str, moving: tuple, angles: Mapping[str, Any]
) -> Coordinate:
    if name in system.geared:
        geared = system.geared[name]
        joint = _coordinate(system, motions, geared.joint, moving, angles)
        position = geared.ratio * joint.position
        position = position if geared.offset is None else position + geared.offset
        row = {j: sp.mul(geared.ratio, entry) for j, entry in joint.row.items()}
        return Coordinate(position, geared.ratio * joint.speed, row)
    branch, (q, v) = system.topology.branch_of(name), moving
    if branch is not None:
        k = system.topology.branches.index(branch)
        return Coordinate(q[k][0], v[k][0], {branch.speeds.start: 1})
    own = system.measured[name]
    now = closure_coordinates.read(own, motions, angles.get(name))
    rates = own.joint.speeds_at
    (row,) = kinematics.relative_jacobian(system, motions, own.closure, now.pose, rates)
    return Coordinate(now.position, now.speed, row)


def coordinates_at(
    model: Model, time: Any, entries: list, angles: Mapping[str, Any]
) -> dict[str, Coordinate]:
    """The same at coordinates and speeds, one after the other, near these angles."""
    motion = unpack_motion(model.system, entries)
    motions = kinematics.link_motions(model.system, *motion, time)
    return coordinates_of(model.system, motions, *motion, angles)


def with_loads(system: System, forces: Forces, given: dict[str, Any]) -> Forces:
    """The forces with those [N m, N] `given` by loads that steps find, by load."""
    loads = over_step(system)
    if not loads:
        return forces
    on, wrenches = list(forces.coordinate_forces), list(forces.wrenches)
    on_joints = dict(forces.on_joints)
    for name, load in loads.items():
        joint, force = load.connection, given[name]
        if joint in system.geared:
            geared = system.geared[joint]
            joint, force = geared.joint, sp.mul(geared.ratio, force)
        branch = system.topology.branch_of(joint)
        if branch is not None:
            k = system.topology.branches.index(branch)
            on[k] = (sp.add(on[k][0], force),)
            continue
        own = system.measured[joint]
        now = closure_coordinates.read(own, forces.motions, forces.followed.angles.get(joint))
        wrench = tuple(sp.scale(force, part) for part in now.wrench)
        add_action_and_reaction(wrenches, own.closure, now.pose, *wrench)
        before = on_joints[joint]
        on_joints[joint] = type(before)(*map(sp.plus, before, wrench))
    return forces._replace(
        wrenches=tuple(wrenches), coordinate_forces=tuple(on), on_joints=on_joints
    )


def forces_of_means(instant: Instant) -> dict[str, Any]:
    """By load its force [N m, N] at a saved instant whose state holds impulses."""
    return {name: instant.means_of(impulse_of(name))[0] for name in over_step(instant.model.system)}


class StopInStep(NamedTuple):
    """A side of a stop in a step: its load, how far the coordinate is beyond it in the middle [rad,
    m], the rate by which that falls, and the row of this rate."""

    name: str
    side: Side
    beyond: Any
    opening: Any
    row: ContactJacobianRow

    def spring(self) -> Any:
        """Force [N m, N] of what gives way there."""
        return self.side.stop.push(self.beyond, -self.opening)[0]

    def followed(self, lightness: Any, h: Any) -> Any:
        """Whether steps of length h [s] follow its spring and damper, which move an inertia of this
        inverse."""
        soft = h * h * self.side.stop.stiffness * lightness < FOLLOWED**2
        if self.side.stop.damping is not None:
            soft = soft & (h * self.side.stop.damping * lightness < FOLLOWED)
        return soft

    def restitution(self, lightness: Any) -> Any:
        """Share of its speed [1] that comes back where steps do not follow its spring."""
        if self.side.stop.damping is None:
            return 1.0
        ratio = 0.5 * self.side.stop.damping * jnp.sqrt(lightness / self.side.stop.stiffness)
        return restitution_of(ratio)


class RubInStep(NamedTuple):
    """Dry friction on a coordinate in a step: its load, largest size [N m, N], the coordinate's
    speed and its row."""

    name: str
    bound: Any
    speed: Any
    row: ContactJacobianRow


class LoadsInStep(NamedTuple):
    """The loads of a step whose force it finds: sides of stops, then friction."""

    stops: tuple[StopInStep, ...]
    rubs: tuple[RubInStep, ...]

    @property
    def rows(self) -> list[ContactJacobianRow]:
        """Their rows, those of stops signed as they open."""
        return [one.row for one in (*self.stops, *self.rubs)]

    def lost(self, forces: Any, change: list) -> Any:
        """Power [W] that these forces along the rows take at speeds that differ so from those at
        which the loads were read."""
        speeds = [*(one.opening for one in self.stops), *(one.speed for one in self.rubs)]
        rates = [sp.add(x, along(row, change)) for x, row in zip(speeds, self.rows, strict=True)]
        return sp.neg(sp.dot(forces, rates))

    def by_load(self, system: System, values: Any) -> dict[str, Any]:
        """Forces or impulses along the rows, as sums by load."""
        found = dict.fromkeys(over_step(system), 0.0)
        for one, value in zip((*self.stops, *self.rubs), values, strict=True):
            sign = one.side.sign if isinstance(one, StopInStep) else 1.0
            found[one.name] = found[one.name] + sign * value
        return found


NO_LOADS = LoadsInStep((), ())


def loads_in_step(system: System, at: dict[str, Coordinate]) -> LoadsInStep:
    """The loads as a step finds their coordinates."""
    stops: list[StopInStep] = []
    rubs: list[RubInStep] = []
    for name, load in over_step(system).items():
        own = at[load.connection]
        bound = load.dry_friction()
        if bound is not None:
            rubs.append(RubInStep(name, bound, own.speed, own.row))
        for side in load.sides():
            row = {j: sp.mul(side.sign, entry) for j, entry in own.row.items()}
            beyond, opening = side.beyond(own.position), side.sign * own.speed
            stops.append(StopInStep(name, side, beyond, opening, row))
    return LoadsInStep(tuple(stops), tuple(rubs))


def counts_of_rows(system: System) -> tuple[int, int]:
    """How many sides stops have, and how many loads rub."""
    loads = over_step(system).values()
    stops = sum(len(load.sides()) for load in loads)
    return stops, sum(load.dry_friction() is not None for load in loads)
