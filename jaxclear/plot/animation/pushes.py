"""Forces of contacts in space: for every possible contact of a joint with clearance an arrow that
ends where it touches, along the normal force on the journal, while it touches.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxclear.ground import sparse as sp
from jaxclear.results.relative_motion import seen
from jaxclear.results.solids.shapes import Triangles, joined, rod
from jaxclear.results.trajectory import Trajectory

__all__ = ["Pushes", "arrow", "pushes"]

# Length of the arrow of the largest force and of the smallest, and its radius, as shares of the
# mechanism's size; the head's share of the length, and its radius in shafts.
LONGEST, SHORTEST, THICK = 0.22, 0.04, 0.006
HEAD, WIDE = 0.3, 2.6
# Of an arrow that is not there.
NONE = 1e-9


class Pushes(NamedTuple):
    """`matrices` (contacts, frames, 4, 4) that bring the unit arrow into place, `names` of the
    contacts, and the `largest` force [N] of all saving times."""

    matrices: np.ndarray
    names: tuple[str, ...]
    largest: float


def arrow() -> Triangles:
    """An arrow along z that ends in the origin, of length and shaft radius 1."""
    shaft = rod(1.0, 1.0 - HEAD).moved(np.eye(3), np.array([0.0, 0.0, -0.5 * (1.0 + HEAD)]))
    angle = np.linspace(0, 2 * np.pi, 13)[:-1]
    rim = np.stack([WIDE * np.cos(angle), WIDE * np.sin(angle), np.full(12, -HEAD)], -1)
    points = np.concatenate([rim, [[0.0, 0.0, 0.0], [0.0, 0.0, -HEAD]]])
    low, high = np.arange(12), (np.arange(12) + 1) % 12
    side = np.stack([low, high, np.full(12, 12)], -1)
    base = np.stack([high, low, np.full(12, 13)], -1)
    return joined([shaft, Triangles(points, np.concatenate([side, base]))])


def pushes(run: Trajectory, frames: np.ndarray, last: int, size: float) -> Pushes:
    """The arrows of a run over the saving times `frames`, in a mechanism of this size [m]."""
    found, names = [], []
    joints = run.formulation.contact_joints(run.mechanism)
    histories = {name: run.contact(name) for name in joints}
    every = [np.nan_to_num(np.asarray(own.normal_force)[:last]) for own in histories.values()]
    largest = max((float(own.max(initial=0.0)) for own in every), default=0.0)
    for name, history in histories.items():
        forces = np.nan_to_num(np.asarray(history.normal_force)[frames])
        place, towards = _contacts(run, name, history, frames)
        for k, contact in enumerate(history.names):
            names.append(f"{name}, {contact}")
            found.append(_matrices(place[:, k], towards[:, k], forces[:, k], largest, size))
    matrices = np.stack(found) if found else np.zeros((0, len(frames), 4, 4), np.float32)
    return Pushes(matrices, tuple(names), largest)


def _contacts(run: Trajectory, name: str, history: Any, frames: np.ndarray) -> tuple:
    """Places (frames, contacts, 3) [m] of a joint's contacts and directions of the normal forces on
    its journal, in the ground frame."""
    connection = run.mechanism.connections[name]
    joint: Any = connection.joint
    joint = getattr(joint, "gap", joint)
    outer, inner = seen(run, connection.parent), seen(run, connection.child)
    turn = np.asarray(outer.rotation)[frames]
    own = turn.transpose(0, 2, 1) @ np.asarray(inner.rotation)[frames]

    def normals(offset, axes, depths):
        vectors = tuple(tuple(axes[:, k]) for k in joint.axes)
        candidates = joint.contact_candidates(tuple(offset), vectors, tuple(depths))
        return sp.stack([x for one in candidates for x in sp.stack(one.normal)])

    offset, depths = (np.asarray(x)[frames] for x in (history.offset, history.indentation))
    away = np.asarray(jax.vmap(normals)(offset, own, depths)).reshape(len(frames), -1, 3)
    place = np.nan_to_num(np.asarray(history.place)[frames])
    origin = np.asarray(outer.place)[frames, None]
    return origin + place @ turn.transpose(0, 2, 1), -away @ turn.transpose(0, 2, 1)


def _matrices(
    place: np.ndarray, towards: np.ndarray, force: np.ndarray, largest: float, size: float
) -> np.ndarray:
    """Where the unit arrow is, in which direction, how long and thick, frame by frame."""
    acts = (force > 0) & np.isfinite(towards).all(axis=-1)
    share = np.sqrt(force / largest) if largest > 0 else np.zeros(len(force))
    long = np.where(acts, (SHORTEST + (LONGEST - SHORTEST) * share) * size, NONE * size)
    thick = np.where(acts, THICK * size, NONE * size)
    along = np.where(acts[:, None], towards, [0.0, 0.0, 1.0])
    beside = np.eye(3)[np.argmin(np.abs(along), axis=-1)]
    first = np.cross(beside, along)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    axes = np.stack([first, np.cross(along, first), along], -1)
    found = np.zeros((len(force), 4, 4), np.float32)
    found[:, :3, :3] = axes * np.stack([thick, thick, long], -1)[:, None, :]
    found[:, :3, 3] = place
    found[:, 3, 3] = 1.0
    return found
