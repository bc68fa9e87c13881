"""That the texts of a figure can be read: ticks with room for their labels, and few of them on
logarithmic axes; names and titles in lines as long as there is room; a figure so high that axes
lose nothing by it.

Where texts end is measured after matplotlib's own layout, so that no plot counts letters.
"""

import re
import textwrap
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
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

__all__ = ["RAISED", "Roomy", "columns_of", "fitted", "key", "places"]

# The most ticks of an axis, and of a logarithmic one.
MOST_TICKS, MOST_DECADES = 9, 6
# A label stands this many of its heights from the next one, above it and beside it; a digit is so
# wide [heights].
ABOVE, BESIDE, DIGIT = 0.6, 1.0, 0.64
# Letters of the name of a row, or of a line in a legend, before it is folded.
ROW, LINE = 28, 46
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

    def __init__(self, whole: bool = False):
        self.whole = whole

    def __call__(self) -> Any:
        axis: Any = self.axis
        return self.tick_values(*axis.get_view_interval())

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """The places; those outside are not drawn."""
        for most in range(MOST_TICKS, 0, -1):
            round_ones = MaxNLocator(most, steps=[1, 2, 2.5, 5, 10], integer=self.whole)
            found = np.asarray(round_ones.tick_values(vmin, vmax))
            if _has_room(self.axis, found[(found >= vmin) & (found <= vmax)]):
                break
        return found


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


def _decimal(value: float, _: int = 0) -> str:
    """A place of a logarithmic axis."""
    if not value > 0 or 1e-3 <= value < 1e4:
        return f"{value:g}"
    power = int(np.floor(np.log10(value) + 1e-9))
    factor = f"{value / 10.0**power:.3g}"
    return rf"$10^{{{power}}}$" if factor == "1" else rf"${factor} \cdot 10^{{{power}}}$"


def _has_room(axis: Any, found: np.ndarray) -> bool:
    """Whether the labels of places stand apart."""
    usual: Any = matplotlib.rcParams
    own = axis.get_tick_params().get("labelsize", usual[f"{axis.axis_name}tick.labelsize"])
    size = FontProperties(size=own).get_size_in_points()
    box, inch = axis.axes.get_window_extent(), axis.get_figure(root=True).dpi
    labels = axis.get_major_formatter().format_ticks(found)
    if axis.axis_name == "x":
        taken = sum(DIGIT * len(label) + BESIDE for label in labels) - BESIDE
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
            one.set_major_formatter(FuncFormatter(_decimal))
            one.set_minor_formatter(NullFormatter())


def columns_of(labels: Sequence[str], room: float, size: float) -> int:
    """In how many columns labels, of letters of `size` [pt], stand in a legend for which there is
    `room` [pt]."""
    longest = max((len(line) for label in labels for line in label.split("\n")), default=0)
    return max(1, min(len(labels), int(room / (LETTER * size * (longest + HANDLE))), MOST_COLUMNS))


def key(axis: Any, lines: Any = None, **kwargs: Any) -> None:
    """A legend within axes, as wide as there is room; `lines`: handles and labels, by default all
    of the axes."""
    handles, labels = lines or axis.get_legend_handles_labels()
    place = axis.get_subplotspec()
    beside = 1 if place is None else place.get_gridspec().ncols
    room = 0.8 * 72 * axis.get_figure(root=True).get_figwidth() / beside
    width = min(LINE, max(int(room / (LETTER * SMALL)) - HANDLE, 12))
    labels = [textwrap.fill(label, width) for label in labels]
    if labels:
        columns = columns_of(labels, room, SMALL)
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
    _widen(figure, flat)
    layout.execute(figure)
    before = {axis: axis.get_window_extent().height for axis in flat}
    folded = [_fold(title, figure.bbox.width)] if title else []
    folded += [_fold(axis.title, _room(axis, figure, bars)) for axis in axes]
    for axis in (*flat, *bars):
        box = axis.get_window_extent()
        _without_offset(axis.xaxis)
        _without_offset(axis.yaxis)
        folded.append(_fold(axis.xaxis.label, box.width))
        folded.append(_fold(axis.yaxis.label, box.height, upright=True))
    needed = {axis: max(before[axis], _rows_need(axis)) for axis in flat}
    if any(folded) or needed != before:
        layout.execute(figure)
        lost: dict[int, float] = defaultdict(float)
        for axis in flat:
            box = axis.get_window_extent()
            row = round(box.y1)
            lost[row] = max(lost[row], needed[axis] - box.height)
        figure.set_figheight(figure.get_figheight() + sum(lost.values()) / figure.dpi)


def _widen(figure: Figure, axes: list) -> None:
    """Adds the room that names of rows take beyond `NAMES` to the width of the figure."""
    beyond: dict[int, float] = defaultdict(float)
    for axis in axes:
        place = axis.get_subplotspec()
        if place is not None and _has_rows(axis):
            wide = max((one.get_window_extent().width for one in axis.get_yticklabels()), default=0)
            first = place.colspan.start
            beyond[first] = max(beyond[first], wide / figure.dpi - NAMES)
    figure.set_figwidth(figure.get_figwidth() + sum(beyond.values()))


def _room(axis: Any, figure: Figure, bars: list) -> float:
    """Width [pixel] for the title of axes: as far as there is nothing else on both sides where they
    stand alone."""
    box, place = axis.get_window_extent(), axis.get_subplotspec()
    if place is None or not (place.is_first_col() and place.is_last_col()):
        return box.width
    middle = 0.5 * (box.x0 + box.x1)
    ends = [figure.bbox.width, *(one.get_window_extent().x0 for one in bars)]
    return 2 * min(middle, min(ends) - middle)


def _without_offset(axis: Any) -> None:
    """Says in the label what is taken off the numbers of an axis, and their power of ten."""
    label, offset = axis.get_label_text(), axis.get_offset_text()
    said = OFFSET.fullmatch(axis.get_major_formatter().get_offset().replace("\N{MINUS SIGN}", "-"))
    if said is None or not any(said.groups()) or not label or not offset.get_visible():
        return
    what, _, unit = label.rstrip("]").partition(" [")
    taken = f" \N{MINUS SIGN} {float(said[2]):.12g}" if said[2] else ""
    scale = f"10{said[1].translate(RAISED)} " if said[1] else ""
    unit = f"{scale}{unit}".removesuffix(" 1" if scale else "").rstrip()
    axis.set_label_text(f"{what}{taken} [{unit}]" if unit else f"{what}{taken}")
    offset.set_visible(False)


def _fold(text: Any, room: float, upright: bool = False) -> bool:
    """Folds a text into lines for which there is room [pixel]; whether that was needed."""
    said, box = text.get_text(), text.get_window_extent()
    long = box.height if upright else box.width
    if not said or long <= room or "\n" in said:
        return False
    text.set_text(textwrap.fill(said, max(int(TAKEN * len(said) * room / long), 12)))
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
    if any(len(line) > ROW for own in lines for line in own):
        names = ["\n".join(textwrap.fill(line, ROW) for line in own) for own in lines]
        axis.set_yticks(axis.get_yticks(), names, fontsize=labels[0].get_fontsize())


def _rows_need(axis: Any) -> float:
    """Height [pixel] that the names of rows need; none where they are numbers."""
    if not _has_rows(axis):
        return 0.0
    labels = axis.get_yticklabels()
    highest = max((one.get_window_extent().height for one in labels), default=0.0)
    low, high = sorted(axis.get_ylim())
    return 1.15 * highest * (high - low)
