"""What the figures share: an empty canvas or the user's axes, shades of one colour, readable units,
a joint's setting for a title, warnings as a caption; and that their texts can be read: ticks with
room for their labels, names and titles in lines as long as there is room. Where texts end is
measured after matplotlib's own layout.

Every function of the room takes `ax`. Without it the function makes a figure and returns that, so
that a notebook shows it and `.savefig` keeps it. With it the function draws there and returns the
axes, as matplotlib's users expect: one axes, or as many as the figure has panels.
"""

import re
import textwrap
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.ticker import (
    AutoLocator,
    FixedLocator,
    FuncFormatter,
    Locator,
    LogLocator,
    MaxNLocator,
    NullFormatter,
)

from jaxclear.ground.arguments import expect
from jaxclear.ground.wording import described
from jaxclear.results.trajectory import Trajectory

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
    """An empty figure and its axes.

    Args:
        rows, columns: numbers of axes.
        size: width and height [inch].
        kwargs: of matplotlib's `subplots`.
    """
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
    def figure_of(self) -> Any:
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
            text = "\n".join(_fill_lines(sentences, IN_PANEL))
            last = self.axes.flat[-1]
            place = {"transform": last.transAxes, "va": "bottom", "fontsize": 0.8 * LETTERS}
            # A panel in space has a depth besides.
            depth = [0.0] if last.name == "3d" else []
            last.text(0.01, 0.01, *depth, text, color=_caption_colour(sentences), **place)
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
    """Panels of a new figure, or the axes that the user gave.

    Args:
        what: name of the figure in messages.
        ax: axes of the user, one or several; None: a new figure.
        rows, columns: numbers of axes.
        size: width and height of a new figure [inch].
        space: whether axes are three-dimensional.
        kwargs: of matplotlib's `subplots`.

    Raises:
        ValueError: the axes are not as many as the figure has, or of the wrong projection.
    """
    if ax is None:
        if space:
            kwargs["subplot_kw"] = {"projection": "3d", "computed_zorder": False}
        figure, axes = canvas(rows, columns, size, squeeze=False, **kwargs)
        return Panels(figure, axes)
    axes_of_user = list(ax.flat) if isinstance(ax, np.ndarray) else ax
    axes_of_user = list(axes_of_user) if isinstance(axes_of_user, Iterable) else [axes_of_user]
    count, name = rows * columns, "3d" if space else "rectilinear"
    required = "one axes" if count == 1 else f"{count} axes"
    if len(axes_of_user) != count or not all(isinstance(one, Axes) for one in axes_of_user):
        raise ValueError(
            f"ax of plot.{what} is {described(ax)}; it must be {required} of matplotlib."
        )
    if space and any(one.name != name for one in axes_of_user):
        raise ValueError(f'plot.{what} draws in space: give axes with projection="3d".')
    if not space and any(one.name == "3d" for one in axes_of_user):
        raise ValueError(f"plot.{what} draws in the plane: give axes without projection.")
    array = np.empty(count, object)
    array[:] = axes_of_user
    return Panels(None, array.reshape(rows, columns))


def over_time(axis: Any, x: np.ndarray, y: np.ndarray, time: np.ndarray) -> LineCollection:
    """A curve coloured by time; the axis is scaled to hold it.

    Args:
        axis: of matplotlib.
        x, y: coordinates, shape (n,).
        time: [s], shape (n,).
    """
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
    """Raises `ValueError` for what is no run, or several of them."""
    expect(run, Trajectory, "the run", "a run, as jaxclear.simulate returns it")
    run.history.check_single()


def setting(run: Trajectory, joint: str) -> str:
    """The joint's clearance and the duration of the run, for a title."""
    gap: Any = run.mechanism.connections[joint].joint
    clearance = length(float(getattr(gap, "gap", gap).clearance))
    return f" (clearance {clearance}, {float(run.time[-1]):g} s)"


