"""What the insets of an animation show: every joint with clearance, its gap magnified.

A joint is told by views. In a round one the journal (or ball) lies in its bearing, the wall being
the places that its centre reaches before it touches a new surface; in a slot the corners of a
slider lie before its walls. Another joint shows how deep its contacts are.

Forces of contacts in space: for every possible contact of a joint with clearance an arrow that
ends where it touches, along the normal force on the journal, while it touches.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxclear.components.clearance import (
    BallSocket,
    JournalBearing,
    PlanarJournalBearing,
    SliderGuide,
)
from jaxclear.ground import sparse as sp
from jaxclear.results.relative_motion import marker_motion
from jaxclear.results.response import PeakContactForce
from jaxclear.results.solids import Triangles, join_parts, rod
from jaxclear.results.trajectory import Trajectory

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
    return join_parts([shaft, Triangles(points, np.concatenate([side, base]))])


def pushes(run: Trajectory, frames: np.ndarray, last: int, size: float) -> Pushes:
    """The arrows of contact forces over the frames of an animation.

    Args:
        run: trajectory.
        frames: indices of the saving times that are shown.
        last: number of saving times over which the largest force is taken.
        size: of the mechanism [m], by which arrows are scaled.
    """
    placed, names = [], []
    joints = run.formulation.contact_joints(run.mechanism)
    histories = {name: run.contact(name) for name in joints}
    every = [np.nan_to_num(np.asarray(h.normal_force)[:last]) for h in histories.values()]
    largest = max((float(h.max(initial=0.0)) for h in every), default=0.0)
    for name, history in histories.items():
        forces = np.nan_to_num(np.asarray(history.normal_force)[frames])
        place, towards = _contact_places(run, name, history, frames)
        for k, contact in enumerate(history.names):
            names.append(f"{name}, {contact}")
            placed.append(_arrow_matrices(place[:, k], towards[:, k], forces[:, k], largest, size))
    matrices = np.stack(placed) if placed else np.zeros((0, len(frames), 4, 4), np.float32)
    return Pushes(matrices, tuple(names), largest)


def _contact_places(run: Trajectory, name: str, history: Any, frames: np.ndarray) -> tuple:
    """Places (frames, contacts, 3) [m] of a joint's contacts and directions of the normal forces on
    its journal, in the ground frame."""
    connection = run.mechanism.connections[name]
    joint: Any = connection.joint
    joint = getattr(joint, "gap", joint)
    outer, inner = marker_motion(run, connection.parent), marker_motion(run, connection.child)
    turn = np.asarray(outer.rotation)[frames]
    relative = turn.transpose(0, 2, 1) @ np.asarray(inner.rotation)[frames]

    offset, depths = (np.asarray(x)[frames] for x in (history.offset, history.indentation))
    away = np.asarray(_normals(joint, offset, relative, depths)).reshape(len(frames), -1, 3)
    place = np.nan_to_num(np.asarray(history.place)[frames])
    origin = np.asarray(outer.place)[frames, None]
    return origin + place @ turn.transpose(0, 2, 1), -away @ turn.transpose(0, 2, 1)


@eqx.filter_jit
def _normals(joint: Any, offsets: Any, rotations: Any, indentations: Any) -> Any:
    """Normals of a joint's contacts, frame by frame, as one compiled program."""

    def at_frame(offset, axes, depths):
        vectors = tuple(tuple(axes[:, k]) for k in joint.axes)
        candidates = joint.contact_candidates(tuple(offset), vectors, tuple(depths))
        return sp.stack([x for one in candidates for x in sp.stack(one.normal)])

    return jax.vmap(at_frame)(offsets, rotations, indentations)


