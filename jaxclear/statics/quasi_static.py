r"""A mechanism at rest at a position of its drives: where its loops close, how its reactions hold
the loads, and on which side of its bearing each journal lies.

Every joint is the ideal one whose coordinates the joint tells, between a journal and a bearing's
marker that is moved to where the journal lies. The journal lies where its reaction presses it,
which is what contact and its force complement each other to: $c - |e| \ge 0$, $\lambda \ge 0$,
$\lambda (c - |e|) = 0$ without friction; a load that does not pull leaves it in the middle. So the
unknowns are the free coordinates and the seats of the journals, and the equations that loops close
and that every seat is the one of its own reaction: as many of the ones as of the others.

Newton's method on the loops, the seats following their reactions, from where the neighbour stood:
one kernel of machine code for all positions of all samples (`native`). An error of a seat shrinks
by the clearance's share of the links with every turn, so two to four turns reach rounding.
Derivatives are those of the solved equations (implicit function theorem), whatever turns were
taken.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from jaxclear.components.body import Connection
from jaxclear.components.clearance import AbstractClearance, AbstractPermanentJoint
from jaxclear.components.coupling import Latch, Motor
from jaxclear.components.drive import ConstantPosition
from jaxclear.components.joint.base import AbstractDrivenJoint, drive_of
from jaxclear.components.load_base import AbstractStateLoad
from jaxclear.formulations.permanent_reactions import Reaction, reaction_through
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Pose, frame_with_axis
from jaxclear.ground.wording import listed, unknown
from jaxclear.multibody import constraints, dynamics, kinematics, tree
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces, applied_forces
from jaxclear.multibody.joint_replacement import at_rest_under
from jaxclear.multibody.mechanism import Mechanism, rebuilt
from jaxclear.multibody.newton import shorten_step
from jaxclear.multibody.rows import wrench_in_joint
from jaxclear.multibody.start_constraints import speed_scales
from jaxclear.multibody.start_equations import retract
from jaxclear.multibody.state import Followed, unpack_motion
from jaxclear.multibody.system import System, acting_in, longest_arm, motor_ends, prepare
from jaxclear.multibody.topology import motor_name
from jaxclear.multibody.tree import Motion
from jaxclear.native import while_loop

# Numbers of a seat: offset (x, y, z) [m] and slope (dx/dz, dy/dz) of the axis [1].
SEAT = 5


class HeldMotor(eqx.Module):
    """A motor that is held: its `coupling` then holds the joint behind it at `rest` and the
    `factor` times the motor's angle."""

    coupling: str = eqx.field(static=True)
    factor: Any
    rest: Any


class Posed(eqx.Module):
    """A mechanism whose drives hold their joints and whose joints are ideal, with the clearance
    joints that these stand for (`gaps`, by connection); or, `loose`, one that has its clearance
    joints itself. `rows`: those rows of all loops that determine it, where the others follow from
    them; None for all. `motors`: those that are held, by name."""

    mechanism: Mechanism
    gaps: dict[str, AbstractClearance]
    drives: tuple[str, ...] = eqx.field(static=True)
    rows: tuple[int, ...] | None = eqx.field(static=True, default=None)
    loose: bool = eqx.field(static=True, default=False)
    motors: dict[str, HeldMotor] = eqx.field(default_factory=dict)

    def of(self, mechanism: Mechanism) -> "Posed":
        """The same of a mechanism with other numbers."""
        return posed(mechanism, self.drives, loose=self.loose, rows=self.rows)

    def at(self, position: Any) -> "Posed":
        """The same at other positions of the drives, in the order of `drives` [rad, m]."""
        if not self.drives:
            return self

        def places(posed):
            scene = posed.mechanism
            return [
                scene.couplings[self.motors[n].coupling].place
                if n in self.motors
                else scene.connections[n].joint.drive.position
                for n in self.drives
            ]

        values = [position[i] for i in range(len(self.drives))]
        for i, name in enumerate(self.drives):
            if name in self.motors:
                values[i] = self.motors[name].rest + self.motors[name].factor * values[i]
        return eqx.tree_at(places, self, values)

    def determining(self, values: list) -> list:
        """Of values of all rows of loops those of the rows that determine the mechanism."""
        return values if self.rows is None else [values[i] for i in self.rows]

    def among(self, count: int, values: list) -> tuple:
        """Values of these rows among those of all, 0 elsewhere."""
        if self.rows is None:
            return tuple(values)
        return tuple(values[self.rows.index(i)] if i in self.rows else 0 for i in range(count))


