"""How the parts of a connection move against each other, whatever kind of joint holds them.

It follows from the bodies' motion, so it is known of every connection: driven, closing a loop, with
clearance or without.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxclear.components.body import GROUND, Marker
from jaxclear.ground.arguments import check_name


class RelativeMotion(NamedTuple):
    """The child's marker as seen by the parent's, in its axes: `offset` (time, 3) [m] and its
    `rate` [m/s], `turn` (time,) [rad] about the z axis, without jumps, and its `spin` [rad/s]."""

    offset: np.ndarray
    rate: np.ndarray
    turn: np.ndarray
    spin: np.ndarray


class MarkerMotion(NamedTuple):
    """A marker in the ground frame over time."""

    rotation: np.ndarray
    place: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray


def marker_frame(marker: Marker) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) and place (3,) [m] of a marker in its body."""
    rotation, place = jax.tree.map(float, marker.pose())
    return np.array(rotation), np.array(place)


def marker_motion(run: Any, marker: Marker) -> MarkerMotion:
    """A marker in the ground frame over a run."""
    if marker.body == GROUND:
        turn, at = marker_frame(marker)
        rest = np.zeros((len(run.time), 3))
        return MarkerMotion(np.broadcast_to(turn, (len(rest), 3, 3)), rest + at, rest, rest)
    m = run.marker(marker)
    return MarkerMotion(*map(np.asarray, (m.rotation, m.position, m.velocity, m.body.spin)))


def relative_motion(run: Any, name: str) -> RelativeMotion:
    """Motion of a connection's child against its parent over a run. Raises `ValueError` for a name
    that there is not."""
    check_name("joint", name, run.mechanism.connections, " in this mechanism")
    connection = run.mechanism.connections[name]
    parent, child = marker_motion(run, connection.parent), marker_motion(run, connection.child)
    away = child.place - parent.place
    velocity = child.velocity - parent.velocity - np.cross(parent.spin, away)
    inwards = parent.rotation.transpose(0, 2, 1)
    relative = inwards @ child.rotation
    spin = np.einsum("tij,tj->ti", inwards, child.spin - parent.spin)
    return RelativeMotion(
        np.einsum("tij,tj->ti", inwards, away),
        np.einsum("tij,tj->ti", inwards, velocity),
        np.unwrap(np.arctan2(relative[:, 1, 0], relative[:, 0, 0])),
        spin[:, 2],
    )
