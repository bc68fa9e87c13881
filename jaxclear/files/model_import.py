"""Mechanisms from URDF and MJCF: bodies with their inertias, joints with their axes, and gravity;
what acts on joints is in `model_loads`. What is not taken over is named in a warning.

Geometries of a URDF or MJCF file by their names, as triangles to draw bodies with.
"""

import dataclasses
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxclear.components.body import Connection
from jaxclear.components.drive import ConstantPosition
from jaxclear.components.load import Gravity
from jaxclear.files.model_loads import STOPS, list_deflections, loads_of
from jaxclear.files.model_tree import HERE, Tree, equalities_of, rotation_of
from jaxclear.files.mujoco_model import (
    Compiled,
    compiled,
    coordinates_at,
    keyframes,
    names_of,
    not_taken_over,
)
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name
from jaxclear.ground.warning import warn
from jaxclear.ground.wording import listed
from jaxclear.multibody.joint_replacement import without_loads_on
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.topology import grow_tree
from jaxclear.results import solids
from jaxclear.results.solids import Triangles


class NotImported(UserWarning):
    """Warning: parts of a model file that the mechanism does not contain."""


class ImportedSoft(UserWarning):
    """Warning: parts of a model file that deflect under the model's own weight."""


@answering
def read_urdf(path: Any, *, floating: bool = False, stops: str = "steady") -> Mechanism:
    """Read a mechanism from a URDF file.

    The mechanism contains what `read_mjcf` lists.

    Args:
        path: path of the file.
        floating: whether the root gets a free joint; False (default) fixes it to the ground.
        stops: stiffness of joint limits, "steady" (default) or "impact", as of `read_mjcf`.

    Returns:
        The `Mechanism`.

    Raises:
        ValueError: if the file is invalid or has no body with mass.
    """
    return _build_mechanism(compiled(path, floating=floating), stops)


@answering
def read_mjcf(
    path: Any, *, floating: bool = False, stops: str = "steady", keyframe: str | None = None
) -> Mechanism:
    """Read a mechanism from a file of MJCF (or URDF), with the names of the file.

    Bodies have the frames, inertias and joints of the model: hinges are `Revolute`, slides
    `Prismatic`, balls `Spherical`, free joints `Free`, welds `Fixed`; coordinates count from the
    model's reference configuration. Gravity becomes a load; damping and stiffness of hinges and
    slides a `JointSpring`, armature a `RotorInertia`, dry friction a `JointFriction` (it holds what
    is driven by less; in MuJoCo it creeps), limits a `JointStop`. Active equalities `connect` and
    `weld` are `Spherical` and `Fixed` joints that close loops, linear ones between joints (URDF's
    `mimic`) a `Ratio`; a joint with an equality of its own is driven (`drive.ConstantPosition`).
    Welded bodies without inertia become part of their parent. Several joints of one body get bodies
    between them, of 1e-12 of its mass. `read_shapes` reads geometries.

    A `NotImported` warning names what is missing: contacts, actuators, tendons, other equalities, a
    reference configuration that is not kept, and the above of balls and free joints. An
    `ImportedSoft` warning names what deflects under weight and springs, and by how much.

    Args:
        path: path of the file. `pip install "jaxclear[import]"` installs MuJoCo, which reads it.
        floating: whether roots without a joint get a free one; False by default.
        stops: what the springs of joint limits have in common with MuJoCo's soft constraints.
            "steady" (default): the deflection under weight and springs of the model's tree.
            "impact": distance and time in which they stop a moving part; under a steady load they
            deflect 1 / (1 - d) times as far, for MuJoCo's impedance d (20 times by default).
        keyframe: name of the keyframe of the file in which the mechanism starts; None (default) for
            the reference configuration. Loops are closed from there; speeds and controls are
            ignored.

    Returns:
        The `Mechanism`.

    Raises:
        ValueError: if the file is invalid, has no body with mass, or no such keyframe.
    """
    return _build_mechanism(compiled(path, floating=floating), stops, keyframe)


def _build_mechanism(read: Compiled, stops: str, keyframe: str | None = None) -> Mechanism:
    check_name("stops", stops, STOPS)
    model = read.model
    bodies, joints = names_of(model)
    tree = Tree(model, bodies, joints)
    equal = equalities_of(model, tree)
    missing = [*not_taken_over(read, joints), *equal.missing]
    initial = {} if keyframe is None else coordinates_at(model, joints, keyframe)
    if keyframe is None and model.nkey:
        missing.append(
            f"keyframes {listed(keyframes(model))} (read_mjcf(..., keyframe=...) starts)"
        )
    _warn_of(read, "not taken over", missing, NotImported)
    if not tree.bodies:
        raise ValueError(f"{read.name} has no body with mass.")
    loads = without_loads_on(dict(loads_of(model, joints, stops)), tuple(equal.fixed))
    _warn_of(read, "gives way at rest", list_deflections(model, joints, loads), ImportedSoft)
    if np.any(model.opt.gravity):
        loads["gravity"] = Gravity(tuple(map(float, model.opt.gravity)))
    connections = _hold(tree.connections, equal.fixed) | equal.connections
    # Where an equality holds a free body, its place is only near: the loop decides.
    free = tree.start | {name: initial[name] for name in tree.start if initial}
    start = {name: place for name, place in free.items() if name not in equal.free}
    near = {name: place for name, place in free.items() if name in equal.free} | equal.rotations
    near |= {n: v for n, v in initial.items() if n not in free and n not in equal.fixed}
    grown = grow_tree(tree.bodies, connections)
    guess = {name: place for name, place in near.items() if grown.branch_of(name) is not None}
    return Mechanism(
        tree.bodies, connections, loads, couplings=equal.couplings, start=start, guess=guess
    )


