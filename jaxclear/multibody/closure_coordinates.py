r"""The coordinate of a joint that the tree does not carry, on which loads act: of one that closes a
loop, or one with clearance.

It is read between the joint's two markers, $q(T)$ of their relative pose $T$, and a load's force
acts along $\partial q / \partial T$: the work of a load is that of its coordinate, also where a
journal leans. An angle so read is known but for whole turns. Where a force depends on it the state
follows the angle by its rate, and only its whole turns are taken from there, so that errors of the
integration do not enter.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground import sparse as sp
from jaxclear.multibody import kinematics, transmissions
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.rows import CoordinateReading, Direction, OnClosure
from jaxclear.multibody.state import Layout, unpack_followed, unpack_motion
from jaxclear.multibody.system import System, coordinate_loads
from jaxclear.multibody.topology import coordinate_joint
from jaxclear.multibody.tree import Motion, Wrench

TURN = 2 * jnp.pi


def read(system: System, name: str, motions: tuple[Motion, ...], angle: Any) -> CoordinateReading:
    """The coordinate of a joint outside the tree as the motions of the links tell it; `angle`: one
    within half a turn of it, None where whole turns do not matter."""
    coordinate = system.measured[name]
    pose, velocity, spin = kinematics.relative_motion(coordinate.closure, motions)[2]
    joint = coordinate.joint
    (position,), (speed,) = joint.coordinates_at(pose), joint.speeds_at(pose, velocity, spin)
    if angle is not None:
        position = nearest_turn(position, angle)
    force = tuple(joint.speeds_at(pose, axis, sp.ZERO)[0] for axis in sp.IDENTITY)
    torque = tuple(joint.speeds_at(pose, sp.ZERO, axis)[0] for axis in sp.IDENTITY)
    place = OnClosure(coordinate.closure, pose, Wrench(force, torque), name)
    return CoordinateReading(position, speed, Direction((place,)))


def nearest_turn(angle: Any, near: Any) -> Any:
    """The angle [rad] and as many whole turns as bring it within half a turn of another."""
    return angle + TURN * jnp.round((near - angle) / TURN)


def angle_rates(system: System, layout: Layout, motions: tuple[Motion, ...]) -> list:
    """Rates [rad/s] of the angles that the state follows."""
    return [read(system, name, motions, None).speed for name in layout.angles]


def angles_at_start(
    mechanism: Mechanism, system: System, names: tuple[str, ...], motions: tuple[Motion, ...]
) -> dict[str, Any]:
    """The angles [rad] of joints outside the tree, by joint: within half a turn of what `start` or
    `guess` gives for the joint, of 0 where they give nothing."""
    angles = {}
    start = mechanism.guess | mechanism.start
    for name in names:
        joint = coordinate_joint(name, mechanism.bodies, mechanism.connections)
        near = joint.start(start[name])[0] if name in start else 0.0
        angles[name] = read(system, name, motions, near).position
    return angles


def states_at_start(system: System, layout: Layout, motions: tuple[Motion, ...]) -> list[Any]:
    """The states of loads and of flanks with which a run begins: shafts are relaxed."""
    loads = [x.start for _, load in coordinate_loads(system) for x in load.states()]
    for train in system.transmissions.values():
        if train.has_twist:
            twist = transmissions.twist_of(motions, train)
            loads.append(transmissions.end_at_start(train, twist))
        loads += [0.0] * (len(train.states()) - train.has_twist)
    return loads


def started(
    mechanism: Mechanism, system: System, layout: Layout, time: Any, state: Float[Array, " n"]
) -> Float[Array, " n"]:
    """The state at the start of a run, with what it follows beside the motion."""
    if not layout.angles and not layout.states:
        return state
    motions = kinematics.link_motions(system, *unpack_motion(system, _entries(state)), time)
    if layout.angles:
        angles = angles_at_start(mechanism, system, layout.angles, motions)
        state = _with_angles(layout, state, angles)
    if layout.states:
        first, values = layout.state_start, states_at_start(system, layout, motions)
        state = state.at[first : first + len(values)].set(sp.stack(values))
    return state


def anchored(
    system: System, layout: Layout, time: Any, state: Float[Array, " n"]
) -> Float[Array, " n"]:
    """The state with the angles that it follows as its coordinates tell them: what their
    integration has gathered in errors is dropped."""
    if not layout.angles:
        return state
    entries = _entries(state)
    motions = kinematics.link_motions(system, *unpack_motion(system, entries), time)
    followed = unpack_followed(layout, entries).angles
    angles = {n: read(system, n, motions, x).position for n, x in followed.items()}
    return _with_angles(layout, state, angles)


def _entries(state: Array) -> list:
    return [state[i] for i in range(len(state))]


def _with_angles(layout: Layout, state: Array, angles: dict[str, Any]) -> Array:
    first = layout.angle_start
    return state.at[first : first + len(angles)].set(sp.stack(list(angles.values())))
