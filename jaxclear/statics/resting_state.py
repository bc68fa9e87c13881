"""A start at which journals lie in their bearings as their reactions press them, instead of in the
middle, from where they would fall through their play.

Each lies as its own reaction presses it, or, where the loops through them do not let them, all
together at the least of one potential, without friction: the elastic energy of the contacts less
the work of the reactions that the joints have while all of them touch (d'Alembert: that is the work
of loads and inertia forces). Newton's method on the coordinates, held back (Levenberg) until its
steps lessen the potential.
"""

import math
import warnings
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.components.body import Connection, Marker
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.coupling import AbstractBodyCoupling
from jaxclear.formulations import CompliantContact, model_of
from jaxclear.formulations.permanent_reactions import ReactionNotUnique
from jaxclear.formulations.rigid import FrictionUnknown
from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.pose import frame_with_axis, quaternion_from_rotation
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import as_vector, with_quantities
from jaxclear.ground.warning import warn
from jaxclear.integrators import NonColliding
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.assembly import ready, ready_from_state
from jaxclear.multibody.contact_point import laws_now
from jaxclear.multibody.length_scales import narrowest_gap
from jaxclear.multibody.magnitudes import UnusualMagnitude
from jaxclear.multibody.mechanism import Mechanism, check_mechanism, rebuilt
from jaxclear.multibody.newton import blocks_of, closed
from jaxclear.multibody.start_equations import (
    LOOP,
    START,
    Ask,
    motions_at,
    retract,
    speed_scales,
    stacked,
    start_problem,
)
from jaxclear.multibody.state import names
from jaxclear.multibody.system import System, prepare, readings
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.state_history import SavedMotion, State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.simulate import simulate
from jaxclear.simulation.wear import initial_depths

# Step [s] over which the first reactions are taken: a motion does not change in it.
FIRST = 1e-7
# Turns of a bisection, each of which halves what is left of an indentation.
HALVINGS = 60


class Pressed(NamedTuple):
    """Reaction on a journal about its marker, in the bearing's axes: force [N], torque [N m]."""

    force: np.ndarray
    torque: np.ndarray


@answering
def resting_state(mechanism: Mechanism, worn: Any = None) -> State:
    """An initial state in which every journal rests in its bearing.

    A run from it begins without a fall through the clearance. Each journal rests where the reaction
    of its joint presses it, as deep as its contact law needs to carry that reaction. Reactions
    include loads, drives and inertia forces of the start, and friction where they are unique and
    its law says which Coulomb's law it stands for; journals without a reaction stay in the middle.
    Where loops do not allow this, all journals rest together where their contacts carry the loads
    without friction. Coordinates in `start` of the mechanism are kept.

    Args:
        mechanism: the `Mechanism`.
        worn: worn depths [m] by joint and surface, such as `run.worn`; None (default) for new
            surfaces.

    Returns:
        A `State`, for `simulate`, `steady_cycle`, `wear_life` or a `Problem`.

    Raises:
        ValueError: if for some joint it is not known where a load presses it, or no rest is found.
    """
    check_double_precision()
    check_mechanism(mechanism, "the argument of resting_state")
    mechanism = with_quantities(mechanism)
    surfaces = initial_depths(mechanism, worn)
    if not mechanism.topology.clearances:
        return State(surfaces)
    first = _run_first_step(mechanism)
    read = {} if surfaces is None else readings(prepare(mechanism), surfaces)
    moved, start = _assemble_in_seats(first, mechanism, read)
    model = model_of(mechanism, CompliantContact())
    labels = names(model.system, model.layout)
    parts = labels[: model.layout.memory_start], labels[model.layout.remembered]
    motion = SavedMotion(
        jnp.zeros(()),
        start.coordinates,
        start.speeds,
        jnp.zeros(len(parts[1])),
        tuple(parts[0]),
        tuple(parts[1]),
        moved.topology.redundancy,
    )
    return State(surfaces, motion=motion)


def _run_first_step(mechanism: Mechanism) -> Trajectory:
    """A run so short that nothing moves, in which all journals touch; without friction where it
    would hang on reactions that are not unique, or has no Coulomb's law."""
    options: dict[str, Any] = {"save": 2, "integrator": NonColliding(FIRST), "verify": False}
    try:
        return simulate(mechanism, FIRST, **options)
    except (ReactionNotUnique, FrictionUnknown):
        return simulate(_without_friction(mechanism), FIRST, **options)


def _without_friction(mechanism: Mechanism) -> Mechanism:
    for name, connection in mechanism.connections.items():
        if getattr(connection.joint, "friction", None) is not None:
            joint = eqx.tree_at(lambda joint_of: joint_of.friction, connection.joint, None)
            mechanism = mechanism.with_joint(name, joint)
    return mechanism