def captioned(figure: Figure, sentences: Sequence[str] = ()) -> Figure:
    """The figure with texts that can be read, made higher by the sentences below it."""
    fitted(figure)
    if not sentences:
        return figure
    lines = _fill_lines(sentences, int(PER_INCH * figure.get_figwidth()))
    below = (len(lines) + 1) * LINE
    lines_of_all = figure.get_figheight() + below
    figure.set_figheight(lines_of_all)
    # The layout would set a legend outside the axes and a label of the figure upon each other.
    for legend in figure.legends:
        legend.set_bbox_to_anchor((0.0, below / lines_of_all, 1.0, 1.0), figure.transFigure)
        below += legend.get_window_extent().height / figure.dpi + LINE
    space = (0.0, below / lines_of_all, 1.0, 1.0 - below / lines_of_all)
    figure.set_layout_engine("constrained", rect=space)
    text = "\n".join(lines)
    look: Any = {"fontsize": LETTERS, "color": _caption_colour(sentences), "va": "bottom"}
    figure.text(0.01, 0.5 * LINE / lines_of_all, text, **look)
    return figure


def _caption_colour(sentences: Sequence[str]) -> str:
    """Red if a sentence is a warning; notes are grey."""
    return "C3" if any(sentence.startswith(WARNING) for sentence in sentences) else "0.35"


def as_warnings(sentences: Iterable[str], name: str = "") -> list[str]:
    """Sentences marked as warnings, those of a run called `name`, if it has a name."""
    return [f"{WARNING}{f' ({name})' if name else ''}: {sentence}" for sentence in sentences]


def _fill_lines(sentences: Sequence[str], width: int) -> list[str]:
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
    sentences = [line for name, run in runs.items() for line in as_warnings(run.warnings, name)]
    sentences += [note for run in runs.values() for note in run.notes]
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


# How a sentence below a figure begins if a number shown is beyond its tolerance.
WARNING = "Warning"
# The most ticks of an axis, and of a logarithmic one.
MOST_TICKS, MOST_DECADES = 9, 6
# A label stands this many of its heights from the next one, above it and beside it; a digit is so
# wide [heights].
ABOVE, GAP, DIGIT = 0.6, 1.0, 0.64
# Letters of the name of a row, or of a line in a legend, before it is folded.
ROW, IN_KEY = 28, 46
# A letter's mean width [heights]; what a legend has beside its letters [letters].
LETTER, HANDLE = 0.55, 6
MOST_COLUMNS, SMALL = 5, 7.0
# What names of rows may take of the width of a figure [inch].
NAMES = 0.9
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# As matplotlib writes a power of ten, and what is taken off numbers.
OFFSET = re.compile(r"(?:1e(-?\d+))?([+-][-\d.e]+)?")
# Of the room for a text, what it may take.
TAKEN = 0.96


class Roomy(Locator):
    """Round places, as many as their labels leave room for; `whole`: of what is counted."""

    def __init__(self, integers: bool = False):
        self.integers = integers

    def __call__(self) -> Any:
        axis: Any = self.axis
        return self.tick_values(*axis.get_view_interval())

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """The places; those outside are not drawn."""
        for most in range(MOST_TICKS, 0, -1):
            round_ones = MaxNLocator(most, steps=[1, 2, 2.5, 5, 10], integer=self.integers)
            ticks = np.asarray(round_ones.tick_values(vmin, vmax))
            if _labels_fit(self.axis, ticks[(ticks >= vmin) & (ticks <= vmax)]):
                break
        return ticks


