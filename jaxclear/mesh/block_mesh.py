"""Hexahedra in structured blocks: which points they share, and how well shaped they are.

A block is a grid of points (i, j, k); blocks of one size form a group. Where blocks meet, they
share points, so what moves the points keeps the mesh whole.

How the inside of a block mesh follows its walls.

Vertices of blocks follow by a volume spline of the walls' displacement, edges by arc length between
their vertices, faces and volumes by transfinite interpolation with arc lengths, all blocks of a
group at once; across faces between blocks the displacement is smoothed. What is affine in the
walls' displacement is taken out before and added afterwards, so that an affine displacement is met
exactly. All of it is linear in the displacement: whatever does not depend on it is computed once.

Sources: volume spline (distance as radial function with a linear polynomial): Hounjet, Meijer 1995,
NLR TP 95309. Transfinite interpolation: Gordon, Hall 1973, Int. J. Numer. Meth. Eng. 7, 461,
doi:10.1002/nme.1620070405; with arc lengths: Soni 1985, AIAA 85-1526.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float, Int

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
    """A mesh of hexahedra in structured blocks that share points.

    Args:
        points: points of the mesh [m], an array (points, 3).
        groups: indices of the points of blocks of one size, a tuple of arrays (blocks, i, j, k).
    """

    points: Float[Array, "points 3"]
    groups: tuple[Int[np.ndarray, "blocks i j k"], ...]

    def hexahedra(self) -> Int[np.ndarray, "cells 8"]:
        """Corners of every cell, ordered as in VTK."""
        return np.concatenate([_cell_corners(group) for group in self.groups])

    def scaled_jacobians(self) -> Float[Array, " cells"]:
        """Shape of every cell: the smallest determinant of the edges at a corner, each of unit
        length. 1: a box; 0 or less: inverted.

        Source: Knupp 2000, Int. J. Numer. Meth. Eng. 48, 1165.
        """
        return _shape_quality(self.points, self.hexahedra())

    def volume(self) -> Float[Array, ""]:
        """Volume of all cells [m3]: five tetrahedra each, the mean of both ways to cut them."""
        return _hexahedron_volumes(self.points, self.hexahedra())


# Two ways to cut a hexahedron into five tetrahedra.
CUTS = (
    ((0, 1, 3, 4), (1, 2, 3, 6), (1, 6, 4, 5), (3, 4, 6, 7), (1, 3, 4, 6)),
    ((0, 1, 2, 5), (0, 2, 3, 7), (0, 5, 7, 4), (2, 7, 5, 6), (0, 2, 7, 5)),
)


@jax.jit
def _shape_quality(points, hexahedra):
    corners = points[hexahedra]
    edges = corners[:, np.array(NEXT)] - corners[:, :, None, :]
    lengths = jnp.linalg.norm(edges, axis=-1)
    a, b, c = jnp.moveaxis(edges, 2, 0)
    boxes = jnp.sum(jnp.cross(a, b) * c, axis=-1)
    return jnp.min(boxes / jnp.prod(lengths, axis=-1), axis=-1)


@jax.jit
def _hexahedron_volumes(points, hexahedra):
    return 0.5 * sum(_tetrahedron_volumes(points[hexahedra], cut) for cut in CUTS)


def _tetrahedron_volumes(corners, cut):
    a, b, c, d = jnp.moveaxis(corners[:, np.array(cut)], 2, 0)
    return jnp.sum(jnp.einsum("...i,...i", jnp.cross(b - a, c - a), d - a)) / 6


def _cell_corners(group: Int[np.ndarray, "blocks i j k"]) -> Int[np.ndarray, "cells 8"]:
    i, j, k = (size - 1 for size in group.shape[1:])
    corners = [group[:, a : a + i, b : b + j, c : c + k] for a, b, c in CORNERS]
    return np.stack(corners, axis=-1).reshape(-1, 8)


def join_blocks(groups: Sequence[Float[np.ndarray, "blocks i j k 3"]]) -> BlockMesh:
    """The mesh of blocks given by the places of their points; points in one place become one.
    Blocks that are left-handed are turned over."""
    groups = [np.stack([_make_right_handed(block) for block in group]) for group in groups]
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


def _make_right_handed(block: Float[np.ndarray, "i j k 3"]) -> Float[np.ndarray, "i j k 3"]:
    corner = block[0, 0, 0]
    edges = block[1, 0, 0] - corner, block[0, 1, 0] - corner, block[0, 0, 1] - corner
    return block if np.linalg.det(np.stack(edges)) > 0 else block[::-1]


# Points of the walls that the spline goes through, at most: its matrix is full.
MOST_CENTRES = 600
# Passes of smoothing across faces between blocks.
PASSES = 2


class BlockDeformation(eqx.Module):
    """What carries a displacement of the points `held` [m] to all points of a mesh: by weights of
    the volume `spline` [1] and of its `affine` part [1/m, 1], by arc `lengths` [1] within blocks
    and over `links` [1] between these."""

    mesh: BlockMesh
    wall: Int[np.ndarray, " held"]
    free: Int[np.ndarray, " vertices"]
    spline: Float[Array, "vertices held"]
    affine: Float[Array, "4 held"]
    lengths: tuple[Float[Array, "blocks i j k 3"], ...]
    faces: Int[np.ndarray, " faces"]
    links: tuple[Int[np.ndarray, " links"], Int[np.ndarray, " links"], Float[Array, " links"]]

    @eqx.filter_jit
    def __call__(self, displacement: Float[Array, "held 3"]) -> Float[Array, "points 3"]:
        """Displacement of every point [m]."""
        points = self.mesh.points
        everywhere = _append_ones(points) @ (self.affine @ displacement)
        rest = displacement - everywhere[self.wall]
        moved = jnp.zeros_like(points).at[self.wall].set(rest)
        moved = moved.at[self.free].set(self.spline @ rest)
        is_set = jnp.zeros(len(points), bool).at[self.wall].set(True).at[self.free].set(True)
        moved = self._smoothed(self._filled(moved, is_set))
        return everywhere + self._filled(moved, is_set.at[self.faces].set(True))

    def _filled(self, moved, is_set: Bool[Array, " points"]):
        for group, lengths in zip(self.mesh.groups, self.lengths, strict=True):
            filled = jax.vmap(_filled)(moved[group], is_set[group], lengths)
            moved = moved.at[group].set(filled)
        return moved

    def _smoothed(self, moved):
        here, there, weights = self.links
        for _ in range(PASSES):
            pulls = weights[:, None] * (moved[there] - moved[here])
            moved = moved.at[here].add(0.5 * pulls)
        return moved


def deformation(mesh: BlockMesh, wall: Int[np.ndarray, " held"]) -> BlockDeformation:
    """What moves a mesh of which the points `held` are displaced by hand."""
    points = np.asarray(mesh.points)
    free = np.setdiff1d(_corner_points(mesh), wall)
    faces = np.setdiff1d(_shared_points(mesh), np.union1d(wall, free))
    return BlockDeformation(
        mesh=mesh,
        wall=wall,
        free=free,
        spline=jnp.asarray(_spline_weights(points, wall, free)),
        affine=jnp.asarray(np.linalg.pinv(np.insert(points[wall], 0, 1.0, axis=1))),
        lengths=tuple(_arc_lengths(points[group]) for group in mesh.groups),
        faces=faces,
        links=_neighbour_weights(mesh, points, faces),
    )


def _append_ones(points):
    return jnp.concatenate([jnp.ones((len(points), 1)), points], axis=1)


def _corner_points(mesh: BlockMesh) -> Int[np.ndarray, " vertices"]:
    return np.unique(np.concatenate([g[np.ix_(*_ends(g.shape))].ravel() for g in mesh.groups]))


def _ends(shape: tuple[int, ...]) -> list[Any]:
    return [range(shape[0]), *([0, size - 1] for size in shape[1:])]


def _shared_points(mesh: BlockMesh) -> Int[np.ndarray, " points"]:
    """Points of more than one block."""
    owners = np.concatenate([np.unique(block) for group in mesh.groups for block in group])
    numbers, times = np.unique(owners, return_counts=True)
    return numbers[times > 1]


def _spline_weights(points, wall, free) -> Float[np.ndarray, "free held"]:
    """Weights of the walls' displacements in those of the free vertices."""
    from scipy.interpolate import RBFInterpolator

    weights = np.zeros((len(free), len(wall)))
    if len(free):
        centres = np.unique(np.linspace(0, len(wall) - 1, min(len(wall), MOST_CENTRES)).astype(int))
        places = points[wall[centres]]
        spline = RBFInterpolator(places, np.eye(len(centres)), kernel="linear", degree=1)
        weights[:, centres] = spline(points[free])
    return weights


