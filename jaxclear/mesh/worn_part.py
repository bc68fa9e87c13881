"""A worn part of a run as a volume mesh for finite elements and viewers, from a joint's name."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_number, expect
from jaxclear.ground.wording import described
from jaxclear.mesh.block_mesh import BlockMesh
from jaxclear.mesh.solids import Solid, bush, pin, socket
from jaxclear.multibody.mechanism import Mechanism

# The part that carries a worn surface, by the surface's name.
PARTS = {"bearing": bush, "journal": pin, "socket": socket}


@answering
def solid(
    mechanism: Mechanism,
    joint: str,
    surface: str = "bearing",
    *,
    thickness: float,
    cells: tuple[int, int, int] | None = None,
) -> Solid:
    """Mesh the part of a joint that carries a worn surface, as hexahedra in blocks.

    `.new` is its mesh, `.worn(run.worn_depth(joint, surface))` the worn one, with the same cells,
    in the frame of the bearing, journal or socket, z along its axis. The inside follows the depth
    linearly, so derivatives to it are exact.

    Args:
        mechanism: the mechanism.
        joint: name of the joint.
        surface: name of the surface that wears: "bearing" (the part is a bush), "journal" (a pin)
            or "socket" (a shell).
        thickness: thickness of the part behind the wall [m], > 0; of a pin that of the blocks at
            the wall, at most half its radius.
        cells: number of cells around (a multiple of 4), along (even; a socket has none) and through
            (even); by default as fine as the wear map, and 8 through.

    Returns:
        the part, a `Solid`.

    Raises:
        ValueError: if the surface does not wear, or thickness or cells do not fit it.
    """
    expect(mechanism, Mechanism, "what the part belongs to", "a jaxclear.Mechanism")
    wear_map = _find_wear_map(mechanism, joint, surface)
    part = f'the {surface} of "{joint}"'
    check_number(f"the thickness of {part}", thickness, "m", above=0)
    if surface == "journal" and thickness > 0.5 * float(wear_map.radius):
        raise ValueError(
            f"the blocks at the wall of {part} are {float(thickness):g} m thick; half its radius, "
            f"{0.5 * float(wear_map.radius):g} m, is the most."
        )
    least = _fewest_cells(wear_map, surface)
    counts = (*least, 8) if cells is None else _check_cells(cells, part)
    if counts[0] < least[0] or (surface != "socket" and counts[1] < least[1]):
        raise ValueError(
            f"{counts[0]} cells around and {counts[1]} along {part} would miss worn places of its "
            f"map; take at least {least[0]} and {least[1]}."
        )
    return PARTS[surface](wear_map, float(thickness), counts)


def _find_wear_map(mechanism: Mechanism, joint: str, surface: str) -> Any:
    maps = {
        (name, surface_name): wear_map
        for name in mechanism.topology.clearances
        for surface_name, (wear_map, _) in mechanism.connections[name].joint.maps().items()
        if surface_name in PARTS
    }
    if (joint, surface) not in maps:
        meshable = ", ".join(f'"{name}" {surface_name}' for name, surface_name in maps) or "none"
        raise ValueError(
            f"joint {joint!r} has no {surface} that wears and could be meshed; there are: "
            f"{meshable}."
        )
    return maps[joint, surface]


def _fewest_cells(wear_map: Any, surface: str) -> tuple[int, int]:
    """The fewest cells that do not miss one of the map's."""
    around, along = wear_map.cells
    # The sides of a cube have as many cells upwards as around.
    around = max(around, 2 * along) if surface == "socket" else around
    return max(8, 4 * -(-around // 4)), max(4, 2 * -(-along // 2))


def _check_cells(cells: Any, part: str) -> tuple[int, int, int]:
    if not isinstance(cells, (tuple, list)) or len(cells) != 3:
        raise ValueError(
            f"cells of {part} is {described(cells)}; it must be three numbers: around, along, "
            "through."
        )
    for what, count, factor in zip(("around", "along", "through"), cells, (4, 2, 2), strict=True):
        check_count(f"the number of cells {what} {part}", count, 2 * factor)
        if count % factor:
            raise ValueError(
                f"the number of cells {what} {part} is {count}; it must be a multiple of {factor}."
            )
    around, along, through = cells
    return around, along, through


@answering
def write(path: Any, worn: BlockMesh, new: BlockMesh | None = None) -> Path:
    """Write a mesh to a file through meshio, in the format of the file's ending (.vtu, .vtk, .xdmf,
    .inp, .msh ...).

    Cells carry their scaled Jacobian.

    Args:
        path: path of the file.
        worn: the mesh, a `BlockMesh`.
        new: mesh of the part as new; with it points carry their displacement [m].

    Returns:
        the path.

    Raises:
        ValueError: if a cell is inverted.
    """
    import meshio

    expect(worn, BlockMesh, "what is written", "the mesh of a part, such as solid(...).new")
    quality = np.asarray(worn.scaled_jacobians())
    if not np.all(quality > 0):
        raise ValueError(
            f"{np.sum(~(quality > 0))} of {len(quality)} cells are inverted (scaled Jacobian "
            f"{quality.min():.3g}): the part is worn through, or nearly; make it thicker."
        )
    points = np.asarray(worn.points)
    data = {}
    if new is not None:
        data["displacement"] = np.asarray(jnp.asarray(worn.points) - new.points)
    shape = {"scaled_jacobian": [quality]}
    written = meshio.Mesh(
        points, [("hexahedron", worn.hexahedra())], point_data=data, cell_data=shape
    )
    written.write(path)
    return Path(path)
