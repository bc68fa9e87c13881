"""Figures of many cycles and many lives: how a machine settles, how lives differ."""

from typing import Any

import numpy as np

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import expect
from jaxclear.plot.canvas import panels, readable, volume
from jaxclear.plot.fitting import Roomy, key
from jaxclear.studies.life.lives import WearLives
from jaxclear.studies.life.result import DEPTH, VOLUME
from jaxclear.studies.life.settled import Settled

__all__ = ["settled", "wear_lives"]


@answering
def settled(found: Settled, *, ax: Any = None) -> Any:
    """How far the ends of each cycle are apart, with the tolerance, and the responses of each, full
    where they are taken as the motion. `ax`: axes for the ends and for each response."""
    expect(found, Settled, "the cycle", "what jaxclear.settled returns")
    table, units = found.table(), found.problem.units()
    names = list(found.problem.response_names)
    sheet = panels("settled", ax, 1, 1 + len(names), (4.2 * (1 + len(names)), 3.4))
    first, *others = sheet.axes.flat
    taken = table["taken"].to_numpy(bool)
    first.semilogy(table["cycle"], table["apart"], "o-", ms=4, mfc="none", lw=1.0)
    first.axhline(found.tolerance, color="C3", ls="--", lw=1.0, label="tolerance")
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
        axis.xaxis.set_major_locator(Roomy(whole=True))
    sheet.title(found.sentence().partition(": ")[0] + ".")
    return sheet.done([f"Warning: {one}" for one in found.warnings])


@answering
def wear_lives(found: WearLives, *, ax: Any = None) -> Any:
    """Largest depth and volume lost of every life over its cycles. `ax`: two axes."""
    expect(found, WearLives, "the lives", "what jaxclear.wear_lives returns")
    sheet = panels("wear_lives", ax, 1, 2, (9.0, 3.8))
    lives = [life for life in found.lives if life]
    for axis, kind in zip(sheet.axes.flat, (DEPTH, VOLUME), strict=True):
        curves = [life.over_life(kind) for life in lives]
        every = np.concatenate(curves) if curves else np.zeros(0)
        factor, unit = readable(every, "m") if kind == DEPTH else volume(every)
        for life, curve in zip(lives, curves, strict=True):
            early = bool(life.ended)
            axis.plot(life.cycles, factor * curve, lw=0.8, alpha=0.7, color="C3" if early else "C0")
        axis.set_xlabel("cycles [1]")
        axis.set_ylabel(f"{'largest depth' if kind == DEPTH else 'volume lost'} [{unit}]")
    sheet.title(found.sentence())
    return sheet.done()
