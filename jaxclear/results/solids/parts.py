"""The parts of a mechanism as triangles, each in the frame of its body; and where the joints are.

A joint is drawn by what it holds: a pin in a bush, a ball, a slider on its rail. One with clearance
is drawn in its own size where it has one.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxclear.components.body import GROUND, Connection
from jaxclear.ground.arguments import check_known, expect
from jaxclear.ground.wording import described
from jaxclear.results.relative_motion import marker_frame, relative_motion, seen
from jaxclear.results.solids import shapes
from jaxclear.results.solids.shapes import Triangles

__all__ = ["Part", "checked_meshes", "parts", "size_of"]

# Radius of a pin or ball without a size of its own, and how much wider what is around it is; shares
# of the mechanism's size.
PIN, AROUND_IT, LONG = 0.016, 1.35, 0.06
# A body of less than this share of the heaviest one's mass has no size of its own.
NO_MASS = 1e-9


class Part(NamedTuple):
    """Triangles of a body, or of the ground: its `solid`, and what its `joints` are drawn by."""

    solid: Triangles
    joints: dict[str, Triangles]

    @property
    def whole(self) -> Triangles:
        """All of them."""
        return shapes.joined([*self.joints.values(), self.solid])


def size_of(run: Any) -> float:
    """The longest side [m] of the box in which all joints and centres of mass move."""
    places = [np.asarray(run.body(name).com) for name in run.mechanism.bodies]
    places += [seen(run, own.parent).place for own in run.mechanism.connections.values()]
    every = np.concatenate(places)
    every = every[np.isfinite(every).all(axis=1)]
    return float(np.ptp(every, axis=0).max()) or 1.0


def parts(run: Any, meshes: Mapping[str, Triangles], size: float) -> dict[str, Part]:
    """What every body, and the ground, is drawn by."""
    ends: dict[str, list[np.ndarray]] = {name: [] for name in (GROUND, *run.mechanism.bodies)}
    joints: dict[str, dict[str, Triangles]] = {name: {} for name in ends}
    for name, connection in run.mechanism.connections.items():
        outer, inner = _joint(connection, size, _travel(run, name))
        for marker, part in ((connection.parent, outer), (connection.child, inner)):
            rotation, place = marker_frame(marker)
            if not len(part.points):
                continue
            ends[marker.body].append(place)
            joints[marker.body][name] = part.moved(rotation, place)
    solids = {name: shapes.joined([]) for name in ends} | dict(meshes)
    heaviest = max(float(body.mass) for body in run.mechanism.bodies.values())
    for name, body in run.mechanism.bodies.items():
        # One without mass is only there to join others, such as one between two hinges: its joints
        # are seen.
        if name not in meshes and float(body.mass) >= NO_MASS * heaviest:
            solids[name] = shapes.of_body(body, np.array(ends[name]).reshape(-1, 3), size)
    return {name: Part(solids[name], joints[name]) for name in ends}


def _joint(connection: Connection, size: float, travel: tuple[float, float]) -> tuple:
    """(outer part, on the parent; inner part, on the child), each in its marker's frame."""
    joint: Any = connection.joint
    joint = getattr(joint, "gap", joint)
    rows = set(getattr(joint, "rows", ()) or getattr(joint, "ideal_rows", ()))
    empty = Triangles(np.zeros((0, 3)), np.zeros((0, 3), int))
    if not {"x"} <= rows:
        return empty, empty
    if "z" not in rows and "x.z" in rows:
        return _rail(joint, size, travel)
    radius = float(getattr(joint, "bearing_radius", getattr(joint, "socket_radius", PIN * size)))
    if rows == {"x", "y", "z"}:
        ring = shapes.tube(1.02 * radius, AROUND_IT * radius, radius)
        return ring, shapes.ball(radius)
    long = float(getattr(joint, "length", None) or LONG * size)
    return shapes.tube(radius, AROUND_IT * radius, 0.8 * long), shapes.rod(0.98 * radius, long)


def _rail(joint: Any, size: float, travel: tuple[float, float]) -> tuple:
    """Rails on both sides, as long as the slider travels, and the slider."""
    width = float(getattr(joint, "width", 2 * PIN * size))
    long = float(getattr(joint, "length", 2 * width))
    gap, thick = float(getattr(joint, "clearance", 0.0)), 0.25 * width
    low, high = travel[0] - 0.6 * long, travel[1] + 0.6 * long
    bar = shapes.box((thick, width, high - low))
    rails = [
        bar.moved(
            np.eye(3), np.array([side * (0.5 * (width + thick) + gap), 0.0, 0.5 * (low + high)])
        )
        for side in (-1, 1)
    ]
    return shapes.joined(rails), shapes.box((width, width, long))


def _travel(run: Any, name: str) -> tuple[float, float]:
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
        check_known("body", name, [*run.mechanism.bodies, GROUND], " in this mechanism")
    found = {}
    for name, given in meshes.items():
        own = given if isinstance(given, Mapping) else {"": given}
        parts = (_mesh(f"{name}, {part}" if part else name, one) for part, one in own.items())
        found[name] = shapes.joined(parts)
    return found


def _mesh(name: str, given: Any) -> Triangles:
    what = f'the mesh of "{name}"'
    wanted = "the path of a file, or (points (n, 3) [m], triangles (m, 3))"
    if isinstance(given, (str, Path)):
        import meshio

        if not Path(given).is_file():
            raise ValueError(f"{what} is {str(given)!r}, and there is no such file.")
        # meshio guesses whether an STL file is a text by a number that may overflow.
        with np.errstate(over="ignore"):
            read = meshio.read(given)
        cells = [own.data for own in read.cells if own.type == "triangle"]
        if not cells:
            raise ValueError(f"{what}, {given}, holds no triangles.")
        given = read.points, np.concatenate(cells)
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise ValueError(f"{what} is {described(given)}; it must be {wanted}.")
    points, corners = np.asarray(given[0], float), np.asarray(given[1])
    shaped = points.ndim == 2 and points.shape[1] == 3 and corners.ndim == 2
    inside = shaped and corners.shape[1] == 3 and corners.size and corners.min() >= 0
    if not inside or corners.max() >= len(points) or not np.isfinite(points).all():
        raise ValueError(
            f"{what} has points of shape {points.shape} and triangles of shape {corners.shape}; "
            f"it must be {wanted}, the triangles indices of the points."
        )
    return Triangles(points, corners.astype(int))