class Undetermined(ValueError):
    """Loops have fewer or more rows than there are free coordinates: they do not determine where a
    mechanism stands, or not what each journal carries."""


class Standing(NamedTuple):
    """A mechanism at coordinates and seats: `residual` of the loops' closure [m, 1] with its
    `jacobian` (by free speed), of the rows that determine it, and the `seats` in which the
    reactions there would press the journals."""

    system: System
    motions: tuple[Motion, ...]
    residual: list
    jacobian: list
    reactions: dict[str, Reaction]
    seats: dict[str, tuple]


def posed(
    mechanism: Mechanism,
    drives: tuple[str, ...],
    *,
    loose: bool = False,
    rows: tuple[int, ...] | None = None,
) -> Posed:
    """The mechanism with joints and motors held, ready for positions.

    Args:
        mechanism: under its loads.
        drives: joints and motors that are held.
        loose: whether clearance joints stay; otherwise ideal ones take their place.
        rows: which rows of the loops determine the position; None: all.

    Raises:
        ValueError: a coupling or load has no equilibrium, or a joint cannot be held.
    """
    for name, coupling in mechanism.couplings.items():
        if coupling.gives and coupling.stiffness is None:
            raise ValueError(
                f'coupling "{name}" has play and no stiffness, by which its flanks would press '
                "where the mechanism rests; give that of its shaft or teeth."
            )
    ends: dict[Any, Any] = motor_ends(mechanism)
    acting = acting_in(mechanism)
    for name, load in mechanism.loads.items():
        steered = load.motor_of() if isinstance(load, AbstractStateLoad) and load.states() else None
        place = ends[steered].coordinate if steered in ends else steered
        # An encoder at the motor does not see where the joint is.
        sees_motor = steered in ends and steered not in acting[name].coordinates()
        if steered is not None and not {place, *([] if sees_motor else [steered])} & {*drives}:
            angles = f' (angles of the motor: its ratio times those of "{steered}")'
            raise ValueError(
                f'load "{name}" is a controller whose states decide where "{place}" rests; hold '
                f'that: positions={{"{place}": [...]}}{angles if steered in ends else ""}.'
            )
    mechanism, motors = _constrain_motors(mechanism, drives)
    for name in drives:
        if name not in mechanism.connections and name not in motors:
            raise ValueError(unknown("joint", name, mechanism.connections, " to be held"))
    others = [name for name in mechanism.driven if name not in drives]
    if others:
        raise ValueError(
            f"joint {listed(others)} is driven and its positions are not told; give positions of "
            "every drive."
        )
    connections, gaps = {}, {}
    for name, connection in mechanism.connections.items():
        joint = connection.joint
        if name in mechanism.topology.clearances and not loose:
            gaps[name] = joint
            try:
                joint = joint.coordinate_form()
                gaps[name].seat((1.0, 1.0, 0), sp.ZERO)
            except ValueError as error:
                raise ValueError(f'joint "{name}" {error}') from None
        if isinstance(joint, AbstractPermanentJoint):
            joint = joint.ideal
        if name in drives:
            joint = _driven_joint(name, joint)
        connections[name] = Connection(joint, connection.parent, connection.child)
    start, guess = (_free(mechanism.start_arguments[what], drives) for what in ("start", "guess"))
    loads = at_rest_under(mechanism.loads, drives)
    # What a run begins with says where the mechanism stands at one position only.
    bare = Mechanism(
        mechanism.bodies, connections, loads, couplings=mechanism.couplings, guess=start | guess
    )
    return Posed(bare, gaps, drives, rows, loose, motors)


