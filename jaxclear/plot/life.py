"""Figures of a life: depth, volume and responses over cycles."""

from typing import Any

import numpy as np

from jaxclear.ground.arguments import expect
from jaxclear.plot.canvas import panels, readable, volume
from jaxclear.plot.fitting import key
from jaxclear.studies.life.result import CONFIDENCE, DEPTH, VOLUME, WearLife

__all__ = ["wear_life"]

# Points of a curve.
POINTS = 200
# Panels side by side at the most.
MOST_BESIDE = 3
# Of a share: below this it is rounding.
LEAST_SHARE = 1e-8


def wear_life(life: WearLife, *, ax: Any = None) -> Any:
    """Largest depth and volume of every surface, and every response, over the cycles of a life: the
    curves between stages, the stages as dots, 95 % errors as bands (depth, volume) and bars
    (responses that are means over cycles). Below: what limits the trust in them.
    `ax`: as many axes as there are quantities."""
    expect(life, WearLife, "the life", "what jaxclear.wear_life returns")
    names = life.problem.response_names
    shown = [DEPTH, VOLUME, *names]
    columns = 2 if len(shown) == 4 else min(len(shown), MOST_BESIDE)
    if ax is not None:
        columns = len(shown)
    rows = -(-len(shown) // columns)
    size = (4.2 * columns, 3.2 * rows)
    sheet = panels("wear_life", ax, rows, columns, size, sharex=True)
    axes = sheet.axes
    for axis, name in zip(axes.flat, shown, strict=False):
        _response(axis, life, name) if name in names else _worn(axis, life, name)
    for axis in axes.flat[len(shown) :]:
        axis.remove()
    for column in range(columns):
        last = max(i for i in range(len(shown)) if i % columns == column)
        axes.flat[last].set_xlabel("cycles")
        axes.flat[last].tick_params(labelbottom=True)
    short = f"{life.cycles[-1]:.4g} cycles of machine life from {life.simulated} simulated ones"
    sheet.title(short)
    said = [f"Ended early: {life.ended}"] if life.ended else []
    return sheet.done([*said, *(f"Warning: {one}" for one in life.warnings)])


def _worn(axis: Any, life: WearLife, kind: str) -> None:
    """Depth or volume of each surface."""
    errors = life.errors if kind == DEPTH else life.errors_of_volume
    places = np.linspace(0.0, life.cycles[-1], POINTS)
    band = np.interp(places, life.cycles, errors)
    whole = life.over_life(kind)
    factor, unit = readable(whole, "m") if kind == DEPTH else volume(whole)
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


def _response(axis: Any, life: WearLife, name: str) -> None:
    """A response, with what its mean may be off."""
    values = life.over_life(name)
    factor, unit = readable(values, life.problem.units()[name])
    places = np.linspace(0.0, life.cycles[-1], POINTS)
    axis.plot(places, factor * life.over_life(name, places), color="C2", lw=0.9, ls="--")
    noise = [CONFIDENCE * stage.settled.responses()[name][1] for stage in life.stages]
    bars = factor * np.array(noise)
    axis.errorbar(life.cycles, factor * values, yerr=bars, fmt="o", ms=4, color="C2", capsize=3)
    axis.set_ylabel(name if unit == "1" else f"{name} [{unit}]")
    if life.concerned(name):
        axis.set_title("in doubt: a warning concerns it", fontsize=8, color="C3")
