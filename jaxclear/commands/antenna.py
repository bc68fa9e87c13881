"""The antenna study from one command: joint models, friction laws, errors of the tip and its path,
for both drives.

Writes figures (PNG) and tables (CSV) into a folder and prints what it found.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import StudyFolder, report_warnings
from jaxclear.ground.table import as_table
from jaxclear.plot.canvas import as_warnings, captioned, warned
from jaxclear.results.pointing_error import PointingError, shift, turn
from jaxclear.results.trajectory import Trajectory
from jaxclear.scenes.antenna import BASE, BEARING_RADIUS, HOLD, JOINTS, KINDS, TIP, antenna

# Step of the runs [s]; the book's page on accuracy shows what it costs in accuracy.
STEP = 1e-3
# A regularised law that nearly holds, with full friction at this slip speed [m/s], beside that of
# Bai & Zhao (0.1 m/s).
STEEP = {"static_speed": 1e-3, "kinetic_speed": 1e-2}
# Slip slower than this is sticking [m/s].
STUCK = 1e-12
# The tip's departure is drawn this many times as large, and the close-up of stick and slip shows
# this interval [s].
EXAGGERATION, CLOSE = 20.0, (0.75, 1.3)
COULOMB, WIDE, NARROW = "Coulomb (sticks)", "three-zone, 0.1 m/s", "three-zone, 1 mm/s"


def _simulate(
    kind: str, drive: str, duration: float, friction: Any = "set_valued", regularised: bool = False
) -> Any:
    """A run saved at every step."""
    rig = antenna(kind, drive=drive, friction=friction)
    integrator = jc.integrator.NonColliding(STEP, regularised=regularised)
    return jc.simulate(rig, duration, save=round(duration / STEP) + 1, integrator=integrator)


def friction_runs(duration: float) -> dict[str, Any]:
    """The step drive over `duration` [s] with Coulomb's law and with two regularised ones."""
    steep = jc.friction.ThreeZone(mu_static=0.15, mu_kinetic=0.1, **STEEP)
    return {
        COULOMB: _simulate("spatial", "step", duration),
        NARROW: _simulate("spatial", "step", duration, steep, True),
        WIDE: _simulate("spatial", "step", duration, "regularised", True),
    }


def motion_table(runs: dict[str, Any]) -> pandas.DataFrame:
    """One row a joint model: swing of both joints, and what they carry and lose."""
    rows = []
    for kind, run in runs.items():
        row: dict[str, Any] = {"joints": kind}
        for name in JOINTS:
            row[f"{name} swing [rad]"] = np.ptp(np.asarray(run.coordinate(name)))
            if kind != "ideal":
                mean = jc.response.MeanContactForce(name)(run)
                friction = np.asarray(run.contact(name).traction).sum(1).mean()
                row[f"{name} mean normal force [N]"] = float(mean)
                row[f"{name} mean friction at the saves [N]"] = friction
        rows.append(row)
    return as_table(rows)


def friction_table(runs: dict[str, Any]) -> pandas.DataFrame:
    """One row a friction law: how slowly joint 1 slips while Coulomb's law makes it stick."""
    first = BEARING_RADIUS * np.abs(np.asarray(runs[COULOMB].speed("J1")))
    sticks = first < STUCK
    sticks[0] = False
    rows = []
    for label, run in runs.items():
        slip = BEARING_RADIUS * np.abs(np.asarray(run.speed("J1")))
        share = np.mean(slip[1:] < STUCK)
        row = {"friction": label, "share of time stuck [1]": share}
        row["largest slip while Coulomb sticks [m/s]"] = np.max(slip[sticks], initial=0.0)
        row["median [m/s]"] = np.median(slip[sticks]) if sticks.any() else np.nan
        rows.append(row)
    return as_table(rows)


def study(folder: Path, duration: float = 4.0) -> None:
    """Runs everything and writes it to `folder`; `duration` [s] of the periodic drive."""
    files = StudyFolder(folder)
    print("periodic drive: ideal, planar and spatial joints", flush=True)
    periodic = {kind: _simulate(kind, "periodic", duration) for kind in reversed(KINDS)}
    print("step drive: Coulomb's law and two regularised ones", flush=True)
    stepped = friction_runs(HOLD)
    report_warnings(periodic | stepped)
    errors = {
        "periodic": jc.pointing_error(periodic["spatial"], TIP, BASE),
        "step": jc.pointing_error(stepped[COULOMB], TIP, BASE),
    }
    tables = _make_tables(periodic, stepped, errors)
    files.write_tables(**tables)
    for name in ("motion", "stick_slip"):
        print(f"\n{tables[name]}", flush=True)
    for drive, error in errors.items():
        print(f"\n{drive} drive: {error.sentence()}")
    figures = _draw_figures(periodic, stepped, errors)
    files.write_figures(**figures)
    print(f"\n{files.sentence()}")


