"""A mechanism: bodies, connections and loads by name, checked before anything is traced.

The numbers are leaves of a pytree; names, joint types and what is absent are its structure. Values
that are being traced are not checked: they were when the mechanism was built with numbers.
"""

import dataclasses
from collections.abc import Mapping
from types import UnionType
from typing import Any, get_args

import equinox as eqx
import jax
import numpy as np

from jaxclear.components.body import GROUND, Body, Connection
from jaxclear.components.clearance import (
    AbstractClearance,
    BallSocket,
    JournalBearing,
    PlanarJournalBearing,
    SliderGuide,
)
from jaxclear.components.joint import AbstractJoint, drive_of
from jaxclear.components.load import AbstractBodyLoad, AbstractCoordinateLoad, AbstractLoad, Gravity
from jaxclear.ground.quantity import (
    as_number,
    check_range,
    concrete,
    numbers,
    parameters,
)
from jaxclear.laws.stiffness import fitted
from jaxclear.multibody.loops import Baumgarte, Projection
from jaxclear.multibody.topology import Topology, grow, joint_of

NO_TURN = (1.0, 0.0, 0.0, 0.0)


def _guess(value: Any) -> tuple:
    values = tuple(value) if isinstance(value, (tuple, list)) or np.ndim(value) else (value,)
    return tuple(as_number(x) for x in values)


class Mechanism(eqx.Module):
    """Bodies held together by connections, under loads.

    `start` gives rough joint coordinates by connection (or floating body): 1 number, all the
    joint's coordinates, or for a spherical joint 3 numbers (a rotation vector [rad]); `speeds`
    likewise, in the joint's own speeds. What is not given starts at the joint's home, at rest.
    Raises `ValueError` with a sentence naming what is wrong.
    """

    bodies: dict[str, Body]
    connections: dict[str, Connection]
    loads: dict[str, AbstractLoad]
    start: dict[str, tuple]
    speeds: dict[str, tuple]
    stabilisation: Baumgarte | Projection | None
    topology: Topology = eqx.field(static=True)

    def __init__(
        self,
        bodies: Mapping[str, Body],
        connections: Mapping[str, Connection],
        loads: Mapping[str, AbstractLoad] | None = None,
        *,
        start: Mapping[str, Any] | None = None,
        speeds: Mapping[str, Any] | None = None,
        stabilisation: Baumgarte | Projection | None | str = "default",
    ):
        for what, given in (("bodies", bodies), ("connections", connections)):
            _expect(given, Mapping, what, "a dictionary from names")
        self.bodies, self.connections, self.loads = (
            dict(bodies),
            dict(connections),
            dict(loads or {}),
        )
        self.start = {name: _guess(value) for name, value in (start or {}).items()}
        self.speeds = {name: _guess(value) for name, value in (speeds or {}).items()}
        check_names(self.bodies, self.connections, self.loads)
        check_numbers(self.bodies, self.connections, self.loads)
        _check_finite("the mechanism", {"start": self.start, "speeds": self.speeds})
        self.topology = grow(self.bodies, self.connections)
        self.stabilisation = (
            Baumgarte()
            if isinstance(stabilisation, str) and stabilisation == "default"
            else stabilisation
        )
        kinds = (Baumgarte, Projection, type(None))
        _expect(
            self.stabilisation,
            kinds,
            "stabilisation",
            "a jaxclear.Baumgarte, a jaxclear.Projection, or None for none",
        )
        check_structure(self)

    @property
    def baumgarte(self) -> Baumgarte | None:
        """What pulls drifting loops back within the equations of motion."""
        return self.stabilisation if isinstance(self.stabilisation, Baumgarte) else None

    @property
    def projects(self) -> bool:
        """Whether loops are closed anew after every step."""
        return isinstance(self.stabilisation, Projection) and bool(self.topology.loops)

    def parameters(self) -> Any:
        """All numbers of the mechanism with unit and meaning, as a pandas table."""
        import pandas

        parts = ("bodies", "connections", "loads", "stabilisation")
        return pandas.DataFrame(
            [row for part in parts for row in parameters(getattr(self, part), part)]
        )


