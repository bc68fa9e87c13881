"""Figures of lives and designs: how a machine settles, depth, volume and responses over cycles, how
lives differ; what a design chose, how the limits stand, how the search went; and a front.
"""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import expect
from jaxclear.plot.canvas import ROW, Roomy, as_warnings, key, panels, readable, volume
from jaxclear.studies.design.largest import Largest
from jaxclear.studies.design.result import Design
from jaxclear.studies.life.result import CONFIDENCE, DEPTH, VOLUME, WearLife
from jaxclear.studies.life.steady_cycle import SteadyCycle
from jaxclear.studies.life.wear_life import WearLifeSample


@answering
def steady_cycle(result: SteadyCycle, *, ax: Any = None) -> Any:
    """Distance between the ends of each cycle, with the tolerance, and the responses of each cycle.

    Filled marks are cycles that are taken as the motion.

    Args:
        result: a `SteadyCycle`, as `jaxclear.steady_cycle` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for the distance and one for each response; by
            default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    expect(result, SteadyCycle, "the cycle", "what jaxclear.steady_cycle returns")
    table, units = result.table(), result.problem.units()
    names = list(result.problem.response_names)
    sheet = panels("steady_cycle", ax, 1, 1 + len(names), (4.2 * (1 + len(names)), 3.4))
    first, *others = sheet.axes.flat
    taken = table["taken"].to_numpy(bool)
    first.semilogy(table["cycle"], table["apart"], "o-", ms=4, mfc="none", lw=1.0)
    first.axhline(result.tolerance, color="C3", ls="--", lw=1.0, label="tolerance")
    first.set_ylabel("distance of its ends [1]")
    key(first)
    for axis, name in zip(others, names, strict=True):
        label = name if units[name] == "1" else f"{name} [{units[name]}]"
        values = table[label].to_numpy(float)
        factor, unit = readable(values[np.isfinite(values)], units[name])
        axis.plot(table["cycle"], factor * values, "o-", ms=4, mfc="none", color="C2", lw=0.8)
        axis.plot(table["cycle"][taken], factor * values[taken], "o", ms=4, color="C2")
        axis.set_ylabel(f"{name} [{unit}]")
    for axis in sheet.axes.flat:
        axis.set_xlabel("cycle [1]")
        axis.xaxis.set_major_locator(Roomy(integers=True))
    sheet.title(result.sentence().partition(": ")[0] + ".")
    return sheet.done(as_warnings(result.warnings))


@answering
def wear_life_sample(result: WearLifeSample, *, ax: Any = None) -> Any:
    """Largest depth and worn volume of every life over its cycles.

    Args:
        result: a `WearLifeSample`, as `jaxclear.wear_life_sample` returns it.
        ax: two `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    expect(result, WearLifeSample, "the lives", "what jaxclear.wear_life_sample returns")
    sheet = panels("wear_life_sample", ax, 1, 2, (9.0, 3.8))
    lives = [life for life in result.lives if life]
    for axis, kind in zip(sheet.axes.flat, (DEPTH, VOLUME), strict=True):
        curves = [life.over_life(kind) for life in lives]
        every = np.concatenate(curves) if curves else np.zeros(0)
        factor, unit = readable(every, "m") if kind == DEPTH else volume(every)
        for life, curve in zip(lives, curves, strict=True):
            early = bool(life.ended)
            axis.plot(life.cycles, factor * curve, lw=0.8, alpha=0.7, color="C3" if early else "C0")
        axis.set_xlabel("cycles [1]")
        axis.set_ylabel(f"{'largest depth' if kind == DEPTH else 'volume lost'} [{unit}]")
    sheet.title(result.sentence())
    return sheet.done()


# Points of a curve.
POINTS = 200
# Panels side by side at the most.
MOST_COLUMNS = 3
# Of a share: below this it is rounding.
LEAST_SHARE = 1e-8


@answering
def wear_life(life: WearLife, *, ax: Any = None) -> Any:
    """Largest depths, worn volumes and responses over the cycles of a life.

    Dots are the stages, bands (depth, volume) and bars (responses that are means over cycles) 95 %
    errors. Warnings stand below.

    Args:
        life: a `WearLife`, as `jaxclear.wear_life` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each quantity; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `life` is something else.
    """
    expect(life, WearLife, "the life", "what jaxclear.wear_life returns")
    names = life.problem.response_names
    quantities = [DEPTH, VOLUME, *names]
    columns = 2 if len(quantities) == 4 else min(len(quantities), MOST_COLUMNS)
    if ax is not None:
        columns = len(quantities)
    rows = -(-len(quantities) // columns)
    size = (4.2 * columns, 3.2 * rows)
    sheet = panels("wear_life", ax, rows, columns, size, sharex=True)
    axes = sheet.axes
    for axis, name in zip(axes.flat, quantities, strict=False):
        _draw_response(axis, life, name) if name in names else _draw_worn(axis, life, name)
    for axis in axes.flat[len(quantities) :]:
        axis.remove()
    for column in range(columns):
        last = max(i for i in range(len(quantities)) if i % columns == column)
        axes.flat[last].set_xlabel("cycles")
        axes.flat[last].tick_params(labelbottom=True)
    short = f"{life.cycles[-1]:.4g} cycles of machine life from {life.simulated} simulated ones"
    sheet.title(short)
    notes = [f"Ended early: {life.ended}"] if life.ended else []
    return sheet.done([*as_warnings(life.warnings), *notes])


def _draw_worn(axis: Any, life: WearLife, kind: str) -> None:
    """Depth or volume of each surface."""
    errors = life.errors if kind == DEPTH else life.errors_of_volume
    places = np.linspace(0.0, life.cycles[-1], POINTS)
    band = np.interp(places, life.cycles, errors)
    curve_of_all = life.over_life(kind)
    factor, unit = readable(curve_of_all, "m") if kind == DEPTH else volume(curve_of_all)
    for number, (joint, surface) in enumerate(life.surfaces):
        name, colour = f"{kind} {joint} {surface}", f"C{number}"
        curve = factor * life.over_life(name, places)
        axis.plot(places, curve, color=colour, lw=1.2, label=f"{joint} {surface}")
        axis.plot(life.cycles, factor * life.over_life(name), "o", ms=4, color=colour)
        grown = curve - curve[0]
        axis.fill_between(
            places, curve - band * grown, curve + band * grown, color=colour, alpha=0.25, lw=0
        )
    axis.set_ylabel(f"{'largest depth' if kind == DEPTH else 'volume lost'} [{unit}]")
    axis.set_title(f"known to {100 * max(errors[-1], LEAST_SHARE):.2g} %", fontsize=8)
    if len(life.surfaces) > 1:
        key(axis)


def _draw_response(axis: Any, life: WearLife, name: str) -> None:
    """A response, with what its mean may be off."""
    values = life.over_life(name)
    factor, unit = readable(values, life.problem.units()[name])
    places = np.linspace(0.0, life.cycles[-1], POINTS)
    axis.plot(places, factor * life.over_life(name, places), color="C2", lw=0.9, ls="--")
    noise = [CONFIDENCE * stage.settled.responses()[name][1] for stage in life.stages]
    bars = factor * np.array(noise)
    axis.errorbar(life.cycles, factor * values, yerr=bars, fmt="o", ms=4, color="C2", capsize=3)
    axis.set_ylabel(name if unit == "1" else f"{name} [{unit}]")
    if life.is_affected(name):
        axis.set_title("in doubt: a warning concerns it", fontsize=8, color="C3")


@answering
def design(result: Design, *, ax: Any = None) -> Any:
    """Nominal values and tolerances of a design, its limits, and the cost over the rounds.

    The limits are drawn as used shares, by the last verification, with 95 % errors.

    Args:
        result: a `Design`, as `jaxclear.design` returns it.
        ax: three `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    expect(result, Design, "the design", "what jaxclear.design returns")
    names = result.question.freedom.names
    height = 2.2 + 0.34 * max(len(names), len(result.limits))
    sheet = panels("design", ax, 1, 3, (13.0, height), width_ratios=(1.2, 1.2, 0.9))
    for draw, axis in zip((_draw_width, _draw_limit, _draw_history), sheet.axes.flat, strict=True):
        draw(axis, result)
    sheet.title(result.sentence().partition(". ")[0] + ".")
    return sheet.done([] if result.holds else [result.sentence()])


