"""Figures of runs and studies. Every function returns a matplotlib figure and neither shows nor
saves it.
"""

from collections.abc import Mapping
from typing import Any

import matplotlib
import matplotlib.ticker
import numpy as np
from matplotlib.figure import Figure

from jaxclear.components.wear_map import CylinderMap
from jaxclear.results.pointing_error import PointingError, shift, turn
from jaxclear.results.trajectory import Trajectory
from jaxclear.studies.advice.advice import PRESENT, REFERENCE, Advice
from jaxclear.studies.advice.pilot import describe
from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.sensitivity import Sensitivity

MILLI, MICRO = 1e3, 1e6
# Trials of an advice that are no rung of the ladder.
BESIDE = (REFERENCE, PRESENT)
# An error of ten times the response is drawn no higher.
LARGEST_ERROR = 10.0


def _figure(rows: int = 1, columns: int = 1, size: tuple[float, float] = (7.0, 4.5), **kwargs: Any):
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **kwargs)


def _shades(count: int) -> list:
    return [matplotlib.colormaps["viridis"](x) for x in np.linspace(0.0, 0.85, count)]


def _setting(run: Trajectory, joint: str) -> str:
    """The joint's clearance and the duration of the run, for a title."""
    clearance = float(run.mechanism.connections[joint].joint.clearance)
    return f" (clearance {MILLI * clearance:g} mm, {float(run.time[-1]):g} s)"


def displacement(runs: Mapping[str, Trajectory], ideal: Trajectory, body: str) -> Figure:
    """Path of a body's centre of mass in x and y for several runs beside the ideal one, and their
    distance from it.
    """
    figure, axes = _figure(3, 1, (8.0, 8.5), sharex=True)
    reference = np.asarray(ideal.body(body).com)
    for axis, k, letter in zip(axes[:2], (0, 1), "xy", strict=True):
        axis.plot(ideal.time, MILLI * reference[:, k], "k--", lw=1.2, label="ideal", zorder=3)
        for (label, run), shade in zip(runs.items(), _shades(len(runs)), strict=True):
            axis.plot(
                run.time,
                MILLI * np.asarray(run.body(body).com)[:, k],
                color=shade,
                lw=1.0,
                label=label,
            )
        axis.set_ylabel(f"{body} {letter} [mm]")
    for (label, run), shade in zip(runs.items(), _shades(len(runs)), strict=True):
        away = np.asarray(run.body(body).com)[:, :2] - reference[:, :2]
        axes[2].plot(
            run.time, MICRO * np.linalg.norm(away, axis=1), color=shade, lw=0.8, label=label
        )
    axes[2].set_ylabel("distance from ideal [µm]")
    axes[2].set_xlabel("time [s]")
    axes[2].set_ylim(bottom=0)
    figure.legend(
        *axes[0].get_legend_handles_labels(),
        ncols=5,
        fontsize=8,
        title="radial clearance",
        loc="outside lower center",
    )
    axes[0].set_title(f"Centre of mass of the {body}")
    return figure


def angular_velocity(
    run: Trajectory, ideal: Trajectory, body: str, label: str = "with clearance"
) -> Figure:
    """Angular velocity of a body about z with clearance and without, and their difference."""
    figure, axes = _figure(2, 1, (8.0, 6.0), sharex=True)
    own, other = (np.asarray(r.body(body).spin)[:, 2] for r in (run, ideal))
    axes[0].plot(run.time, own, color="C0", lw=1.2, label=label)
    axes[0].plot(ideal.time, other, "k--", lw=0.9, label="ideal")
    axes[0].set_ylabel("angular velocity [rad/s]")
    axes[0].legend(loc="upper right", fontsize=8)
    axes[0].set_title(f"Angular velocity of the {body} about the z axis")
    axes[1].plot(run.time, own - other, color="C0", lw=0.7)
    axes[1].axhline(0.0, color="k", lw=0.6)
    axes[1].set_ylabel("difference from ideal [rad/s]")
    axes[1].set_xlabel("time [s]")
    return figure