def _pressed_seat(
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


def _assemble_in_seats(first: Trajectory, mechanism: Mechanism, read: dict) -> tuple:
    """(mechanism, its start) with every journal in its seat."""
    if any(isinstance(coupling, AbstractBodyCoupling) for coupling in mechanism.couplings.values()):
        # A journal in its seat by a bearing that is moved would mesh elsewhere.
        return _solve_rest(first, mechanism, read)
    system = prepare(mechanism)
    connections = dict(mechanism.connections)
    with warnings.catch_warnings(record=True) as doubts:
        for name in mechanism.topology.clearances:
            offset, slope, load = _pressed_seat(first, mechanism, name)
            share = _stretch_of_seat(system, name, (offset, slope), load, read.get(name, {}))
            moved = _marker_at_seat(connections[name].parent, share * offset, share * slope)
            connections[name] = Connection(connections[name].joint, moved, connections[name].child)
    with warnings.catch_warnings():
        # Its numbers have been looked at; where a journal lies is no length of a link.
        warnings.simplefilter("ignore", UnusualMagnitude)
        put = rebuilt(mechanism, connections=connections)
    try:
        assembled, start = ready(put)[:2]
    except ValueError:
        # The loops do not let every journal lie as its own reaction presses it.
        return _solve_rest(first, mechanism, read)
    for doubt in doubts:
        warn(str(doubt.message), doubt.category)
    return assembled, start


def _solve_rest(first: Trajectory, mechanism: Mechanism, read: dict) -> tuple:
    """(mechanism, its start) where all journals rest under the reactions that they have while they
    touch. Raises `ValueError` where no such place is found."""
    with warnings.catch_warnings():
        # Reactions that close the loops among themselves move nothing: any of them will do.
        warnings.filterwarnings("ignore", message="the reaction of joint .* is not unique")
        reactions = {n: _reaction(first, mechanism, n) for n in mechanism.topology.clearances}
    rest = rest_under(mechanism, reactions, read)
    if rest is None:
        raise ValueError(
            "the journals of this mechanism find no rest under their reactions without friction: "
            "something that loads hold in no direction moves away. Begin with a state of a run."
        )
    return ready_from_state(mechanism, rest, ready(mechanism).start.speeds, 0.0)


def _reaction(first: Trajectory, mechanism: Mechanism, name: str) -> Pressed:
    """Reaction on a journal at the start, in the bearing's axes."""
    connection = mechanism.connections[name]
    body, pose = connection.parent.body, connection.parent.pose()
    turn = np.asarray(sp.dense(pose.rotation), float).reshape(3, 3)
    if body in mechanism.bodies:
        turn = np.asarray(first.body(body).rotation[0]) @ turn
    reaction = first.reaction(name)
    return Pressed(*(turn.T @ np.asarray(x[0]) for x in (reaction.force, reaction.torque)))


def _stretch_of_seat(system: System, name: str, seat: tuple, load: float, worn: dict) -> float:
    """By how much a seat is to be stretched so that the contacts carry the `load` [N]."""
    if load == 0.0:
        return 1.0
    bearing, place = system.bearings[name], tuple(map(jnp.asarray, seat))
    # As an array: of each number of Python's there would be a program.
    force = lambda share: float(_force_of_seat(bearing, place, jnp.asarray(share), worn))
    low, high = 0.0, 1.0
    while force(high) < load:
        low, high = high, 2.0 * high
        if not math.isfinite(high):
            return 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if force(middle) < load else (low, middle)
    return high


@compiled_quickly
def _force_of_seat(bearing: Any, seat: tuple, share: Any, worn: dict) -> Any:
    """Sum of the elastic forces [N] of the contacts of a journal in a stretched seat."""
    joint: AbstractClearance = bearing.joint
    offset, slope = (share * x for x in seat)
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


def _marker_at_seat(marker: Marker, offset: np.ndarray, slope: np.ndarray) -> Marker:
    """A bearing's marker where the journal's is when it lies in its seat."""
    pose = marker.pose()
    turn = np.asarray(sp.dense(pose.rotation), float).reshape(3, 3)
    at = np.asarray(sp.dense(pose.translation), float).ravel() + turn @ offset
    place = at if np.any(at[2]) else at[:2]
    if not np.any(slope):
        # Planar markers stay so.
        return eqx.tree_at(lambda m: m.at, marker, as_vector(place), is_leaf=lambda x: x is None)
    lean = np.asarray(sp.dense(frame_with_axis((*slope, 1.0))), float).reshape(3, 3)
    return Marker(marker.body, place, quaternion=np.asarray(quaternion_from_rotation(turn @ lean)))


# Steps after which a rest that has not been found counts as none; forces that are left at one,
# beside the largest reaction.
MOST_STEPS, RESIDUAL = 400, 1e-6
# By which a step that lessens the potential is held back less, and one that does not more.
LESS, MORE = 0.3, 4.0
# Points of Gauss and Legendre's rule between touch and an indentation: after t^2 for the share of
# it, powers of a half are polynomials.
POINTS = 8
# Steps that close the loops anew.
CLOSING = 4


def rest_under(mechanism: Mechanism, pressed: dict[str, Pressed], worn: dict) -> Array | None:
    """Coordinates at which journals rest under given reactions; None where they are not reached.

    Args:
        mechanism: with clearance joints.
        pressed: reaction of each of them.
        worn: depth maps as gaps read them, by joint and surface.
    """
    assembled, start = ready(mechanism)[:2]
    problem = start_problem(assembled, False)
    arm = float(problem.arm)
    largest = max(float(np.linalg.norm(force.force)) for force in pressed.values())
    if largest == 0.0:
        return start.coordinates
    at = lambda q: _potential_at(assembled, q, pressed, worn)
    moved = lambda q, step: _move_closed(assembled, q, step)
    q, softness = start.coordinates, largest * arm**2 / float(narrowest_gap(problem.system))
    now = at(q)
    for _ in range(MOST_STEPS):
        value, *derivatives, rows = now
        free = _null_space(np.asarray(rows))
        slope, bend = (free.T @ np.asarray(force) for force in derivatives)
        bend = bend @ free
        if np.abs(slope).max(initial=0.0) < RESIDUAL * largest * arm:
            return q
        sizes, vectors = np.linalg.eigh(bend)
        # Where the potential bends down, as far as where it bends up.
        step = -free @ (vectors @ ((vectors.T @ slope) / (np.abs(sizes) + softness)))
        there = moved(q, jnp.asarray(step))
        then = at(there)
        if float(then[0]) < float(value):
            q, now, softness = there, then, LESS * softness
        else:
            softness *= MORE
    return None


def _null_space(rows: np.ndarray) -> np.ndarray:
    """Directions (v, n) in which no row changes."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, sizes, vectors = np.linalg.svd(rows)
    rank = int((sizes > 1e-9 * sizes.max(initial=0.0)).sum())
    return vectors[rank:].T


@compiled_quickly
def _potential_at(mechanism: Mechanism, q: Array, pressed: dict[str, Pressed], worn: dict) -> tuple:
    """Potential [J] at coordinates, its gradient and Hessian in the scaled speeds, and the rows
    (rows, v) that hold the loops there."""
    problem = start_problem(mechanism, False)
    scales = speed_scales(problem)
    energy = lambda step: _total_potential(
        problem, retract(problem.system, q, scales * step), pressed, worn
    )
    none = jnp.zeros(problem.system.topology.speed_count)
    value, slope = jax.value_and_grad(energy)(none)
    rows = stacked(problem, blocks_of(problem, q, 0.0, (LOOP, START)))[0] * scales
    return value, slope, jax.hessian(energy)(none), rows


@compiled_quickly
def _move_closed(mechanism: Mechanism, q: Array, step: Array) -> Array:
    """Coordinates after a step in the scaled speeds, loops closed."""
    problem = start_problem(mechanism, False)
    q = retract(problem.system, q, speed_scales(problem) * step)
    return closed(problem, q, 0.0, CLOSING, (LOOP, START))


def _total_potential(problem: Ask, q: Array, pressed: dict[str, Pressed], worn: dict) -> Array:
    still = jnp.zeros(problem.system.topology.speed_count)
    motions = motions_at(problem, q, still, 0.0)[2]
    total: Any = 0.0
    for name, bearing in problem.system.bearings.items():
        pose = kinematics.relative_motion(bearing.closure, motions)[1]
        readings = worn.get(name, {})
        depths = contact_point.depths(bearing.joint, pose, readings)
        contact_laws = contact_point.laws_at(bearing.joint, bearing.contact_laws, pose, readings)
        # Forces are those of the laws as they are there, not of how these change from place to
        # place.
        contact_laws = jax.lax.stop_gradient(contact_laws)
        for laws, depth in zip(contact_laws, depths, strict=True):
            total = total + _stored_energy(laws.contact.elastic_force, depth)
        force, torque = pressed[name]
        axis = sp.transpose(pose.rotation)[2]
        # A lean towards x is a turn about y, one towards y a turn back about x.
        leant = sp.sub(sp.mul(torque[1], axis[0]), sp.mul(torque[0], axis[1]))
        total = total + sp.add(sp.dot(tuple(force), pose.translation), leant)
    return total


def _stored_energy(force: Any, depth: Any) -> Array:
    """Energy [J] of an elastic force at an indentation [m]."""
    points, weights = np.polynomial.legendre.leggauss(POINTS)
    t = jnp.asarray(0.5 * (points + 1))
    deep = jnp.where(depth > 0, depth, 0.0)
    return jnp.sum(jnp.asarray(weights) * t * deep * jax.vmap(force)(deep * t * t))