def _make_tables(periodic: dict, stepped: dict, errors: dict) -> dict[str, pandas.DataFrame]:
    tables = {"motion": motion_table(periodic), "stick_slip": friction_table(stepped)}
    tables |= {f"pointing_{drive}": error.budget().reset_index() for drive, error in errors.items()}
    parts = [stepped[COULOMB].switchings(name).assign(joint=name) for name in JOINTS]
    return tables | {"switchings_step": pandas.concat(parts, ignore_index=True)}


def _draw_figures(periodic: dict, stepped: dict, errors: dict) -> dict[str, Any]:
    spatial, error = periodic["spatial"], errors["periodic"]
    figures = {
        "motion": motion_figure(periodic),
        "stick_slip": stick_slip_figure(stepped, "J1", BEARING_RADIUS, CLOSE),
        "errors": errors_figure(errors),
        "tip_path": tip_path_figure(spatial, error, periodic["ideal"], EXAGGERATION),
    }
    budgets = {f"pointing_budget_{drive}": plot.pointing_budget(e) for drive, e in errors.items()}
    return figures | budgets


MILLI = 1e3
STYLES = {"ideal": ("k", "--"), "planar": ("C0", "-"), "spatial": ("C3", "-")}
# Difference of model and exact error below which nothing is drawn on a logarithmic axis, relative
# to the largest.
FLOOR = 1e-6


def motion_figure(runs: Mapping[str, Trajectory]) -> Figure:
    """Angle of both joints over time, and the speed, for every joint model; below, how far the
    angles are from the ideal ones.
    """
    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    for column, joint in enumerate(JOINTS):
        ideal = np.asarray(runs["ideal"].coordinate(joint))
        for kind, run in runs.items():
            colour, line = STYLES[kind]
            angle, speed = (np.asarray(read(joint)) for read in (run.coordinate, run.speed))
            axes[0][column].plot(
                run.time, angle, color=colour, ls=line, lw=1.3, label=f"{kind} joints"
            )
            axes[1][column].plot(run.time, speed, color=colour, ls=line, lw=1.3)
            if kind != "ideal":
                axes[2][column].plot(run.time, np.abs(angle - ideal), color=colour, lw=1.3)
        axes[0][column].set_title(f"{joint}")
        axes[2][column].set_xlabel("time [s]")
        axes[2][column].set_yscale("log")
        axes[2][column].set_ylim(bottom=1e-5)
    for row, label in enumerate(("angle [rad]", "speed [rad/s]", "off the ideal angle [rad]")):
        axes[row][0].set_ylabel(label)
    figure.legend(*axes[0][0].get_legend_handles_labels(), ncols=3, loc="outside lower center")
    return warned(figure, runs)


def stick_slip_figure(
    runs: Mapping[str, Trajectory], joint: str, radius: float, close: tuple[float, float]
) -> Figure:
    """Slip speed, acceleration and friction of a joint, by friction law.

    Args:
        runs: by friction law; the first marks where the joint sticks.
        joint: name.
        radius: of its bearing [m].
        close: interval of the close-up on the right [s].
    """
    figure = Figure(figsize=(11.0, 8.5), layout="constrained")
    axes = figure.subplots(3, 2, sharex="col")
    for number, (label, run) in enumerate(runs.items()):
        time, speed = np.asarray(run.time), np.asarray(run.speed(joint))
        acceleration = np.diff(speed) / np.diff(time)
        friction = np.asarray(run.contact(joint).traction).sum(1)[1:]
        style = {"color": f"C{number}", "lw": 1.6 if number == 0 else 1.0, "zorder": 3 - number}
        for column in (0, 1):
            axes[0][column].plot(time, MILLI * radius * speed, label=label, **style)
            axes[1][column].plot(time[1:], acceleration, **style)
            axes[2][column].plot(time[1:], friction, **style)
    first = next(iter(runs.values()))
    time, speed = np.asarray(first.time), np.asarray(first.speed(joint))
    sticks = np.abs(speed) * radius < STUCK
    sticks[0] = False
    for axis in axes.flat:
        _shade_where(axis, time, sticks)
    for axis in axes[:, 1]:
        _fit_limits(axis, (time > close[0]) & (time < close[1]))
        axis.set_xlim(*close)
        axis.axhline(0.0, color="0.6", lw=0.6, zorder=1)
    for row, text in enumerate(("slip speed [mm/s]", "acceleration [rad/s²]", "friction [N]")):
        axes[row][0].set_ylabel(text)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    axes[0][0].set_title(f"{joint}; grey: sticks by Coulomb's law")
    axes[0][1].set_title("close up")
    lines = axes[0][0].get_legend_handles_labels()
    figure.legend(*lines, ncols=len(runs), fontsize=9, loc="outside lower center")
    return warned(figure, runs)


def _shade_where(axis, time, mask):
    """Grey where `held`, over the whole height of the axis."""
    low, high = axis.get_ylim()
    across = axis.get_xaxis_transform()
    axis.fill_between(time, 0, 1, where=mask, color="0.88", transform=across, zorder=0, lw=0)
    axis.set_ylim(low, high)


