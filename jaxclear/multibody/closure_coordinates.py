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
    """The coordinate of a joint outside the tree, from the motions of its two links.

    Args:
        system: prepared mechanism; `system.measured` has the joint's closure.
        name: joint that closes a loop, or has clearance.
        motions: motion of every link at the instant.
        angle: angle [rad] within half a turn of the result; None: whole turns are not counted.
    """
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
    """Rates [rad/s] of the angles of joints outside the tree that are state entries.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        layout: whose `angles` names these joints, in the order of the result.
        motions: motion of every link at one instant, in the order of `system.links`.
    """
    return [read(system, name, motions, None).speed for name in layout.angles]


def angles_at_start(
    mechanism: Mechanism, system: System, names: tuple[str, ...], motions: tuple[Motion, ...]
) -> dict[str, Any]:
    """Initial angles [rad] of joints outside the tree, by joint.

    Each is within half a turn of what `start` or `guess` gives for the joint, of 0 without either.

    Args:
        mechanism: with `start` and `guess`.
        system: prepared mechanism, as `prepare` returns it.
        names: joints whose angle is followed over whole turns.
        motions: motion of every link at the start.
    """
    angles = {}
    start = mechanism.guess | mechanism.start
    for name in names:
        joint = coordinate_joint(name, mechanism.bodies, mechanism.connections)
        near = joint.start(start[name])[0] if name in start else 0.0
        angles[name] = read(system, name, motions, near).position
    return angles


def states_at_start(system: System, motions: tuple[Motion, ...]) -> list[Any]:
    """Initial states of loads and then of transmissions, in the order of a layout's `states`.

    A transmission's shaft begins relaxed, its far end where the twist puts it.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at the start.
    """
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
    """The state at the start of a run, with angles outside the tree and load states filled in.

    Args:
        mechanism: whose `start` and `guess` decide whole turns.
        system: prepared mechanism, as `prepare` returns it.
        layout: where these entries sit.
        time: start of the run [s].
        state: with coordinates and speeds filled in, shape (n,).
    """
    if not layout.angles and not layout.states:
        return state
    motions = kinematics.link_motions(system, *unpack_motion(system, _as_scalars(state)), time)
    if layout.angles:
        angles = angles_at_start(mechanism, system, layout.angles, motions)
        state = _set_angles(layout, state, angles)
    if layout.states:
        first, values = layout.state_start, states_at_start(system, motions)
        state = state.at[first : first + len(values)].set(sp.stack(values))
    return state


def anchored(
    system: System, layout: Layout, time: Any, state: Float[Array, " n"]
) -> Float[Array, " n"]:
    """The state with the angles outside the tree recomputed from the coordinates.

    This drops the error that their integration has accumulated; whole turns stay.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        layout: where these angles sit.
        time: instant [s] of the state.
        state: end of a span of a run, shape (n,).
    """
    if not layout.angles:
        return state
    entries = _as_scalars(state)
    motions = kinematics.link_motions(system, *unpack_motion(system, entries), time)
    followed = unpack_followed(layout, entries).angles
    angles = {n: read(system, n, motions, x).position for n, x in followed.items()}
    return _set_angles(layout, state, angles)


def _as_scalars(state: Array) -> list:
    return [state[i] for i in range(len(state))]


def _set_angles(layout: Layout, state: Array, angles: dict[str, Any]) -> Array:
    first = layout.angle_start
    return state.at[first : first + len(angles)].set(sp.stack(list(angles.values())))
