"""A mechanism made ready for the time loop: numbers moved into the frames in which the equations
are written.

Everything here is computed once before the loop starts, from the same leaves, so derivatives pass
through.
"""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.body import GROUND
from jaxclear.components.clearance import AbstractClearance, ContactLaws
from jaxclear.components.coupling import (
    AbstractCoordinateCoupling,
    AbstractForceCoupling,
    CoordinateTerm,
    Efficiency,
)
from jaxclear.components.joint import AbstractJoint, AbstractRubbingJoint, Revolute
from jaxclear.components.journal_film import film_of
from jaxclear.components.load import (
    AbstractBodyLoad,
    AbstractJointLoad,
    AbstractStateLoad,
    Gravity,
    MotorEnd,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_many
from jaxclear.ground.ordered import Ordered
from jaxclear.ground.pose import REST, Pose
from jaxclear.multibody.contact_point import fitted_laws
from jaxclear.multibody.loops import LENGTH, TURN, Closure, CoordinateSum, SummedCoordinate
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.meshes import drawn_pose, make_mesh_reading, markers, meshing_parts
from jaxclear.multibody.pose_rows import CoordinateOf, closing_rows, reading_of
from jaxclear.multibody.topology import (
    Branch,
    Topology,
    coordinate_joint,
    joint_of,
    motor_name,
    rubbing_in,
)
from jaxclear.multibody.tree import Link


class Bearing(eqx.Module):
    """A clearance joint ready for evaluation: its markers as a closure and its laws, fitted to it
    as made."""

    closure: Closure
    joint: AbstractClearance
    contact_laws: tuple[ContactLaws, ...]

    @property
    def radii(self) -> list:
        """Radius [m] of journal or ball in each possible contact; infinite where it has none."""
        shapes = [laws.shape for laws in self.contact_laws]
        return [jnp.inf if shape is None else shape.inner_radius for shape in shapes]


class ClosureCoordinate(eqx.Module):
    """The coordinate of a joint that the tree does not carry, on which loads act, between the two
    markers of a closure; `followed`: it is an angle whose whole turns matter.
    """

    joint: AbstractJoint
    closure: Closure
    followed: bool = eqx.field(static=True)


# The states of a shaft's far end in its gap, and of friction that holds.
TWIST, SLIP = "twist", "slip"


class DrivingEnd(eqx.Module):
    """The end of a coupling at which it loses power: its coordinate, by how much the twist changes
    with it, and what it loses."""

    coordinate: str = eqx.field(static=True)
    slope: Any
    loses: Efficiency


class Transmission(eqx.Module):
    """A coupling that gives: its row, as a closure, and the `scale` by which the residual is
    divided so that it is the twist [rad, m] along which play and stiffness are; `slides`: the
    coordinate with which flanks that wear slide (None: they do not)."""

    closure: Closure
    scale: Any
    coupling: Any  # an AbstractCoupling
    driving: "DrivingEnd | None" = None
    slides: str | None = eqx.field(static=True, default=None)

    def states(self) -> tuple[str, ...]:
        """Its states."""
        rubs = self.driving is not None or self.coupling.thread is not None
        return (TWIST,) * self.has_twist + (SLIP,) * rubs

    @property
    def has_twist(self) -> bool:
        """Whether its law has a state of the flank."""
        play = self.coupling.play
        return play is not None and bool(play.law.has_twist)

    @property
    def separates_by_torque(self) -> bool:
        """Whether its flanks are left where the torque would pull."""
        play = self.coupling.play
        return play is not None and bool(play.law.separates_by_torque)


class Geared(eqx.Module):
    """A motor that turns with the coordinate of a `joint`: `ratio` of its angle to that coordinate,
    and the angle at which this is 0 (None: 0)."""

    joint: str = eqx.field(static=True)
    ratio: Any
    offset: Any


class System(eqx.Module):
    """Links in the topology's order, loop closures and the joints that make them, clearance joints,
    couplings that give, and loads; `measured`: joints outside the tree on whose coordinate loads
    act; `load_closures`: markers between which loads in joints act, by load; `geared`: motors that
    turn with a joint; `flanks`: couplings whose play is between rigid ones. `arm` [m]: the longest,
    where rows of loops depend on each other; None elsewhere.
    """

    links: tuple[Link, ...]
    closures: tuple[Closure, ...]
    closing: tuple[Any, ...]
    bearings: dict[str, Bearing] = eqx.field(converter=Ordered)
    loads: dict[str, Any] = eqx.field(converter=Ordered)
    measured: dict[str, ClosureCoordinate] = eqx.field(converter=Ordered)
    load_markers: dict[str, tuple[tuple[int | None, Pose], ...]] = eqx.field(converter=Ordered)
    gravity: sp.Vec
    arm: Any
    topology: Topology = eqx.field(static=True)
    load_closures: dict[str, Closure] = eqx.field(converter=Ordered, default_factory=dict)
    transmissions: dict[str, Transmission] = eqx.field(converter=Ordered, default_factory=dict)
    geared: dict[str, Geared] = eqx.field(converter=Ordered, default_factory=dict)
    flanks: dict[str, Transmission] = eqx.field(converter=Ordered, default_factory=dict)


def _rotate_pose(pose: Pose, turn: sp.Mat) -> Pose:
    return Pose(sp.product(pose.rotation, turn), pose.translation)


def prepare(mechanism: Mechanism, shifts: dict[str, Pose] | None = None) -> System:
    """The system of a mechanism. `shifts`: by connection where its parent's marker has moved to, in
    that marker (a bearing whose journal leans in its gap, say)."""
    shifts = shifts or {}
    topology = mechanism.topology
    links: list[Link] = []
    for subtree in topology.subtrees:
        for position in subtree:
            links.append(_make_link(mechanism, position, subtree, links, shifts))
    frames = {GROUND: REST} | {
        branch.body: link.frame for branch, link in zip(topology.branches, links, strict=True)
    }

    def closure(name, rows, reading=None):
        ends = (mechanism.connections[name].parent, mechanism.connections[name].child)
        poses = [frames[marker.body].after(marker.pose()) for marker in ends]
        if name in shifts:
            poses[0] = poses[0].after(shifts[name])
        return Closure(*poses, *[topology.index(marker.body) for marker in ends], rows, reading)

    closures = tuple(
        closure(name, closing_rows(joint), reading_of(joint))
        for name, joint in ((n, mechanism.connections[n].joint) for n in topology.closing)
    )
    joints = [mechanism.connections[name].joint for name in topology.clearances]
    laws = map_many(fitted_laws, [(joint,) for joint in joints])
    bearings = {}
    for name, joint, law in zip(topology.clearances, joints, laws, strict=True):
        bearings[name] = Bearing(closure(name, joint.ideal_rows), joint, law)
    loads, load_markers, load_closures, gravity = {}, {}, {}, sp.ZERO
    for name, load in acting_in(mechanism).items():
        if isinstance(load, Gravity):
            gravity = sp.vec3(load.acceleration)
        else:
            loads[name] = load
        if isinstance(load, AbstractBodyLoad):
            load_markers[name] = tuple(
                (topology.index(m.body), frames[m.body].after(m.pose())) for m in load.markers()
            )
        if isinstance(load, AbstractJointLoad):
            load_closures[name] = closure(load.connection, ())
    closing = tuple(mechanism.connections[name].joint for name in topology.closing)
    places = dict(zip(topology.closing, closures, strict=True))
    places |= {name: bearing.closure for name, bearing in bearings.items()}
    closures += tuple(_make_row(mechanism, name, places, frames) for name in topology.couplings)
    transmissions = {}
    for name, coupling in mechanism.couplings.items():
        if coupling.gives:
            law = _make_row(mechanism, name, places, frames)
            scale = scale_of(mechanism, coupling)
            _check_error(name, coupling, law)
            end = _driving_end(mechanism, name, scale)
            slides = sliding_along(name, coupling)
            transmissions[name] = Transmission(law, scale, coupling, end, slides)
    measured = _measured(mechanism, places)
    loaded = (loads, measured, load_markers, gravity)
    behind = (load_closures, transmissions, geared_motors(mechanism))
    system = System(tuple(links), closures, closing, bearings, *loaded, None, topology, *behind)
    return dataclasses.replace(system, arm=longest_arm(system)) if topology.depend else system


def _check_error(name: str, coupling: Any, part: Closure) -> None:
    """Raises `ValueError` for a transmission error of a joint whose turn nobody counts."""
    summed = isinstance(part.reading, CoordinateSum)
    if summed and coupling.transmission_error is not None and part.reading.terms[0].link is None:
        raise ValueError(
            f'coupling "{name}" has a transmission_error, a function of the turn of joint '
            f'"{part.reading.terms[0].joint}", which closes a loop or has clearance; only a joint '
            "that the tree carries can have one behind a coupling.Motor."
        )


def acting_in(mechanism: Mechanism) -> dict[str, Any]:
    """Loads, films of joints and couplings that are forces between coordinates, by name; each
    knows the motors behind its joints."""
    ends, result = motor_ends(mechanism), {}
    for name, load in mechanism.loads.items():
        if isinstance(load, AbstractStateLoad):
            load = load.of_bodies(mechanism.bodies).behind(ends)
        result[name] = load
    result |= films_in(mechanism)
    part = mechanism.couplings.items()
    return result | {n: c for n, c in part if isinstance(c, AbstractForceCoupling)}


def films_in(mechanism: Mechanism) -> dict[str, AbstractJointLoad]:
    """The loads that fill gaps of joints, by name."""
    joints = {name: mechanism.connections[name].joint for name in mechanism.topology.clearances}
    joints |= rubbing_in(mechanism.connections)
    gaps = {name: joint.gap_load(name) for name, joint in joints.items()}
    return {film_of(name): load for name, load in gaps.items() if load is not None}


def motor_ends(mechanism: Mechanism) -> dict[str, MotorEnd]:
    """The motors behind couplings that give, by the joint that each turns."""
    ends: dict[str, MotorEnd] = {}
    for name, coupling in mechanism.couplings.items():
        joints = coupling.joints()
        twists = coupling.play is not None or coupling.stiffness is not None
        if coupling.motor is not None and twists and len(joints) == 1:
            ends[joints[0]] = _end_of_motor(mechanism, name)
    return ends


def _end_of_motor(mechanism: Mechanism, name: str) -> MotorEnd:
    """The motor of a coupling as its joint sees it."""
    motor, terms = motor_name(name), dict(_terms_with_motor(mechanism, name))
    coupling: Any = mechanism.couplings[name]
    part, total = terms.pop(motor), coupling.total()
    (factor,) = terms.values()
    return MotorEnd(motor, -factor / part, None if total is None else total / part)


def _make_row(mechanism: Mechanism, name: str, places: dict, frames: dict) -> Closure:
    """The row of a coupling; `places`: closures of the joints outside the tree, `frames` of all
    bodies in their links."""
    coupling = mechanism.couplings[name]
    if isinstance(coupling, AbstractCoordinateCoupling) or coupling.motor is not None:
        return _make_sum_row(mechanism, name, places)
    return _make_meshing_row(mechanism, coupling, frames)


def scale_of(mechanism: Mechanism, coupling: Any) -> Any:
    """What the residual of a coupling is divided by, so that it is its twist."""
    if isinstance(coupling, AbstractCoordinateCoupling) or coupling.motor is not None:
        return coupling.terms()[0].factor
    return coupling.play_radius(drawn_pose(coupling, mechanism.bodies, mechanism.connections))


def _driving_end(mechanism: Mechanism, name: str, scale: Any) -> DrivingEnd | None:
    """Where a coupling loses power; None for one that loses none."""
    coupling: Any = mechanism.couplings[name]
    if coupling.efficiency is None:
        return None
    if coupling.motor is not None:
        motor = motor_name(name)
        slope = dict(_terms_with_motor(mechanism, name))[motor] / scale
        return DrivingEnd(motor, slope, coupling.efficiency)
    first = coupling.joints()[0]
    drawn = drawn_pose(coupling, mechanism.bodies, mechanism.connections)
    side = 1.0 if meshing_parts(coupling, mechanism.connections)[0].is_child else -1.0
    slope = side * coupling.radii(drawn)[0] / scale
    return DrivingEnd(first, slope, coupling.efficiency)


def sliding_along(name: str, coupling: Any) -> str | None:
    """The coordinate along which play is seen whose flanks wear; None of any other coupling."""
    if coupling.play is None or coupling.play.wear is None:
        return None
    if isinstance(coupling, AbstractCoordinateCoupling) or coupling.motor is not None:
        first = coupling.terms()[0].joint
        return first if isinstance(first, str) else motor_name(name)
    return coupling.play_joint()


def _terms_with_motor(mechanism: Mechanism, name: str) -> list[CoordinateTerm]:
    """The terms of a coupling, its motor by name."""
    coupling: Any = mechanism.couplings[name]
    part = coupling.terms()
    called = lambda joint: joint if isinstance(joint, str) else motor_name(name)
    return [CoordinateTerm(called(joint), factor) for joint, factor in part]


def geared_motors(mechanism: Mechanism) -> dict[str, Geared]:
    """The motors that turn with a joint, by name."""
    result = {}
    couplings: dict[str, Any] = dict(mechanism.couplings)
    for name, coupling in couplings.items():
        motor = motor_name(name)
        if motor in dict(mechanism.topology.geared):
            end = _end_of_motor(mechanism, name)
            result[motor] = Geared(coupling.joints()[0], end.ratio, end.offset)
    return result


def _make_meshing_row(mechanism: Mechanism, coupling: Any, frames: dict[str, Pose]) -> Closure:
    """The row of a coupling of bodies, between the markers that mesh."""
    topology, connections = mechanism.topology, mechanism.connections
    ends = markers(coupling, connections)
    parent, child = (frames[marker.body].after(marker.pose()) for marker in ends)
    first, second = (topology.index(marker.body) for marker in ends)
    reading = make_mesh_reading(coupling, topology, mechanism.bodies, connections)
    return Closure(parent, child, first, second, (LENGTH,), reading)


def _make_sum_row(mechanism: Mechanism, name: str, places: dict[str, Closure]) -> Closure:
    """The row of a coupling of coordinates; `places`: closures of the joints outside the tree."""
    topology, result = mechanism.topology, _terms_with_motor(mechanism, name)
    coupling: Any = mechanism.couplings[name]
    joints = {n: coordinate_joint(n, mechanism.bodies, mechanism.connections) for n, _ in result}
    links = {branch.connection: i for i, branch in enumerate(topology.branches)}
    terms = []
    for joint, factor in result:
        part, closure = joints[joint], places.get(joint)
        turn = closure is not None and part.units == ("rad",)
        terms.append(
            SummedCoordinate(joint, factor, CoordinateOf(part), closure, links.get(joint), turn)
        )
    first = joints[result[0].joint]
    row = LENGTH if first.units == ("m",) else TURN
    summed = CoordinateSum(tuple(terms), coupling.total())
    return Closure(REST, REST, None, None, (row,), summed)


def _measured(mechanism: Mechanism, places: dict[str, Closure]) -> dict[str, ClosureCoordinate]:
    """Joints outside the tree, of these closures, on whose coordinate loads act."""
    acting = [x for x in acting_in(mechanism).values() if isinstance(x, AbstractStateLoad)]
    lossy = {c.joints()[0] for c in mechanism.couplings.values() if c.efficiency is not None}
    lossy |= {sliding_along(name, c) or "" for name, c in mechanism.couplings.items()}
    result = {}
    for name, closure in places.items():
        part = [load for load in acting if name in load.coordinates()]
        if part or name in lossy:
            joint = coordinate_joint(name, mechanism.bodies, mechanism.connections)
            followed = joint.units == ("rad",) and any(load.reads_position() for load in part)
            result[name] = ClosureCoordinate(joint, closure, followed)
    return result


def _make_link(
    mechanism: Mechanism,
    position: int,
    subtree: tuple[int, ...],
    links: list[Link],
    shifts: dict[str, Pose],
) -> Link:
    topology = mechanism.topology
    branch = topology.branches[position]
    if branch.motor:
        return _make_motor_link(mechanism, branch)
    body = mechanism.bodies[branch.body]
    joint = joint_of(branch, mechanism.bodies, mechanism.connections)
    base, outer = REST, REST
    if branch.connection is not None:
        connection = mechanism.connections[branch.connection]
        base, outer = connection.parent.pose(), connection.child.pose()
        if branch.connection in shifts:
            base = base.after(shifts[branch.connection])
        if branch.reversed:
            base, outer = _rotate_pose(outer, joint.reversal), _rotate_pose(base, joint.reversal)
    parent = topology.index(branch.parent)
    if parent is not None:
        base = links[parent].frame.after(base)
    frame = outer.inverse() if outer is not REST else REST
    centre = frame.point(sp.vec3(body.com))
    inertia = sp.congruence(frame.rotation, body.inertia_matrix())
    return Link(
        joint,
        base,
        frame,
        body.mass,
        sp.scale(body.mass, centre),
        sp.shift_inertia(inertia, body.mass, sp.ZERO, centre),
        -1 if parent is None else subtree.index(parent),
        _reflected_inertia(mechanism, branch.connection),
    )


def _make_motor_link(mechanism: Mechanism, branch: Branch) -> Link:
    """The link of a motor: it has an angle and an inertia along it, and nothing else."""
    joint, rotor = Revolute(), _reflected_inertia(mechanism, branch.name)
    return Link(joint, REST, REST, 0, sp.ZERO, NO_INERTIA, -1, rotor)


NO_INERTIA: sp.Mat = (sp.ZERO,) * 3


def _reflected_inertia(mechanism: Mechanism, connection: str | None) -> Any:
    """Inertia of loads and motors that moves with the coordinate of a joint, or of a motor, alone;
    None for none."""
    acting = [x for x in mechanism.loads.values() if isinstance(x, AbstractStateLoad)]
    turning = {connection: None} | {
        motor: part.ratio
        for motor, part in geared_motors(mechanism).items()
        if part.joint == connection
    }
    part = []
    for name, ratio in turning.items():
        result = [load.inertia_along() for load in acting if name in load.coordinates()]
        result += [
            coupling.motor.inertia
            for part_name, coupling in mechanism.couplings.items()
            if coupling.motor is not None and motor_name(part_name) == name
        ]
        values = [inertia for inertia in result if inertia is not None]
        part += [x if ratio is None else ratio * ratio * x for x in values]
    return sum(part) if part else None


def coordinate_loads(system: System | Mechanism) -> list[tuple[str, AbstractStateLoad]]:
    """Loads on coordinates of joints, by name."""
    return [
        (name, load) for name, load in system.loads.items() if isinstance(load, AbstractStateLoad)
    ]


def body_loads(system: System) -> list[tuple[str, AbstractBodyLoad]]:
    """Loads on markers, by name."""
    return [
        (name, load) for name, load in system.loads.items() if isinstance(load, AbstractBodyLoad)
    ]


def rubbing_joints(system: System) -> dict[str, AbstractRubbingJoint]:
    """Joints that touch all the time: those of the tree, then those that close loops."""
    joints = {
        branch.name: link.joint
        for branch, link in zip(system.topology.branches, system.links, strict=True)
    }
    joints |= dict(zip(system.topology.closing, system.closing, strict=True))
    return {
        name: joint for name, joint in joints.items() if isinstance(joint, AbstractRubbingJoint)
    }


def wearing_in(mechanism: Mechanism) -> dict[str, Any]:
    """What has surfaces that wear: joints that may open, those that touch all the time, and plays
    of couplings, by name."""
    connections = mechanism.connections
    result: dict[str, Any] = {n: connections[n].joint for n in mechanism.topology.clearances}
    result |= rubbing_in(connections)
    result |= {n: part.play for n, part in mechanism.couplings.items() if part.gives and part.play}
    return {name: part for name, part in result.items() if part.maps()}


def flanks_that_wear(system: System) -> dict[str, Any]:
    """Plays whose flanks wear, by coupling."""
    part = system.transmissions.items()
    return {n: x.coupling.play for n, x in part if x.coupling.play and x.coupling.play.wear}


def with_worn_flanks(system: System, worn: dict) -> System:
    """The system with plays grown as their flanks are worn [m], by coupling and flank."""
    plays = {n: play for n, play in flanks_that_wear(system).items() if n in worn}
    if not plays:
        return system
    grown = dict(system.transmissions)
    for name, play in plays.items():
        depths = {flank: depth[0, 0] for flank, depth in worn[name].items()}
        coupling = dataclasses.replace(grown[name].coupling, play=play.grown(depths))
        grown[name] = dataclasses.replace(grown[name], coupling=coupling)
    return dataclasses.replace(system, transmissions=grown)


def wear_maps(system: System) -> dict[str, dict]:
    """Wear map and law of each surface that wears, by joint and surface: of joints that may open,
    then of those that touch all the time, then of flanks of play, by coupling."""
    joints: dict[str, Any] = {name: bearing.joint for name, bearing in system.bearings.items()}
    joints |= rubbing_joints(system)
    joints |= flanks_that_wear(system)
    return {name: joint.maps() for name, joint in joints.items() if joint.maps()}


def readings(system: System, worn: dict) -> dict:
    """Worn surfaces in the form in which the gaps read them."""
    maps = wear_maps(system)
    return {
        name: {s: maps[name][s][0].reading(depth) for s, depth in surfaces.items()}
        for name, surfaces in worn.items()
    }


def longest_arm(system: System) -> Any:
    """Length [m] beside which drift of the loops is measured: the longest distance within a body
    from its inboard joint to another joint, or its radius of gyration about that joint, if that is
    longer."""
    squares = [
        sp.total(link.inertia[i][i] for i in range(3)) / (2.0 * link.mass)
        for link in system.links
        if not sp.is_zero(link.mass)
    ]
    squares += [sp.dot(x, x) for x in (link.base.translation for link in system.links)]
    closures = [*system.closures, *(bearing.closure for bearing in system.bearings.values())]
    for closure in closures:
        squares += [sp.dot(x.translation, x.translation) for x in (closure.parent, closure.child)]
    # By pairs: the derivative of `jnp.max` may be 0 / 0, as `start_equations` says of its own.
    return jnp.sqrt(functools.reduce(jnp.maximum, squares))
