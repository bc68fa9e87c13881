"""What a run looks like in space: bodies and joints as triangles, each in the frame of its body
[m], and worn walls as quadrilaterals, one for each cell of a wear map.

A body without a mesh is the cuboid that has its mass and moments of inertia, as far as that is no
larger than its joints are apart, with a rod to each of its joints; in the plane, where only one
moment is known, a slender bar, or a square plate where all joints are in one place. A joint is
drawn by what it holds: a pin in a bush, a ball, a slider on its rail; one with clearance in its own
size where it has one.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxclear.components.beam import parts_of_beams
from jaxclear.components.body import GROUND, Body, Connection
from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.wording import described
from jaxclear.results.relative_motion import marker_frame, marker_motion, relative_motion

AROUND = 24
# A flat body is drawn at least so thick, and a rod so thin, as shares of the mechanism's size.
THINNEST, ROD = 0.012, 0.008
# Length over width of a bar in the plane, and the most of that size that it is wide; and what a
# body measures where its joints are in one place.
SLENDER, WIDEST, BLOCK = 10.0, 0.05, 0.1


class Triangles(NamedTuple):
    """`points` (n, 3) [m] and the three `corners` (m, 3) of each triangle, as indices of them."""

    points: np.ndarray
    corners: np.ndarray

    def moved(self, rotation: np.ndarray, place: np.ndarray) -> "Triangles":
        """In another frame."""
        return Triangles(self.points @ np.asarray(rotation).T + place, self.corners)


def join_parts(parts: Iterable[Triangles]) -> Triangles:
    """All parts as one; none at all are no triangles."""
    count, points, corners = 0, [np.zeros((0, 3))], [np.zeros((0, 3), int)]
    for part in parts:
        points.append(part.points)
        corners.append(part.corners + count)
        count += len(part.points)
    return Triangles(np.concatenate(points), np.concatenate(corners))


def make_box(sides: Any) -> Triangles:
    """A cuboid about the origin. Faces have corners of their own, so that edges stay sharp."""
    parts = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            first, second = (axis + 1) % 3, (axis + 2) % 3
            points = np.zeros((4, 3))
            points[:, axis] = side
            points[:, first] = [-side, side, side, -side]
            points[:, second] = [-1, -1, 1, 1]
            parts.append(Triangles(points, np.array([[0, 1, 2], [0, 2, 3]])))
    cube = join_parts(parts)
    return Triangles(0.5 * cube.points * np.asarray(sides, float), cube.corners)


def _revolve(profile: np.ndarray) -> Triangles:
    """A closed outline of points (radius, z) turned about z; edges are sharp."""
    angle = np.linspace(0, 2 * np.pi, AROUND + 1)
    across = np.stack([np.cos(angle), np.sin(angle)], -1)
    parts = []
    for (r0, z0), (r1, z1) in zip(profile, np.roll(profile, -1, axis=0), strict=True):
        rings = [np.c_[r * across, np.full(len(angle), z)] for r, z in ((r0, z0), (r1, z1))]
        low = np.arange(AROUND)
        high = low + AROUND + 1
        corners = np.concatenate(
            [np.stack([low, low + 1, high], -1), np.stack([low + 1, high + 1, high], -1)]
        )
        parts.append(Triangles(np.concatenate(rings), corners))
    return join_parts(parts)


def rod(radius: float, length: float) -> Triangles:
    """A cylinder along z about the origin."""
    half = 0.5 * length
    return _revolve(np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]]))


def make_tube(inner: float, outer: float, length: float) -> Triangles:
    """A hollow cylinder along z about the origin.

    Args:
        inner, outer: radii [m].
        length: along z [m].
    """
    half = 0.5 * length
    return _revolve(np.array([[inner, -half], [outer, -half], [outer, half], [inner, half]]))


def make_ball(radius: float) -> Triangles:
    """A sphere about the origin."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, AROUND // 2 + 1)
    return _revolve(radius * np.stack([np.cos(angle), np.sin(angle)], -1))


def make_capsule(radius: float, length: float) -> Triangles:
    """A cylinder along z about the origin, of this length between the half spheres at its ends."""
    angle = np.linspace(0, 0.5 * np.pi, AROUND // 4 + 1)
    upper = np.stack([radius * np.cos(angle), 0.5 * length + radius * np.sin(angle)], -1)
    return _revolve(np.concatenate([upper[::-1] * [1, -1], upper]))


def rod_between(start: np.ndarray, end: np.ndarray, radius: float) -> Triangles:
    """A cylinder from one point to another.

    Args:
        start, end: centres of its faces [m].
        radius: [m].
    """
    axis = np.asarray(end) - start
    length = float(np.linalg.norm(axis))
    return rod(radius, length).moved(_along(axis / length), 0.5 * (np.asarray(start) + end))


def _along(direction: np.ndarray) -> np.ndarray:
    """A rotation that brings z into a direction."""
    across = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(across, direction)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first), direction], 1)