class Decades(Locator):
    """Places of a logarithmic axis: powers of ten, over few of them also twice and five times
    those, within one of them round places."""

    def __call__(self) -> Any:
        axis: Any = self.axis
        return self.tick_values(*axis.get_view_interval())

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """The places."""
        low, high = np.log10(vmin), np.log10(vmax)
        steps = np.arange(np.floor(low), np.ceil(high) + 1)
        powers = 10.0**steps
        if high - low < 0.7:
            return MaxNLocator(4, steps=[1, 2, 5, 10]).tick_values(vmin, vmax)
        if high - low < 2.0:
            return np.outer(powers, (1, 2, 5)).ravel()
        every = -(-int(np.floor(high) - np.ceil(low) + 1) // MOST_DECADES)
        return powers[steps % every == 0]


def _format_decimal(value: float, _: int = 0) -> str:
    """A place of a logarithmic axis."""
    if not value > 0 or 1e-3 <= value < 1e4:
        return f"{value:g}"
    power = int(np.floor(np.log10(value) + 1e-9))
    factor = f"{value / 10.0**power:.3g}"
    return rf"$10^{{{power}}}$" if factor == "1" else rf"${factor} \cdot 10^{{{power}}}$"


def _labels_fit(axis: Any, widths: np.ndarray) -> bool:
    """Whether the labels of places stand apart."""
    usual: Any = matplotlib.rcParams
    w = axis.get_tick_params().get("labelsize", usual[f"{axis.axis_name}tick.labelsize"])
    size = FontProperties(size=w).get_size_in_points()
    box, inch = axis.axes.get_window_extent(), axis.get_figure(root=True).dpi
    labels = axis.get_major_formatter().format_ticks(widths)
    if axis.axis_name == "x":
        taken = sum(DIGIT * len(label) + GAP for label in labels) - GAP
        return taken * size <= 72 * box.width / inch
    return (1 + ABOVE) * size * (len(labels) - 1) <= 72 * box.height / inch


# Numbers that differ by less than this share of themselves are one, which stands in a view so much
# wider [share of it] to either side.
ROUNDING, EQUAL = 1e-9, 0.05


def places(axis: Any) -> None:
    """Gives axes whose ticks are matplotlib's own such as can be read; numbers that differ by
    rounding only stand in the middle, as equal ones do."""
    for one, limits in ((axis.xaxis, axis.set_xlim), (axis.yaxis, axis.set_ylim)):
        low, high = sorted(one.get_view_interval())
        if one.get_scale() == "linear" and high - low < ROUNDING * max(abs(low), abs(high)):
            middle = 0.5 * (low + high)
            limits(middle - EQUAL * abs(middle), middle + EQUAL * abs(middle))
        if type(one.get_major_locator()) is AutoLocator:
            one.set_major_locator(Roomy())
        elif type(one.get_major_locator()) is LogLocator:
            one.set_major_locator(Decades())
            one.set_major_formatter(FuncFormatter(_format_decimal))
            one.set_minor_formatter(NullFormatter())


def columns_of(labels: Sequence[str], space: float, size: float) -> int:
    """Number of columns of a legend.

    Args:
        labels: of the legend.
        space: width of the legend [pt].
        size: of letters [pt].
    """
    longest = max((len(line) for label in labels for line in label.split("\n")), default=0)
    return max(1, min(len(labels), int(space / (LETTER * size * (longest + HANDLE))), MOST_COLUMNS))


def key(axis: Any, lines: Any = None, **kwargs: Any) -> None:
    """A legend within axes, as wide as there is room; `lines`: handles and labels, by default all
    of the axes."""
    handles, labels = lines or axis.get_legend_handles_labels()
    place = axis.get_subplotspec()
    at_side = 1 if place is None else place.get_gridspec().ncols
    space = 0.8 * 72 * axis.get_figure(root=True).get_figwidth() / at_side
    width = min(IN_KEY, max(int(space / (LETTER * SMALL)) - HANDLE, 12))
    labels = [textwrap.fill(label, width) for label in labels]
    if labels:
        columns = columns_of(labels, space, SMALL)
        axis.legend(handles, labels, fontsize=SMALL, ncols=columns, **kwargs)


def fitted(figure: Figure) -> None:
    """Makes the texts of a figure such as can be read."""
    layout, title = figure.get_layout_engine(), getattr(figure, "_suptitle", None)
    if layout is None:
        return
    bars = [one for one in figure.axes if one.get_label() == "<colorbar>"]
    axes = [one for one in figure.axes if one not in bars]
    flat = [one for one in axes if one.name != "3d"]
    for axis in flat:
        places(axis)
        _fold_rows(axis)
    _widen_for_names(figure, flat)
    layout.execute(figure)
    before = {axis: axis.get_window_extent().height for axis in flat}
    folded = [_fold_text(title, figure.bbox.width)] if title else []
    folded += [_fold_text(axis.title, _title_width(axis, figure, bars)) for axis in axes]
    for axis in (*flat, *bars):
        box = axis.get_window_extent()
        _move_offset_to_label(axis.xaxis)
        _move_offset_to_label(axis.yaxis)
        folded.append(_fold_text(axis.xaxis.label, box.width))
        folded.append(_fold_text(axis.yaxis.label, box.height, upright=True))
    needed = {axis: max(before[axis], _height_of_rows(axis)) for axis in flat}
    if any(folded) or needed != before:
        layout.execute(figure)
        overflow: dict[int, float] = defaultdict(float)
        for axis in flat:
            box = axis.get_window_extent()
            row = round(box.y1)
            overflow[row] = max(overflow[row], needed[axis] - box.height)
        figure.set_figheight(figure.get_figheight() + sum(overflow.values()) / figure.dpi)


def _widen_for_names(figure: Figure, axes: list) -> None:
    """Adds the room that names of rows take beyond `NAMES` to the width of the figure."""
    beyond: dict[int, float] = defaultdict(float)
    for axis in axes:
        place = axis.get_subplotspec()
        if place is not None and _has_rows(axis):
            wide = max((one.get_window_extent().width for one in axis.get_yticklabels()), default=0)
            first = place.colspan.start
            beyond[first] = max(beyond[first], wide / figure.dpi - NAMES)
    figure.set_figwidth(figure.get_figwidth() + sum(beyond.values()))


def _title_width(axis: Any, figure: Figure, bars: list) -> float:
    """Width [pixel] for the title of axes: as far as there is nothing else on both sides where they
    stand alone."""
    box, place = axis.get_window_extent(), axis.get_subplotspec()
    if place is None or not (place.is_first_col() and place.is_last_col()):
        return box.width
    middle = 0.5 * (box.x0 + box.x1)
    ends = [figure.bbox.width, *(one.get_window_extent().x0 for one in bars)]
    return 2 * min(middle, min(ends) - middle)


def _move_offset_to_label(axis: Any) -> None:
    """Says in the label what is taken off the numbers of an axis, and their power of ten."""
    label, offset = axis.get_label_text(), axis.get_offset_text()
    text = OFFSET.fullmatch(axis.get_major_formatter().get_offset().replace("\N{MINUS SIGN}", "-"))
    if text is None or not any(text.groups()) or not label or not offset.get_visible():
        return
    what, _, unit = label.rstrip("]").partition(" [")
    taken = f" \N{MINUS SIGN} {float(text[2]):.12g}" if text[2] else ""
    scale = f"10{text[1].translate(RAISED)} " if text[1] else ""
    unit = f"{scale}{unit}".removesuffix(" 1" if scale else "").rstrip()
    axis.set_label_text(f"{what}{taken} [{unit}]" if unit else f"{what}{taken}")
    offset.set_visible(False)


def _fold_text(text: Any, space: float, upright: bool = False) -> bool:
    """Folds a text into lines for which there is room [pixel]; whether that was needed."""
    line, box = text.get_text(), text.get_window_extent()
    long = box.height if upright else box.width
    if not line or long <= space or "\n" in line:
        return False
    text.set_text(textwrap.fill(line, max(int(TAKEN * len(line) * space / long), 12)))
    return True


def _has_rows(axis: Any) -> bool:
    """Whether rows have names: they are 1 apart."""
    named = isinstance(axis.yaxis.get_major_locator(), FixedLocator)
    return named and np.allclose(np.abs(np.diff(axis.get_yticks())), 1.0)


def _fold_rows(axis: Any) -> None:
    """Folds the names of rows."""
    if not _has_rows(axis):
        return
    labels = axis.get_yticklabels()
    lines = [one.get_text().split("\n") for one in labels]
    if any(len(line) > ROW for row in lines for line in row):
        names = ["\n".join(textwrap.fill(line, ROW) for line in row) for row in lines]
        axis.set_yticks(axis.get_yticks(), names, fontsize=labels[0].get_fontsize())


def _height_of_rows(axis: Any) -> float:
    """Height [pixel] that the names of rows need; none where they are numbers."""
    if not _has_rows(axis):
        return 0.0
    labels = axis.get_yticklabels()
    highest = max((one.get_window_extent().height for one in labels), default=0.0)
    low, high = sorted(axis.get_ylim())
    return 1.15 * highest * (high - low)
