"""Geometries of a URDF or MJCF file by their names, as triangles to draw bodies with."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxclear.files.model_tree import HERE, Tree, rotation_of
from jaxclear.files.mujoco_model import compiled, names_of
from jaxclear.ground.answering import answering
from jaxclear.results.solids import shapes
from jaxclear.results.solids.shapes import Triangles

__all__ = ["read_shapes"]

# Of mjtGeom: what a size says. Planes and height fields have no body.
SHAPES = {
    2: lambda size: shapes.ball(size[0]),
    3: lambda size: shapes.capsule(size[0], 2 * size[1]),
    4: lambda size: _stretched(shapes.ball(1.0), size),
    5: lambda size: shapes.rod(size[0], 2 * size[1]),
    6: lambda size: shapes.box(2 * size),
}
MESH = 7
# Groups that MuJoCo's viewer shows: others hold shapes for contacts.
SHOWN = 2


@answering
def read_shapes(path: Any, *, floating: bool = False) -> dict[str, dict[str, Triangles]]:
    """The geometries in a file of URDF or MJCF by body and name, each as (points (n, 3) [m],
    triangles (m, 3)) in the frame of the body that `read_urdf` and `read_mjcf` make of it; those
    of the world by "ground". `plot.animate(run, meshes=...)` and `run.to_vtk` draw bodies with
    them.

    Boxes, cylinders, capsules, spheres, ellipsoids and meshes; planes and height fields are left
    out. A body is drawn by what is to be seen of it (a URDF's visual geometries, an MJCF's groups 0
    to 2), where there is nothing else by what it collides with. Of a file that names meshes of
    which one cannot be read all meshes are left out. Needs `pip install "jaxclear[import]"`. Raises
    `ValueError` with a sentence.
    """
    model = compiled(path, floating=floating, seen=True).model
    urdf = "<robot" in Path(path).read_text("utf-8", "ignore")
    bodies, joints = names_of(model)
    tree = Tree(model, bodies, joints)
    found: dict[str, dict[str, Triangles]] = {}
    for index in range(model.nbody):
        owner, place = tree.part[index] if index else (0, HERE)
        own = found.setdefault(bodies[owner], {})
        for name, solid in _of_body(model, index, bodies[index], urdf):
            name = name if name not in own else f"{name} {len(own)}"
            own[name] = solid.moved(place.rotation, place.origin)
    return {body: own for body, own in found.items() if own}


def _of_body(model: Any, index: int, body: str, urdf: bool) -> Iterator[tuple[str, Triangles]]:
    """Geometries of a body with their names, in its frame."""
    first = int(model.body_geomadr[index])
    every = range(first, first + int(model.body_geomnum[index]))
    own = [k for k in every if int(model.geom_type[k]) in (*SHAPES, MESH)]
    seen = [k for k in own if model.geom_group[k] <= SHOWN]
    if urdf:
        seen = [k for k in own if not (model.geom_contype[k] or model.geom_conaffinity[k])]
    for count, k in enumerate(seen or own):
        size = np.array(model.geom_size[k])
        kind = int(model.geom_type[k])
        solid = _mesh(model, int(model.geom_dataid[k])) if kind == MESH else SHAPES[kind](size)
        name = model.geom(k).name or f"{body} geometry {count}"
        yield name, solid.moved(rotation_of(model.geom_quat[k]), np.array(model.geom_pos[k]))


def _mesh(model: Any, index: int) -> Triangles:
    points = slice(*_span(model.mesh_vertadr[index], model.mesh_vertnum[index]))
    corners = slice(*_span(model.mesh_faceadr[index], model.mesh_facenum[index]))
    return Triangles(np.array(model.mesh_vert[points], float), np.array(model.mesh_face[corners]))


def _span(first: Any, count: Any) -> tuple[int, int]:
    return int(first), int(first) + int(count)


def _stretched(solid: Triangles, sizes: np.ndarray) -> Triangles:
    return Triangles(solid.points * sizes, solid.corners)
