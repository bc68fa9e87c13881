"""Figures of one run's motion beside the ideal mechanism's, and of a journal in its bearing."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxclear.ground.arguments import expect
from jaxclear.plot.canvas import MILLI, check_run, panels, readable, setting, shades, warned
from jaxclear.plot.fitting import key
from jaxclear.results.trajectory import Trajectory

__all__ = ["angular_velocity", "displacement", "end_centres", "journal_ends"]


def displacement(
    runs: Mapping[str, Trajectory], ideal: Trajectory, body: str, *, ax: Any = None
) -> Any:
    """Path of a body's centre of mass in x and y for several runs beside the ideal one, and their
    distance from it. `ax`: three axes to draw in.
    """
    expect(runs, Mapping, "runs", "a dictionary of runs by the label of each")
    for one in (*runs.values(), ideal):
        check_run(one)
    sheet = panels("displacement", ax, 3, 1, (8.0, 8.5), sharex=True)
    axes = sheet.axes.flat
    reference = np.asarray(ideal.body(body).com)
    for axis, k, letter in zip(axes[:2], (0, 1), "xy", strict=True):
        axis.plot(ideal.time, MILLI * reference[:, k], "k--", lw=1.2, label="ideal", zorder=3)
        for (label, run), shade in zip(runs.items(), shades(len(runs)), strict=True):
            axis.plot(
                run.time,
                MILLI * np.asarray(run.body(body).com)[:, k],
                color=shade,
                lw=1.0,
                label=label,
            )
        axis.set_ylabel(f"{body} {letter} [mm]")
    away = [
        np.linalg.norm(np.asarray(run.body(body).com)[:, :2] - reference[:, :2], axis=1)
        for run in runs.values()
    ]
    factor, unit = readable(np.concatenate([*away, [0.0]]), "m")
    for run, way, shade in zip(runs.values(), away, shades(len(runs)), strict=True):
        axes[2].plot(run.time, factor * way, color=shade, lw=0.8)
    axes[2].set_ylabel(f"distance from ideal [{unit}]")
    axes[2].set_xlabel("time [s]")
    axes[2].set_ylim(bottom=0)
    sheet.legend(title="radial clearance")
    sheet.title(f"Centre of mass of the {body}")
    return warned(sheet, {**runs, "ideal": ideal})


def angular_velocity(
    run: Trajectory,
    ideal: Trajectory,
    body: str,
    label: str = "with clearance",
    *,
    ax: Any = None,
) -> Any:
    """Angular velocity of a body about z with clearance and without, and their difference. `ax`:
    two axes to draw in."""
    for one in (run, ideal):
        check_run(one)
    sheet = panels("angular_velocity", ax, 2, 1, (8.0, 6.0), sharex=True)
    axes = sheet.axes.flat
    own, other = (np.asarray(r.body(body).spin)[:, 2] for r in (run, ideal))
    axes[0].plot(run.time, own, color="C0", lw=1.2, label=label)
    axes[0].plot(ideal.time, other, "k--", lw=0.9, label="ideal")
    axes[0].set_ylabel("angular velocity [rad/s]")
    sheet.legend()
    sheet.title(f"Angular velocity of the {body} about the z axis")
    axes[1].plot(run.time, own - other, color="C0", lw=0.7)
    axes[1].axhline(0.0, color="k", lw=0.6)
    axes[1].set_ylabel("difference from ideal [rad/s]")
    axes[1].set_xlabel("time [s]")
    return warned(sheet, {label: run, "ideal": ideal})


def journal_ends(run: Trajectory, joint: str, *, ax: Any = None) -> Any:
    """Centres of the journal's two ends in the bearing's end planes, with the clearance circle.

    Indentation is of the order of a thousandth of the clearance, so points in contact lie on the
    circle. `ax`: two axes to draw in.
    """
    ends = end_centres(run, joint)
    clearance = float(run.mechanism.connections[joint].joint.clearance)
    sheet = panels("journal_ends", ax, 1, 2, (9.0, 4.8), sharex=True, sharey=True)
    axes = sheet.axes.flat
    turn = np.linspace(0, 2 * np.pi, 400)
    factor, unit = readable([clearance], "m")
    circle = factor * clearance * np.stack([np.cos(turn), np.sin(turn)])
    labels = ("lower end (z = -L/2)", "upper end (z = L/2)")
    for axis, end, label in zip(axes, ends, labels, strict=True):
        axis.plot(*circle, "r-", lw=0.7, label="clearance circle")
        axis.set_xlim(-1.15 * factor * clearance, 1.15 * factor * clearance)
        axis.plot(*(factor * end.T), ".", ms=3.0, alpha=0.4, color="C0", label="journal centre")
        axis.set_aspect("equal")
        axis.set_title(label)
        axis.set_xlabel(f"x in the bearing [{unit}]")
    axes[0].set_ylabel(f"y in the bearing [{unit}]")
    sheet.title(f"Ends of the journal of {joint}{setting(run, joint)}")
    key(axes[1], loc="upper right")
    return warned(sheet, {"": run})


def end_centres(run: Trajectory, joint: str) -> np.ndarray:
    """Points where the journal's axis pierces the bearing's lower and upper end plane, (2, time, 2)
    [m].
    """
    check_run(run)
    history = run.contact(joint)
    ends_of = getattr(run.mechanism.connections[joint].joint, "end_centres", None)
    if ends_of is None:
        raise ValueError(
            f'the joint "{joint}" has no two ends to draw; it must be a clearance.JournalBearing.'
        )
    ends = ends_of(tuple(np.asarray(history.offset).T), (tuple(np.asarray(history.axis).T),))
    return np.stack([np.stack(end[:2], axis=-1) for end in ends])