def check_names(bodies: dict, connections: dict, loads: dict) -> None:
    """Names must refer to something, types must be what the slot expects, and every body must be
    held.
    """
    if not bodies:
        raise ValueError("a mechanism needs at least one body.")
    if GROUND in bodies:
        raise ValueError(
            f'"{GROUND}" is the fixed frame and cannot be a body; choose another name.'
        )
    for name, body in bodies.items():
        _expect(body, Body, f'body "{name}"', "a jaxclear.Body")
    known = f"the bodies are {', '.join(map(repr, bodies))} and '{GROUND}'"
    for name, connection in connections.items():
        _expect(connection, Connection, f'connection "{name}"', "a jaxclear.Connection")
        _expect(
            connection.joint,
            (AbstractJoint, AbstractClearance),
            f'the joint of connection "{name}"',
            "a joint",
        )
        _check_slots(f'connection "{name}"', connection)
        for marker in (connection.parent, connection.child):
            if marker.body not in bodies and marker.body != GROUND:
                raise ValueError(
                    f'connection "{name}" refers to body "{marker.body}", which does not exist: '
                    f"{known}."
                )
        if connection.parent.body == connection.child.body:
            raise ValueError(
                f'connection "{name}" joins "{connection.parent.body}" to itself; it needs two '
                "bodies."
            )
    for name, load in loads.items():
        _expect(load, AbstractLoad, f'load "{name}"', "a jaxclear.load")
        _check_slots(f'load "{name}"', load)
        if isinstance(load, AbstractBodyLoad):
            for marker in load.markers():
                if marker.body not in bodies and marker.body != GROUND:
                    raise ValueError(
                        f'load "{name}" acts on body "{marker.body}", which does not exist: '
                        f"{known}."
                    )
        if isinstance(load, AbstractCoordinateLoad):
            joint = connections[load.connection].joint if load.connection in connections else None
            if not isinstance(joint, AbstractJoint) or len(joint.home) != 1:
                raise ValueError(
                    f'load "{name}" acts on the coordinate of connection "{load.connection}", '
                    "which must be an ideal "
                    "revolute or prismatic joint of this mechanism."
                )
    _check_reach(bodies, connections)


def _check_reach(bodies: dict, connections: dict) -> None:
    reached, frontier = {GROUND}, [GROUND]
    while frontier:
        body = frontier.pop()
        for connection in connections.values():
            ends = [connection.parent.body, connection.child.body]
            if body in ends:
                other = ends[1 - ends.index(body)]
                if other not in reached:
                    reached.add(other)
                    frontier.append(other)
    lost = [body for body in bodies if body not in reached]
    if lost:
        raise ValueError(
            f"no chain of connections leads from the ground to {', '.join(map(repr, lost))}; "
            "connect it, or let it float "
            'with jaxclear.joint.Free() from "ground".'
        )


def _expect(thing: Any, kind: Any, what: str, wanted: str) -> None:
    if not isinstance(thing, kind):
        raise ValueError(f"{what} is {thing!r}; it must be {wanted}.")


def _check_slots(what: str, module: eqx.Module) -> None:
    """Slots for laws, drives, markers and the like must hold one of their family."""
    for field in dataclasses.fields(module):
        kinds = get_args(field.type) if isinstance(field.type, UnionType) else (field.type,)
        if not all(isinstance(kind, type) and kind is not Any for kind in kinds):
            continue
        families = [kind for kind in kinds if issubclass(kind, eqx.Module)]
        value = getattr(module, field.name)
        if value is None and field.default is not None and type(None) not in kinds:
            raise ValueError(f"{what} has {field.name} None; it needs one.")
        if families and set(kinds) <= {*families, type(None)}:
            if not isinstance(value, kinds):
                wanted = " or ".join(
                    "None" if kind is type(None) else kind.__name__ for kind in kinds
                )
                raise ValueError(f"{what} has {field.name} {value!r}; it must be {wanted}.")
            if value is not None:
                _check_slots(f"{what}, {field.name},", value)


def _check_finite(what: str, part: Any) -> None:
    for path, leaf in jax.tree_util.tree_leaves_with_path(part):
        if (
            eqx.is_array(leaf)
            and not isinstance(leaf, jax.core.Tracer)
            and not np.all(np.isfinite(leaf))
        ):
            name = jax.tree_util.keystr(path).removeprefix(".")
            raise ValueError(f"{what} has {name} = {leaf}; it must be a finite number.")


def _check_ranges(what: str, part: Any) -> None:
    for path, leaf, metadata in numbers(part):
        check_range(lambda: what, path, leaf, metadata)


def check_numbers(bodies: dict, connections: dict, loads: dict) -> None:
    """Masses, inertias and joint dimensions must be possible."""
    for name, body in bodies.items():
        _check_finite(f'body "{name}"', body)
        if body.com is not None and len(body.com) not in (2, 3):
            raise ValueError(
                f'body "{name}" has a centre of mass of {len(body.com)} numbers; give 2 (planar) '
                "or 3."
            )
        _check_inertia(name, body)
        _check_ranges(f'body "{name}"', body)
    for name, connection in connections.items():
        _check_finite(f'connection "{name}"', connection)
        if isinstance(connection.joint, AbstractClearance):
            _check_clearance(name, connection.joint)
            _check_fit(name, connection.joint)
        _check_ranges(f'connection "{name}"', connection)
    for name, load in loads.items():
        _check_finite(f'load "{name}"', load)
        _check_ranges(f'load "{name}"', load)