def solid_of_body(body: Body, joints: np.ndarray, size: float) -> Triangles:
    """A solid for a body: a block by its inertia, with rods to its joints.

    Args:
        body: with mass, centre of mass and inertia.
        joints: positions of its joints [m], shape (n, 3).
        size: of the mechanism [m], by which rods are drawn.
    """
    com = np.zeros(3)
    if body.com is not None:
        com[: len(body.com)] = [float(x) for x in body.com]
    turn, sides = _cuboid(body, joints, size)
    extent = np.ptp(joints @ turn, axis=0) if len(joints) else np.zeros(3)
    sides = np.minimum(sides, np.maximum(extent, BLOCK * size))
    middle = com
    if len(body.inertia) == 1 and len(joints) > 1:
        # A bar in the plane lies between its joints, where its centre of mass may not be.
        along = turn[:, 0]
        middle = joints[0] + along * (along @ (com - joints[0]))
    solid = make_box(np.maximum(sides, THINNEST * size)).moved(turn, middle)
    ends = [end for end in joints if np.linalg.norm(end - com) > 1e-6 * size]
    return join_parts([solid, *(rod_between(com, end, ROD * size) for end in ends)])


def _cuboid(body: Body, joints: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) and sides (3,) [m] of the cuboid with a body's mass and moments of inertia."""
    moments = np.array(jax.tree.map(float, body.inertia_matrix())) / float(body.mass)
    if len(body.inertia) > 1:
        values, axes = np.linalg.eigh(moments)
        return axes, np.sqrt(np.maximum(6.0 * (values.sum() - 2.0 * values), 0.0))
    square = 12.0 * moments[2, 2]
    away = joints - (joints[0] if len(joints) > 1 else np.zeros(3))
    farthest = np.zeros(3) if not len(away) else away[np.linalg.norm(away, axis=1).argmax()]
    spread = np.ptp(joints, axis=0) if len(joints) else np.zeros(3)
    if np.linalg.norm(spread[:2]) < 0.1 * np.sqrt(square):
        return np.eye(3), np.sqrt(0.5 * square) * np.array([1.0, 1.0, 0.4])
    x, y = farthest[:2] / np.linalg.norm(farthest[:2])
    length = np.sqrt(square)
    width = min(length / SLENDER, WIDEST * size)
    turn = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
    # Thin, so that what slides along it is seen.
    return turn, np.array([length, width, 0.4 * width])


# Radius of a pin or ball without a size of its own, and how much wider what is around it is; shares
# of the mechanism's size.
PIN, AROUND_IT, LONG = 0.016, 1.35, 0.06
# Cosine of the largest tilt of bodies that move in a plane.
FLAT = 0.99
# A body of less than this share of the heaviest one's mass has no size of its own.
NO_MASS = 1e-9


class Part(NamedTuple):
    """Triangles of a body, or of the ground: its `solid`, and what its `joints` are drawn by."""

    solid: Triangles
    joints: dict[str, Triangles]

    @property
    def triangles(self) -> Triangles:
        """All of them."""
        return join_parts([*self.joints.values(), self.solid])


def size_of(run: Any) -> float:
    """The longest side [m] of the box in which all joints and centres of mass move."""
    places = [np.asarray(run.body(name).com) for name in run.mechanism.bodies]
    places += [marker_motion(run, c.parent).place for c in run.mechanism.connections.values()]
    every = np.concatenate(places)
    every = every[np.isfinite(every).all(axis=1)]
    return float(np.ptp(every, axis=0).max()) or 1.0


def moves_in_plane(run: Any) -> bool:
    """Whether all bodies turn about z alone, up to their tilt in joints with clearance."""
    turns = [np.asarray(run.body(name).rotation)[:, 2, 2] for name in run.mechanism.bodies]
    return min(np.nanmin(turn) for turn in turns) > FLAT


