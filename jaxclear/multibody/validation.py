"""What a mechanism is refused for, in sentences that name the body, joint or load and say what
would be right.

A part checks itself when it is built; here is what needs the other parts: names, what a slot holds,
numbers that were changed afterwards, drives, loads and starts that fit the tree.
"""

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxclear.components.body import GROUND, Body, Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.coupling import AbstractCoupling
from jaxclear.components.joint import AbstractJoint
from jaxclear.components.joint.base import drive_of
from jaxclear.components.load import AbstractBodyLoad, AbstractCoordinateLoad, AbstractLoad, Gravity
from jaxclear.ground.arguments import check_known, expect
from jaxclear.ground.kinds import check_kinds
from jaxclear.ground.quantity import check_range, numbers
from jaxclear.ground.wording import listed, meant
from jaxclear.laws.stiffness import fitted
from jaxclear.multibody.own_parts import check_own_drive, check_own_load
from jaxclear.multibody.pose_rows import check_rows
from jaxclear.multibody.topology import Topology, coordinate_joint
from jaxclear.multibody.worn_laws import check_followed


def check_parts(bodies: dict, connections: dict, loads: dict, couplings: dict) -> None:
    """Types must be what the slots expect, names refer to something, numbers be possible, and every
    body be held.
    """
    if not bodies:
        raise ValueError("a mechanism needs at least one body.")
    if GROUND in bodies:
        raise ValueError(
            f'"{GROUND}" is the fixed frame and cannot be a body; choose another name.'
        )
    for name, body in bodies.items():
        expect(body, Body, f'body "{name}"', "a jaxclear.Body")
        check_values(f'body "{name}"', body)
    for name, connection in connections.items():
        _check_connection(name, connection, bodies)
    for name, load in loads.items():
        _check_load(name, load, bodies, connections)
    for name, coupling in couplings.items():
        expect(coupling, AbstractCoupling, f'coupling "{name}"', "one of jaxclear.coupling")
        _check_slots(f'coupling "{name}"', coupling)
        check_values(f'coupling "{name}"', coupling)
    if sum(isinstance(load, Gravity) for load in loads.values()) > 1:
        raise ValueError("a mechanism has more than one load.Gravity; give one.")
    _check_reach(bodies, connections)


def _check_connection(name: str, connection: Any, bodies: dict) -> None:
    expect(connection, Connection, f'joint "{name}"', "a jaxclear.Connection")
    joint = connection.joint
    wanted = "one of jaxclear.joint or jaxclear.clearance"
    expect(joint, (AbstractJoint, AbstractClearance), f'joint "{name}"', wanted)
    _check_slots(f'joint "{name}"', joint)
    check_values(f'joint "{name}"', joint)
    for side, marker in (("parent", connection.parent), ("child", connection.child)):
        _check_body(f'joint "{name}" refers to', marker.body, bodies)
        check_values(f'the {side} marker of joint "{name}"', marker)
    if connection.parent.body == connection.child.body:
        raise ValueError(
            f'joint "{name}" joins "{connection.parent.body}" to itself; it needs two bodies.'
        )
    check_own_drive(name, drive_of(joint))
    if isinstance(joint, AbstractJoint):
        check_rows(name, joint)
    if isinstance(joint, AbstractClearance):
        try:
            plain = _in_numpy(joint)
            for laws in plain.contact_laws():
                # What a law asks of a shape hangs on its form: no number is worked out.
                eqx.filter_eval_shape(fitted, laws.contact, laws.shape)
            check_followed(plain)
        except ValueError as error:
            raise ValueError(f'joint "{name}": {error}') from None


def _in_numpy(tree: Any) -> Any:
    """The same with numbers that NumPy computes with: JAX would compile each operation."""
    known = lambda leaf: isinstance(leaf, jax.Array) and not isinstance(leaf, jax.core.Tracer)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[()] if known(leaf) else leaf, tree)


def _check_load(name: str, load: Any, bodies: dict, connections: dict) -> None:
    expect(load, AbstractLoad, f'load "{name}"', "one of jaxclear.load")
    _check_slots(f'load "{name}"', load)
    check_values(f'load "{name}"', load)
    check_own_load(name, load)
    if isinstance(load, AbstractBodyLoad):
        markers = load.markers()
        for marker in markers:
            _check_body(f'load "{name}" acts on', marker.body, bodies)
        if markers and all(marker.body == GROUND for marker in markers):
            raise ValueError(
                f'load "{name}" acts on "{GROUND}" alone, which nothing moves; put a marker of it '
                f"on one of the bodies {listed(bodies)}."
            )
    if isinstance(load, AbstractCoordinateLoad):
        check_known("joint", load.connection, connections, f' for load "{name}" to act on')
        joint = one_coordinate(
            f'load "{name}" acts on',
            load.connection,
            bodies,
            connections,
            " Put the load on markers (jaxclear.load.Torque) or on another joint.",
        )
        if drive_of(joint) is not None:
            raise ValueError(
                f'load "{name}" acts on joint "{load.connection}", whose coordinate is driven; put '
                "the load on markers (jaxclear.load.Torque) or on another joint."
            )


