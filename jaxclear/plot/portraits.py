"""A motion in its phase plane, at every period of it, and over a number that varies: phase
portrait, Poincaré section, bifurcation.
"""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_number, expect
from jaxclear.plot.canvas import check_run, over_time, panels, readable, warned
from jaxclear.plot.signal import Signal, reached, signal
from jaxclear.results.trajectory import Trajectory

__all__ = ["at_periods", "bifurcation", "phase_portrait", "poincare_section"]

# Points between two saving times, of a curve.
BETWEEN = 4


@answering
def phase_portrait(
    run: Trajectory,
    of: str,
    axis: str | None = None,
    *,
    since: float = 0.0,
    ax: Any = None,
) -> Any:
    """Rate over value, coloured by time: of a body the place "x", "y", "z" of its centre of mass or
    its "turn" about z (ground frame), of a joint that of the child's marker in the parent's axes.
    `since` [s]: from when on. `ax`: axes to draw in. Raises `ValueError`.
    """
    own = signal(run, of, axis)
    check_number("since of phase_portrait", since, "s")
    kept = reached(run, since)
    (values, across), (rates, up) = own.shown(), own.rates_shown()
    sheet = panels("phase_portrait", ax, size=(6.4, 4.8))
    lines = over_time(sheet.one, values[kept], rates[kept], own.time[kept])
    sheet.whole.colorbar(lines, ax=sheet.one, label="time [s]")
    sheet.one.set_xlabel(across)
    sheet.one.set_ylabel(up)
    sheet.title(f"Phase portrait of {of}")
    return warned(sheet, {"": run})


def at_periods(own: Signal, period: float, since: float, until: float) -> tuple:
    """(times [s], values, rates) once a period from `since` to `until` [s]; between saving times by
    cubics through values and rates."""
    times = np.arange(since, until * (1 + 1e-12), period)
    kept = own.time <= until * (1 + 1e-12)
    curve = CubicHermiteSpline(own.time[kept], own.values[kept], np.asarray(own.rates)[kept])
    return times, curve(times), curve.derivative()(times)


def _checked(run: Trajectory, own: Signal, period: float, since: float, what: str) -> float:
    """The end of the run [s]. Raises `ValueError` where no two periods are left."""
    own.rates_shown()
    check_number(f"period of {what}", period, "s", above=0)
    check_number(f"since of {what}", since, "s", at_least=float(run.time[0]))
    until = min(float(run.ended), float(run.time[-1]))
    if until - since < period:
        raise ValueError(
            f"from {since:g} s to {until:g} s there is no whole period of {period:g} s; run longer "
            "or begin earlier."
        )
    return until


@answering
def poincare_section(
    run: Trajectory,
    of: str,
    axis: str | None = None,
    *,
    period: float,
    since: float = 0.0,
    ax: Any = None,
) -> Any:
    """Value and rate once a `period` [s] (that of the drive) from `since` [s] on: one point for a
    motion that repeats, n for one that repeats every n periods, a cloud for a chaotic one. What it
    is of as in `phase_portrait`. `ax`: axes to draw in. Raises `ValueError`.
    """
    own = signal(run, of, axis)
    until = _checked(run, own, period, since, "poincare_section")
    times, _, _ = found = at_periods(own, period, since, until)
    section = own._replace(values=found[1], rates=found[2])
    (values, across), (rates, up) = section.shown(), section.rates_shown()
    sheet = panels("poincare_section", ax, size=(6.4, 4.8))
    points = sheet.one.scatter(values, rates, c=np.arange(len(times)), s=12, cmap="viridis")
    sheet.whole.colorbar(points, ax=sheet.one, label="period [1]")
    sheet.one.set_xlabel(across)
    sheet.one.set_ylabel(up)
    sheet.title(f"Poincaré section of {of}, every {period:.4g} s")
    return warned(sheet, {"": run})


@answering
def bifurcation(
    runs: Mapping[float, Trajectory],
    of: str,
    axis: str | None = None,
    *,
    period: float,
    since: float = 0.0,
    over: str = "radial clearance [m]",
    ax: Any = None,
) -> Any:
    """Value once a `period` [s] from `since` [s] on, over a number: `runs` by that number, `over`
    says what it is, with its unit. One point where the motion repeats each period. What it is of as
    in `phase_portrait`. `ax`: axes to draw in. Raises `ValueError`.
    """
    expect(runs, Mapping, "runs", "a dictionary of runs by the number that varies")
    if not runs:
        raise ValueError("runs of bifurcation is empty; it must hold a run for each number.")
    found = {}
    for number, run in runs.items():
        check_run(run)
        check_number("a number of bifurcation", number)
        own = signal(run, of, axis)
        until = _checked(run, own, period, since, "bifurcation")
        found[float(number)] = at_periods(own, period, since, until)[1]
    every = own._replace(values=np.concatenate(list(found.values())))
    values, up = every.shown()
    numbers = np.repeat(list(found), [len(one) for one in found.values()])
    what, _, unit = over.rpartition(" [")
    factor, shown = readable(numbers, unit.rstrip("]"))
    sheet = panels("bifurcation", ax, size=(7.0, 4.6))
    sheet.one.plot(factor * numbers, values, ".", ms=3, color=matplotlib.colormaps["viridis"](0.25))
    sheet.one.set_xlabel(f"{what} [{shown}]" if what else over)
    sheet.one.set_ylabel(f"{up}")
    sheet.title(f"Once every {period:.4g} s")
    return warned(sheet, {f"{factor * n:.4g} {shown}": run for n, run in runs.items()})