def _constrain_motors(
    mechanism: Mechanism, drives: tuple[str, ...]
) -> tuple[Mechanism, dict[str, HeldMotor]]:
    """The mechanism whose couplings of motors that are held hold the joints behind these, and no
    load acts on the motors; raises `ValueError` for one that cannot."""
    named = {motor_name(name): name for name in mechanism.couplings}
    motors, couplings = {}, dict(mechanism.couplings)
    for motor in drives:
        coupling: Any = couplings.get(named.get(motor, ""))
        if coupling is None or coupling.motor is None or motor in mechanism.connections:
            continue
        first, *others = coupling.terms()
        if not coupling.gives or isinstance(first.joint, Motor) or len(others) != 1:
            raise ValueError(
                f'motor "{motor}" cannot be held apart from what it turns: coupling '
                f'"{named[motor]}" has neither play nor stiffness along the joint behind it. Hold '
                "joints instead."
            )
        total = coupling.total()
        motors[motor] = HeldMotor(named[motor], -others[0].factor, 0.0 if total is None else total)
        args = {"play": coupling.play, "stiffness": coupling.stiffness, "damping": coupling.damping}
        couplings[named[motor]] = Latch(str(first.joint), 0.0, **args)
    if not motors:
        return mechanism, {}
    acting = acting_in(mechanism)
    loads = {
        name: load
        for name, load in mechanism.loads.items()
        if not isinstance(load, AbstractStateLoad) or not {*acting[name].coordinates()} & {*motors}
    }
    kinds = ("start", "guess", "speeds")
    starts = {what: _free(mechanism.start_arguments[what], tuple(motors)) for what in kinds}
    bare = rebuilt(mechanism, couplings=couplings, loads=loads, **starts)
    return bare, motors


def _free(values_of: dict[str, tuple], drives: tuple[str, ...]) -> dict[str, tuple]:
    return {name: values for name, values in values_of.items() if name not in drives}


def _driven_joint(name: str, joint: Any) -> Any:
    """The joint with its coordinate held."""
    if isinstance(joint, AbstractClearance):
        raise ValueError(
            f'joint "{name}" has clearance, and this mechanism rests where its potential energy is '
            "least (springs, or freedoms that its loops leave); hold an ideal joint."
        )
    if not isinstance(joint, AbstractDrivenJoint):
        raise ValueError(
            f'joint "{name}" is a {type(joint).__name__}, whose position cannot be held by one '
            "number; hold a revolute or a prismatic joint, or a journal or a slider."
        )
    return eqx.tree_at(lambda j: j.drive, joint, ConstantPosition(0.0), is_leaf=lambda x: x is None)


def shift(seat: tuple) -> Pose:
    """Where the bearing's marker is taken to be for a journal in this seat: at the journal's
    centre, its z axis along the journal's."""
    x, y = seat[3:]
    if sp.is_zero(x) and sp.is_zero(y):
        return Pose(sp.IDENTITY, seat[:3])
    if not sp.is_zero(x) and not sp.is_zero(y):
        return Pose(frame_with_axis((x, y, jnp.ones(()))), seat[:3])
    # About one axis only, so that a plane stays one.
    size = 1 / jnp.sqrt(1 + (x * x if sp.is_zero(y) else y * y))
    if sp.is_zero(y):
        sine = size * x
        return Pose(((size, 0, sine), (0, 1, 0), (-sine, 0, size)), seat[:3])
    sine = size * y
    return Pose(((1, 0, 0), (0, size, sine), (0, -sine, size)), seat[:3])