def _arrow_matrices(
    place: np.ndarray, towards: np.ndarray, force: np.ndarray, largest: float, size: float
) -> np.ndarray:
    """Where the unit arrow is, in which direction, how long and thick, frame by frame."""
    acts = (force > 0) & np.isfinite(towards).all(axis=-1)
    share = np.sqrt(force / largest) if largest > 0 else np.zeros(len(force))
    long = np.where(acts, (SHORTEST + (LONGEST - SHORTEST) * share) * size, NONE * size)
    thick = np.where(acts, THICK * size, NONE * size)
    along = np.where(acts[:, None], towards, [0.0, 0.0, 1.0])
    across = np.eye(3)[np.argmin(np.abs(along), axis=-1)]
    first = np.cross(across, along)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    axes = np.stack([first, np.cross(along, first), along], -1)
    matrices = np.zeros((len(force), 4, 4), np.float32)
    matrices[:, :3, :3] = axes * np.stack([thick, thick, long], -1)[:, None, :]
    matrices[:, :3, 3] = place
    matrices[:, 3, 3] = 1.0
    return matrices


# Directions in which a wall is drawn, and columns of the chart of forces.
DIRECTIONS, COLUMNS = 180, 400
TURN = np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False)


class Worn(NamedTuple):
    """A worn wall along a circle: `depth` (cells,) [m] at the end, and the `share` of it that was
    there at each frame (frames, cells), in bytes."""

    depth: np.ndarray
    share: np.ndarray


def inset(run: Trajectory, name: str, frames: np.ndarray, last: int) -> dict[str, Any]:
    """Data that the inset of a joint shows.

    Args:
        run: trajectory.
        name: clearance joint.
        frames: indices of the saving times that are shown.
        last: number of saving times over which the force is charted.
    """
    history = run.contact(name)
    joint = run.mechanism.connections[name].joint
    joint = getattr(joint, "gap", joint)
    force = np.asarray(history.normal_force)
    every = np.nan_to_num(force[:last].sum(axis=1))
    columns = np.array_split(np.arange(last), min(COLUMNS, last))
    return {
        "name": name,
        "clearance": float(getattr(joint, "clearance", 0.0)),
        "contacts": list(history.names),
        "depth": np.asarray(history.indentation)[frames],
        "force": np.nan_to_num(force[frames]),
        "most": float(every.max(initial=0.0)),
        "peak": float(PeakContactForce(name)(run)),
        "chart": np.array([[np.asarray(run.time)[data[0]], every[data].max()] for data in columns]),
        "views": VIEWS.get(type(joint), _view_depths)(run, name, joint, history, frames),
    }


def _journal_view(
    title: str, centre: np.ndarray, wall: Any, paths: np.ndarray, contacts: list, worn: Worn | None
) -> dict[str, Any]:
    """A journal in a hole: its `centre` (frames, 2) [m], the `wall` (directions,) [m], the `ways`
    (frames, contacts, 2) towards its `contacts`, and how deep the wall has `worn`."""
    return {
        "kind": "round",
        "title": title,
        "centre": centre,
        "wall": wall,
        "ways": paths,
        "of": contacts,
        "worn": None if worn is None else worn.depth,
        "grown": None if worn is None else worn.share,
    }


def _worn_depth(run: Trajectory, name: str, surface: str) -> np.ndarray | None:
    """Depth of a surface [m], None where it does not wear."""
    depth_of = run.worn.get(name, {}).get(surface)
    return None if depth_of is None else np.asarray(depth_of)


def _wall_over_time(
    run: Trajectory, surface: tuple[str, str], frames: np.ndarray, circle: Callable, cut: Callable
) -> Worn | None:
    """A `surface` (joint, its name) along a circle at each of `frames`, all of its depth where it
    does not wear any more; None for one that does not wear. `circle` takes the circle from the
    depth, `cut` from the form in which the gap reads it."""
    name, side = surface
    worn = _worn_depth(run, name, side)
    if worn is None:
        return None
    joint: Any = run.mechanism.connections[name].joint
    # As the surface was updated last before a saving time, and at the end as it is then.
    updated = jax.tree.map(np.asarray, run.history.read[name][side])
    at_end = cut(joint.maps()[side][0].reading(run.worn[name][side]))
    depth = np.concatenate([cut(updated)[:-1], np.asarray(at_end)[None]])[frames]
    share = np.where(at_end > 0, depth / np.where(at_end > 0, at_end, 1.0), 1.0)
    in_bytes = np.round(255 * np.clip(np.nan_to_num(share), 0.0, 1.0)).astype(np.uint8)
    return Worn(circle(worn), in_bytes)