def _draw_width(axis: Any, result: Design) -> None:
    freedom = result.question.freedom
    units = dict(zip(freedom.names, result.problem.variable_units, strict=True))
    places = np.arange(len(freedom.names))
    after = np.array([result.tolerances[name] for name in freedom.names])
    factor, unit = readable(after, units[freedom.names[0]])
    if len(set(units.values())) > 1:
        factor, unit = 1.0, "own unit"
    axis.barh(places + 0.19, factor * freedom.usual, 0.36, color="0.75", label="as given")
    axis.barh(places - 0.19, factor * after, 0.36, color="C0", label="designed")
    labels = [
        f"{name}\nat {1e3 * result.nominal[name]:.5g} mm" if units[name] == "m" else name
        for name in freedom.names
    ]
    axis.set_yticks(places, labels, fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel(f"tolerance ± [{unit}]")
    key(axis)


def _draw_limit(axis: Any, result: Design) -> None:
    places = np.arange(len(result.limits))
    used = 100 * (1.0 + result.excess)
    check = result.round.check
    errors = np.zeros(len(used)) if check is None else 100 * check.excess_errors
    colours = ["C3" if not one <= result.allowed_excess else "C2" for one in result.excess]
    axis.barh(places, np.maximum(used, 0.0), 0.5, color=colours, alpha=0.7)
    axis.errorbar(used, places, xerr=errors, fmt="none", ecolor="k", capsize=3)
    axis.axvline(100.0, color="k", lw=1.0)
    axis.set_yticks(places, [limit.words() for limit in result.limits], fontsize=7)
    axis.invert_yaxis()
    axis.set_xlim(0.0, max(110.0, 1.1 * float(np.nanmax(used, initial=100.0))))
    axis.set_xlabel("limit used up [%]")


def _draw_history(axis: Any, result: Design) -> None:
    history = result.history()
    axis.plot(history["runs"], history["cost"], "o-", color="C0", ms=4, lw=1.2)
    holds = history["largest excess"] <= result.allowed_excess
    axis.plot(
        history["runs"][holds],
        history["cost"][holds],
        "o",
        ms=9,
        mfc="none",
        mec="C2",
        label="limits kept",
    )
    axis.set_xlabel("runs")
    axis.set_ylabel("cost")
    if holds.any():
        key(axis)


@answering
def largest(result: Largest, *, ax: Any = None) -> Any:
    """The limited number over the mean of the variable, with 95 % errors and the bound.

    Trials that keep the limit are filled, the others hollow.

    Args:
        result: a `Largest`, as `jaxclear.largest` returns it.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    expect(result, Largest, "the result", "what jaxclear.largest returns")
    sheet = panels("largest", ax, 1, 1, (6.0, 3.8))
    values, numbers, errors = (
        np.array([getattr(trial, part) for trial in result.trials])
        for part in ("value", "number", "error")
    )
    along, unit = readable(values, result.units[0])
    factor, unit_of_number = readable([*numbers, float(result.limit.bound())], result.units[1])
    for trial, x, y, error in zip(
        result.trials, along * values, factor * numbers, factor * errors, strict=True
    ):
        fill = "C0" if trial.excess <= 0 else "none"
        sheet.one.errorbar(x, y, error, fmt="o", color="C0", mfc=fill, capsize=3)
    sheet.one.axhline(factor * float(result.limit.bound()), color="k", lw=1.0, ls="--")
    sheet.one.set_xlabel(f"{result.variable} [{unit}]")
    words = f"{result.limit.words()} [{unit_of_number}]"
    sheet.one.set_ylabel(textwrap.fill(words, ROW))
    return sheet.done([result.sentence()])


@answering
def pareto_front(result: Sequence[Design], limit: int = 0, *, ax: Any = None) -> Any:
    """Cost of designs over the bound of one limit.

    Designs that satisfy their limits are filled, the others hollow.

    Args:
        result: a sequence of `Design`, as `jaxclear.pareto_front` returns it.
        limit: number of the limit, from 0 (default) on.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    for one in result:
        expect(one, Design, "a design of the front", "one that jaxclear.pareto_front returns")
    bounds = np.array([float(one.limits[limit].bound()) for one in result])
    factor, unit = readable(bounds, result[0].unit(limit))
    costs, holds = np.array([one.cost for one in result]), np.array([one.holds for one in result])
    sheet = panels("pareto_front", ax, size=(5.6, 3.8))
    axis = sheet.one
    axis.plot(factor * bounds, costs, "-", color="C0", lw=1.2)
    axis.plot(factor * bounds[holds], costs[holds], "o", color="C0", label="holds")
    if not holds.all():
        bad = ~holds
        axis.plot(factor * bounds[bad], costs[bad], "o", mfc="none", color="C3", label="does not")
    axis.set_xlabel(f"{result[0].limits[limit].words()} [{unit}]", fontsize=8)
    axis.set_ylabel("cost")
    key(axis)
    return sheet.done()