def stand_at(scene: Posed, q: Any, seats: dict[str, tuple], side: float = 1.0) -> Standing:
    """Reactions of a mechanism at rest and the seats to which they press the journals.

    Args:
        scene: mechanism at one position of its drives.
        q: coordinates of the tree, scalars.
        seats: offset and tilt of each journal in its bearing.
        side: 1, or -1 for reversed loads (not springs).

    Raises:
        Undetermined: the loops do not determine the position.
    """
    system = prepare(scene.mechanism, {name: shift(seat) for name, seat in seats.items()})
    count = system.topology.speed_count
    places, rates = unpack_motion(system, [*q, *(0,) * count])
    motions = kinematics.link_motions(system, places, rates, 0.0)
    rows = loop_rows(system, motions)
    every = [row for row_set in rows for row in row_set.jacobian]
    if len(every) < count or (scene.rows is None and len(every) > count):
        raise Undetermined(f"the loops have {len(every)} rows for {count} free coordinates.")
    residual, jacobian = scene.determining(_list_residuals(rows)), scene.determining(every)
    loaded, forces = acting(system, motions, side)
    transposed = [[row.get(j, 0) for row in jacobian] for j in range(count)]
    multipliers = scene.among(len(every), solved(transposed, unheld(loaded, forces)))
    reactions = reactions_of(loaded, forces, multipliers, places)
    pressed = {}
    for name, gap in scene.gaps.items():
        offset, slope = gap.seat(*reactions[name])
        pressed[name] = (*offset, *slope)
    return Standing(system, motions, residual, jacobian, reactions, pressed)


def standing_motion(
    scene: Posed, q: Any, seats: dict[str, tuple]
) -> tuple[System, tuple[Motion, ...]]:
    """The prepared mechanism with its journals in their seats, and the poses of its links.

    Args:
        scene: mechanism at one position of its drives.
        q: coordinates of the tree, scalars.
        seats: offset and tilt of each journal in its bearing.
    """
    system = prepare(scene.mechanism, {name: shift(seat) for name, seat in seats.items()})
    places = unpack_motion(system, [*q, *(0,) * system.topology.speed_count])
    return system, kinematics.link_motions(system, *places, 0.0)


def residuals_of(scene: Posed, q: Any, seats: dict[str, tuple]) -> list:
    """Residuals of all loops [m, 1].

    Args:
        scene: mechanism at one position of its drives.
        q: coordinates of the tree, scalars.
        seats: offset and tilt of each journal in its bearing.
    """
    return _list_residuals(loop_rows(*standing_motion(scene, q, seats)))


def loop_rows(system: System, motions: tuple[Motion, ...]) -> list[constraints.ConstraintRows]:
    """The rows of each loop."""
    return [constraints.constraint_rows(system, motions, closure) for closure in system.closures]


def open_loops(system: System, motions: tuple[Motion, ...]) -> dict[str, Any]:
    """By how much each joint that closes a loop is open [m, 1]."""
    pairs = zip(system.topology.loops, loop_rows(system, motions), strict=True)
    residuals = {name: [*rows.residuals, *rows.fixed.values()] for name, rows in pairs}
    return {n: jnp.max(jnp.abs(sp.stack(rows)), initial=0.0) for n, rows in residuals.items()}


def _list_residuals(rows: list[constraints.ConstraintRows]) -> list:
    return [value for rows_of in rows for value in rows_of.residuals]


