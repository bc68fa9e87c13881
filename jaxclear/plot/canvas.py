"""What the figures share: an empty canvas or the user's axes, shades of one colour, readable units,
a joint's setting for a title, the warnings of the runs shown for a caption.

Every function of the room takes `ax`. Without it the function makes a figure and returns that, so
that a notebook shows it and `.savefig` keeps it. With it the function draws there and returns the
axes, as matplotlib's users expect: one axes, or as many as the figure has panels.
"""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from jaxclear.ground.arguments import expect
from jaxclear.ground.wording import described
from jaxclear.plot.fitting import RAISED, columns_of, fitted, key, places
from jaxclear.results.trajectory import Trajectory

__all__ = [
    "MICRO",
    "MILLI",
    "Panels",
    "canvas",
    "captioned",
    "check_run",
    "length",
    "over_time",
    "panels",
    "readable",
    "setting",
    "shades",
    "volume",
    "warned",
]

MILLI, MICRO = 1e3, 1e6
# A caption is written in letters of this size [pt]; so many of them fill an inch, and a line is so
# high [inch]; and so many lines are shown at the most.
LETTERS, PER_INCH, LINE, MOST_LINES = 7, 18, 0.13, 6
# Letters in a line of sentences within a panel.
IN_PANEL = 70
# Powers of ten of the prefixes of units; and units that take them all, beside "m" and "rad", which
# take those that make them small.
PREFIXES = {3 * k: prefix for k, prefix in zip(range(-6, 4), "afpnµm kMG", strict=True)} | {0: ""}
PREFIXED = {"N", "N m", "J", "W", "Pa", "s", "m/s", "rad/s", "Hz"}
# Numbers within these stand as they are.
LEAST, LARGEST = 1e-3, 1e5


def canvas(rows: int = 1, columns: int = 1, size: tuple[float, float] = (7.0, 4.5), **kwargs: Any):
    """An empty figure of `size` [inch] and its axes."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **kwargs)


class Panels(NamedTuple):
    """Where is drawn: the `axes` of the panels, an array; `figure` is that of the function, None
    where the user gave the axes."""

    figure: Figure | None
    axes: np.ndarray

    @property
    def one(self) -> Any:
        """The first panel, or the only one."""
        return self.axes.flat[0]

    @property
    def whole(self) -> Any:
        """The figure in which the panels stand."""
        return self.one.get_figure()

    def title(self, text: str) -> None:
        """What stands above all panels."""
        if self.figure is None or self.axes.size == 1:
            self.one.set_title(text, fontsize=10)
        else:
            self.figure.suptitle(text, fontsize=10)

    def legend(self, *lines: Any, **kwargs: Any) -> None:
        """What all panels share; handles and labels, by default the first panel's."""
        handles, labels = lines or self.one.get_legend_handles_labels()
        if self.figure is None:
            key(self.one, (handles, labels))
        else:
            columns = columns_of(labels, 72 * self.figure.get_figwidth(), 8)
            how: Any = {"fontsize": 8, "loc": "outside lower center", "ncols": columns}
            self.figure.legend(handles, labels, **how, **kwargs)

    def done(self, sentences: Sequence[str] = ()) -> Any:
        """What the function returns, with sentences below it (in the last panel where the axes are
        the user's)."""
        if self.figure is not None:
            return captioned(self.figure, sentences)
        for axis in self.axes.flat:
            places(axis)
        if sentences:
            text = "\n".join(_lines(sentences, IN_PANEL))
            last = self.axes.flat[-1]
            place = {"transform": last.transAxes, "va": "bottom", "fontsize": 0.8 * LETTERS}
            # A panel in space has a depth besides.
            last.text(0.01, 0.01, *([0.0] if last.name == "3d" else []), text, color="C3", **place)
        return self.one if self.axes.size == 1 else self.axes


def panels(
    what: str,
    ax: Any,
    rows: int = 1,
    columns: int = 1,
    size: tuple[float, float] = (7.0, 4.5),
    space: bool = False,
    **kwargs: Any,
) -> Panels:
    """New panels of a figure of `size` [inch], or the `ax` that the user gave; `space`: in three
    dimensions. Raises `ValueError` unless these are as many as the figure `what` has."""
    if ax is None:
        if space:
            kwargs["subplot_kw"] = {"projection": "3d", "computed_zorder": False}
        figure, axes = canvas(rows, columns, size, squeeze=False, **kwargs)
        return Panels(figure, axes)
    given = list(ax.flat) if isinstance(ax, np.ndarray) else ax
    given = list(given) if isinstance(given, Iterable) else [given]
    count, name = rows * columns, "3d" if space else "rectilinear"
    wanted = "one axes" if count == 1 else f"{count} axes"
    if len(given) != count or not all(isinstance(one, Axes) for one in given):
        raise ValueError(
            f"ax of plot.{what} is {described(ax)}; it must be {wanted} of matplotlib."
        )
    if space and any(one.name != name for one in given):
        raise ValueError(f'plot.{what} draws in space: give axes with projection="3d".')
    if not space and any(one.name == "3d" for one in given):
        raise ValueError(f"plot.{what} draws in the plane: give axes without projection.")
    found = np.empty(count, object)
    found[:] = given
    return Panels(None, found.reshape(rows, columns))


