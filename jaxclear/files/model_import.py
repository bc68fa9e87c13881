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
from jaxclear.components.drive import Held
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
from jaxclear.ground.arguments import check_known
from jaxclear.ground.warning import warn
from jaxclear.ground.wording import listed
from jaxclear.multibody.exchange import without_loads_on
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.topology import grow
from jaxclear.results import solids
from jaxclear.results.solids import Triangles


class NotImported(UserWarning):
    """Something in a model that the mechanism does not have."""


class ImportedSoft(UserWarning):
    """Something in a model that gives way under the model's own weight."""


@answering
def read_urdf(path: Any, *, floating: bool = False, stops: str = "steady") -> Mechanism:
    """The mechanism in a URDF file, root fixed in the ground, or `floating`; as `read_mjcf`."""
    return _mechanism(compiled(path, floating=floating), stops)


@answering
def read_mjcf(
    path: Any, *, floating: bool = False, stops: str = "steady", keyframe: str | None = None
) -> Mechanism:
    """The mechanism in a file of MJCF (or URDF), with the names of the file.

    Bodies have the frames, inertias and joints of the model: hinges are `Revolute`, slides
    `Prismatic`, balls `Spherical`, free joints `Free`, welds `Fixed`; coordinates count from the
    model's reference configuration. Gravity becomes a load; of hinges and slides damping and
    stiffness a `JointSpring`, armature a `RotorInertia`, dry friction a `JointFriction`, limits a
    `JointStop`. Active equalities `connect` are `Spherical` joints and `weld` `Fixed` ones that
    close loops, linear ones between joints (URDF's `mimic`) a `Ratio`; a joint that one holds alone
    is driven (`drive.Held`). Bodies without inertia that are welded become part of what they are
    welded to. Several joints of one body get bodies between them, of 1e-12 of its mass. Geometries
    and their names are read by `read_shapes`.

    - `path`: of the file. `jaxclear[import]` installs MuJoCo, which reads it.
    - `floating`: roots without a joint get a free one.
    - `stops`: what limits, soft constraints in MuJoCo and springs here, have of it. "steady": under
      weight and springs of the model's tree they give way as far. "impact": they stop what runs
      into them over the same way and time, and give way 1 / (1 - d) times as far under a steady
      load, for MuJoCo's impedance d (20 times by default).
    - `keyframe`: that of the file in which it starts, by its name; by default the reference. What
      closes loops from there is the nearest place; speeds and controls are not taken over.

    Dry friction holds what is driven by less; in MuJoCo it creeps. A `NotImported` warning names
    what is not taken over: contacts, actuators, tendons, other equalities, a reference
    configuration that is not kept, and what a ball or a free joint has of the above. An
    `ImportedSoft` warning says what gives way under weight and springs, and by how much. Raises
    `ValueError` with a sentence.
    """
    return _mechanism(compiled(path, floating=floating), stops, keyframe)


def _mechanism(read: Compiled, stops: str, keyframe: str | None = None) -> Mechanism:
    check_known("stops", stops, STOPS)
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
        held = dataclasses.replace(joint, drive=Held(place))
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