def acting(
    system: System,
    motions: tuple[Motion, ...],
    side: Any,
    angles: dict[str, Any] | None = None,
) -> tuple[System, Forces]:
    """The forces on a mechanism at rest, and the mechanism with gravity as it acts.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: of all links, at rest.
        side: 1, or -1 to reverse loads; springs, stops and flexible couplings stay.
        angles: [rad] near which coordinates outside the tree are read, by joint.
    """
    ask = lambda part: applied_forces(part, motions, {}, 0.0, Followed(angles or {}))
    if isinstance(side, float) and side == 1.0:
        return system, ask(system)
    springs = {name: load for name, load in system.loads.items() if load.springs_back()}
    loads = {name: load for name, load in system.loads.items() if name not in springs}
    # Couplings that give are springs.
    direct = ask(dataclasses.replace(system, loads=springs))
    reversible = ask(dataclasses.replace(system, loads=loads, transmissions={}))
    add = lambda a, b: sp.add(a, sp.mul(side, b))
    wrenches = jax.tree.map(add, direct.wrenches, reversible.wrenches)
    forces = jax.tree.map(add, direct.coordinate_forces, reversible.coordinate_forces)
    rows = *direct.rows, *(row._replace(force=sp.mul(side, row.force)) for row in reversible.rows)
    gravity = dataclasses.replace(system, gravity=sp.scale(side, system.gravity))
    total = direct._replace(wrenches=wrenches, coordinate_forces=forces, rows=rows)
    return gravity, total


def solved(matrix: list[list], right: list) -> list:
    """x of matrix x = right, rows of sparse scalars; nan where the matrix is singular."""
    if not right:
        return []
    if len(right) == 1:
        return [right[0] / matrix[0][0]]
    return factorisation.eliminate(matrix, right)


def unheld(system: System, forces: Forces) -> list:
    """What the multipliers must give each free coordinate for the mechanism to rest."""
    ground, missing = kinematics.upward(system), []
    for subtree in system.topology.subtrees:
        parts = (system.links, forces.motions, forces.wrenches)
        links, motions, wrenches = kinematics.by_subtree(subtree, *parts)
        bias = tree.bias_forces(links, motions, ground, wrenches)
        applied = [force for i in subtree for force in forces.coordinate_forces[i]]
        missing += [sp.sub(b, f) for f, b in zip(applied, bias, strict=True)]
    return missing


def reactions_of(
    system: System, forces: Forces, multipliers: tuple, places: tuple
) -> dict[str, Reaction]:
    """Reaction of every connection at rest, by name.

    Args:
        system: with gravity as it acts (`acting`).
        forces: on the mechanism at rest.
        multipliers: of the moving rows of all closures.
        places: coordinates, a tuple for each link.
    """
    still = Solution(tuple((0,) * len(motion.columns) for motion in forces.motions), multipliers)
    forces = dynamics.with_closures(system, forces, still)
    reactions = {
        name: Reaction(*wrench_in_joint(forces.rows, name))
        for name in (*system.topology.loops, *system.bearings)
    }
    through = dynamics.joint_wrenches(system, forces, still)
    for index, branch in enumerate(system.topology.branches):
        drive = drive_of(system.links[index].joint)
        place = places[index] if drive is None else (drive.motion(0.0)[0],)
        if branch.connection is not None:
            pose = system.links[index].joint.motion(place)
            motion = reaction_through(pose, branch.reversed, through[index])
            reactions[branch.connection] = motion
    return reactions


# Turns after which a position that has not settled counts as not found.
MOST_TURNS = 25
# A turn that changes coordinates [rad, shares of the longest arm] and seats by less than this is
# the last: what is left is its square, or its share by the clearances.
SETTLED = 1e-9
# By how much rows of loops that follow from the others may be open [m, 1]: what closes a loop as it
# was drawn counts as closed (`start_check.HELD`).
FOLLOWS = 1e-6
# Of a Newton step, in radians or shares of the longest arm.
LONGEST = 0.5


class Spot(eqx.Module):
    """Where the mechanism stands at one position: entries of the tree's coordinates, numbers of the
    seats that are not zero by construction, by how much the last turn moved them [1], and on which
    of its ways the mechanism is assembled: the sign of the loops' determinant, which changes where
    two of them meet and nowhere else (0 where there is no loop)."""

    q: Array
    seats: dict[str, Array]
    change: Array
    branch: Array


class Read(NamedTuple):
    """What is read of a mechanism at positions, in the order of `Positions`."""

    coordinates: Array
    seats: dict[str, Array]
    is_solved: Array
    side: float
    moving: dict[str, tuple[int, ...]]
    other: Any = None
    carried: Any = None


