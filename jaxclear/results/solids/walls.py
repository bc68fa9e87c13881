"""Worn walls as quadrilaterals, one for each cell of a wear map."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Wall", "wall"]


class Wall(NamedTuple):
    """`points` (n, 3) [m] of the worn wall, in the frame of its bearing, journal, socket, ball,
    guide or slider;
    `corners` (cells, 4) of each cell, and its `depth` (cells,) [m]."""

    points: np.ndarray
    corners: np.ndarray
    depth: np.ndarray


def _cylinder(wear_map: Any, reach: np.ndarray) -> np.ndarray:
    angle, height = _grid(reach, (-0.5 * float(wear_map.length), 0.5 * float(wear_map.length)))
    return np.stack([reach * np.cos(angle), reach * np.sin(angle), height], -1)


def _sphere(wear_map: Any, reach: np.ndarray) -> np.ndarray:
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
    "bearing": (_cylinder, 1),
    "journal": (_cylinder, -1),
    "socket": (_sphere, 1),
    "ball": (_sphere, -1),
}


def wall(wear_map: Any, surface: str, depth: np.ndarray) -> Wall | None:
    """The worn wall of a surface; None of one whose shape is not known. `depth` (around, along)
    [m]."""
    if wear_map.flat:
        return _flat(wear_map, 1 if surface == "guide" else -1, depth)
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


def _flat(wear_map: Any, sign: int, depth: np.ndarray) -> Wall:
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