def journal_ends(run: Trajectory, joint: str) -> Figure:
    """Centres of the journal's two ends in the bearing's end planes, with the clearance circle.

    Indentation is of the order of a thousandth of the clearance, so points in contact lie on the
    circle.
    """
    ends = end_centres(run, joint)
    clearance = float(run.mechanism.connections[joint].joint.clearance)
    figure, axes = _figure(1, 2, (9.0, 4.8), sharex=True, sharey=True)
    turn = np.linspace(0, 2 * np.pi, 400)
    for axis, end, label in zip(
        axes, ends, ("lower end (z = -L/2)", "upper end (z = L/2)"), strict=True
    ):
        axis.plot(
            MICRO * clearance * np.cos(turn),
            MICRO * clearance * np.sin(turn),
            "r-",
            lw=0.7,
            label="clearance circle",
        )
        axis.set_xlim(-1.15 * MICRO * clearance, 1.15 * MICRO * clearance)
        axis.plot(
            MICRO * end[:, 0],
            MICRO * end[:, 1],
            ".",
            ms=3.0,
            alpha=0.4,
            color="C0",
            label="journal centre",
        )
        axis.set_aspect("equal")
        axis.set_title(label)
        axis.set_xlabel("x in the bearing [µm]")
    axes[0].set_ylabel("y in the bearing [µm]")
    figure.suptitle(f"Ends of the journal of {joint}{_setting(run, joint)}")
    axes[1].legend(loc="upper right", fontsize=8)
    return figure


def end_centres(run: Trajectory, joint: str) -> np.ndarray:
    """Points where the journal's axis pierces the bearing's lower and upper end plane, (2, time, 2)
    [m].
    """
    history = run.contact(joint)
    bearing = run.mechanism.connections[joint].joint
    ends = bearing.end_centres(
        tuple(np.asarray(history.offset).T), (tuple(np.asarray(history.axis).T),)
    )
    return np.stack([np.stack(end[:2], axis=-1) for end in ends])


def _wear(run: Trajectory, joint: str, surface: str) -> tuple[CylinderMap, np.ndarray]:
    wear_map = run.mechanism.connections[joint].joint.maps()[surface][0]
    return wear_map, np.asarray(run.worn[joint][surface])


def wear_unrolled(run: Trajectory, joint: str, surface: str = "bearing") -> Figure:
    """Worn depth over direction and position along the axis, the wall rolled out flat; beside it
    the deepest cell of each row.
    """
    wear_map, depth = _wear(run, joint, surface)
    figure, axes = _figure(1, 2, (9.5, 4.2), width_ratios=(3.2, 1.0), sharey=True)
    around = np.linspace(0, 360, depth.shape[0] + 1)
    along = MILLI * np.linspace(-0.5, 0.5, depth.shape[1] + 1) * float(wear_map.length)
    mesh = axes[0].pcolormesh(
        around, along, MICRO * depth.T, cmap="inferno", norm=_stretched(MICRO * depth)
    )
    figure.colorbar(mesh, ax=axes[0], label="worn depth [µm] (colour ~ square root)")
    axes[0].set_xlabel("direction from the bearing's x axis [deg]")
    axes[0].set_ylabel("position along the axis [mm]")
    axes[0].set_title(f"Worn depth of the {surface} of {joint}, unrolled{_setting(run, joint)}")
    axes[0].set_xticks(range(0, 361, 60))
    heights = MILLI * np.asarray(wear_map.heights())
    axes[1].barh(
        heights,
        MICRO * depth.max(axis=0),
        height=heights[1] - heights[0] if len(heights) > 1 else 1.0,
        color="C1",
    )
    axes[1].set_xlabel("deepest in row [µm]")
    return figure


def _stretched(values):
    return matplotlib.colors.PowerNorm(0.5, vmin=0.0, vmax=max(float(values.max()), 1e-12))


