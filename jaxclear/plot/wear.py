"""Figures of a worn surface: rolled out flat, and in space with its depth exaggerated."""

from collections.abc import Callable
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from jaxclear.ground.argument_errors import answering
from jaxclear.multibody.system import wearing_in
from jaxclear.plot.canvas import MILLI, check_run, key, length, panels, readable, setting, warned
from jaxclear.results.trajectory import Trajectory

# A hollow of a sphere is looked at from somewhat above it, and rather from the side [deg].
ABOVE, STEEPEST = 12.0, 40.0
# What the deepest place is drawn as, as a share of the radius; and what colours say.
DEPTH_SHARE, COLOUR = 0.2, "worn depth [{}] (colour ~ square root)"


class Wall(NamedTuple):
    """How a worn wall is drawn: boundaries of the cells along it and what they are called; `places`
    gives x, y and z of the corners of its cells [mm] from their distances to the axis, or to the
    middle of a sphere [mm]; `rise`: angle [deg] under which a row is looked at; `height` of the
    picture beside its width.
    """

    edges: np.ndarray
    along: str
    round_about: str
    places: Callable[[np.ndarray], tuple]
    rise: Callable[[float], float]
    height: float


def _cylinder_wall(wear_map: Any) -> Wall:
    around, along = wear_map.cells
    edges = MILLI * np.linspace(-0.5, 0.5, along + 1) * float(wear_map.length)
    angles = np.linspace(0, 2 * np.pi, around + 1)[:, None]

    def places(reach):
        return reach * np.cos(angles), reach * np.sin(angles), edges * np.ones_like(reach)

    across = "direction from the {}'s x axis [deg]"
    return Wall(edges, "position along the axis [mm]", across, places, lambda _: 22.0, 1.2)


def _sphere_wall(wear_map: Any) -> Wall:
    around, along = wear_map.cells
    edges = np.linspace(-90, 90, along + 1)
    azimuth, elevation = np.linspace(0, 2 * np.pi, around + 1)[:, None], np.radians(edges)

    def places(reach):
        flat = reach * np.cos(elevation)
        return flat * np.cos(azimuth), flat * np.sin(azimuth), reach * np.sin(elevation)

    across = "azimuth from the {}'s x axis [deg]"
    rise = lambda row: min(max(row + ABOVE, -STEEPEST), STEEPEST)
    return Wall(edges, "elevation [deg]", across, places, rise, 1.0)


# What either side of a guide or slider is called.
FLAT = {"guide": "wall", "slider": "face"}
# The shape of a wall, by the surface's name.
SHAPES = {"socket": _sphere_wall, "ball": _sphere_wall}


def _wear_of_surface(run: Trajectory, joint: str, surface: str) -> tuple[Any, np.ndarray]:
    check_run(run)
    depth = np.asarray(run.worn_depth(joint, surface))
    wear_map = wearing_in(run.mechanism)[joint].maps()[surface][0]
    if wear_map.cells == (1, 1):
        raise ValueError(
            f'the {surface} of "{joint}" wears to one depth and has no map to draw: read '
            f'run.worn_depth("{joint}", "{surface}").'
        )
    return wear_map, depth


def _wall_of_surface(wear_map: Any, surface: str) -> Wall:
    return SHAPES.get(surface, _cylinder_wall)(wear_map)


@answering
def wear_unrolled(run: Trajectory, joint: str, surface: str = "bearing", *, ax: Any = None) -> Any:
    """Worn depth of a surface, unrolled, and the largest depth of each row.

    Of a guide or slider the depth along either wall is drawn.

    Args:
        run: the run.
        joint: name of the joint.
        surface: name of the surface; "bearing" by default.
        ax: two `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such surface that wears, or it has a single depth.
    """
    wear_map, depth = _wear_of_surface(run, joint, surface)
    if wear_map.flat:
        return _draw_along_walls(run, joint, surface, wear_map, depth, ax)
    wall = _wall_of_surface(wear_map, surface)
    sheet = panels("wear_unrolled", ax, 1, 2, (9.5, 4.2), width_ratios=(3.2, 1.0), sharey=True)
    axes = sheet.axes.flat
    around = np.linspace(0, 360, depth.shape[0] + 1)
    factor, unit = readable(depth, "m")
    mesh = axes[0].pcolormesh(
        around, wall.edges, factor * depth.T, cmap="inferno", norm=_root_norm(factor * depth)
    )
    sheet.figure_of.colorbar(mesh, ax=axes[0], label=COLOUR.format(unit))
    axes[0].set_xlabel(wall.round_about.format(surface))
    axes[0].set_ylabel(wall.along)
    sheet.title(f"Worn depth of the {surface} of {joint}, unrolled{setting(run, joint)}")
    axes[0].set_xticks(range(0, 361, 60))
    middles, widths = 0.5 * (wall.edges[1:] + wall.edges[:-1]), np.diff(wall.edges)
    axes[1].barh(middles, factor * depth.max(axis=0), height=widths, color="C1")
    axes[1].set_xlabel(f"deepest in row [{unit}]")
    return warned(sheet, {"": run})


