"""The spanning tree: which joints carry coordinates, which close loops, and where every number sits
in the state.

The tree grows from the ground over the ideal joints, driven ones first, then those with the fewest
freedoms, then the shortest way: what is left to close loops has the most freedoms, hence the fewest
constraint rows. Clearance joints are contacts and never belong to the tree; a body that only they
hold floats free. All of it is static: names and counts, no numbers.

Every number of a mechanism, in the unit of the joint it is of: a coordinate is in rad or m as
its joint turns or slides.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from jaxclear.components.body import GROUND, Body, Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.coupling import (
    AbstractCoordinateCoupling,
    AbstractCoupling,
    AbstractForceCoupling,
)
from jaxclear.components.joint import AbstractJoint, AbstractRubbingJoint, Free, Planar, Revolute
from jaxclear.components.joint.base import drive_of
from jaxclear.components.load_base import acts_on_coordinates
from jaxclear.ground.quantity import numbers
from jaxclear.ground.wording import listed


@dataclass(frozen=True)
class Branch:
    """One body of the tree: held by `connection` (None: floating), turned round if the connection
    starts at this body; or a `motor`, which has no body: both names are then its own.
    """

    body: str
    connection: str | None
    parent: str
    reversed: bool
    coordinates: slice
    speeds: slice
    motor: bool = False

    @property
    def name(self) -> str:
        """What its coordinates go by: the connection's name, or that of the floating body."""
        return self.connection or self.body

    @property
    def coordinate_count(self) -> int:
        return self.coordinates.stop - self.coordinates.start

    @property
    def speed_count(self) -> int:
        return self.speeds.stop - self.speeds.start


@dataclass(frozen=True)
class Redundancy:
    """What is too much in the loops of a mechanism that moves all the same: of the rows that motion
    changes only `rank` are independent, all or, where they `depend` on each other, fewer; `rows`
    (joint, row) follow from the others or are never changed, and the reactions of `joints` (and
    couplings) are not unique. `far`: whether the loops are closed from the guess by a damped search
    only.

    States saved before 0.26 do not say whether rows depend: then it is taken so.
    """

    rank: int
    depend: bool = True
    rows: tuple[tuple[str, str], ...] = ()
    joints: tuple[str, ...] = ()
    far: bool = False

    def __str__(self) -> str:
        """The same as a sentence."""
        rows, verb = listed_rows(self.rows), "follow" if len(self.rows) > 1 else "follows"
        least = (
            f"of the reactions in {listed(self.joints)} the least are taken that close the loops."
        )
        return (
            f"overconstrained: of the rows that close loops {rows} {verb} from the others. The "
            f"motion is unique; {least}"
        )


def listed_rows(rows: tuple[tuple[str, str], ...]) -> str:
    """Rows by joint, in words; a coupling is one row, without a name of its own."""
    report = {joint: [part for name, part in rows if name == joint] for joint, _ in rows}
    return "; ".join(
        f'{", ".join(part)} of joint "{name}"' if any(part) else f'coupling "{name}"'
        for name, part in report.items()
    )


@dataclass(frozen=True)
class Topology:
    """Static structure of a mechanism. `subtrees`: what hangs together without the ground, as
    tuples of indices of branches; `loops`: what closes loops, joints and then `couplings`, those
    that are rows. `geared`: motors that turn with a joint (name, joint), and have no coordinate.
    `redundancy` is known once the mechanism has been assembled
    (`redundancy.py`); None where no row is redundant.
    """

    branches: tuple[Branch, ...]
    subtrees: tuple[tuple[int, ...], ...]
    loops: tuple[str, ...]
    clearances: tuple[str, ...]
    coordinate_count: int
    speed_count: int
    redundancy: Redundancy | None = None
    couplings: tuple[str, ...] = ()
    geared: tuple[tuple[str, str], ...] = ()

    @property
    def closing(self) -> tuple[str, ...]:
        """Joints that close loops."""
        return self.loops[: len(self.loops) - len(self.couplings)]

    @property
    def motors(self) -> tuple[str, ...]:
        """Coordinates of motors, their own and those that turn with a joint."""
        part = (branch.name for branch in self.branches if branch.motor)
        return (*part, *dict(self.geared))

    @property
    def depend(self) -> bool:
        """Whether rows of loops that motion changes are known to depend on each other."""
        return self.redundancy is not None and self.redundancy.depend

    @property
    def searched(self) -> bool:
        """Whether loops are closed by a damped search first."""
        return self.redundancy is not None and (self.redundancy.depend or self.redundancy.far)

    @property
    def overconstrained(self) -> bool:
        """Whether rows of loops are known to be too many."""
        return self.redundancy is not None and bool(self.redundancy.rows)

    def branch_of(self, connection: str) -> Branch | None:
        """The branch held by a connection, or None where it closes a loop or has clearance."""
        return next((branch for branch in self.branches if branch.connection == connection), None)

    def index(self, body: str) -> int | None:
        """Index of a body's branch; None for the ground."""
        return (
            None
            if body == GROUND
            else next(i for i, branch in enumerate(self.branches) if branch.body == body)
        )


