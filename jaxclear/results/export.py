"""A run as an xarray DataTree: every history by body and joint, with units and meaning as
attributes.

A run as a time series for ParaView and other viewers: bodies and worn walls, through meshio.

Each saved instant is a file of its own (.vtu, VTK's unstructured grid), and `run.pvd` names them
with their times.
"""

from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import jax
import numpy as np

from jaxclear.components.body import GROUND
from jaxclear.components.joint.base import drive_of
from jaxclear.ground.arguments import check_count
from jaxclear.ground.datasets import provenance
from jaxclear.multibody.topology import coordinate_units, turns
from jaxclear.results import histories, transmissions
from jaxclear.results.relative_motion import marker_frame
from jaxclear.results.solids import checked_meshes, parts, size_of, wall
from jaxclear.results.state_history import StateHistory

XYZ = np.array(["x", "y", "z"], object)
# Fields of each history with dimension, unit and meaning; {} is the name of the body or joint.
BODY = {
    "com": ("axis", "m", "centre of mass of {}"),
    "quaternion": ("component", "1", "orientation of {}, scalar first"),
    "velocity": ("axis", "m/s", "velocity of the centre of mass of {}"),
    "spin": ("axis", "rad/s", "angular velocity of {}, ground axes"),
    "acceleration": ("axis", "m/s^2", "acceleration of the centre of mass of {}"),
    "angular_acceleration": ("axis", "rad/s^2", "angular acceleration of {}, ground axes"),
}
CONTACT = {
    "offset": ("axis", "m", "journal against bearing of {}, bearing axes"),
    "indentation": ("contact", "m", "overlap, positive in contact"),
    "normal_force": ("contact", "N", "normal contact force"),
    "slip_speed": ("contact", "m/s", "sliding speed at the contact"),
    "traction": ("contact", "N", "friction force"),
}
REACTION = {
    "force": ("axis", "N", "force on the child of {}, ground axes"),
    "torque": ("axis", "N m", "torque on the child of {}, ground axes"),
}


def dataset_of_run(history: StateHistory, worn: dict, attributes: dict, flat: bool) -> Any:
    """A run as an xarray DataTree by body, joint and surface, or as one flat data set.

    Args:
        history: states of the run, from which motion, contacts and reactions are computed.
        worn: depth maps [m] at the end, by joint and surface.
        attributes: of the whole.
        flat: whether to return one Dataset with dotted names.
    """
    import xarray

    nodes = _nodes(history, worn)
    coordinates = {
        "time": ("time", np.asarray(history.time), {"units": "s"}),
        "axis": ("axis", XYZ),
        "component": ("component", np.array(["w", *XYZ], object)),
    }
    attrs = attributes | {"jax": jax.__version__, "mechanism": str(history.mechanism)}
    attrs = {"what": "run"} | attrs | provenance()
    if not flat:
        root = {"/": xarray.Dataset(coords=coordinates, attrs=attrs)}
        below = {"/".join(path): xarray.Dataset(variables) for path, variables in nodes.items()}
        return xarray.DataTree.from_dict(root | below)
    columns = {}
    for path, variables in nodes.items():
        above = ".".join(path)
        for field, (dims, *rest) in variables.items():
            every = tuple(dim if dim in coordinates else f"{above}.{dim}" for dim in dims)
            columns[f"{above}.{field}"] = (every, *rest)
    return xarray.Dataset(columns, coordinates, attrs)


def _nodes(history: StateHistory, worn: dict) -> dict[tuple[str, ...], dict[str, tuple]]:
    """By body, joint, coupling or surface its variables: dimensions, values, attributes."""
    nodes: dict[tuple[str, ...], dict[str, tuple]] = {}

    def put(path, field, dims, values, unit, meaning):
        attrs = {"units": unit, "long_name": meaning}
        nodes.setdefault(path, {})[field] = (dims, np.asarray(values), attrs)

    def put_all(names, read, fields):
        for name in names:
            part = read(history, name)
            for field, (dim, unit, meaning) in fields.items():
                values = getattr(part, field)
                put((name,), field, ("time", dim), values, unit, meaning.format(name))

    mechanism = history.mechanism
    put_all(mechanism.bodies, histories.body, BODY)
    put_all(history.formulation.contact_joints(mechanism), histories.contact, CONTACT)
    for name in history.formulation.contact_joints(mechanism):
        impulse = histories.contact_impulse(history, name)
        put((name,), "contact_impulse", ("time",), impulse, "N s", "impulse of the normal forces")
    put_all(mechanism.connections, histories.reaction_history, REACTION)
    for name, unit in _single_coordinates(history).items():
        what = "slides" if unit == "m" else "turns"
        place, speed = (history.coordinate(name, speeds=is_speed) for is_speed in (False, True))
        put((name,), "coordinate", ("time",), place, unit, f"how far {name} {what}")
        put((name,), "speed", ("time",), speed, f"{unit}/s", f"how fast {name} {what}")
    for name, coupling in mechanism.couplings.items():
        unit = "N m" if turns(mechanism, coupling) else "N"
        sent = transmissions.transmitted(history, name)
        put((name,), "transmitted", ("time",), sent, unit, "what the coupling transmits")
        if coupling.gives:
            c, length = transmissions.coupling(history, name), unit == "N"
            put((name,), "twist", ("time",), c.twist, "m" if length else "rad", "its twist")
            put((name,), "flank", ("time",), c.flank, "1", "the flank that presses, 1 or -1")
    for joint, surfaces in worn.items():
        for surface, depth in surfaces.items():
            where = joint, surface
            put(where, "worn_depth", ("around", "along"), depth, "m", "worn depth at the end")
            volume = histories.worn_volume(history, joint, surface)
            put(where, "worn_volume", ("time",), volume, "m^3", "volume lost")
    if history.balanced:
        energies = histories.energy_history(history)
        for name in energies.__dataclass_fields__:
            values = getattr(energies, name)
            put(("energy",), name, ("time",), values, "J", name.replace("_", " "))
    return nodes