def _hold(connections: dict[str, Connection], places: dict[str, float]) -> dict[str, Connection]:
    """Connections some of whose joints are held at a coordinate [rad, m]."""
    changed = dict(connections)
    for name, place in places.items():
        connection = connections[name]
        joint: Any = connection.joint
        driven = dataclasses.replace(joint, drive=ConstantPosition(place))
        changed[name] = Connection(driven, connection.parent, connection.child)
    return changed


def _warn_of(read: Compiled, what: str, sentences: Iterable[str], kind: type[Warning]) -> None:
    text = "; ".join(sentences)
    if text:
        warn(f"{read.name}: {what}: {text}.", kind)


# Of mjtGeom: what a size says. Planes and height fields have no body.
SHAPES = {
    2: lambda size: solids.make_ball(size[0]),
    3: lambda size: solids.make_capsule(size[0], 2 * size[1]),
    4: lambda size: _stretch_solid(solids.make_ball(1.0), size),
    5: lambda size: solids.rod(size[0], 2 * size[1]),
    6: lambda size: solids.make_box(2 * size),
}
MESH = 7
# Groups that MuJoCo's viewer shows: others hold shapes for contacts.
VISIBLE_GROUPS = 2


@answering
def read_shapes(path: Any, *, floating: bool = False) -> dict[str, dict[str, Triangles]]:
    """Read the geometries of a URDF or MJCF file, to draw bodies with.

    Boxes, cylinders, capsules, spheres, ellipsoids and meshes are read; planes and height fields
    are not. A body is drawn by its visible geometries (a URDF's visual ones, an MJCF's groups 0 to
    2), where there are none by those for collisions. Where one of a file's meshes cannot be read,
    all meshes are left out. Needs `pip install "jaxclear[import]"`.

    Args:
        path: path of the file.
        floating: whether roots without a joint get a free one, as of `read_mjcf`; False by default.

    Returns:
        By body and name (points [m], shape (n, 3); triangles, shape (m, 3)), in the frame of the
        body that `read_urdf` and `read_mjcf` make; those of the world by "ground". They are
        `meshes` of `plot.animate` and `run.to_vtk`.

    Raises:
        ValueError: if the file is invalid.
    """
    model = compiled(path, floating=floating, visible=True).model
    urdf = "<robot" in Path(path).read_text("utf-8", "ignore")
    bodies, joints = names_of(model)
    tree = Tree(model, bodies, joints)
    shapes: dict[str, dict[str, Triangles]] = {}
    for index in range(model.nbody):
        owner, place = tree.part[index] if index else (0, HERE)
        of_body = shapes.setdefault(bodies[owner], {})
        for name, solid in _of_body(model, index, bodies[index], urdf):
            name = name if name not in of_body else f"{name} {len(of_body)}"
            of_body[name] = solid.moved(place.rotation, place.origin)
    return {body: of_body for body, of_body in shapes.items() if of_body}


def _of_body(model: Any, index: int, body: str, urdf: bool) -> Iterator[tuple[str, Triangles]]:
    """Geometries of a body with their names, in its frame."""
    first = int(model.body_geomadr[index])
    every = range(first, first + int(model.body_geomnum[index]))
    indices = [k for k in every if int(model.geom_type[k]) in (*SHAPES, MESH)]
    visible = [k for k in indices if model.geom_group[k] <= VISIBLE_GROUPS]
    if urdf:
        visible = [k for k in indices if not (model.geom_contype[k] or model.geom_conaffinity[k])]
    for count, k in enumerate(visible or indices):
        size = np.array(model.geom_size[k])
        kind = int(model.geom_type[k])
        solid = _mesh(model, int(model.geom_dataid[k])) if kind == MESH else SHAPES[kind](size)
        name = model.geom(k).name or f"{body} geometry {count}"
        yield name, solid.moved(rotation_of(model.geom_quat[k]), np.array(model.geom_pos[k]))


def _mesh(model: Any, index: int) -> Triangles:
    points = slice(*_index_range(model.mesh_vertadr[index], model.mesh_vertnum[index]))
    corners = slice(*_index_range(model.mesh_faceadr[index], model.mesh_facenum[index]))
    return Triangles(np.array(model.mesh_vert[points], float), np.array(model.mesh_face[corners]))


def _index_range(first: Any, count: Any) -> tuple[int, int]:
    return int(first), int(first) + int(count)


def _stretch_solid(solid: Triangles, sizes: np.ndarray) -> Triangles:
    return Triangles(solid.points * sizes, solid.corners)