def over_time(axis: Any, x: np.ndarray, y: np.ndarray, time: np.ndarray) -> LineCollection:
    """A curve coloured by time [s]; the axis is widened to hold it."""
    points = np.stack([x, y], -1)
    lines = LineCollection(list(np.stack([points[:-1], points[1:]], 1)), cmap="viridis", lw=1.0)
    lines.set_array(time[:-1])
    axis.add_collection(lines)
    axis.autoscale_view()
    return lines


def shades(count: int) -> list:
    """Colours from dark to light."""
    return [matplotlib.colormaps["viridis"](x) for x in np.linspace(0.0, 0.85, count)]


def check_run(run: Any) -> None:
    """Raises `ValueError` for what is no run."""
    expect(run, Trajectory, "the run", "a run, as jaxclear.simulate returns it")


def setting(run: Trajectory, joint: str) -> str:
    """The joint's clearance and the duration of the run, for a title."""
    own: Any = run.mechanism.connections[joint].joint
    clearance = length(float(getattr(own, "gap", own).clearance))
    return f" (clearance {clearance}, {float(run.time[-1]):g} s)"


def captioned(figure: Figure, sentences: Sequence[str] = ()) -> Figure:
    """The figure with texts that can be read, made higher by the sentences below it."""
    fitted(figure)
    if not sentences:
        return figure
    lines = _lines(sentences, int(PER_INCH * figure.get_figwidth()))
    below = (len(lines) + 1) * LINE
    whole = figure.get_figheight() + below
    figure.set_figheight(whole)
    # The layout would set a legend outside the axes and a label of the figure upon each other.
    for legend in figure.legends:
        legend.set_bbox_to_anchor((0.0, below / whole, 1.0, 1.0), figure.transFigure)
        below += legend.get_window_extent().height / figure.dpi + LINE
    room = (0.0, below / whole, 1.0, 1.0 - below / whole)
    figure.set_layout_engine("constrained", rect=room)
    text = "\n".join(lines)
    figure.text(0.01, 0.5 * LINE / whole, text, fontsize=LETTERS, color="C3", va="bottom")
    return figure


def _lines(sentences: Sequence[str], width: int) -> list[str]:
    """The first of the sentences, as far as there is room in lines of so many letters, and how many
    more there are."""
    lines: list[str] = []
    for number, sentence in enumerate(sentences):
        more = f" (+{len(sentences) - number} more)"
        folded = textwrap.wrap(sentence, width - len(more))
        if lines and len(lines) + len(folded) > MOST_LINES:
            return [*lines[:-1], lines[-1] + more]
        lines += folded if len(folded) <= MOST_LINES else [*folded[: MOST_LINES - 1], " …"]
    return lines


def warned(figure: Figure | Panels, runs: Mapping[str, Trajectory]) -> Any:
    """The figure with what the runs it shows warn of below it; `runs` by what they are called
    ("" where there is one)."""
    sentences = [
        f"Warning{f' ({name})' if name else ''}: {sentence}"
        for name, run in runs.items()
        for sentence in run.warnings
    ]
    return figure.done(sentences) if isinstance(figure, Panels) else captioned(figure, sentences)


def readable(values: Any, unit: str) -> tuple[float, str]:
    """Factor and unit in which values are readable: with the prefix of their size, or, of a unit
    that takes none, with the power of ten."""
    sizes = np.abs(np.asarray(values, float))
    size = float(np.max(sizes[np.isfinite(sizes)], initial=0.0))
    small = unit in ("m", "rad")
    if size == 0.0 or (size >= 1.0 and small) or (LEAST <= size < LARGEST and not small):
        return 1.0, unit
    power = int(3 * np.floor(np.log10(size * (1 + 1e-12)) / 3))
    if not small and unit not in PREFIXED:
        return 10.0**-power, f"10{str(power).translate(RAISED)} {unit}".removesuffix(" 1")
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    return 10.0**-power, PREFIXES[power] + unit


def length(metres: float) -> str:
    """A length as a text."""
    factor, unit = readable([metres], "m")
    return f"{factor * metres:.4g} {unit}"


def volume(values: np.ndarray) -> tuple[float, str]:
    """Factor and unit in which volumes in cubic metres are readable."""
    factor, unit = readable(1e9 * values, "mm³")
    return 1e9 * factor, unit
