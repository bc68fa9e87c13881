"""A start at which journals lie in their bearings as their reactions press them, instead of in the
middle, from where they would fall through their play.
"""

import math
import warnings
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.components.body import Connection, Marker
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.coupling import AbstractBodyCoupling
from jaxclear.formulations import CompliantContact, model_of
from jaxclear.formulations.unique_reactions import ReactionNotUnique
from jaxclear.ground import sparse as sp
from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import expect
from jaxclear.ground.pose import frame_with_axis, quaternion_from_rotation
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.warning import warn
from jaxclear.integrators import NonColliding
from jaxclear.multibody.assembly import ready, ready_from
from jaxclear.multibody.contact_point import laws_now
from jaxclear.multibody.magnitudes import UnusualMagnitude
from jaxclear.multibody.mechanism import Mechanism, rebuilt
from jaxclear.multibody.state import names
from jaxclear.multibody.system import System, prepare, readings
from jaxclear.results.state_history import SavedMotion, State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.resting import Pressed, resting
from jaxclear.simulation.simulate import simulate
from jaxclear.simulation.wear import worn_as_given

__all__ = ["seated"]

# Step [s] over which the first reactions are taken: a motion does not change in it.
FIRST = 1e-7
# Turns of a bisection, each of which halves what is left of an indentation.
HALVINGS = 60


@answering
def seated(mechanism: Mechanism, worn: Any = None) -> State:
    """Where a run may begin without a fall: the mechanism's own start, with every journal pressed
    into its bearing by the reaction that the joint has there while all of them touch
    (`NonColliding`), as deep as its law carries that reaction, and resting in it.

    Loads, drives and inertia forces of the start count; friction leans a journal sideways. Journals
    without a reaction stay in the middle. Where reactions are not unique (a door on two hinges with
    play) no friction leans a journal. Where the loops do not let each journal lie as its own
    reaction presses it (a spatial linkage whose ends stay in their planes), all rest together where
    their contacts carry the loads, without friction. `worn`: depths [m] by joint and surface, such
    as `run.worn`. Give the state to `simulate`, `settled`, `wear_life` or a `Problem`. What `start`
    holds is held. Raises `ValueError` with a sentence for a joint of which it is not known where a
    load presses it.
    """
    check_double_precision()
    expect(mechanism, Mechanism, "what is seated", "a jaxclear.Mechanism")
    surfaces = worn_as_given(mechanism, worn)
    if not mechanism.topology.clearances:
        return State(surfaces)
    first = _first_reactions(mechanism)
    read = {} if surfaces is None else readings(prepare(mechanism), surfaces)
    known, start = _put(first, mechanism, read)
    model = model_of(mechanism, CompliantContact())
    own = names(model.system, model.layout)
    parts = own[: model.layout.memory_start], own[model.layout.remembered]
    motion = SavedMotion(
        jnp.zeros(()),
        start.coordinates,
        start.speeds,
        jnp.zeros(len(parts[1])),
        tuple(parts[0]),
        tuple(parts[1]),
        known.topology.redundancy,
    )
    return State(surfaces, motion=motion)


def _first_reactions(mechanism: Mechanism) -> Trajectory:
    """A run so short that nothing moves, in which all journals touch; without friction where it
    would hang on reactions that are not unique."""
    asked: dict[str, Any] = {"save": 2, "integrator": NonColliding(FIRST), "verify": False}
    try:
        return simulate(mechanism, FIRST, **asked)
    except ReactionNotUnique:
        return simulate(_without_friction(mechanism), FIRST, **asked)


def _without_friction(mechanism: Mechanism) -> Mechanism:
    for name, connection in mechanism.connections.items():
        if getattr(connection.joint, "friction", None) is not None:
            joint = eqx.tree_at(lambda own: own.friction, connection.joint, None)
            mechanism = mechanism.with_joint(name, joint)
    return mechanism


def _pressed(
    first: Trajectory, mechanism: Mechanism, name: str
) -> tuple[np.ndarray, np.ndarray, float]:
    """(offset [m] of a journal that its reaction presses to the wall, slope of its axis, sum of the
    forces [N] that its contacts carry)."""
    if name in first.formulation.contact_joints(first.mechanism):
        contact = first.contact(name)
        axis = np.asarray(contact.axis[0])
        load = float(np.sum(contact.normal_force[0]))
        return np.asarray(contact.offset[0]), axis[:2] / axis[2], load
    force, torque = _reaction(first, mechanism, name)
    joint = mechanism.connections[name].joint
    try:
        offset, slope = joint.seat(tuple(force), tuple(torque))
    except ValueError as error:
        raise ValueError(f'joint "{name}" {error}') from None
    return np.array(offset, float), np.array(slope, float), float(np.linalg.norm(force))