def wear_surface(
    run: Trajectory, joint: str, surface: str = "bearing", exaggeration: float | None = None
) -> Figure:
    """The worn wall in space, depth exaggerated so that the deepest place shows as a fifth of the
    radius.
    """
    wear_map, depth = _wear(run, joint, surface)
    radius = float(wear_map.radius)
    factor = 0.2 * radius / max(depth.max(), 1e-15) if exaggeration is None else exaggeration
    ringed = np.vstack([depth[-1:], depth, depth[:1]])
    padded = np.pad(ringed, ((0, 0), (1, 1)), mode="edge")
    corners = 0.25 * (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:])
    angles = np.linspace(0, 2 * np.pi, depth.shape[0] + 1)[:, None]
    reach = MILLI * (radius + factor * corners)
    heights = (
        MILLI
        * np.linspace(-0.5, 0.5, depth.shape[1] + 1)[None]
        * float(wear_map.length)
        * np.ones_like(reach)
    )
    figure = Figure(figsize=(7.5, 6.0), layout="constrained")
    axis = figure.add_subplot(projection="3d", computed_zorder=False)
    norm = _stretched(MICRO * depth)
    colours = matplotlib.colormaps["YlOrRd"](norm(MICRO * depth))
    axis.plot_surface(
        reach * np.cos(angles), reach * np.sin(angles), heights, facecolors=colours, rstride=1, cstride=1,
        shade=False, edgecolor=(0, 0, 0, 0.06), linewidth=0.2,
    )  # fmt: skip
    scale = matplotlib.cm.ScalarMappable(norm, "YlOrRd")
    figure.colorbar(
        scale, ax=axis, label="worn depth [µm] (colour ~ square root)", shrink=0.7, pad=0.12
    )
    axis.set_xlabel("x [mm]")
    axis.set_ylabel("y [mm]")
    axis.set_zlabel("z [mm]")
    axis.set_title(
        f"Worn {surface} of {joint} seen from outside, depth × {factor:.0f}{_setting(run, joint)}"
    )
    axis.set_box_aspect((1, 1, 1.2))
    deepest = np.degrees(float(wear_map.angles()[int(depth.max(axis=1).argmax())]))
    axis.view_init(elev=22.0, azim=deepest + 25.0)
    return figure