def parts(run: Any, meshes: Mapping[str, Triangles], size: float) -> dict[str, Part]:
    """Solids by which the ground and every body are drawn, by name.

    Args:
        run: trajectory; joints that slide are drawn as long as they travel.
        meshes: by body, instead of the solid that would be drawn.
        size: of the mechanism [m].
    """
    ends: dict[str, list[np.ndarray]] = {name: [] for name in (GROUND, *run.mechanism.bodies)}
    joints: dict[str, dict[str, Triangles]] = {name: {} for name in ends}
    hinges = parts_of_beams(run.mechanism.loads)
    for name, connection in run.mechanism.connections.items():
        outer, inner = _joint(connection, size, _travel_of_slider(run, name))
        for marker, part in ((connection.parent, outer), (connection.child, inner)):
            rotation, place = marker_frame(marker)
            if not len(part.points):
                continue
            ends[marker.body].append(place)
            if marker.body == GROUND and not slides(connection.joint):
                part = join_parts([part, _base_plate(part)])
            if name not in hinges:
                joints[marker.body][name] = part.moved(rotation, place)
    solids = {name: join_parts([]) for name in ends} | dict(meshes)
    heaviest = max(float(body.mass) for body in run.mechanism.bodies.values())
    for name, body in run.mechanism.bodies.items():
        # One without mass is only there to join others, such as one between two hinges: its joints
        # are seen.
        if name not in meshes and float(body.mass) >= NO_MASS * heaviest:
            solids[name] = solid_of_body(body, np.array(ends[name]).reshape(-1, 3), size)
    return {name: Part(solids[name], joints[name]) for name in ends}


def slides(joint: Any) -> bool:
    """Whether a joint, ideal or with clearance, slides along its z axis and does not turn."""
    rows = rows_of(joint)
    return "z" not in rows and "x.z" in rows


def rows_of(joint: Any) -> set[str]:
    """Names of the relative motions that a joint, ideal or with clearance, prevents."""
    gap: Any = getattr(joint, "gap", joint)
    return set(getattr(gap, "rows", ()) or getattr(gap, "ideal_rows", ()))


def _base_plate(part: Triangles) -> Triangles:
    """What a joint of the ground is fastened to: a square behind its part."""
    width, thick = 1.5 * np.ptp(part.points[:, 0]), 0.1 * np.ptp(part.points[:, 0])
    behind = np.array([0.0, 0.0, part.points[:, 2].min() - 0.5 * thick])
    return make_box((width, width, thick)).moved(np.eye(3), behind)


def _joint(connection: Connection, size: float, travel: tuple[float, float]) -> tuple:
    """(outer part, on the parent; inner part, on the child), each in its marker's frame."""
    joint: Any = connection.joint
    joint, rows = getattr(joint, "gap", joint), rows_of(joint)
    empty = Triangles(np.zeros((0, 3)), np.zeros((0, 3), int))
    if not {"x"} <= rows:
        return empty, empty
    if slides(joint):
        return _rail_solids(joint, size, travel)
    radius = float(getattr(joint, "bearing_radius", getattr(joint, "socket_radius", PIN * size)))
    if rows == {"x", "y", "z"}:
        ring = make_tube(1.02 * radius, AROUND_IT * radius, radius)
        return ring, make_ball(radius)
    long = float(getattr(joint, "length", None) or LONG * size)
    return make_tube(radius, AROUND_IT * radius, 0.8 * long), rod(0.98 * radius, long)


def _rail_solids(joint: Any, size: float, travel: tuple[float, float]) -> tuple:
    """Rails on both sides, as long as the slider travels, and the slider."""
    width = float(getattr(joint, "width", 2 * PIN * size))
    long = float(getattr(joint, "length", 2 * width))
    gap, thick = float(getattr(joint, "clearance", 0.0)), 0.25 * width
    low, high = travel[0] - 0.6 * long, travel[1] + 0.6 * long
    bar = make_box((thick, width, high - low))
    rails = [
        bar.moved(
            np.eye(3), np.array([side * (0.5 * (width + thick) + gap), 0.0, 0.5 * (low + high)])
        )
        for side in (-1, 1)
    ]
    return join_parts(rails), make_box((width, width, long))


def _travel_of_slider(run: Any, name: str) -> tuple[float, float]:
    """Least and largest place [m] of a child's marker along the z axis of its parent's."""
    along = relative_motion(run, name).offset[:, 2]
    along = along[np.isfinite(along)]
    return float(along.min()), float(along.max())


def checked_meshes(run: Any, meshes: Any) -> dict[str, Triangles]:
    """Meshes by body (and of the ground): of files (through meshio), or of points and triangles, or
    several by name."""
    if meshes is None:
        return {}
    expect(meshes, Mapping, "meshes", "a dictionary from names of bodies")
    for name in meshes:
        check_name("body", name, [*run.mechanism.bodies, GROUND], " in this mechanism")
    checked = {}
    for name, mesh in meshes.items():
        by_name = mesh if isinstance(mesh, Mapping) else {"": mesh}
        parts = (_mesh(f"{name}, {part}" if part else name, one) for part, one in by_name.items())
        checked[name] = join_parts(parts)
    return checked


