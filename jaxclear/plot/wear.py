"""Figures of a worn surface: rolled out flat, and in space with its depth exaggerated."""

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from jaxclear.components.wear_map import CylinderMap
from jaxclear.plot.canvas import MICRO, MILLI, canvas, check_run, setting, warned
from jaxclear.results.trajectory import Trajectory

__all__ = ["wear_surface", "wear_unrolled"]


def _wear(run: Trajectory, joint: str, surface: str) -> tuple[CylinderMap, np.ndarray]:
    check_run(run)
    depth = np.asarray(run.worn_depth(joint, surface))
    return run.mechanism.connections[joint].joint.maps()[surface][0], depth


def wear_unrolled(run: Trajectory, joint: str, surface: str = "bearing") -> Figure:
    """Worn depth over direction and position along the axis, the wall rolled out flat; beside it
    the deepest cell of each row.
    """
    wear_map, depth = _wear(run, joint, surface)
    figure, axes = canvas(1, 2, (9.5, 4.2), width_ratios=(3.2, 1.0), sharey=True)
    around = np.linspace(0, 360, depth.shape[0] + 1)
    along = MILLI * np.linspace(-0.5, 0.5, depth.shape[1] + 1) * float(wear_map.length)
    mesh = axes[0].pcolormesh(
        around, along, MICRO * depth.T, cmap="inferno", norm=_stretched(MICRO * depth)
    )
    figure.colorbar(mesh, ax=axes[0], label="worn depth [µm] (colour ~ square root)")
    axes[0].set_xlabel("direction from the bearing's x axis [deg]")
    axes[0].set_ylabel("position along the axis [mm]")
    axes[0].set_title(f"Worn depth of the {surface} of {joint}, unrolled{setting(run, joint)}")
    axes[0].set_xticks(range(0, 361, 60))
    heights = MILLI * np.asarray(wear_map.heights())
    axes[1].barh(
        heights,
        MICRO * depth.max(axis=0),
        height=heights[1] - heights[0] if len(heights) > 1 else 1.0,
        color="C1",
    )
    axes[1].set_xlabel("deepest in row [µm]")
    return warned(figure, {"": run})


def _stretched(values):
    return matplotlib.colors.PowerNorm(0.5, vmin=0.0, vmax=max(float(values.max()), 1e-12))


def wear_surface(
    run: Trajectory, joint: str, surface: str = "bearing", exaggeration: float | None = None
) -> Figure:
    """The worn wall in space, depth exaggerated so that the deepest place shows as a fifth of the
    radius.
    """
    wear_map, depth = _wear(run, joint, surface)
    radius = float(wear_map.radius)
    factor = 0.2 * radius / max(depth.max(), 1e-15) if exaggeration is None else exaggeration
    ringed = np.vstack([depth[-1:], depth, depth[:1]])
    padded = np.pad(ringed, ((0, 0), (1, 1)), mode="edge")
    corners = 0.25 * (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:])
    angles = np.linspace(0, 2 * np.pi, depth.shape[0] + 1)[:, None]
    reach = MILLI * (radius + factor * corners)
    rows = np.linspace(-0.5, 0.5, depth.shape[1] + 1)
    heights = MILLI * float(wear_map.length) * rows * np.ones_like(reach)
    figure = Figure(figsize=(7.5, 6.0), layout="constrained")
    axis = figure.add_subplot(projection="3d", computed_zorder=False)
    norm = _stretched(MICRO * depth)
    colours = matplotlib.colormaps["YlOrRd"](norm(MICRO * depth))
    across, upward = reach * np.cos(angles), reach * np.sin(angles)
    grid = {"edgecolor": (0, 0, 0, 0.06), "linewidth": 0.2, "rstride": 1, "cstride": 1}
    axis.plot_surface(across, upward, heights, facecolors=colours, shade=False, **grid)
    scale = matplotlib.cm.ScalarMappable(norm, "YlOrRd")
    figure.colorbar(
        scale, ax=axis, label="worn depth [µm] (colour ~ square root)", shrink=0.7, pad=0.12
    )
    axis.set_xlabel("x [mm]")
    axis.set_ylabel("y [mm]")
    axis.set_zlabel("z [mm]")
    title = f"Worn {surface} of {joint} seen from outside, depth × {factor:.0f}"
    axis.set_title(title + setting(run, joint), fontsize=10)
    axis.set_box_aspect((1, 1, 1.2))
    deepest = np.degrees(float(wear_map.angles()[int(depth.max(axis=1).argmax())]))
    axis.view_init(elev=22.0, azim=deepest + 25.0)
    return warned(figure, {"": run})