MOTOR = ".motor"


def motor_name(coupling: str) -> str:
    """What the coordinate of a coupling's motor goes by."""
    return f"{coupling}{MOTOR}"


def motors(couplings: Mapping[str, AbstractCoupling]) -> dict[str, str]:
    """The couplings that have a motor, by the motor's name."""
    return {motor_name(name): name for name, part in couplings.items() if part.motor is not None}


def all_planar(bodies: Mapping[str, Body]) -> bool:
    """Whether all bodies have an inertia about z alone, as those of a planar mechanism."""
    return all(len(body.inertia) == 1 for body in bodies.values())


def free_joint(body: Body) -> AbstractJoint:
    """The joint of a body that only contacts hold: in the plane if its inertia is planar, in space
    otherwise.
    """
    return Planar() if len(body.inertia) == 1 else Free()


def joint_of(
    branch: Branch, bodies: dict[str, Body], connections: dict[str, Connection]
) -> AbstractJoint:
    """The joint of a branch: of its connection, of a floating body, or of a motor.

    Args:
        branch: of the tree.
        bodies: by name; a floating body's inertia decides between planar and spatial.
        connections: by name.
    """
    if branch.motor:
        return Revolute()
    return (
        free_joint(bodies[branch.body])
        if branch.connection is None
        else connections[branch.connection].joint
    )


def coordinate_joint(
    name: str, bodies: dict[str, Body], connections: dict[str, Connection]
) -> AbstractJoint:
    """The joint in whose coordinates a name is given and read.

    It is the connection's, also where that closes a loop or has clearance; for a body the joint
    that places it in the ground.

    Args:
        name: connection, body, or motor.
        bodies: by name.
        connections: by name.

    Raises:
        ValueError: with a clause to be put behind the name, where there is no such joint.
    """
    if name not in connections:
        is_motor = name.endswith(MOTOR) and name not in bodies
        return Revolute() if is_motor else free_joint(bodies[name])
    joint = connections[name].joint
    return joint.coordinate_form() if isinstance(joint, AbstractClearance) else joint


def rubbing_in(connections: dict[str, Connection]) -> dict[str, AbstractRubbingJoint]:
    """Ideal joints whose parts touch all the time and rub, by name."""
    joints = {name: connection.joint for name, connection in connections.items()}
    return {n: joint for n, joint in joints.items() if isinstance(joint, AbstractRubbingJoint)}


def grow_tree(
    bodies: dict[str, Body],
    connections: dict[str, Connection],
    couplings: Mapping[str, AbstractCoupling] | None = None,
    first: tuple[str, ...] = (),
) -> Topology:
    """The spanning tree of a mechanism whose names have been checked.

    Args:
        bodies: by name.
        connections: by name; clearance joints are never in the tree.
        couplings: by name; rigid ones close loops, motors become branches. None: none.
        first: joints that are put in the tree wherever possible.
    """
    ideal = {name: c for name, c in connections.items() if isinstance(c.joint, AbstractJoint)}
    depth = {GROUND: 0}
    order: list[tuple[str, str | None, str, bool]] = []
    unused = list(ideal)

    def rank(name):
        joint = ideal[name].joint
        ends = (ideal[name].parent.body, ideal[name].child.body)
        reached = [end for end in ends if end in depth]
        free = len(joint.home) if drive_of(joint) is None else -1
        # Friction costs least in the tree: joints that may have it go first among equals.
        free -= 0.5 * isinstance(joint, AbstractRubbingJoint) + 10 * (name in first)
        return (free, depth[reached[0]], unused.index(name))

    while len(depth) <= len(bodies):
        open_ends = [
            n for n in unused if (ideal[n].parent.body in depth) != (ideal[n].child.body in depth)
        ]
        if open_ends:
            name = min(open_ends, key=rank)
            parent, child = ideal[name].parent.body, ideal[name].child.body
            rotated = parent not in depth
            inner, outer = (child, parent) if rotated else (parent, child)
            order.append((outer, name, inner, rotated))
            unused.remove(name)
        else:
            outer = next(body for body in bodies if body not in depth)
            order.append((outer, None, GROUND, False))
            inner = GROUND
        depth[outer] = depth[inner] + 1
    return _lay_out(order, unused, bodies, connections, couplings)


