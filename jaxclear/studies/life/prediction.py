"""Where a motion settles on a surface worn further: carried on in a straight line from the last two
surfaces on which it settled.

A journal follows the wall as that wears. Begun where the wall was, it would fall, and a cycle would
go to its settling.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import prepare
from jaxclear.results.state_history import SavedMotion

# So many times the way between two surfaces a line is carried on at the most.
FURTHEST = 4.0


class Place(NamedTuple):
    """A motion settled on surfaces of these depths [m], all cells in a row."""

    depth: np.ndarray
    motion: SavedMotion


def units_of_coordinates(mechanism: Mechanism) -> tuple[str, ...]:
    """Unit of each coordinate of the tree."""
    return tuple(
        unit
        for link, branch in zip(prepare(mechanism).links, mechanism.topology.branches, strict=True)
        for unit in link.joint.units[: branch.coordinate_count]
    )


def predicted(places: Sequence[Place], depth: np.ndarray, units: tuple[str, ...]) -> SavedMotion:
    """Where a motion begins on surfaces of this depth: at the end of the last one that settled,
    moved as the surfaces have moved since."""
    last = places[-1].motion
    before = next((p for p in places[-2::-1] if np.any(p.depth != places[-1].depth)), None)
    if before is None:
        return last
    way = places[-1].depth - before.depth
    share = float(np.dot(depth - places[-1].depth, way) / np.dot(way, way))
    share = float(np.clip(share, -FURTHEST, FURTHEST))
    coordinates = np.asarray(last.coordinates - before.motion.coordinates)
    turns = np.array([unit == "rad" for unit in units])
    # Whole turns are no change of place.
    coordinates = coordinates - np.where(turns, 2 * np.pi * np.round(coordinates / 2 / np.pi), 0.0)
    # So is a quaternion's opposite.
    quaternion = np.array([unit == "1" for unit in units])
    if np.any(np.abs(coordinates[quaternion]) > 0.5):
        return last
    speeds = last.speeds - before.motion.speeds
    return SavedMotion(
        last.time,
        jnp.asarray(last.coordinates + share * coordinates),
        jnp.asarray(last.speeds + share * speeds),
        last.remembered,
        last.names,
        last.remembered_names,
        last.redundancy,
    )