class ByLoops(eqx.Module):
    """How positions are sought: which numbers of each seat move, and whether the loads pull (1) or
    push (-1)."""

    moving: dict[str, tuple[int, ...]] = eqx.field(static=True)
    side: float = eqx.field(static=True, default=1.0)

    @property
    def reversed(self) -> "ByLoops":
        """The same under reversed loads."""
        return ByLoops(self.moving, -self.side)

    def alone(self, scene: Posed, start: Spot) -> Spot:
        """Where the mechanism stands at one position, sought from a start."""
        return _settled(scene, start, self)

    def each(self, scene: Posed, position: Array, starts: Spot) -> Spot:
        """Solutions at several positions, each from its own start; pure.

        Args:
            scene: the mechanism.
            position: of the drives, shape (positions, drives).
            starts: with a first axis of positions.
        """
        one = lambda place, start: find_spot(scene.at(place), start, self)
        return jax.vmap(one)(position, starts)

    def read(self, scene: Posed, position: Array, spots: Spot) -> Read:
        """Coordinates, seats and soundness of solutions at several positions.

        Args:
            scene: the mechanism.
            position: of the drives, shape (positions, drives).
            spots: solutions (`each`).
        """
        seats = {
            name: jnp.zeros((len(position), SEAT)).at[:, list(numbers)].set(spots.seats[name])
            for name, numbers in self.moving.items()
        }
        closed = jnp.ones(len(position), bool)
        if scene.rows is not None:
            opened = jax.vmap(lambda numbers, s: self._open(scene.at(numbers), s))(position, spots)
            closed = opened <= FOLLOWS
        return Read(spots.q, seats, closed & (spots.change <= SETTLED), self.side, self.moving)

    def _open(self, scene: Posed, spot: Spot) -> Array:
        """By how much a row of the loops is open at the most [m, 1]."""
        residual = residuals_of(scene, spot.q, self.opened(spot.seats))
        return jnp.max(jnp.abs(sp.stack(residual)), initial=0.0)

    def amiss(self, scene: Posed, spot: Spot) -> tuple[dict[str, Any], dict[str, Any]]:
        """By how much loops are open [m, 1], by the joint that closes them, and how deep journals
        lie in their bearings: not at all."""
        return open_loops(*standing_motion(scene, spot.q, self.opened(spot.seats))), {}

    def opened(self, seats: dict[str, Array]) -> dict[str, tuple]:
        """The five numbers of each seat, those that are zero by construction as such."""
        return {
            name: tuple(seats[name][numbers.index(k)] if k in numbers else 0 for k in range(SEAT))
            for name, numbers in self.moving.items()
        }

    def middle(self) -> dict[str, Array]:
        """The numbers of each seat that move, of journals in the middle."""
        return {name: jnp.zeros(len(numbers)) for name, numbers in self.moving.items()}

    def closed(self, seats: dict[str, tuple]) -> dict[str, Array]:
        """The numbers of each seat that move."""
        return {name: sp.stack([seats[name][k] for k in k]) for name, k in self.moving.items()}


def loop_method(scene: Posed) -> ByLoops:
    """Which numbers of the seats move."""
    method = ByLoops(dict.fromkeys(scene.gaps, ()))
    while True:
        moves = moved_by(scene, method)
        if moves == method:
            return method
        method = moves


def moved_by(scene: Posed, method: ByLoops) -> ByLoops:
    """Which numbers of the seats the reactions move where those of a way may."""
    moves: dict[str, tuple[int, ...]] = {}

    def seats_at(q, seats):
        now = stand_at(scene, q, method.opened(seats)).seats
        moves.update({n: tuple(k for k in range(SEAT) if not sp.is_zero(now[n][k])) for n in now})
        return q

    count = prepare(scene.mechanism).topology.coordinate_count
    jax.eval_shape(seats_at, jnp.zeros(count), method.middle())
    return ByLoops(moves)