def _draw_along_walls(
    run: Trajectory, joint: str, surface: str, wear_map: Any, depth: np.ndarray, ax: Any
) -> Any:
    """Worn depth along the lower (-x) and the upper (x) wall or face, downwards."""
    sheet = panels("wear_unrolled", ax, 1, 2, (9.5, 4.2), width_ratios=(3.2, 1.0), sharey=True)
    axes = sheet.axes.flat
    edges = MILLI * (
        float(wear_map.middle) + np.linspace(-0.5, 0.5, depth.shape[1] + 1) * float(wear_map.length)
    )
    factor, unit = readable(depth, "m")
    names = tuple(f"{side} {FLAT[surface]}" for side in ("lower", "upper"))
    for k, name in enumerate(names):
        axes[0].stairs(factor * depth[k], edges, color=f"C{k}", lw=1.4, label=name)
    axes[0].set_xlabel(f"position along the {surface} [mm]")
    axes[0].set_ylabel(f"worn depth [{unit}]")
    sheet.title(f"Worn depth of the {surface} of {joint}{setting(run, joint)}")
    axes[0].margins(x=0.0)
    key(axes[0])
    axes[1].bar(names, factor * depth.max(axis=1), color=("C0", "C1"), width=0.6)
    axes[1].set_xlabel("deepest")
    axes[0].set_ylim(axes[0].get_ylim()[::-1])
    return warned(sheet, {"": run})


def _root_norm(values):
    return matplotlib.colors.PowerNorm(0.5, vmin=0.0, vmax=float(values.max()) or 1.0)


@answering
def wear_surface(run: Trajectory, joint: str, surface: str = "bearing", *, ax: Any = None) -> Any:
    """The worn wall in space, its deepest place drawn as a fifth of the radius.

    Args:
        run: the run.
        joint: name of the joint.
        surface: name of the surface; "bearing" by default.
        ax: `matplotlib.axes.Axes` with projection="3d" to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such surface that wears, it has a single depth, or it is flat.
    """
    wear_map, depth = _wear_of_surface(run, joint, surface)
    if wear_map.flat:
        raise ValueError(
            f'the {surface} of joint "{joint}" is flat; jaxclear.plot.wear_unrolled draws its '
            "depth along either side."
        )
    wall = _wall_of_surface(wear_map, surface)
    radius = float(wear_map.radius)
    deepest = float(depth.max())
    drawn = DEPTH_SHARE * radius / (deepest or 1.0)
    ringed = np.vstack([depth[-1:], depth, depth[:1]])
    padded = np.pad(ringed, ((0, 0), (1, 1)), mode="edge")
    corners = 0.25 * (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:])
    across, upward, heights = wall.places(MILLI * (radius + drawn * corners))
    sheet = panels("wear_surface", ax, size=(7.5, 6.0), space=True)
    axis = sheet.one
    factor, unit = readable(depth, "m")
    norm = _root_norm(factor * depth)
    colours = matplotlib.colormaps["YlOrRd"](norm(factor * depth))
    # As `plot_surface` draws it, which goes through its faces one by one.
    places = np.stack([across, upward, heights], axis=-1)
    faces = np.stack([places[:-1, :-1], places[:-1, 1:], places[1:, 1:], places[1:, :-1]], axis=2)
    grid = {"facecolor": colours.reshape(-1, 4), "edgecolor": (0, 0, 0, 0.06), "linewidth": 0.2}
    axis.add_collection3d(Poly3DCollection(faces.reshape(-1, 4, 3), **grid))
    axis.auto_scale_xyz(across, upward, heights)
    scale = matplotlib.cm.ScalarMappable(norm, "YlOrRd")
    sheet.figure_of.colorbar(scale, ax=axis, label=COLOUR.format(unit), shrink=0.7, pad=0.12)
    axis.set_xlabel("x [mm]")
    axis.set_ylabel("y [mm]")
    # Matplotlib stands it on its head where the view rises from behind.
    axis.zaxis.set_rotate_label(False)
    axis.set_zlabel("z [mm]", rotation=90)
    axis.locator_params(nbins=5)
    title = f"Worn {surface} of {joint} seen from outside{setting(run, joint)}"
    sheet.title(f"{title}: {length(deepest)} is drawn as {length(drawn * deepest)}")
    axis.set_box_aspect((1, 1, wall.height), zoom=0.9)
    column, row = map(int, np.unravel_index(int(np.argmax(depth)), depth.shape))
    side = np.degrees(float(wear_map.angles()[column]))
    rise = wall.rise(0.5 * (wall.edges[row] + wall.edges[row + 1]))
    # Not along an axis, whose numbers would lie in one place.
    phase = (side + 25.0) % 90.0
    axis.view_init(elev=rise, azim=side + 25.0 + np.clip(phase, 20.0, 70.0) - phase)
    return warned(sheet, {"": run})