def monte_carlo(study: MonteCarlo) -> Figure:
    """Histogram of every response over the sample, with mean and 5 to 95 % range."""
    names = list(study.responses)
    figure, axes = _figure(1, len(names), (4.6 * len(names), 3.8), squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        values = study.responses[name]
        values = values[np.isfinite(values)]
        factor, unit = _readable(values, study.problem.units()[name])
        axis.hist(factor * values, bins="auto", color="C0", alpha=0.8)
        axis.axvline(factor * values.mean(), color="k", lw=1.2, label="mean")
        low, high = np.percentile(factor * values, [5, 95])
        axis.axvspan(low, high, color="C1", alpha=0.25, label="5 to 95 %", zorder=0)
        axis.set_xlabel(f"{name} [{unit}]")
        axis.set_ylabel("samples")
    figure.legend(
        *axes[0][0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=2
    )
    figure.suptitle(f"Monte Carlo, {len(study.values)} samples, {len(study.failed)} failed")
    return figure


def _readable(values: np.ndarray, unit: str) -> tuple[float, str]:
    """Factor and unit in which values in metres or radians are readable; other units stay."""
    if unit not in ("m", "rad") or not len(values):
        return 1.0, unit
    size = np.abs(values).max()
    return next(
        ((f, p + unit) for f, p in ((1.0, ""), (1e3, "m"), (1e6, "µ")) if size * f >= 1.0),
        (1e9, f"n{unit}"),
    )


def sensitivity(study: Sensitivity) -> Figure:
    """Every derivative by every method, with its 95 % interval; a method that refused is named, not
    drawn.
    """
    entries = list(study.derivatives.items())
    figure, axes = _figure(1, len(entries), (4.6 * len(entries), 3.6), squeeze=False)
    for axis, ((response, variable), derivative) in zip(axes[0], entries, strict=True):
        labels = [*derivative.estimates, "answer"]
        answers = [*derivative.estimates.values(), derivative]
        for row, answer in enumerate(answers):
            if np.isfinite(answer.value):
                colour = "k" if row == len(answers) - 1 else "C0"
                axis.errorbar(
                    answer.value, -row, xerr=answer.error, fmt="o", color=colour, capsize=4
                )
            else:
                axis.text(
                    0.5,
                    -row,
                    "refused",
                    transform=axis.get_yaxis_transform(),
                    ha="center",
                    va="center",
                    color="C3",
                )
        axis.set_yticks([-row for row in range(len(labels))], labels)
        axis.set_ylim(-len(labels) + 0.4, 0.6)
        axis.axvline(0.0, color="0.7", lw=0.8)
        axis.xaxis.set_major_locator(matplotlib.ticker.MaxNLocator(4))
        axis.set_xlabel(f"d({response}) / d({variable}) [{study.unit(response, variable)}]")
        axis.set_title(derivative.verdict, fontsize=8, wrap=True)
    return figure


def work_precision(advice: Advice) -> Figure:
    """Error of every trial against its cost alone, one line a rung, with the accuracy asked and the
    recommended setting.

    Grey: the reference, and what it cannot tell from no error. Runs that failed are not drawn;
    errors outside are drawn at the edge, LARGEST_ERROR or the lower end of the grey.
    """
    figure, axis = _figure(1, 1, (8.0, 5.4))
    known = max(rule.trust for rule in advice.standards.values())
    floor = max(0.3 * min(known, advice.accuracy), 1e-12)
    table = advice.table()
    table = table[np.isfinite(table["error"]) & np.isfinite(table["wall s per simulated s"])]
    table = table.assign(
        error=table["error"].clip(floor, LARGEST_ERROR), cost=table["wall s per simulated s"]
    )
    for index, (name, rung) in enumerate(
        table[~table["rung"].isin(BESIDE)].groupby("rung", sort=False)
    ):
        axis.plot(rung["cost"], rung["error"], "o-", ms=4, lw=1.2, color=f"C{index}", label=name)
    for name, marker in zip(BESIDE, "Dx", strict=True):
        rung = table[table["rung"] == name]
        axis.plot(rung["cost"], rung["error"], marker, ms=6, color="0.35", label=name)
    best = table[table["recommended"]]
    axis.plot(
        best["cost"], best["error"], "o", ms=14, mfc="none", mec="k", mew=1.6, label="recommended"
    )
    axis.axhline(
        advice.accuracy,
        color="C3",
        ls="--",
        lw=1.0,
        label=f"accuracy asked, {100 * advice.accuracy:g} %",
    )
    axis.axhspan(floor, known, color="0.9", zorder=0)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("computing time per simulated second, one run alone [s]")
    axis.set_ylabel(
        "largest error of a response [1]" + (", means over the copies" if advice.means else "")
    )
    cheapest = f"cheapest in batches of {advice.batch}" if advice.batch else "cheapest alone"
    axis.set_title(f"Recommended, {cheapest}: {describe(advice.recommended)}", fontsize=10)
    figure.legend(
        *axis.get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=3
    )
    return figure


def pointing_budget(error: PointingError) -> Figure:
    """Pointing and position error of a tip over time, exact beside the adjoint model, with what
    each joint contributes; beside it the root mean squares, each with its share of the mean
    square."""
    figure, axes = _figure(2, 2, (10.0, 6.4), width_ratios=(2.4, 1.0))
    table = error.budget()
    quantities = (
        ("pointing", error.pointing_angle, turn, "rad"),
        ("position", error.position_error, shift, "m"),
    )
    for (over_time, beside), (what, exact, size, base_unit) in zip(axes, quantities, strict=True):
        factor, unit = _readable(exact, base_unit)
        shades = dict(zip(error.names, (f"C{k}" for k in range(len(error.names))), strict=True))
        for name, shade in shades.items():
            values = factor * size(error.contributions[name])
            over_time.plot(
                error.time, values, color=shade, lw=0.9, alpha=0.85, label=f"{name} alone"
            )
        over_time.plot(error.time, factor * exact, color="0.55", lw=3.0, label="exact", zorder=2.5)
        over_time.plot(
            error.time, factor * size(error.model), "k--", lw=1.0, label="adjoint model", zorder=3
        )
        over_time.set_ylabel(f"{what} error [{unit}]")
        over_time.set_ylim(bottom=0)
        column = factor * table[f"rms {what} [{base_unit}]"]
        colours = [shades.get(name, "k" if name == "model" else "0.55") for name in table.index]
        beside.barh(range(len(table)), column, color=colours)
        for row, (value, share) in enumerate(
            zip(column, table[f"share of {what} [1]"], strict=True)
        ):
            text = "" if np.isnan(share) or row >= len(error.names) else f"{100 * share:.3g} %"
            beside.text(value, row, f" {text}", va="center", fontsize=8)
        beside.set_yticks(range(len(table)), table.index)
        beside.set_xlim(0.0, 1.25 * max(column.max(), np.finfo(float).tiny))
        beside.invert_yaxis()
        beside.set_xlabel(f"rms [{unit}]; %: share of its square")
    axes[1][0].set_xlabel("time [s]")
    figure.legend(
        *axes[0][0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=5
    )
    figure.suptitle(f'Error of the tip on "{error.tip}" seen from "{error.base}"')
    return figure
