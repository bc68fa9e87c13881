"""Hexahedra in structured blocks: which points they share, and how well shaped they are.

A block is a grid of points (i, j, k); blocks of one size form a group. Where blocks meet, they
share points, so what moves the points keeps the mesh whole.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

# Points closer than this share of the mesh's size are one.
SAME = 1e-9
# Corners of a hexahedron in the order of VTK, in steps along i, j, k.
CORNERS = (
    (0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1),
)  # fmt: skip
# Of each corner the three next to it, in the right-handed order.
NEXT = (
    (1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3),
)  # fmt: skip


class BlockMesh(eqx.Module):
    """Points (points, 3) [m], and groups of blocks: indices of points (blocks, i, j, k)."""

    points: Float[Array, "points 3"]
    groups: tuple[Int[np.ndarray, "blocks i j k"], ...]

    def hexahedra(self) -> Int[np.ndarray, "cells 8"]:
        """Corners of every cell, ordered as in VTK."""
        return np.concatenate([_cells(group) for group in self.groups])

    def scaled_jacobians(self) -> Float[Array, " cells"]:
        """Shape of every cell: the smallest determinant of the edges at a corner, each of unit
        length. 1: a box; 0 or less: inverted.

        Source: Knupp 2000, Int. J. Numer. Meth. Eng. 48, 1165.
        """
        return _shapes(self.points, self.hexahedra())

    def volume(self) -> Float[Array, ""]:
        """Volume of all cells [m3]: five tetrahedra each, the mean of both ways to cut them."""
        return _volume(self.points, self.hexahedra())


# Two ways to cut a hexahedron into five tetrahedra.
CUTS = (
    ((0, 1, 3, 4), (1, 2, 3, 6), (1, 6, 4, 5), (3, 4, 6, 7), (1, 3, 4, 6)),
    ((0, 1, 2, 5), (0, 2, 3, 7), (0, 5, 7, 4), (2, 7, 5, 6), (0, 2, 7, 5)),
)


@jax.jit
def _shapes(points, hexahedra):
    corners = points[hexahedra]
    edges = corners[:, np.array(NEXT)] - corners[:, :, None, :]
    lengths = jnp.linalg.norm(edges, axis=-1)
    a, b, c = jnp.moveaxis(edges, 2, 0)
    boxes = jnp.sum(jnp.cross(a, b) * c, axis=-1)
    return jnp.min(boxes / jnp.prod(lengths, axis=-1), axis=-1)


@jax.jit
def _volume(points, hexahedra):
    return 0.5 * sum(_tetrahedra(points[hexahedra], cut) for cut in CUTS)


def _tetrahedra(corners, cut):
    a, b, c, d = jnp.moveaxis(corners[:, np.array(cut)], 2, 0)
    return jnp.sum(jnp.einsum("...i,...i", jnp.cross(b - a, c - a), d - a)) / 6


def _cells(group: Int[np.ndarray, "blocks i j k"]) -> Int[np.ndarray, "cells 8"]:
    i, j, k = (size - 1 for size in group.shape[1:])
    corners = [group[:, a : a + i, b : b + j, c : c + k] for a, b, c in CORNERS]
    return np.stack(corners, axis=-1).reshape(-1, 8)


def joined(groups: Sequence[Float[np.ndarray, "blocks i j k 3"]]) -> BlockMesh:
    """The mesh of blocks given by the places of their points; points in one place become one.
    Blocks that are left-handed are turned over."""
    groups = [np.stack([_right_handed(block) for block in group]) for group in groups]
    every = np.concatenate([group.reshape(-1, 3) for group in groups])
    pairs = scipy.spatial.cKDTree(every).query_pairs(SAME * np.ptp(every), output_type="ndarray")
    links = scipy.sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(every),) * 2)
    count, number = scipy.sparse.csgraph.connected_components(links, directed=False)
    points = np.zeros((count, 3))
    points[number] = every
    ends = np.cumsum([group[..., 0].size for group in groups])[:-1]
    shapes = [group.shape[:-1] for group in groups]
    numbers = [n.reshape(s) for n, s in zip(np.split(number, ends), shapes, strict=True)]
    return BlockMesh(jnp.asarray(points), tuple(numbers))


def _right_handed(block: Float[np.ndarray, "i j k 3"]) -> Float[np.ndarray, "i j k 3"]:
    corner = block[0, 0, 0]
    edges = block[1, 0, 0] - corner, block[0, 1, 0] - corner, block[0, 0, 1] - corner
    return block if np.linalg.det(np.stack(edges)) > 0 else block[::-1]