def one_coordinate(what: str, name: str, bodies: dict, connections: dict, else_: str = "") -> Any:
    """The joint `name` as its coordinate is read. Raises `ValueError` where it has not exactly one:
    `what` says who asks, `else_` what would be right."""
    try:
        joint = coordinate_joint(name, bodies, connections)
    except ValueError as error:
        raise ValueError(f'{what} joint "{name}", which {error}') from None
    if len(joint.home) != 1:
        raise ValueError(
            f'{what} the coordinate of joint "{name}", which must have one, of turning or sliding; '
            f"it has {len(joint.home)}.{else_}"
        )
    return joint


def _check_body(what: str, body: str, bodies: dict) -> None:
    if body not in bodies and body != GROUND:
        raise ValueError(
            f'{what} body "{body}", which does not exist: the bodies are {listed(bodies)} and '
            f'"{GROUND}".{meant(body, [*bodies, GROUND])}'
        )


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
            f"no chain of joints leads from the ground to {', '.join(map(repr, lost))}; connect "
            'it, or let it float with jaxclear.joint.Free() from "ground".'
        )


def _check_slots(what: str, module: eqx.Module) -> None:
    """Fields must hold what they are declared to, also where one was changed after its part was
    built.
    """
    check_kinds(lambda: what, module)
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        if isinstance(value, eqx.Module):
            _check_slots(f"{what}, {field.name},", value)


def check_values(what: str, part: Any) -> None:
    """Numbers must be finite and within their ranges, also where one was changed after its part was
    built.
    """
    for path, leaf, metadata in numbers(part):
        if "unit" in metadata:
            check_range(lambda: what, path, leaf, metadata)
        else:
            check_finite(f"{what}, {path},", leaf)


def check_finite(what: str, part: Any) -> None:
    """Numbers must be finite; those that are being traced are not known."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(part):
        if not eqx.is_array(leaf) or isinstance(leaf, jax.core.Tracer):
            continue
        if not (math.isfinite(float(leaf)) if leaf.ndim == 0 else np.all(np.isfinite(leaf))):
            name = jax.tree_util.keystr(path).removeprefix(".")
            raise ValueError(f"{what} has {name} = {leaf}; it must be a finite number.")


def check_tree(topology: Topology, connections: dict, loads: dict) -> None:
    """Drives and inertias of coordinates must fit the tree."""
    for name in topology.closing:
        if drive_of(connections[name].joint) is not None:
            raise ValueError(
                f'joint "{name}" is driven but closes a loop of driven joints; a loop can follow '
                "one of them only."
            )
    for name, load in loads.items():
        if not isinstance(load, AbstractCoordinateLoad) or load.inertia_along() is None:
            continue
        if topology.branch_of(load.connection) is None:
            why = "has clearance" if load.connection in topology.clearances else "closes a loop"
            raise ValueError(
                f'load "{name}" is an inertia on the coordinate of joint "{load.connection}", '
                f"which {why}; only a joint that the tree carries can have it. Take the load out "
                "(mechanism.with_loads), and add its inertia to a body if it matters."
            )


def check_start(bodies: dict, connections: dict, places: dict, speeds: dict) -> None:
    """Starting coordinates (`places`: "start" and "guess" of a mechanism) and speeds must be given
    for what has some, in the right number."""
    for what, given in places.items():
        for name, values in given.items():
            joint = _with_coordinates(what, name, bodies, connections)
            try:
                joint.start(values)
            except ValueError as error:
                raise ValueError(f'{what} of "{name}" {error}') from None
    for name, values in speeds.items():
        joint = _with_coordinates("speeds", name, bodies, connections)
        width = len(joint.columns(joint.home))
        if len(values) != width:
            many = f"{width} number{'s' * (width != 1)}"
            raise ValueError(f'speeds of "{name}" need {many}, not {len(values)}.')


def _with_coordinates(what: str, name: str, bodies: dict, connections: dict) -> AbstractJoint:
    if name not in connections and name not in bodies:
        raise ValueError(
            f'{what} names "{name}", which carries no coordinates; it may name the joints '
            f"{listed(connections)} and the bodies {listed(bodies)}."
            + meant(name, [*connections, *bodies])
        )
    try:
        joint = coordinate_joint(name, bodies, connections)
    except ValueError as error:
        raise ValueError(f'{what} names "{name}", which {error}') from None
    if not joint.home or drive_of(joint) is not None:
        raise ValueError(
            f'{what} names "{name}", whose motion is prescribed or fixed; leave it out.'
        )
    return joint