def _single_coordinates(history: StateHistory) -> dict[str, str]:
    """Joints with one coordinate, of the tree or driven, with its unit."""
    mechanism = history.mechanism
    names = {x.name for x in mechanism.topology.branches if x.speed_count}
    names |= {n for n, x in mechanism.connections.items() if drive_of(x.joint) is not None}
    moving = [*mechanism.connections, *mechanism.topology.motors]
    names |= {*mechanism.topology.motors}
    units = {name: coordinate_units(mechanism, name) for name in moving}
    return {name: x[0] for name, x in units.items() if len(x) == 1 and name in names}


class _Solid(NamedTuple):
    """What moves with a body: `points` in its frame, `cells` of them, `depth` of each cell [m]."""

    body: str
    points: np.ndarray
    kind: str
    cells: np.ndarray
    depth: np.ndarray


def write_vtk(run: Any, folder: Any, frames: int, meshes: Any) -> Path:
    """Writes a run as a series of VTK files; returns the path of its `run.pvd`.

    Args:
        run: trajectory of the mechanism.
        folder: created if it does not exist.
        frames: number of saving times that are written, evenly chosen.
        meshes: by body, instead of the solid that would be drawn.
    """
    import meshio

    check_count("frames of to_vtk", frames)
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"the folder {folder} is a file; give a folder.")
    solids = [*_body_solids(run, meshes), *_wall_solids(run)]
    folder.mkdir(parents=True, exist_ok=True)
    time = np.asarray(run.time)
    last = int(np.sum(time <= float(run.ended) * (1 + 1e-12)))
    chosen = np.unique(np.linspace(0, last - 1, min(frames, last)).round().astype(int))
    numbers = {name: i for i, name in enumerate([GROUND, *run.mechanism.bodies])}
    motions = {name: run.body(name) for name in run.mechanism.bodies}
    cells, body, depth, offset = [], [], [], 0
    for one in solids:
        cells.append((one.kind, one.cells + offset))
        body.append(np.full(len(one.cells), numbers[one.body]))
        depth.append(one.depth)
        offset += len(one.points)
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    series = ElementTree.SubElement(root, "Collection")
    for count, at in enumerate(chosen):
        placed = [_place_solid(one, motions.get(one.body), at) for one in solids]
        points, velocity = (np.concatenate(x) for x in zip(*placed, strict=True))
        name = f"run_{count:05d}.vtu"
        meshio.Mesh(
            points,
            cells,
            point_data={"velocity": velocity},
            cell_data={"body": body, "worn depth": depth},
        ).write(folder / name)
        ElementTree.SubElement(series, "DataSet", timestep=repr(float(time[at])), file=name)
    path = folder / "run.pvd"
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _body_solids(run: Any, meshes: Any) -> list[_Solid]:
    solids = parts(run, checked_meshes(run, meshes), size_of(run))
    return [
        _Solid(name, x.points, "triangle", x.corners, np.zeros(len(x.corners)))
        for name, x in ((name, part.triangles) for name, part in solids.items())
        if len(x.points)
    ]


def _wall_solids(run: Any) -> list[_Solid]:
    """Every worn wall: of a bearing, socket or guide on the parent, of a journal, ball or slider on
    the child."""
    solids = []
    for name, surfaces in run.worn.items():
        if name not in run.mechanism.connections:
            continue
        connection = run.mechanism.connections[name]
        joint = getattr(connection.joint, "gap", connection.joint)
        maps = joint.maps()
        for surface, depth in surfaces.items():
            shape = wall(maps[surface][0], surface, np.asarray(depth)) if surface in maps else None
            if shape is None:
                continue
            inner = surface in joint.inner_surfaces()
            marker = connection.child if inner else connection.parent
            rotation, place = marker_frame(marker)
            points = shape.points @ rotation.T + place
            solids.append(_Solid(marker.body, points, "quad", shape.corners, shape.depth))
    return solids


def _place_solid(solid: _Solid, motion: Any, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and their velocity [m/s] in the ground frame at a saving time."""
    if motion is None:
        return solid.points, np.zeros_like(solid.points)
    points = solid.points @ np.asarray(motion.rotation[at]).T + np.asarray(motion.origin[at])
    arms = points - np.asarray(motion.com[at])
    return points, np.asarray(motion.velocity[at]) + np.cross(np.asarray(motion.spin[at]), arms)
