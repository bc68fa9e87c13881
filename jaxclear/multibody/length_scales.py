"""What a difference in a coordinate means in metres, and how much room the joints with clearance
leave: by both an error is judged as one of place.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import REST
from jaxclear.ground.quantity import Scalar
from jaxclear.multibody.contact_point import depths
from jaxclear.multibody.loops import Closure
from jaxclear.multibody.system import System, longest_arm

# Joints of a body that are nearer than this share of the longest arm are at one place.
AT_ONE_PLACE = 1e-6
# Parts nearer than this share of it touch: it is rounding.
TOUCHING = 1e-12


def which_turn(system: System) -> Bool[np.ndarray, " coordinates"]:
    """Of each coordinate of the tree whether it turns: it is no length."""
    links = zip(system.topology.branches, system.links, strict=True)
    units = [u for branch, link in links if branch.coordinate_count for u in link.joint.units]
    return np.array([unit != "m" for unit in units], bool)


def reach_by_coordinate(system: System, arm: Any) -> Float[Array, " coordinates"]:
    """How far bodies move for a unit of each coordinate of the tree [m]: 1 for a length, the length
    `arm` [m] for what turns."""
    return jnp.where(which_turn(system), arm, 1.0)


def rooms(system: System) -> Float[Array, " contacts"]:
    """The room on one side [m] that each possible contact leaves where its parts stand as drawn,
    unworn."""
    return sp.stack(
        [abs(depth) for part in system.bearings.values() for depth in depths(part.joint, REST, {})]
    )


def narrowest_gap(system: System) -> Scalar:
    """Smallest of the `rooms` [m] that are gaps; infinite without clearance."""
    part = rooms(system) if system.bearings else jnp.zeros(0)
    return narrowest(part, longest_arm(system))


def narrowest(rooms: Float[Array, " contacts"], arm: Any) -> Scalar:
    """Smallest of rooms [m]; infinite where there is none. Parts that touch as drawn, such as a
    ball on a floor, leave no gap by which an error could be judged."""
    return jnp.min(jnp.where(is_gap(rooms, arm), rooms, jnp.inf), initial=jnp.inf)


def is_gap(space: Any, arm: Any) -> Any:
    """Whether parts with this room [m] between them do not touch as drawn."""
    return space > TOUCHING * arm


def gaps_crossed(system: System, direction: Float[Array, " state"]) -> Scalar:
    """By how much places move at the most where a state moves so [1], beside the narrowest gap,
    beside the longest arm where there are none."""
    arm = longest_arm(system)
    arms = reach_by_coordinate(system, arm)
    gap = narrowest_gap(system) if system.bearings else arm
    return jnp.max(arms * abs(direction[: len(arms)]), initial=0.0) / gap


def shortest_part(system: System, closure: Closure) -> Scalar:
    """The shortest distance [m] within a body between two joints of a loop, beside which it is
    judged how far it is open; joints at one place leave none. The longest arm where all are."""
    inboard = {
        i: None if system.links[i].parent < 0 else subtree[system.links[i].parent]
        for subtree in system.topology.subtrees
        for i in subtree
    }
    ends = (closure.parent_link, closure.parent), (closure.child_link, closure.child)
    squares, places = [], []
    up = [_iterate_to_ground(link, inboard) for link, _ in ends]
    common = next(link for link in up[0] if link in up[1])
    for (_, marker), links in zip(ends, up, strict=True):
        place = marker.translation
        for link in links:
            if link is None or link == common:
                break
            squares.append(sp.dot(place, place))
            place = system.links[link].base.translation
        places.append(place)
    across = sp.minus(*places)
    squares.append(sp.dot(across, across))
    part, arm = jnp.asarray(sp.stack(squares), float), longest_arm(system)
    shortest = jnp.min(jnp.where(part > (AT_ONE_PLACE * arm) ** 2, part, jnp.inf))
    return jnp.sqrt(jnp.minimum(shortest, arm * arm))


def _iterate_to_ground(link: int | None, inboard: dict[int, int | None]) -> list[int | None]:
    """A link and those that carry it, the ground (None) last."""
    result = [link]
    while result[-1] is not None:
        result.append(inboard[result[-1]])
    return result