def next_spot(scene: Posed, spot: Spot, method: ByLoops) -> Spot:
    """The next iterate: seats from the reactions, coordinates by a Newton step on the loops.

    Args:
        scene: mechanism at one position of its drives.
        spot: the iterate before.
        method: which seats move, and the side of the loads.
    """
    now = stand_at(scene, spot.q, method.opened(spot.seats), method.side)
    seats, system = method.closed(now.seats), now.system
    count, arm = system.topology.speed_count, longest_arm(system)
    changes = [jnp.max(jnp.abs(seats[n] - spot.seats[n]), initial=0.0) / arm for n in seats]
    q = spot.q
    if count:
        residual = scene.determining(residuals_of(scene, q, method.opened(seats)))
        rows = [[row.get(j, 0) for j in range(count)] for row in now.jacobian]
        step = sp.stack(solved(rows, [sp.neg(x) for x in residual]))
        scales = speed_scales(system, arm)
        q = retract(system, q, shorten_step(step, scales, LONGEST))
        changes.append(jnp.max(jnp.abs(step / scales)))
    branch = factorisation.orientation(rows) if count else jnp.zeros(())
    return Spot(q, seats, jnp.max(jnp.stack([*changes, jnp.zeros(())])), branch)


def find_spot(scene: Posed, start: Spot, method: ByLoops) -> Spot:
    """The fixed point of `next_spot`; pure, with implicit derivatives by the scene's numbers.

    Args:
        scene: mechanism at one position of its drives.
        start: first iterate.
        method: which seats move, and the side of the loads.
    """
    arrays, rest = eqx.partition(scene, eqx.is_inexact_array)

    @jax.custom_jvp
    def solution(arrays, start):
        scene_ = eqx.combine(arrays, rest)
        more = lambda s: ~(s[0].change <= SETTLED) & (s[1] < MOST_TURNS)
        turn = lambda s: (next_spot(scene_, s[0], method), s[1] + 1)
        first = eqx.tree_at(lambda s: s.change, start, jnp.full((), jnp.inf))
        return while_loop(more, turn, (first, jnp.zeros((), int)))[0]

    @solution.defjvp
    def tangents(primals, moved):
        spot = solution(*primals)
        return spot, _implicit_tangent(primals[0], moved[0], rest, spot, method)

    return solution(arrays, start)


_settled = eqx.filter_jit(find_spot)


def _implicit_tangent(arrays: Any, moved: Any, rest: Any, spot: Spot, method: ByLoops) -> Spot:
    """How the spot moves with the numbers of the scene: implicit function theorem."""
    system = prepare(eqx.combine(arrays, rest).mechanism)
    count = system.topology.speed_count
    flat, unflatten = ravel_pytree(spot.seats)
    place = lambda step: retract(system, spot.q, step)

    def equations(arrays, unknowns):
        scene, seats = eqx.combine(arrays, rest), unflatten(unknowns[count:])
        now = stand_at(scene, place(unknowns[:count]), method.opened(seats), method.side)
        misses = unknowns[count:] - ravel_pytree(method.closed(now.seats))[0]
        return jnp.concatenate([sp.stack(now.residual), misses])

    here = jnp.concatenate([jnp.zeros(count), flat])
    rows = jax.jacfwd(equations, argnums=1)(arrays, here)
    right = jax.jvp(lambda scene_: equations(scene_, here), (arrays,), (moved,))[1]
    # The inverse first, so that what is solved for stays linear and can be transposed.
    solve = lambda unit: jnp.stack(factorisation.eliminate(list(rows), unit))
    inverse = jax.vmap(solve)(jnp.eye(len(here)))
    change = -jnp.sum(inverse * right[:, None], axis=0)
    q = jax.jvp(place, (here[:count],), (change[:count],))[1]
    return Spot(q, unflatten(change[count:]), jnp.zeros(()), jnp.zeros(()))
