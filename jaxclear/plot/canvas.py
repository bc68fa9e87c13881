"""What the figures share: an empty canvas, shades of one colour, readable units, a joint's setting
for a title.
"""

from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from jaxclear.results.trajectory import Trajectory

__all__ = ["MICRO", "MILLI", "canvas", "readable", "setting", "shades"]

MILLI, MICRO = 1e3, 1e6


def canvas(rows: int = 1, columns: int = 1, size: tuple[float, float] = (7.0, 4.5), **kwargs: Any):
    """An empty figure of `size` [inch] and its axes."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **kwargs)


def shades(count: int) -> list:
    """Colours from dark to light."""
    return [matplotlib.colormaps["viridis"](x) for x in np.linspace(0.0, 0.85, count)]


def setting(run: Trajectory, joint: str) -> str:
    """The joint's clearance and the duration of the run, for a title."""
    clearance = float(run.mechanism.connections[joint].joint.clearance)
    return f" (clearance {MILLI * clearance:g} mm, {float(run.time[-1]):g} s)"


def readable(values: np.ndarray, unit: str) -> tuple[float, str]:
    """Factor and unit in which values in metres or radians are readable; other units stay."""
    if unit not in ("m", "rad") or not len(values):
        return 1.0, unit
    size = np.abs(values).max()
    return next(
        ((f, p + unit) for f, p in ((1.0, ""), (1e3, "m"), (1e6, "µ")) if size * f >= 1.0),
        (1e9, f"n{unit}"),
    )