def _neighbour_weights(mesh: BlockMesh, points, faces):
    """From points of faces between blocks to their neighbours; weights by the inverse distance, of
    sum 1 at each."""
    cells = mesh.hexahedra()
    ends = np.concatenate([cells[:, [c, n]] for c, three in enumerate(NEXT) for n in three])
    ends = np.unique(ends, axis=0)
    here, there = ends[np.isin(ends[:, 0], faces)].T
    near = 1.0 / np.linalg.norm(points[there] - points[here], axis=1)
    total = np.bincount(here, near, minlength=len(points))
    return here, there, jnp.asarray(near / total[here])


def _arc_lengths(points: Float[np.ndarray, "blocks i j k 3"]) -> Float[Array, "blocks i j k 3"]:
    """Share of the length of each grid line that lies before a point, along i, j and k."""
    shares = []
    for axis in (1, 2, 3):
        pieces = np.linalg.norm(np.diff(points, axis=axis), axis=-1)
        first = [(1, 0) if a == axis else (0, 0) for a in range(4)]
        lengths = np.pad(np.cumsum(pieces, axis=axis), first)
        shares.append(lengths / np.take(lengths, [-1], axis=axis))
    return jnp.asarray(np.stack(shares, axis=-1))


def _filled(moved, is_set, lengths):
    """Displacements of a block: those known, then of edges, faces and the inside."""
    inner = [_inner_mask(is_set.shape, axis) for axis in range(3)]
    for count in (1, 2, 3):
        for axes in itertools.combinations(range(3), count):
            others = [~inner[axis] for axis in range(3) if axis not in axes]
            region = np.logical_and.reduce([inner[axis] for axis in axes] + others)
            missing = jnp.asarray(region) & ~is_set
            moved = jnp.where(missing[..., None], _transfinite(moved, lengths, axes), moved)
    return moved


def _inner_mask(shape: tuple[int, ...], axis: int) -> Bool[np.ndarray, "i j k"]:
    """Which points lie between both ends of an axis."""
    place = np.arange(shape[axis])
    along = (place > 0) & (place < shape[axis] - 1)
    return np.broadcast_to(np.expand_dims(along, tuple(a for a in range(3) if a != axis)), shape)


def _transfinite(moved, lengths, axes):
    """The Boolean sum of linear interpolations along `axes`: 1 - (1 - P_a)(1 - P_b)(1 - P_c)."""
    rest = moved
    for axis in axes:
        share = lengths[..., axis, None]
        first, last = (jnp.take(rest, jnp.array([end]), axis=axis) for end in (0, -1))
        rest = rest - ((1.0 - share) * first + share * last)
    return moved - rest
