"""What bodies and joints look like in an animation: triangles, in metres, in the body's frame.

A body without a mesh is the cuboid that has its mass and moments of inertia, as far as that is no
larger than its joints are apart, with a rod to each of its joints; in the plane, where only one
moment is known, a slender bar, or a square plate where all joints are in one place.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxclear.components.body import Body

__all__ = ["Triangles", "ball", "box", "capsule", "joined", "of_body", "rod", "tube"]

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


def joined(parts: Iterable[Triangles]) -> Triangles:
    """All parts as one; none at all are no triangles."""
    found, points, corners = 0, [np.zeros((0, 3))], [np.zeros((0, 3), int)]
    for part in parts:
        points.append(part.points)
        corners.append(part.corners + found)
        found += len(part.points)
    return Triangles(np.concatenate(points), np.concatenate(corners))


def box(sides: Any) -> Triangles:
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
    whole = joined(parts)
    return Triangles(0.5 * whole.points * np.asarray(sides, float), whole.corners)


def _turned(profile: np.ndarray) -> Triangles:
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
    return joined(parts)


def rod(radius: float, length: float) -> Triangles:
    """A cylinder along z about the origin."""
    half = 0.5 * length
    return _turned(np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]]))


def tube(inner: float, outer: float, length: float) -> Triangles:
    """A hollow cylinder along z about the origin."""
    half = 0.5 * length
    return _turned(np.array([[inner, -half], [outer, -half], [outer, half], [inner, half]]))


def ball(radius: float) -> Triangles:
    """A sphere about the origin."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, AROUND // 2 + 1)
    return _turned(radius * np.stack([np.cos(angle), np.sin(angle)], -1))


def capsule(radius: float, length: float) -> Triangles:
    """A cylinder along z about the origin, of this length between the half spheres at its ends."""
    angle = np.linspace(0, 0.5 * np.pi, AROUND // 4 + 1)
    upper = np.stack([radius * np.cos(angle), 0.5 * length + radius * np.sin(angle)], -1)
    return _turned(np.concatenate([upper[::-1] * [1, -1], upper]))


def between(start: np.ndarray, end: np.ndarray, radius: float) -> Triangles:
    """A cylinder from one place to another."""
    way = np.asarray(end) - start
    length = float(np.linalg.norm(way))
    return rod(radius, length).moved(_along(way / length), 0.5 * (np.asarray(start) + end))


def _along(direction: np.ndarray) -> np.ndarray:
    """A rotation that brings z into a direction."""
    beside = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(beside, direction)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first), direction], 1)


def of_body(body: Body, joints: np.ndarray, size: float) -> Triangles:
    """A body of a mechanism of this `size` [m], whose joints are in these places (n, 3) [m]."""
    com = np.zeros(3)
    if body.com is not None:
        com[: len(body.com)] = [float(x) for x in body.com]
    turn, sides = _cuboid(body, joints, size)
    apart = np.ptp(joints @ turn, axis=0) if len(joints) else np.zeros(3)
    sides = np.minimum(sides, np.maximum(apart, BLOCK * size))
    solid = box(np.maximum(sides, THINNEST * size)).moved(turn, com)
    ends = [end for end in joints if np.linalg.norm(end - com) > 1e-6 * size]
    return joined([solid, *(between(com, end, ROD * size) for end in ends)])


def _cuboid(body: Body, joints: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) and sides (3,) [m] of the cuboid with a body's mass and moments of inertia."""
    moments = np.array(jax.tree.map(float, body.inertia_matrix())) / float(body.mass)
    if len(body.inertia) > 1:
        own, axes = np.linalg.eigh(moments)
        return axes, np.sqrt(np.maximum(6.0 * (own.sum() - 2.0 * own), 0.0))
    square = 12.0 * moments[2, 2]
    way = np.zeros(3) if not len(joints) else joints[np.linalg.norm(joints, axis=1).argmax()]
    spread = np.ptp(joints, axis=0) if len(joints) else np.zeros(3)
    if np.linalg.norm(spread[:2]) < 0.1 * np.sqrt(square):
        return np.eye(3), np.sqrt(0.5 * square) * np.array([1.0, 1.0, 0.4])
    x, y = way[:2] / np.linalg.norm(way[:2])
    length = np.sqrt(square)
    width = min(length / SLENDER, WIDEST * size)
    turn = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
    # Thin, so that what slides along it is seen.
    return turn, np.array([length, width, 0.4 * width])
