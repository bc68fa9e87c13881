"""The parts whose walls wear, as block meshes: a bush, a pin, the shell of a socket.

Each stands in the frame of its wear map: axis along z, directions from x towards y. Cells get
taller from the wall inwards, each by `GROWTH`; half of those through the thickness belong to blocks
at the wall.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.sphere_map import stencil
from jaxclear.mesh.block_mesh import BlockDeformation, BlockMesh, deformation, join_blocks

GROWTH = 1.3
# Half the side of a pin's square core, as a share of the radius.
CORE = 0.4
# Components of a place in which walls face away from the axis, or from the centre.
ACROSS, ALL_AXES = (1.0, 1.0, 0.0), (1.0, 1.0, 1.0)


class Solid(eqx.Module):
    """A worn part: its mesh as new, and how the mesh follows the wear of its wall.

    Args:
        follow: function that maps a displacement of the wall [m] to all points of the mesh, a
            `BlockDeformation`.
        into: direction from each point of the wall into the material [1], an array (wall, 3).
        position: where each point of the wall lies in the wear map [cells], two arrays (wall,).
    """

    follow: BlockDeformation
    into: Float[Array, "wall 3"]
    position: tuple[Float[Array, " wall"], Float[Array, " wall"]]

    @property
    def new(self) -> BlockMesh:
        """The mesh of the part before it wears."""
        return self.follow.mesh

    def wall_depth(self, depth: Float[Array, "around along"]) -> Float[Array, " wall"]:
        """Worn depth at the points of the wall, by the map's own splines in both directions.

        Args:
            depth: worn depth of each cell of the map [m], an array (around, along).

        Returns:
            depths [m], an array (wall,).
        """
        columns, rows, weights = stencil(*self.position, depth.shape)
        return jnp.sum(weights * depth[columns, rows], axis=(-2, -1))

    def displacement(self, depth: Float[Array, "around along"]) -> Float[Array, "points 3"]:
        """Displacement of every point of the mesh.

        Args:
            depth: worn depth of each cell of the map [m], an array (around, along).

        Returns:
            displacements [m], an array (points, 3).
        """
        wall = self.wall_depth(depth)[:, None] * self.into
        fixed = jnp.zeros((len(self.follow.wall) - len(wall), 3))
        return self.follow(jnp.concatenate([wall, fixed]))

    def worn(self, depth: Float[Array, "around along"]) -> BlockMesh:
        """The mesh of the worn part: the same points and cells, displaced.

        Args:
            depth: worn depth of each cell of the map [m], an array (around, along).

        Returns:
            the mesh, a `BlockMesh`.
        """
        points = self.new.points + self.displacement(depth)
        return eqx.tree_at(lambda mesh: mesh.points, self.new, points)


def bush(wear_map: Any, thickness: float, cells: tuple[int, int, int]) -> Solid:
    """A ring around a bearing's bore; its outer wall stays.

    Args:
        wear_map: of the bearing, with radius and length [m].
        thickness: of the ring [m].
        cells: around (a multiple of 4), along (even) and through (even).
    """
    radius, length = float(wear_map.radius), float(wear_map.length)
    outward = radius + thickness * _layer_distances(cells[2])
    blocks = [
        _ring_points(angles, heights, depths)
        for angles in _split(np.linspace(0, 2 * np.pi, cells[0] + 1), 4)
        for heights in _split(np.linspace(-0.5, 0.5, cells[1] + 1) * length, 2)
        for depths in _split(outward, 2)
    ]
    mesh = join_blocks([np.stack(blocks)])
    distance = np.hypot(*np.asarray(mesh.points).T[:2])
    return _make_solid(mesh, wear_map, distance, (radius, outward[-1]), ACROSS)


def pin(wear_map: Any, thickness: float, cells: tuple[int, int, int]) -> Solid:
    """A journal with a square core.

    Args:
        wear_map: of the journal, with radius and length [m].
        thickness: of the blocks at the wall [m], at most half the radius.
        cells: around (a multiple of 4), along (even) and from the wall to the core (even).
    """
    radius, length = float(wear_map.radius), float(wear_map.length)
    angles = np.linspace(0, 2 * np.pi, cells[0] + 1) + np.pi / 4
    side = cells[0] // 4
    across = np.linspace(-1.0, 1.0, side + 1) * CORE * radius
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * CORE * radius
    share = np.linspace(0, 1, side + 1)[:, None]
    shells, core = [], []
    inward = thickness * _layer_distances(cells[2] // 2)
    for heights in _split(np.linspace(-0.5, 0.5, cells[1] + 1) * length, 2):
        core.append(_extrude(np.stack(np.meshgrid(across, across, indexing="ij"), -1), heights))
        for quarter, sector in enumerate(_split(angles, 4)):
            wall = np.stack([np.cos(sector), np.sin(sector)], -1)
            square = (1 - share) * corners[quarter] + share * corners[quarter + 1]
            layer = (radius - inward)[None, :, None] * wall[:, None]
            steps = np.linspace(0, 1, cells[2] // 2 + 1)[None, :, None]
            rest = (1 - steps) * layer[:, -1:] + steps * square[:, None]
            shells += [_extrude(layer, heights), _extrude(rest, heights)]
    mesh = join_blocks([np.stack(shells), np.stack(core)])
    distance = np.hypot(*np.asarray(mesh.points).T[:2])
    return _make_solid(mesh, wear_map, distance, (radius,), ACROSS)


def socket(wear_map: Any, thickness: float, cells: tuple[int, int, int]) -> Solid:
    """A shell around a ball, from the six sides of a cube; its outer wall stays.

    Args:
        wear_map: of the socket, with its radius [m].
        thickness: of the shell [m].
        cells: around (a multiple of 4), a number that is not used, and through (even).
    """
    radius = float(wear_map.radius)
    outward = radius + thickness * _layer_distances(cells[2])
    share = np.tan(np.linspace(-0.25, 0.25, cells[0] // 4 + 1) * np.pi)
    u, v = np.meshgrid(share, share, indexing="ij")
    sides = [
        np.roll(np.stack([sign * np.ones_like(u), u, v], -1), axis, -1)
        for axis in range(3)
        for sign in (-1.0, 1.0)
    ]
    blocks = [
        (side / np.linalg.norm(side, axis=-1, keepdims=True))[:, :, None] * depths[:, None]
        for side in sides
        for depths in _split(outward, 2)
    ]
    mesh = join_blocks([np.stack(blocks)])
    distance = np.linalg.norm(np.asarray(mesh.points), axis=1)
    return _make_solid(mesh, wear_map, distance, (radius, outward[-1]), ALL_AXES)


def _layer_distances(count: int) -> Float[np.ndarray, " count+1"]:
    """Distances of layers from the wall, as shares of the thickness."""
    return np.concatenate([[0.0], np.cumsum(GROWTH ** np.arange(count))]) / np.sum(
        GROWTH ** np.arange(count)
    )


def _split(marks: Float[np.ndarray, " marks"], count: int) -> list[Float[np.ndarray, " marks"]]:
    size = (len(marks) - 1) // count
    return [marks[i * size : (i + 1) * size + 1] for i in range(count)]


def _ring_points(angles, heights, radii):
    angle, z, r = np.meshgrid(angles, heights, radii, indexing="ij")
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)


def _extrude(plane, heights):
    """A plane grid (i, j, 2) at each height (k)."""
    shape = (*plane.shape[:2], len(heights))
    x, y = (np.broadcast_to(plane[..., None, axis], shape) for axis in range(2))
    return np.stack([x, y, np.broadcast_to(heights, shape)], -1)


def _make_solid(
    mesh: BlockMesh,
    wear_map: Any,
    distance: Float[np.ndarray, " points"],
    walls: tuple[float, ...],
    facing: tuple[float, float, float],
) -> Solid:
    """A solid whose first wall wears and whose others stay, told by their distance from the axis
    or centre."""
    on = [np.flatnonzero(np.abs(distance - wall) < 1e-9 * walls[0]) for wall in walls]
    points = mesh.points[on[0]]
    outward = points * jnp.array(facing)
    outward = outward / jnp.linalg.norm(outward, axis=1, keepdims=True)
    # Away from the gap: a bearing's material lies outside its wall, a journal's inside.
    into = outward if np.min(distance) >= walls[0] * (1 - 1e-9) else -outward
    wall = np.concatenate(on).astype(int)
    return Solid(deformation(mesh, wall), into, wear_map.position(*points.T))
