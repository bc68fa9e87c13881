"""A number of a run over time with its rate, by name, and what is drawn of it: phase portrait,
Poincaré section, bifurcation, spectrum.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import scipy

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_name, check_number, expect
from jaxclear.plot.canvas import check_run, over_time, panels, readable, warned
from jaxclear.results.relative_motion import relative_motion
from jaxclear.results.trajectory import Trajectory

AXES, TURN, FORCE = ("x", "y", "z"), "turn", "force"


class TimeCurve(NamedTuple):
    """A quantity of a run over time.

    Args:
        time: saving times [s], shape (time,).
        values: values in `unit`, shape (time,).
        rates: their rates [unit/s], shape (time,); None where there are none.
        unit: unit of the values.
        label: name of the quantity.
        rate_label: name of its rate.
    """

    time: np.ndarray
    values: np.ndarray
    rates: np.ndarray | None
    unit: str
    label: str
    rate_label: str

    def in_unit(self) -> tuple[np.ndarray, str]:
        """Values in a readable unit, and the axis label with it."""
        factor, unit = readable(self.values, self.unit)
        return factor * self.values, f"{self.label} [{unit}]"

    def rates_in_unit(self) -> tuple[np.ndarray, str]:
        """Rates in a readable unit, and the axis label with it.

        Raises:
            ValueError: if there are none.
        """
        if self.rates is None:
            raise ValueError(f"the {self.label} has no rate; name a place or a turn instead.")
        factor, unit = readable(self.rates, self.unit)
        return factor * self.rates, f"{self.rate_label} [{unit}/s]"


def signal(run: Trajectory, of: str, axis: str | None = None) -> TimeCurve:
    """A quantity of a body or a joint over time, with its rate.

    Args:
        run: the run.
        of: name of a body or joint.
        axis: "x", "y" or "z": position of the centre of mass of a body in the ground frame, or of
            the child's marker in the axes of the parent's; "turn": angle about z of the same;
            "force": normal force of all contacts of a joint. By default x for a body or a journal
            in its clearance, else the coordinate of the joint.

    Returns:
        The `TimeCurve`.

    Raises:
        ValueError: if there is no such body, joint or axis.
    """
    check_run(run)
    mechanism = run.mechanism
    check_name("body or joint", of, [*mechanism.bodies, *mechanism.connections],
                " in this mechanism")  # fmt: skip
    time = np.asarray(run.time)
    if of in mechanism.bodies:
        axis = "x" if axis is None else axis
        check_name("axis", axis, (*AXES, TURN), f' of body "{of}"')
        motion = run.body(of)
        if axis == TURN:
            turn = np.asarray(motion.rotation)
            angle = np.unwrap(np.arctan2(turn[:, 1, 0], turn[:, 0, 0]))
            return TimeCurve(time, angle, np.asarray(motion.spin)[:, 2], "rad", f"turn of {of}",
                          f"angular velocity of {of}")  # fmt: skip
        at = AXES.index(axis)
        values, rates = np.asarray(motion.com)[:, at], np.asarray(motion.velocity)[:, at]
        return TimeCurve(time, values, rates, "m", f"{axis} of {of}", f"velocity {axis} of {of}")
    return _curve_of_joint(run, of, _usual_axis(run, of) if axis is None else axis)


def _usual_axis(run: Trajectory, of: str) -> str:
    joint: Any = run.mechanism.connections[of].joint
    if of in run.mechanism.topology.clearances:
        return "x"
    return TURN if "z" in getattr(joint, "rows", ()) else "z"


def _curve_of_joint(run: Trajectory, of: str, axis: str) -> TimeCurve:
    touching = of in run.formulation.contact_joints(run.mechanism)
    axes = (*AXES, TURN, *([FORCE] if touching else []))
    check_name("axis", axis, axes, f' of joint "{of}"')
    time = np.asarray(run.time)
    if axis == FORCE:
        force = np.asarray(run.contact(of).normal_force).sum(axis=1)
        return TimeCurve(time, force, None, "N", f"normal force in {of}", "")
    motion = relative_motion(run, of)
    if axis == TURN:
        return TimeCurve(time, motion.turn, motion.spin, "rad", f"turn in {of}",
                      f"angular velocity in {of}")  # fmt: skip
    at = AXES.index(axis)
    return TimeCurve(time, motion.offset[:, at], motion.rate[:, at], "m", f"{axis} in {of}",
                  f"velocity {axis} in {of}")  # fmt: skip


def reached(run: Trajectory, since: float) -> np.ndarray:
    """Mask of the saving times that a run reached.

    Args:
        run: the run.
        since: earliest time [s].

    Returns:
        True or False, shape (time,).
    """
    time = np.asarray(run.time)
    return (time >= since) & (time <= float(run.ended) * (1 + 1e-12))


# Points between two saving times, of a curve.
BETWEEN = 4


@answering
def phase_portrait(
    run: Trajectory, of: str, axis: str | None = None, *, since: float = 0.0, ax: Any = None
) -> Any:
    """Rate of a quantity over its value, coloured by time.

    Args:
        run: the run.
        of: name of a body or joint.
        axis: "x", "y" or "z": position of the centre of mass of a body in the ground frame, or of
            the child's marker of a joint in the axes of the parent's; "turn": angle about z of the
            same. By default x for a body or a journal in its clearance, else the coordinate of the
            joint.
        since: time from which the curve is drawn [s]; 0 by default.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such body, joint or axis, or the quantity has no rate.
    """
    curve = signal(run, of, axis)
    check_number("since of phase_portrait", since, "s")
    mask = reached(run, since)
    (values, across), (rates, up) = curve.in_unit(), curve.rates_in_unit()
    sheet = panels("phase_portrait", ax, size=(6.4, 4.8))
    lines = over_time(sheet.one, values[mask], rates[mask], curve.time[mask])
    sheet.figure_of.colorbar(lines, ax=sheet.one, label="time [s]")
    sheet.one.set_xlabel(across)
    sheet.one.set_ylabel(up)
    sheet.title(f"Phase portrait of {of}")
    return warned(sheet, {"": run})


def at_periods(data: TimeCurve, period: float, since: float, until: float) -> tuple:
    """Values and rates of a quantity once a period.

    Between saving times they are those of a cubic through values and rates.

    Args:
        data: the quantity.
        period: period [s], > 0.
        since: first time [s].
        until: last time [s].

    Returns:
        Times [s], values and rates, each of shape (periods,).
    """
    times = np.arange(since, until * (1 + 1e-12), period)
    mask = data.time <= until * (1 + 1e-12)
    curve = scipy.interpolate.CubicHermiteSpline(
        data.time[mask], data.values[mask], np.asarray(data.rates)[mask]
    )
    return times, curve(times), curve.derivative()(times)


def _check(run: Trajectory, curve: TimeCurve, period: float, since: float, what: str) -> float:
    """The end of the run [s]. Raises `ValueError` where no two periods are left."""
    curve.rates_in_unit()
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
    """Value and rate of a quantity once a period.

    A motion that repeats each period shows one point, one that repeats every n periods n points, a
    chaotic one a cloud.

    Args:
        run: the run.
        of: name of a body or joint.
        axis: name of the quantity, "x", "y", "z" or "turn", as of `phase_portrait`.
        period: period of the drive [s], > 0.
        since: time of the first point [s]; 0 by default.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such body, joint or axis, the quantity has no rate, or no whole
            period follows `since`.
    """
    curve = signal(run, of, axis)
    until = _check(run, curve, period, since, "poincare_section")
    times, _, _ = sampled = at_periods(curve, period, since, until)
    section = curve._replace(values=sampled[1], rates=sampled[2])
    (values, across), (rates, up) = section.in_unit(), section.rates_in_unit()
    sheet = panels("poincare_section", ax, size=(6.4, 4.8))
    points = sheet.one.scatter(values, rates, c=np.arange(len(times)), s=12, cmap="viridis")
    sheet.figure_of.colorbar(points, ax=sheet.one, label="period [1]")
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
    """Values of a quantity once a period, over a number that varies from run to run.

    A motion that repeats each period shows one point for its number.

    Args:
        runs: runs by the number that varies.
        of: name of a body or joint.
        axis: name of the quantity, "x", "y", "z" or "turn", as of `phase_portrait`.
        period: period of the drive [s], > 0.
        since: time of the first point [s]; 0 by default.
        over: name of the number with its unit in brackets; "radial clearance [m]" by default.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `runs` is empty, there is no such body, joint or axis, the quantity has no
            rate, or no whole period follows `since`.
    """
    expect(runs, Mapping, "runs", "a dictionary of runs by the number that varies")
    if not runs:
        raise ValueError("runs of bifurcation is empty; it must hold a run for each number.")
    sections = {}
    for number, run in runs.items():
        check_run(run)
        check_number("a number of bifurcation", number)
        curve = signal(run, of, axis)
        until = _check(run, curve, period, since, "bifurcation")
        sections[float(number)] = at_periods(curve, period, since, until)[1]
    every = curve._replace(values=np.concatenate(list(sections.values())))
    values, up = every.in_unit()
    numbers = np.repeat(list(sections), [len(one) for one in sections.values()])
    what, _, unit = over.rpartition(" [")
    factor, unit_text = readable(numbers, unit.rstrip("]"))
    sheet = panels("bifurcation", ax, size=(7.0, 4.6))
    sheet.one.plot(factor * numbers, values, ".", ms=3, color=matplotlib.colormaps["viridis"](0.25))
    sheet.one.set_xlabel(f"{what} [{unit_text}]" if what else over)
    sheet.one.set_ylabel(f"{up}")
    sheet.title(f"Once every {period:.4g} s")
    return warned(sheet, {f"{factor * n:.4g} {unit_text}": run for n, run in runs.items()})


# Saving times count as evenly spread within this share of their distance.
EVEN = 1e-6
# The least number of saving times in a segment, and how many harmonics are marked.
FEWEST, HARMONICS = 8, 10


def spectral_density(time: np.ndarray, values: np.ndarray, segments: int) -> tuple:
    """One-sided power spectral density by Welch's method.

    Windows are Hann's, overlap by half, and have their mean removed.

    Args:
        time: evenly spaced times [s], shape (time,), at least 8.
        values: values in some unit, shape (time,).
        segments: number of windows, >= 1.

    Returns:
        Frequencies [Hz] and densities [unit^2/Hz].

    Raises:
        ValueError: if the times are not evenly spaced.
    """
    from scipy.signal import welch

    steps = np.diff(time)
    if len(time) < FEWEST or np.ptp(steps) > EVEN * steps.mean() * len(time):
        raise ValueError(
            "a spectrum needs saving times that are evenly spread, at least "
            f"{FEWEST} of them; simulate with save=a number of them."
        )
    length = max(2 * len(time) // (segments + 1), FEWEST)
    return welch(values, 1.0 / steps.mean(), window="hann", nperseg=min(length, len(time)))


@answering
def spectrum(
    run: Trajectory,
    of: str,
    axis: str | None = None,
    *,
    since: float = 0.0,
    period: float | None = None,
    segments: int = 3,
    ax: Any = None,
) -> Any:
    """Root of the power spectral density of a quantity over frequency, by Welch's method.

    Args:
        run: the run, with evenly spaced saving times.
        of: name of a body or joint.
        axis: name of the quantity, "x", "y", "z" or "turn", as of `phase_portrait`, or "force": the
            normal force of a joint's contacts.
        since: time from which values are used [s]; 0 by default.
        period: period of the drive [s], > 0, whose harmonics are marked; None by default.
        segments: number of windows, overlapping by half, over which is averaged, >= 1; 3 by
            default. More give a smoother curve of lower resolution.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such body, joint or axis, or saving times are not evenly spaced.
    """
    curve = signal(run, of, axis)
    check_number("since of spectrum", since, "s")
    check_count("segments of spectrum", segments)
    if period is not None:
        check_number("period of spectrum", period, "s", above=0)
    mask = reached(run, since)
    frequency, density = spectral_density(curve.time[mask], curve.values[mask], segments)
    root = np.sqrt(density[1:])
    factor, unit = readable(root, curve.unit)
    sheet = panels("spectrum", ax, size=(7.0, 4.4))
    sheet.one.loglog(frequency[1:], factor * root, lw=1.0, color="C0")
    if period is not None:
        for number in range(1, HARMONICS + 1):
            if number / period < frequency[-1]:
                sheet.one.axvline(number / period, color="0.75", lw=0.6, zorder=0)
    sheet.one.set_xlabel("frequency [Hz]")
    sheet.one.set_ylabel(rf"root of spectral density [{unit}/$\sqrt{{\mathrm{{Hz}}}}$]")
    marked = "" if period is None else f", harmonics of {1 / period:.4g} Hz in grey"
    sheet.title(f"Spectrum of the {curve.label}{marked}")
    return warned(sheet, {"": run})