def _check_inertia(name: str, body: Body) -> None:
    values = [concrete(value) for value in body.inertia]
    if any(value is None for value in values):
        return
    if len(values) == 1:
        if not values[0] > 0:
            raise ValueError(
                f'body "{name}" has inertia {values[0]} kg m2 about z; it must be positive.'
            )
        return
    matrix = np.array(jax.tree.map(float, body.inertia_matrix()))
    moments = np.linalg.eigvalsh(matrix)
    if not moments[0] > 0:
        raise ValueError(
            f'body "{name}" has principal moments of inertia {moments.round(9)} kg m2; all three '
            "must be positive "
            "(the matrix must be positive definite)."
        )
    if moments[0] + moments[1] < moments[2] * (1 - 1e-9):
        raise ValueError(
            f'body "{name}" has principal moments of inertia {moments}; no body has one larger '
            "than the sum of the other two."
        )


def _check_clearance(name: str, joint: AbstractClearance) -> None:
    known = (PlanarJournalBearing, JournalBearing, BallSocket, SliderGuide)
    if not isinstance(joint, known):
        return
    clearance = concrete(joint.clearance)
    outer_name = {BallSocket: "socket_radius", SliderGuide: "width"}.get(
        type(joint), "bearing_radius"
    )
    outer = concrete(getattr(joint, outer_name))
    if outer is not None and not outer > (clearance or 0.0):
        raise ValueError(
            f'joint "{name}" has {outer_name} {outer} m; it must be larger than the clearance '
            f"{clearance} m."
        )
    if isinstance(joint, JournalBearing):
        length, journal = concrete(joint.length), concrete(joint.journal_length)
        if journal is not None and length is not None and journal < length:
            raise ValueError(
                f'joint "{name}" has a journal of length {journal} m in a bearing of {length} m; '
                "the journal must reach "
                "through the bearing, because contact is evaluated at the bearing's two end planes."
            )


def _check_fit(name: str, joint: AbstractClearance) -> None:
    """What the laws take from the pair's geometry must exist."""
    try:
        for pairing in joint.contact_laws():
            fitted(pairing.contact, pairing.shape)
    except ValueError as error:
        raise ValueError(f'joint "{name}": {error}') from None


def check_structure(mechanism: Mechanism) -> None:
    """Drives, loads and starting values must fit the tree."""
    topology, connections = mechanism.topology, mechanism.connections
    for name in topology.loops:
        if drive_of(connections[name].joint) is not None:
            raise ValueError(
                f'connection "{name}" is driven but closes a loop of driven joints; a loop can '
                "follow one of them only."
            )
    for name, load in mechanism.loads.items():
        if isinstance(load, AbstractCoordinateLoad):
            if (
                topology.branch_of(load.connection) is None
                or drive_of(connections[load.connection].joint) is not None
            ):
                raise ValueError(
                    f'load "{name}" acts on connection "{load.connection}", whose coordinate is '
                    "driven or cut to close a "
                    "loop; put the load on markers (jaxclear.load.Torque) or on another connection."
                )
    if sum(isinstance(load, Gravity) for load in mechanism.loads.values()) > 1:
        raise ValueError("a mechanism has more than one load.Gravity; give one.")
    homes = {}
    for branch in topology.branches:
        joint_name = branch.body if branch.connection is None else branch.connection
        homes[joint_name] = branch
    for what, given in (("start", mechanism.start), ("speeds", mechanism.speeds)):
        for name in given:
            if name not in homes:
                raise ValueError(
                    f'{what} names "{name}", which carries no coordinates; those that do are '
                    f"{', '.join(map(repr, homes))}."
                )
            if homes[name].coordinates.start == homes[name].coordinates.stop:
                raise ValueError(
                    f'{what} names "{name}", whose motion is prescribed or fixed; leave it out.'
                )
    for name, given in mechanism.start.items():
        home = joint_of(homes[name], mechanism.bodies, connections).home
        if (
            len(given) == len(home)
            and home[-4:] == NO_TURN
            and all(concrete(x) == 0 for x in given[-4:])
        ):
            raise ValueError(
                f'start of "{name}" ends in a quaternion (w, x, y, z) of zeros; no rotation is '
                f"{NO_TURN}."
            )