def _paths(history: Any, frames: np.ndarray, contacts: list, axes: tuple[int, int]) -> np.ndarray:
    place = np.nan_to_num(np.asarray(history.place)[frames][:, contacts][..., list(axes)])
    return place / np.maximum(np.linalg.norm(place, axis=-1, keepdims=True), 1e-30)


def _wall_of_joint(joint: Any) -> np.ndarray:
    """Reach of the journal's centre in each direction [m]: the clearance, and lobes."""
    reach = [joint.leaned((np.cos(a), np.sin(a), 0.0))[:2] for a in TURN]
    return np.array(reach, float)


def _view_bore(run: Trajectory, name: str, joint: Any, history: Any, frames: np.ndarray) -> list:
    """A planar journal."""
    centre = np.asarray(history.offset)[frames, :2]
    along = lambda depth: depth[:, 0]
    wear = _wall_over_time(run, (name, "bearing"), frames, along, lambda read: read[0][..., 2:-2])
    paths = _paths(history, frames, [0], (0, 1))
    return [_journal_view("across the axis", centre, _wall_of_joint(joint), paths, [0], wear)]


def _ends(run: Trajectory, name: str, joint: Any, history: Any, frames: np.ndarray) -> list:
    """A journal that tilts: both end planes of its bearing."""
    offset, axis = (np.asarray(ends)[frames] for ends in (history.offset, history.axis))
    views = []
    for end, centre in enumerate(joint.end_centres(tuple(offset.T), (tuple(axis.T),))):
        place = np.stack([np.broadcast_to(np.asarray(x), len(frames)) for x in centre[:2]], -1)
        paths = _paths(history, frames, [end], (0, 1))
        along = lambda depth, end=end: depth[:, -end]
        cut = lambda read, end=end: read[-end][..., 2:-2]
        wear = _wall_over_time(run, (name, "bearing"), frames, along, cut)
        title = ("lower end", "upper end")[end]
        views.append(_journal_view(title, place, _wall_of_joint(joint), paths, [end], wear))
    return views


def _view_ball(run: Trajectory, name: str, joint: Any, history: Any, frames: np.ndarray) -> list:
    """A ball, from above and from the side of its socket."""
    offset = np.asarray(history.offset)[frames]
    wall = float(joint.clearance) * np.stack([np.cos(TURN), np.sin(TURN)], -1)
    view = []
    for title, axes in (("along z: x, y", (0, 1)), ("along y: x, z", (0, 2))):
        cut = lambda read, axes=axes: _cut_through_socket(read, axes)
        wear = _wall_over_time(run, (name, "socket"), frames, cut, cut)
        paths = _paths(history, frames, [0], axes)
        view.append(_journal_view(title, offset[:, axes], wall, paths, [0], wear))
    return view


def _cut_through_socket(worn: np.ndarray, axes: tuple[int, int]) -> np.ndarray:
    """Depth (..., cells) along the circle in which a plane through the middle cuts a socket
    (..., around, along): the equator, or the meridians of 0 and 180 degrees."""
    around, along = worn.shape[-2:]
    low = along // 2
    if axes == (0, 1):
        return np.asarray(worn[..., low])
    here, there = worn[..., 0, :], worn[..., around // 2, :]
    return np.concatenate([here[..., low:], there[..., ::-1], here[..., :low]], axis=-1)


def _view_slot(run: Trajectory, name: str, joint: Any, history: Any, frames: np.ndarray) -> list:
    """A slider between two walls."""
    return [{"kind": "slot", "title": "along the guide", "of": [0, 1, 2, 3]}]


def _view_depths(run: Trajectory, name: str, joint: Any, history: Any, frames: np.ndarray) -> list:
    """How deep the contacts of any joint are."""
    count = np.asarray(history.indentation).shape[1]
    return [{"kind": "bars", "title": "indentation", "of": list(range(count))}]


# What is drawn of a joint, by its kind; of a joint of one's own, how deep its contacts are.
VIEWS: dict[type, Callable] = {
    PlanarJournalBearing: _view_bore,
    JournalBearing: _ends,
    BallSocket: _view_ball,
    SliderGuide: _view_slot,
}
