"""Strip chart of how journals move in their bearings."""

from typing import Any

from matplotlib.patches import Patch

from jaxclear.plot.canvas import MILLI, check_run, panels, warned
from jaxclear.results.modes import Mode
from jaxclear.results.trajectory import Trajectory

__all__ = ["modes"]

# Free flight is the paper's white; an impact is drawn at least so wide, as a share of the chart.
COLOURS = {Mode.FREE_FLIGHT: "#e8edf2", Mode.IMPACT: "#c23b22", Mode.CONTACT: "#4a7fb0"}
LEAST_WIDTH = 1e-3
BAR = 0.8


def modes(run: Trajectory, *joints: str, ax: Any = None) -> Any:
    """Free flight, impact and contact over time, a strip for each joint (all with clearance by
    default). Impacts are drawn on top, and never too thin to be seen. `ax`: axes to draw in.
    """
    check_run(run)
    names = joints or tuple(run.formulation.contact_joints(run.mechanism))
    colours = {mode.label: colour for mode, colour in COLOURS.items()}
    span = MILLI * float(run.time[-1] - run.time[0])
    sheet = panels("modes", ax, size=(9.0, 1.3 + 0.45 * len(names)))
    axes = sheet.one
    for row, name in enumerate(names):
        for label, phases in run.modes(name).groupby("mode"):
            start = MILLI * phases["from [s]"].to_numpy()
            width = MILLI * phases["to [s]"].to_numpy() - start
            thin = LEAST_WIDTH * span if label == Mode.IMPACT.label else 0.0
            axes.broken_barh(
                list(zip(start, width.clip(thin), strict=True)),
                (row - 0.5 * BAR, BAR),
                color=colours[label],
                zorder=3 if label == Mode.IMPACT.label else 2,
            )
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(MILLI * float(run.time[0]), MILLI * float(run.time[-1]))
    axes.set_xlabel("time [ms]")
    sheet.title("Modes of motion of the journals")
    patches = [Patch(color=colour) for colour in COLOURS.values()]
    sheet.legend(patches, [mode.label for mode in COLOURS])
    return warned(sheet, {"": run})
