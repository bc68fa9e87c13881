"""How a mechanism is led from one position of its drives to the next, on the way of assembly on
which it began.
"""

from typing import NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.formulations.quasi_static import Posed
from jaxclear.multibody.assembly import nearest
from jaxclear.multibody.system import longest_arm, prepare
from jaxclear.simulation.spot import SETTLED, Spot, Way, settle

# Steps from a position to the next, at the least and at the most: they are halved where coordinates
# move by more than the first bound within one, or the way of assembly changes and they move by more
# than the second [rad, shares of the longest arm]. What moves further, however short the step, has
# jumped: a mechanism follows its drive without jumps, but for the root of what is left to a dead
# point.
STEPS_BETWEEN, MOST_BETWEEN = 4, 256
FURTHEST, FURTHEST_ACROSS = 0.3, 0.06


@eqx.filter_jit
def _settled(scene: Posed, start: Spot, way: Way) -> Spot:
    return settle(scene, start, way)


def _assembled(scene: Posed, way: Way) -> tuple[Spot, Array]:
    found = nearest(scene.mechanism)
    seats = {name: jnp.zeros(len(own)) for name, own in way.moving.items()}
    return Spot(found.start.coordinates, seats, jnp.zeros(()), jnp.zeros(())), found.sound


def _led(scene: Posed, start: Spot, before: np.ndarray, now: np.ndarray, way: Way) -> Spot:
    """The spot at the next position, led there in steps that are halved where it moves far. Raises
    `ValueError` where it jumps, however short the steps: the sign of the loops' determinant tells
    two ways of assembly apart, and spatial loops may have more of one sign."""
    scale, spot = _scales(scene), start
    share, size = 0.0, 1.0 / STEPS_BETWEEN
    while share < 1.0:
        found = _settled(scene.at(before + (share + size) * (now - before)), spot, way)
        moved = float(np.max(np.abs(found.q - spot.q) / scale, initial=0.0))
        settled = bool(found.change <= SETTLED)
        same = bool(found.branch == spot.branch)
        if settled and moved <= (FURTHEST if same else FURTHEST_ACROSS):
            spot, share = found, share + size
            # Twice as long again where the longer step begins at a multiple of itself.
            size *= 2.0 if size < 1.0 / STEPS_BETWEEN and share % (2.0 * size) == 0.0 else 1.0
        elif size > 1.0 / MOST_BETWEEN:
            size *= 0.5
        elif settled:
            _refuse_jump(scene, now)
        else:
            return found
    return spot


def _scales(scene: Posed) -> np.ndarray:
    """What each coordinate's moves are measured by, (coordinates,): the longest arm for lengths
    [m], 1 for angles."""
    system, topology = prepare(scene.mechanism), scene.mechanism.topology
    arm, scales = float(longest_arm(system)), []
    for link, branch in zip(system.links, topology.branches, strict=True):
        scales += [arm if u == "m" else 1.0 for u in link.joint.units[: branch.coordinate_count]]
    return np.array(scales)


def _named(scene: Posed, now: np.ndarray) -> str:
    """A position in words."""
    return ", ".join(f"{n} = {x:.6g}" for n, x in zip(scene.held, now, strict=True))


def _refuse_jump(scene: Posed, now: np.ndarray) -> NoReturn:
    raise ValueError(
        f"the mechanism jumps to another way of its assembly before {_named(scene, now)}: a dead "
        "point lies between this position and the one before, or close by. Give positions on one "
        "side of it."
    )


def spots_along(scene: Posed, position: np.ndarray, way: Way) -> Spot:
    """Where the mechanism stands at each position, gone through in their order. Raises
    `ValueError` for the first that it does not reach."""
    spot, sound = _assembled(scene.at(position[0]), way)
    spots, before = [], position[0]
    for i, now in enumerate(position):
        spot = _led(scene, spot, before, now, way) if i else _settled(scene.at(now), spot, way)
        if not (sound and spot.change <= SETTLED):
            raise ValueError(
                f"the mechanism cannot be assembled at position {i} ({_named(scene, now)}): no "
                "place of its bodies closes the loops there, or a dead point lies on the way from "
                "the position before. Give positions within reach, closer together."
            )
        spots.append(spot)
        before = now
    return jax.tree.map(lambda *own: jnp.stack(own), *spots)