def _mesh(name: str, mesh: Any) -> Triangles:
    what = f'the mesh of "{name}"'
    required = "the path of a file, or (points (n, 3) [m], triangles (m, 3))"
    if isinstance(mesh, (str, Path)):
        import meshio

        if not Path(mesh).is_file():
            raise ValueError(f"{what} is {str(mesh)!r}, and there is no such file.")
        # meshio guesses whether an STL file is a text by a number that may overflow.
        with np.errstate(over="ignore"):
            read = meshio.read(mesh)
        cells = [c.data for c in read.cells if c.type == "triangle"]
        if not cells:
            raise ValueError(f"{what}, {mesh}, holds no triangles.")
        mesh = read.points, np.concatenate(cells)
    if not isinstance(mesh, (tuple, list)) or len(mesh) != 2:
        raise ValueError(f"{what} is {described(mesh)}; it must be {required}.")
    points, corners = np.asarray(mesh[0], float), np.asarray(mesh[1])
    shaped = points.ndim == 2 and points.shape[1] == 3 and corners.ndim == 2
    inside = shaped and corners.shape[1] == 3 and corners.size and corners.min() >= 0
    if not inside or corners.max() >= len(points) or not np.isfinite(points).all():
        raise ValueError(
            f"{what} has points of shape {points.shape} and triangles of shape {corners.shape}; "
            f"it must be {required}, the triangles indices of the points."
        )
    return Triangles(points, corners.astype(int))


class Wall(NamedTuple):
    """`points` (n, 3) [m] of the worn wall, in the frame of its bearing, journal, socket, ball,
    guide or slider;
    `corners` (cells, 4) of each cell, and its `depth` (cells,) [m]."""

    points: np.ndarray
    corners: np.ndarray
    depth: np.ndarray


def _cylinder_points(wear_map: Any, reach: np.ndarray) -> np.ndarray:
    angle, height = _grid(reach, (-0.5 * float(wear_map.length), 0.5 * float(wear_map.length)))
    return np.stack([reach * np.cos(angle), reach * np.sin(angle), height], -1)


def _sphere_points(wear_map: Any, reach: np.ndarray) -> np.ndarray:
    angle, rise = _grid(reach, (-0.5 * np.pi, 0.5 * np.pi))
    flat = reach * np.cos(rise)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), reach * np.sin(rise)], -1)


def _grid(reach: np.ndarray, ends: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    around, along = reach.shape
    angle = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    first, second = np.broadcast_arrays(angle[:, None], np.linspace(*ends, along)[None])
    return first, second


# The shape of a wall, and whether wear widens it, by the surface's name.
SHAPES: dict[str, tuple[Callable, int]] = {
    "bearing": (_cylinder_points, 1),
    "journal": (_cylinder_points, -1),
    "socket": (_sphere_points, 1),
    "ball": (_sphere_points, -1),
}


def wall(wear_map: Any, surface: str, depth: np.ndarray) -> Wall | None:
    """The worn wall of a surface; None where its shape is unknown.

    Args:
        wear_map: cells of the surface.
        surface: its name, such as "bearing".
        depth: worn depth [m] of each cell, shape (around, along).
    """
    if wear_map.flat:
        return _flat_wall(wear_map, 1 if surface == "guide" else -1, depth)
    if surface not in SHAPES:
        return None
    shape, sign = SHAPES[surface]
    around, along = depth.shape
    ringed = np.concatenate([depth[-1:], depth])
    columns = 0.5 * (ringed[1:] + ringed[:-1])
    padded = np.pad(columns, ((0, 0), (1, 1)), mode="edge")
    reach = float(wear_map.radius) + sign * 0.5 * (padded[:, 1:] + padded[:, :-1])
    points = shape(wear_map, reach).reshape(-1, 3)
    column, row = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    after = (column + 1) % around
    place = lambda i, j: i * (along + 1) + j
    corners = [place(column, row), place(after, row), place(after, row + 1), place(column, row + 1)]
    return Wall(points, np.stack(corners, -1).reshape(-1, 4), depth.reshape(-1))


def _flat_wall(wear_map: Any, sign: int, depth: np.ndarray) -> Wall:
    """The walls of a guide, or the faces of a slider, each as deep as its cells at their edges."""
    along = depth.shape[1]
    padded = np.pad(depth, ((0, 0), (1, 1)), mode="edge")
    away = float(wear_map.distance) + sign * 0.5 * (padded[:, 1:] + padded[:, :-1])
    ends = np.array([-0.5, 0.5])
    x = (np.array([-1.0, 1.0])[:, None] * away)[..., None] * np.ones(2)
    y = np.broadcast_to(float(wear_map.breadth) * ends, x.shape)
    z = float(wear_map.middle) + float(wear_map.length) * np.linspace(-0.5, 0.5, along + 1)
    points = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], -1).reshape(-1, 3)
    side, row = np.meshgrid(np.arange(2), np.arange(along), indexing="ij")
    first = 2 * (side * (along + 1) + row)
    corners = np.stack([first, first + 1, first + 3, first + 2], -1).reshape(-1, 4)
    return Wall(points, corners, depth.reshape(-1))