def _lay_out(order, closing, bodies, connections, couplings=None):
    couplings = couplings or {}
    children: dict[str, list] = {}
    for entry in order:
        children.setdefault(entry[2], []).append(entry)
    sequence, subtrees = [], []

    def visit(entry, subtree):
        subtree.append(len(sequence))
        sequence.append(entry)
        for child in children.get(entry[0], []):
            visit(child, subtree)

    for root in children.get(GROUND, []):
        subtrees.append([])
        visit(root, subtrees[-1])
    branches, q, v = [], 0, 0
    for body, name, parent, rotated in sequence:
        joint = free_joint(bodies[body]) if name is None else connections[name].joint
        driven = drive_of(joint) is not None
        nq = 0 if driven else len(joint.home)
        nv = 0 if driven else len(joint.columns(joint.home))
        branches.append(Branch(body, name, parent, rotated, slice(q, q + nq), slice(v, v + nv)))
        q, v = q + nq, v + nv
    clearances = tuple(n for n, c in connections.items() if isinstance(c.joint, AbstractClearance))
    free = {branch.name for branch in branches if branch.coordinate_count}
    geared = tuple(_geared(couplings, free))
    for motor in motors(couplings):
        if motor not in dict(geared):
            subtrees.append([len(branches)])
            coupling = slice(q, q + 1), slice(v, v + 1)
            branches.append(Branch(motor, motor, GROUND, False, *coupling, True))
            q, v = q + 1, v + 1
    rotated = {motor_name(name) for name in couplings} & {*dict(geared)}
    rows = [
        name
        for name, coupling in couplings.items()
        if not coupling.gives
        and motor_name(name) not in rotated
        and not isinstance(coupling, AbstractForceCoupling)
    ]
    loops = (*closing, *rows)
    return Topology(
        tuple(branches),
        tuple(map(tuple, subtrees)),
        loops,
        clearances,
        q,
        v,
        couplings=tuple(rows),
        geared=geared,
    )


def _geared(couplings: Mapping[str, AbstractCoupling], free: set[str]) -> Iterator[tuple[str, str]]:
    """(motor, joint) of motors that turn with the coordinate of a joint of the tree that no drive
    prescribes."""
    for motor, name in motors(couplings).items():
        coupling = couplings[name]
        joints = coupling.joints()
        if not coupling.gives and len(joints) == 1 and joints[0] in free:
            yield motor, joints[0]


def numbers_of_parts(mechanism: Any) -> Iterator[tuple[str, Any, Mapping[str, Any], str]]:
    """(name, value, metadata of its field, unit) of every number of a mechanism but those of its
    start, in definition order."""
    for part in ("bodies", "connections", "loads", "couplings"):
        for name, entry in dict.items(getattr(mechanism, part)):
            joint = part == "connections"
            along = is_sliding(mechanism, name) if joint else moves_along(mechanism, entry)
            for path, leaf, metadata in numbers(entry, f'{part}["{name}"]'):
                yield path, leaf, metadata, unit_along(metadata, along)
    for path, leaf, metadata in numbers(mechanism.stabilisation, "stabilisation"):
        yield path, leaf, metadata, unit_along(metadata, False)


def coordinate_units(mechanism: Any, name: str) -> tuple[str, ...]:
    """Units of the coordinates in which a joint or body is spoken of; none where there are none."""
    try:
        return coordinate_joint(name, mechanism.bodies, mechanism.connections).units
    except (KeyError, ValueError):
        return ()


def moves_along(mechanism: Any, part: Any) -> bool:
    """Whether a load, or the play of a coupling, is along a coordinate that slides."""
    if isinstance(part, AbstractForceCoupling):
        place = part.along()
        return place is None or is_sliding(mechanism, place)
    if acts_on_coordinates(part):
        return is_sliding(mechanism, part.coordinates()[0])
    if not isinstance(part, AbstractCoupling):
        return False
    coupling: Any = part
    if isinstance(part, AbstractCoordinateCoupling) or part.motor is not None:
        first = coupling.terms()[0].joint
        return isinstance(first, str) and is_sliding(mechanism, first)
    return bool(coupling.has_linear_play)


def turns(mechanism: Any, coupling: Any) -> bool:
    """Whether what a coupling transmits is a torque: its first coordinate turns."""
    if isinstance(coupling, AbstractForceCoupling):
        return not moves_along(mechanism, coupling)
    bodies = not isinstance(coupling, AbstractCoordinateCoupling) and coupling.motor is None
    if bodies and not coupling.gives:
        return False
    return not moves_along(mechanism, coupling)


def is_sliding(mechanism: Any, name: str) -> bool:
    """Whether a joint has the one coordinate along which it slides."""
    return coordinate_units(mechanism, name) == ("m",)


def unit_along(metadata: Mapping[str, Any], along: bool) -> str:
    """The unit of a number by its field; `along`: whether it is of a coordinate that slides."""
    unit = metadata.get("unit", "1")
    return metadata.get("sliding", unit) if along else unit
