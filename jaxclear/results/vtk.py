"""A run as a time series for ParaView and other viewers: bodies and worn walls, through meshio.

Each saved instant is a file of its own (.vtu, VTK's unstructured grid), and `run.pvd` names them
with their times.
"""

from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxclear.components.body import GROUND
from jaxclear.ground.arguments import check_count
from jaxclear.results.relative_motion import marker_frame
from jaxclear.results.solids import parts
from jaxclear.results.solids.walls import wall

__all__ = ["write"]


class _Solid(NamedTuple):
    """What moves with a body: `points` in its frame, `cells` of them, `depth` of each cell [m]."""

    body: str
    points: np.ndarray
    kind: str
    cells: np.ndarray
    depth: np.ndarray


def write(run: Any, folder: Any, frames: int, meshes: Any) -> Path:
    """Writes the series into a folder, which is made; the path of its `run.pvd`."""
    import meshio

    check_count("frames of to_vtk", frames)
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"the folder {folder} is a file; give a folder.")
    solids = [*_bodies(run, meshes), *_walls(run)]
    folder.mkdir(parents=True, exist_ok=True)
    time = np.asarray(run.time)
    last = int(np.sum(time <= float(run.ended) * (1 + 1e-12)))
    chosen = np.unique(np.linspace(0, last - 1, min(frames, last)).round().astype(int))
    numbers = {name: i for i, name in enumerate([GROUND, *run.mechanism.bodies])}
    motions = {name: run.body(name) for name in run.mechanism.bodies}
    cells, body, depth, begun = [], [], [], 0
    for one in solids:
        cells.append((one.kind, one.cells + begun))
        body.append(np.full(len(one.cells), numbers[one.body]))
        depth.append(one.depth)
        begun += len(one.points)
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    series = ElementTree.SubElement(root, "Collection")
    for count, at in enumerate(chosen):
        placed = [_placed(one, motions.get(one.body), at) for one in solids]
        points, velocity = (np.concatenate(own) for own in zip(*placed, strict=True))
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


def _bodies(run: Any, meshes: Any) -> list[_Solid]:
    solids = parts.parts(run, parts.checked_meshes(run, meshes), parts.size_of(run))
    return [
        _Solid(name, own.points, "triangle", own.corners, np.zeros(len(own.corners)))
        for name, own in ((name, part.whole) for name, part in solids.items())
        if len(own.points)
    ]


def _walls(run: Any) -> list[_Solid]:
    """Every worn wall: of a bearing, socket or guide on the parent, of a journal, ball or slider on
    the child."""
    found = []
    for name, surfaces in run.worn.items():
        connection = run.mechanism.connections[name]
        joint = getattr(connection.joint, "gap", connection.joint)
        maps = joint.maps()
        for surface, depth in surfaces.items():
            own = wall(maps[surface][0], surface, np.asarray(depth)) if surface in maps else None
            if own is None:
                continue
            inner = surface in joint.inner_surfaces()
            marker = connection.child if inner else connection.parent
            rotation, place = marker_frame(marker)
            points = own.points @ rotation.T + place
            found.append(_Solid(marker.body, points, "quad", own.corners, own.depth))
    return found


def _placed(solid: _Solid, motion: Any, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and their velocity [m/s] in the ground frame at a saving time."""
    if motion is None:
        return solid.points, np.zeros_like(solid.points)
    points = solid.points @ np.asarray(motion.rotation[at]).T + np.asarray(motion.origin[at])
    arms = points - np.asarray(motion.com[at])
    return points, np.asarray(motion.velocity[at]) + np.cross(np.asarray(motion.spin[at]), arms)
