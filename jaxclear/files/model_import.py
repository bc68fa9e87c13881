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
from jaxclear.files.model_loads import STOPS, gives_way, loads_of
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
from jaxclear.multibody.exchange import without_loads_on
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.topology import grow
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
    return _mechanism(compiled(path, floating=floating), stops)


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
    return _mechanism(compiled(path, floating=floating), stops, keyframe)


def _mechanism(read: Compiled, stops: str, keyframe: str | None = None) -> Mechanism:
    check_name("stops", stops, STOPS)
    model = read.model
    bodies, joints = names_of(model)
    tree = Tree(model, bodies, joints)
    held = equalities_of(model, tree)
    missing = [*not_taken_over(read, joints), *held.missing]
    begins = {} if keyframe is None else coordinates_at(model, joints, keyframe)
    if keyframe is None and model.nkey:
        missing.append(
            f"keyframes {listed(keyframes(model))} (read_mjcf(..., keyframe=...) starts)"
        )
    _warn(read, "not taken over", missing, NotImported)
    if not tree.bodies:
        raise ValueError(f"{read.name} has no body with mass.")
    loads = without_loads_on(dict(loads_of(model, joints, stops)), tuple(held.held))
    _warn(read, "gives way at rest", gives_way(model, joints, loads), ImportedSoft)
    if np.any(model.opt.gravity):
        loads["gravity"] = Gravity(tuple(map(float, model.opt.gravity)))
    connections = _held(tree.connections, held.held) | held.connections
    # Where an equality holds a free body, its place is only near: the loop decides.
    free = tree.start | {name: begins[name] for name in tree.start if begins}
    start = {name: place for name, place in free.items() if name not in held.free}
    near = {name: place for name, place in free.items() if name in held.free} | held.turned
    near |= {n: own for n, own in begins.items() if n not in free and n not in held.held}
    grown = grow(tree.bodies, connections)
    guess = {name: place for name, place in near.items() if grown.branch_of(name) is not None}
    return Mechanism(
        tree.bodies, connections, loads, couplings=held.couplings, start=start, guess=guess
    )


def _held(connections: dict[str, Connection], places: dict[str, float]) -> dict[str, Connection]:
    """Connections some of whose joints are held at a coordinate [rad, m]."""
    found = dict(connections)
    for name, place in places.items():
        own = connections[name]
        joint: Any = own.joint
        held = dataclasses.replace(joint, drive=ConstantPosition(place))
        found[name] = Connection(held, own.parent, own.child)
    return found


def _warn(read: Compiled, what: str, said: Iterable[str], kind: type[Warning]) -> None:
    found = "; ".join(said)
    if found:
        warn(f"{read.name}: {what}: {found}.", kind)


# Of mjtGeom: what a size says. Planes and height fields have no body.
SHAPES = {
    2: lambda size: solids.ball(size[0]),
    3: lambda size: solids.capsule(size[0], 2 * size[1]),
    4: lambda size: _stretched(solids.ball(1.0), size),
    5: lambda size: solids.rod(size[0], 2 * size[1]),
    6: lambda size: solids.box(2 * size),
}
MESH = 7
# Groups that MuJoCo's viewer shows: others hold shapes for contacts.
SHOWN = 2


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
