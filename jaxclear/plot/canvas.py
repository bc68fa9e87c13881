"""What the figures share: an empty canvas, shades of one colour, readable units, a joint's setting
for a title, the warnings of the runs shown for a caption.
"""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from jaxclear.ground.arguments import expect
from jaxclear.results.trajectory import Trajectory

__all__ = [
    "MICRO",
    "MILLI",
    "canvas",
    "captioned",
    "check_run",
    "readable",
    "setting",
    "shades",
    "warned",
]

MILLI, MICRO = 1e3, 1e6
# A caption holds so many sentences, in letters of this size [pt]; so many of them fill an inch, and
# a line is so high [inch].
MOST_SENTENCES, LETTERS, PER_INCH, LINE = 3, 7, 18, 0.13


def canvas(rows: int = 1, columns: int = 1, size: tuple[float, float] = (7.0, 4.5), **kwargs: Any):
    """An empty figure of `size` [inch] and its axes."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **kwargs)


def shades(count: int) -> list:
    """Colours from dark to light."""
    return [matplotlib.colormaps["viridis"](x) for x in np.linspace(0.0, 0.85, count)]


def check_run(run: Any) -> None:
    """Raises `ValueError` for what is no run."""
    expect(run, Trajectory, "the run", "a run, as jaxclear.simulate returns it")


def setting(run: Trajectory, joint: str) -> str:
    """The joint's clearance and the duration of the run, for a title."""
    clearance = float(run.mechanism.connections[joint].joint.clearance)
    return f" (clearance {MILLI * clearance:g} mm, {float(run.time[-1]):g} s)"


def captioned(figure: Figure, sentences: Sequence[str]) -> Figure:
    """The figure, made higher by the sentences below it; as it is without any."""
    if not sentences:
        return figure
    said = list(sentences[:MOST_SENTENCES])
    if len(sentences) > MOST_SENTENCES:
        said.append(f"And {len(sentences) - MOST_SENTENCES} more.")
    width = int(PER_INCH * figure.get_figwidth())
    text = "\n".join(textwrap.fill(sentence, width) for sentence in said)
    below = LINE * (text.count("\n") + 2)
    whole = figure.get_figheight() + below
    figure.set_figheight(whole)
    # The layout would set a legend outside the axes and a label of the figure upon each other.
    for legend in figure.legends:
        legend.set_bbox_to_anchor((0.0, below / whole, 1.0, 1.0), figure.transFigure)
        below += legend.get_window_extent().height / figure.dpi + LINE
    room = (0.0, below / whole, 1.0, 1.0 - below / whole)
    figure.set_layout_engine("constrained", rect=room)
    figure.text(0.01, 0.5 * LINE / whole, text, fontsize=LETTERS, color="C3", va="bottom")
    return figure


def warned(figure: Figure, runs: Mapping[str, Trajectory]) -> Figure:
    """The figure with what the runs it shows warn of below it; `runs` by what they are called
    ("" where there is one)."""
    sentences = [
        f"Warning{f' ({name})' if name else ''}: {sentence}"
        for name, run in runs.items()
        for sentence in run.warnings
    ]
    return captioned(figure, sentences)


def readable(values: np.ndarray, unit: str) -> tuple[float, str]:
    """Factor and unit in which values in metres or radians are readable; other units stay."""
    if unit not in ("m", "rad") or not len(values):
        return 1.0, unit
    size = np.abs(values).max()
    return next(
        ((f, p + unit) for f, p in ((1.0, ""), (1e3, "m"), (1e6, "µ")) if size * f >= 1.0),
        (1e9, f"n{unit}"),
    )