def _fit_limits(axis, inside):
    """Limits that show the first two curves where time is `inside`."""
    values = np.concatenate(
        [line.get_ydata()[inside[-len(line.get_ydata()) :]] for line in axis.lines[:2]]
    )
    low, high = values.min(), values.max()
    axis.set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low))


def errors_figure(errors: Mapping[str, PointingError]) -> Figure:
    """Pointing and position error of the tip over time by drive: exact, by the adjoint model, and
    their difference.
    """
    figure = Figure(figsize=(11.0, 6.5), layout="constrained")
    axes = figure.subplots(2, len(errors), sharex="col")
    for column, (drive, error) in enumerate(errors.items()):
        beyond = error.model - error.exact
        # At the start no force is known yet, so nothing leans.
        time = error.time[1:]
        for axis, exact, size, unit in (
            (axes[0][column], error.pointing_angle, turn, "mrad"),
            (axes[1][column], error.position_error, shift, "mm"),
        ):
            axis.plot(time, MILLI * exact[1:], color="0.6", lw=3.0, label="exact")
            axis.plot(time, MILLI * size(error.model)[1:], "k--", lw=1.0, label="adjoint model")
            axis.plot(time, MILLI * size(beyond)[1:], color="C3", lw=1.0, label="their difference")
            axis.set_yscale("log")
            axis.set_ylim(bottom=MILLI * max(size(beyond)[1:].min(), FLOOR * exact.max()))
            axis.set_ylabel(f"{'pointing' if unit == 'mrad' else 'position'} error [{unit}]")
        axes[0][column].set_title(f"{drive} drive")
        axes[1][column].set_xlabel("time [s]")
    figure.legend(*axes[0][0].get_legend_handles_labels(), ncols=3, loc="outside lower center")
    warnings = [w for drive, error in errors.items() for w in as_warnings(error.warnings, drive)]
    return captioned(figure, warnings)


def tip_paths(run: Trajectory, error: PointingError) -> tuple[np.ndarray, np.ndarray]:
    """(ideal, actual) path of the tip in the satellite's axes [m]: with ideal joints at the run's
    coordinates, and as the journals lean."""
    base, link = run.body(BASE), run.body(TIP.body)
    rotated = np.asarray(base.rotation)
    place = np.asarray(run.marker(TIP).position) - np.asarray(base.origin)
    ideal = np.einsum("tji,tj->ti", rotated, place)
    frame = np.asarray(link.rotation) @ np.array(
        [[float(x) for x in row] for row in TIP.pose().rotation]
    )
    linear, angular = error.exact[:, :3], error.exact[:, 3:]
    # The exponential of the twist moves the origin by this to second order in the angle.
    moved = linear + 0.5 * np.cross(angular, linear)
    return ideal, ideal + np.einsum("tji,tjk,tk->ti", rotated, frame, moved)


def tip_path_figure(
    run: Trajectory, error: PointingError, nominal: Trajectory, scale: float
) -> Figure:
    """Path of the tip in space, seen from the satellite.

    Args:
        run: with clearance.
        error: of its tip.
        nominal: run of the ideal mechanism.
        scale: by which the departure of the run from ideal joints is drawn larger [1].
    """
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    axis = figure.add_subplot(projection="3d")
    base = nominal.body(BASE)
    away = np.asarray(nominal.marker(TIP).position) - np.asarray(base.origin)
    frictionless = np.einsum("tji,tj->ti", np.asarray(base.rotation), away)
    ideal, actual = tip_paths(run, error)
    exaggerated = (ideal + scale * (actual - ideal))[1:]
    axis.plot(*frictionless.T, color="0.6", ls="--", lw=1.2, label="ideal mechanism, no friction")
    axis.plot(*ideal.T, color="k", lw=1.2, label="ideal joints, same angles")
    axis.plot(
        *exaggerated.T,
        color="C3",
        lw=1.2,
        label=f"actual, its departure drawn {scale:g} times as large",
    )
    axis.scatter(*ideal[0], color="k", s=25)
    axis.text(*ideal[0], "  start", fontsize=9)
    for name, setter in zip(
        "xyz", (axis.set_xlabel, axis.set_ylabel, axis.set_zlabel), strict=True
    ):
        setter(f"{name} [m]", labelpad=10)
    axis.locator_params(nbins=4)
    points = np.concatenate([frictionless, ideal, exaggerated])
    sides = np.ptp(points, axis=0)
    axis.set_box_aspect(np.maximum(sides, 0.2 * sides.max()), zoom=0.85)
    axis.legend(loc="upper left", fontsize=9)
    largest = MILLI * np.linalg.norm(actual - ideal, axis=1).max()
    axis.set_title(f"Path of the tip seen from the satellite (largest departure {largest:.2f} mm)")
    return warned(figure, {"": run, "ideal": nominal})
