"""Figure of a tip's error: over time, and shared out among the joints."""

from typing import Any

import numpy as np

from jaxclear.ground.arguments import expect
from jaxclear.plot.canvas import panels, readable
from jaxclear.results.pointing_error import PointingError, shift, turn

__all__ = ["pointing_budget"]


def pointing_budget(error: PointingError, *, ax: Any = None) -> Any:
    """Pointing and position error of a tip over time, exact beside the adjoint model, with what
    each joint contributes; beside it the root mean squares, each with its share of the mean
    square. `ax`: four axes to draw in, over time and beside it, row by row."""
    expect(error, PointingError, "the error", "what jaxclear.pointing_error returns")
    sheet = panels("pointing_budget", ax, 2, 2, (10.0, 6.4), width_ratios=(2.4, 1.0))
    axes = sheet.axes
    table = error.budget()
    quantities = (
        ("pointing", error.pointing_angle, turn, "rad"),
        ("position", error.position_error, shift, "m"),
    )
    for (over_time, beside), (what, exact, size, base_unit) in zip(axes, quantities, strict=True):
        factor, unit = readable(exact, base_unit)
        shades = dict(zip(error.names, (f"C{k}" for k in range(len(error.names))), strict=True))
        for name, shade in shades.items():
            values = factor * size(error.contributions[name])
            over_time.plot(
                error.time, values, color=shade, lw=0.9, alpha=0.85, label=f"{name} alone"
            )
        over_time.plot(error.time, factor * exact, color="0.55", lw=3.0, label="exact", zorder=2.5)
        over_time.plot(
            error.time, factor * size(error.model), "k--", lw=1.0, label="adjoint model", zorder=3
        )
        over_time.set_ylabel(f"{what} error [{unit}]")
        over_time.set_ylim(bottom=0)
        column = factor * table[f"rms {what} [{base_unit}]"]
        colours = [shades.get(name, "k" if name == "model" else "0.55") for name in table.index]
        beside.barh(range(len(table)), column, color=colours)
        for row, (value, share) in enumerate(
            zip(column, table[f"share of {what} [1]"], strict=True)
        ):
            text = "" if np.isnan(share) or row >= len(error.names) else f"{100 * share:.3g} %"
            beside.text(value, row, f" {text}", va="center", fontsize=8)
        beside.set_yticks(range(len(table)), table.index)
        beside.set_xlim(0.0, 1.25 * max(column.max(), np.finfo(float).tiny))
        beside.invert_yaxis()
        beside.set_xlabel(f"rms [{unit}]; %: share of its square")
    axes[1][0].set_xlabel("time [s]")
    sheet.legend()
    sheet.title(f'Error of the tip on "{error.tip}" seen from "{error.base}"')
    return sheet.done([f"Warning: {sentence}" for sentence in error.warnings])