def _put(first: Trajectory, mechanism: Mechanism, read: dict) -> tuple:
    """(mechanism, its start) with every journal in its seat."""
    if any(isinstance(own, AbstractBodyCoupling) for own in mechanism.couplings.values()):
        # A journal in its seat by a bearing that is moved would mesh elsewhere.
        return _at_rest_together(first, mechanism, read)
    system = prepare(mechanism)
    connections = dict(mechanism.connections)
    with warnings.catch_warnings(record=True) as doubts:
        for name in mechanism.topology.clearances:
            offset, slope, load = _pressed(first, mechanism, name)
            share = _share(system, name, (offset, slope), load, read.get(name, {}))
            moved = _moved(connections[name].parent, share * offset, share * slope)
            connections[name] = Connection(connections[name].joint, moved, connections[name].child)
    with warnings.catch_warnings():
        # Its numbers have been looked at; where a journal lies is no length of a link.
        warnings.simplefilter("ignore", UnusualMagnitude)
        put = rebuilt(mechanism, connections=connections)
    try:
        known, start = ready(put)[:2]
    except ValueError:
        # The loops do not let every journal lie as its own reaction presses it.
        return _at_rest_together(first, mechanism, read)
    for doubt in doubts:
        warn(str(doubt.message), doubt.category)
    return known, start


def _at_rest_together(first: Trajectory, mechanism: Mechanism, read: dict) -> tuple:
    """(mechanism, its start) where all journals rest under the reactions that they have while they
    touch. Raises `ValueError` where no such place is found."""
    with warnings.catch_warnings():
        # Reactions that close the loops among themselves move nothing: any of them will do.
        warnings.filterwarnings("ignore", message="the reaction of joint .* is not unique")
        reactions = {n: _reaction(first, mechanism, n) for n in mechanism.topology.clearances}
    found = resting(mechanism, reactions, read)
    if found is None:
        raise ValueError(
            "the journals of this mechanism find no rest under their reactions without friction: "
            "something that loads hold in no direction moves away. Begin with a state of a run."
        )
    return ready_from(mechanism, found, ready(mechanism).start.speeds, 0.0)


def _reaction(first: Trajectory, mechanism: Mechanism, name: str) -> Pressed:
    """Reaction on a journal at the start, in the bearing's axes."""
    connection = mechanism.connections[name]
    body, pose = connection.parent.body, connection.parent.pose()
    turn = np.asarray(sp.dense(pose.rotation), float).reshape(3, 3)
    if body in mechanism.bodies:
        turn = np.asarray(first.body(body).rotation[0]) @ turn
    reaction = first.reaction(name)
    return Pressed(*(turn.T @ np.asarray(x[0]) for x in (reaction.force, reaction.torque)))


def _share(system: System, name: str, seat: tuple, load: float, worn: dict) -> float:
    """By how much a seat is to be stretched so that the contacts carry the `load` [N]."""
    if load == 0.0:
        return 1.0
    bearing = system.bearings[name]
    force = eqx.filter_jit(lambda share: _carried(bearing, seat, share, worn))
    low, high = 0.0, 1.0
    while float(force(high)) < load:
        low, high = high, 2.0 * high
        if not math.isfinite(high):
            return 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if float(force(middle)) < load else (low, middle)
    return high


def _carried(bearing: Any, seat: tuple, share: Any, worn: dict) -> Any:
    """Sum of the elastic forces [N] of the contacts of a journal in a stretched seat."""
    joint: AbstractClearance = bearing.joint
    offset, slope = (share * jnp.asarray(x) for x in seat)
    axis = (slope[0], slope[1], 1.0)
    across = {0: (1.0, 0.0, -slope[0]), 1: (0.0, 1.0, -slope[1])}
    axes = across | {2: tuple(x / sp.norm(axis) for x in axis)}
    place = tuple(offset), tuple(axes[k] for k in joint.axes)
    depths = joint.indentations(*place, worn)
    contact_laws = laws_now(joint, bearing.contact_laws, *place, worn)
    forces = [
        jnp.where(depth > 0, laws.contact.elastic_force(jnp.maximum(depth, 0.0)), 0.0)
        for laws, depth in zip(contact_laws, depths, strict=True)
    ]
    return sum(forces)


def _moved(marker: Marker, offset: np.ndarray, slope: np.ndarray) -> Marker:
    """A bearing's marker where the journal's is when it lies in its seat."""
    pose = marker.pose()
    turn = np.asarray(sp.dense(pose.rotation), float).reshape(3, 3)
    at = np.asarray(sp.dense(pose.translation), float).ravel() + turn @ offset
    place = at if np.any(at[2]) else at[:2]
    if not np.any(slope):
        # Planar markers stay so.
        if marker.quaternion is not None:
            return Marker(marker.body, place, quaternion=marker.quaternion)
        axis = marker.named_axis if marker.axis is None else marker.axis
        return Marker(marker.body, place, axis=axis)
    lean = np.asarray(sp.dense(frame_with_axis((*slope, 1.0))), float).reshape(3, 3)
    return Marker(marker.body, place, quaternion=quaternion_from_rotation(turn @ lean))
