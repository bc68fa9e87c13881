"""Figures of designs: what was chosen, how the limits stand, how the search went; and a front of
cost against a limit."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxclear.ground.arguments import expect
from jaxclear.plot.canvas import panels, readable
from jaxclear.plot.fitting import key
from jaxclear.studies.design.result import Design

__all__ = ["design", "design_front"]


def design(found: Design, *, ax: Any = None) -> Any:
    """Nominal values with their tolerances, before and after; how much of each limit is used up,
    with 95 % errors, by the last verification; cost over the rounds. `ax`: three axes to draw
    in."""
    expect(found, Design, "the design", "what jaxclear.design returns")
    names = found.question.freedom.names
    height = 2.2 + 0.34 * max(len(names), len(found.limits))
    sheet = panels("design", ax, 1, 3, (13.0, height), width_ratios=(1.2, 1.2, 0.9))
    for draw, axis in zip((_widths, _limits, _history), sheet.axes.flat, strict=True):
        draw(axis, found)
    sheet.title(found.sentence().partition(". ")[0] + ".")
    return sheet.done([] if found.holds else [found.sentence()])


def _widths(axis: Any, found: Design) -> None:
    freedom = found.question.freedom
    units = dict(zip(freedom.names, found.problem.variable_units, strict=True))
    places = np.arange(len(freedom.names))
    after = np.array([found.tolerances[name] for name in freedom.names])
    factor, unit = readable(after, units[freedom.names[0]])
    if len(set(units.values())) > 1:
        factor, unit = 1.0, "own unit"
    axis.barh(places + 0.19, factor * freedom.usual, 0.36, color="0.75", label="as given")
    axis.barh(places - 0.19, factor * after, 0.36, color="C0", label="designed")
    labels = [
        f"{name}\nat {1e3 * found.nominal[name]:.5g} mm" if units[name] == "m" else name
        for name in freedom.names
    ]
    axis.set_yticks(places, labels, fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel(f"tolerance ± [{unit}]")
    key(axis)


def _limits(axis: Any, found: Design) -> None:
    places = np.arange(len(found.limits))
    used = 100 * (1.0 + found.excess)
    last = found.rounds[-1].check
    errors = np.zeros(len(used)) if last is None else 100 * last.excess_errors
    colours = ["C3" if not one <= found.allowed_excess else "C2" for one in found.excess]
    axis.barh(places, np.maximum(used, 0.0), 0.5, color=colours, alpha=0.7)
    axis.errorbar(used, places, xerr=errors, fmt="none", ecolor="k", capsize=3)
    axis.axvline(100.0, color="k", lw=1.0)
    axis.set_yticks(places, [limit.words() for limit in found.limits], fontsize=7)
    axis.invert_yaxis()
    axis.set_xlim(0.0, max(110.0, 1.1 * float(np.nanmax(used, initial=100.0))))
    axis.set_xlabel("limit used up [%]")


def _history(axis: Any, found: Design) -> None:
    history = found.history()
    axis.plot(history["runs"], history["cost"], "o-", color="C0", ms=4, lw=1.2)
    kept = history["largest excess"] <= found.allowed_excess
    axis.plot(
        history["runs"][kept],
        history["cost"][kept],
        "o",
        ms=9,
        mfc="none",
        mec="C2",
        label="limits kept",
    )
    axis.set_xlabel("runs")
    axis.set_ylabel("cost")
    if kept.any():
        key(axis)


def design_front(found: Sequence[Design], limit: int = 0, *, ax: Any = None) -> Any:
    """Cost against the bound of one limit, its designs that hold full and the others hollow.
    `ax`: axes to draw in."""
    for one in found:
        expect(one, Design, "a design of the front", "one that jaxclear.design_front returns")
    bounds = np.array([float(one.limits[limit].bound()) for one in found])
    factor, unit = readable(bounds, found[0].unit(limit))
    costs, held = np.array([one.cost for one in found]), np.array([one.holds for one in found])
    sheet = panels("design_front", ax, size=(5.6, 3.8))
    axis = sheet.one
    axis.plot(factor * bounds, costs, "-", color="C0", lw=1.2)
    axis.plot(factor * bounds[held], costs[held], "o", color="C0", label="holds")
    if not held.all():
        lost = ~held
        axis.plot(factor * bounds[lost], costs[lost], "o", mfc="none", color="C3", label="does not")
    axis.set_xlabel(f"{found[0].limits[limit].words()} [{unit}]", fontsize=8)
    axis.set_ylabel("cost")
    key(axis)
    return sheet.done()
