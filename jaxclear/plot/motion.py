"""Figures of one run: its motion beside the ideal mechanism's, a journal in its bearing and how it
moves there, friction over the motion, and the error of a tip shared out among the joints.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.patches import Patch

from jaxclear.components.body import GROUND, Marker
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.ground.printing import in_a_line
from jaxclear.plot.canvas import (
    MILLI,
    as_warnings,
    check_run,
    key,
    over_time,
    panels,
    readable,
    setting,
    shades,
    warned,
)
from jaxclear.plot.signal import reached
from jaxclear.results.modes import Mode
from jaxclear.results.pointing_error import PointingError, shift, turn
from jaxclear.results.relative_motion import marker_motion, relative_motion
from jaxclear.results.solids import moves_in_plane, rows_of, slides
from jaxclear.results.trajectory import Trajectory


@answering
def displacement(
    runs: Mapping[str, Trajectory], ideal: Trajectory, body: str, *, ax: Any = None
) -> Any:
    """Path of a body's centre of mass in x and y for several runs and the ideal one.

    The third panel shows their distance from the ideal path.

    Args:
        runs: runs by the label of each.
        ideal: run of the ideal mechanism, with the same saving times.
        body: name of the body.
        ax: three `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such body, or `runs` is no dictionary of runs.
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
    for run, distance, shade in zip(runs.values(), away, shades(len(runs)), strict=True):
        axes[2].plot(run.time, factor * distance, color=shade, lw=0.8)
    axes[2].set_ylabel(f"distance from ideal [{unit}]")
    axes[2].set_xlabel("time [s]")
    axes[2].set_ylim(bottom=0)
    sheet.legend(title="radial clearance")
    sheet.title(f"Centre of mass of the {body}")
    return warned(sheet, {**runs, "ideal": ideal})


@answering
def path(run: Trajectory, *markers: Marker | str, ax: Any = None) -> Any:
    """Paths of points of bodies, and in grey the mechanism at the instant that spreads it most.

    Of a mechanism that moves in the x-y plane y is drawn over x, of another the path in space.
    Triangles are joints of the ground, dashed lines its rails, circles other joints.

    Args:
        run: the run.
        markers: one or several `Marker`s, or names of bodies, whose centres of mass they then are.
        ax: `matplotlib.axes.Axes` to draw in, in space with `projection="3d"`; by default a new
            figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no marker, or no such body.
    """
    check_run(run)
    if not markers:
        raise ValueError(
            "plot.path has no point to draw; give markers or names of bodies, such as "
            'plot.path(run, jc.Marker("rod", (0.06, 0.02))).'
        )
    mask, connections = reached(run, -np.inf), run.mechanism.connections
    paths = [np.asarray(run.path(marker))[mask] for marker in markers]
    moving = {n: c.child if c.parent.body == GROUND else c.parent for n, c in connections.items()}
    joints = {name: marker_motion(run, side).place[mask] for name, side in moving.items()}
    at = np.prod(np.ptp([*joints.values()], axis=0)[:, :2], axis=1).argmax()
    factor, unit = readable(np.concatenate([*paths, *joints.values()]), "m")
    space = not moves_in_plane(run)
    sheet = panels("path", ax, size=(6.0, 5.0), space=space)
    axis, count = sheet.one, 3 if space else 2

    def draw(places: np.ndarray, style: str, colour: Any, **look: Any) -> None:
        axis.plot(*factor * places[:, :count].T, style, color=colour, **look)

    for body in run.mechanism.bodies:
        ends = [
            marker_motion(run, side).place[mask][at]
            for connection in connections.values()
            for side in (connection.parent, connection.child)
            if side.body == body
        ]
        draw(np.array([*ends, *ends[:1]]).reshape(-1, 3), "-", "0.8", lw=2.5, zorder=1)
    for name, connection in connections.items():
        is_ground = GROUND in (connection.parent.body, connection.child.body)
        is_rail = is_ground and slides(connection.joint)
        if is_rail:
            along = joints[name][:, np.ptp(joints[name], axis=0).argmax()]
            draw(joints[name][[along.argmin(), along.argmax()]], "--", "0.4", lw=0.8, zorder=1)
        mark, size = ("s", 9) if is_rail else ("^", 7) if is_ground else ("o", 5)
        place = joints[name][at : at + 1]
        draw(place, mark, "0.4", mfc="0.6" if is_ground else "w", ms=size, zorder=3 - is_ground)
        side = "top" if is_ground else "bottom"
        axis.text(*factor * place[0, :count], f"  {name}", color="0.4", fontsize=8, va=side)
    for k, (marker, places) in enumerate(zip(markers, paths, strict=True)):
        label = marker if isinstance(marker, str) else in_a_line(marker).replace('"', "")
        draw(places, "-", f"C{k}", lw=1.4, label=label)
    axis.set_aspect("equal")
    for letter in "xyz"[:count]:
        getattr(axis, f"set_{letter}label")(f"{letter} [{unit}]")
    sheet.legend()
    sheet.title("Path of a point" if len(markers) == 1 else "Paths of points")
    return warned(sheet, {"": run})


@answering
def angular_velocity(
    run: Trajectory, ideal: Trajectory, body: str, label: str = "with clearance", *, ax: Any = None
) -> Any:
    """Angular velocity of a body about z with clearance and without, and their difference.

    Args:
        run: run of the mechanism with clearance.
        ideal: run of the ideal mechanism, with the same saving times.
        body: name of the body.
        label: legend of `run`; "with clearance" by default.
        ax: two `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such body, or an argument is no run.
    """
    for one in (run, ideal):
        check_run(one)
    sheet = panels("angular_velocity", ax, 2, 1, (8.0, 6.0), sharex=True)
    axes = sheet.axes.flat
    rate, other = (np.asarray(r.body(body).spin)[:, 2] for r in (run, ideal))
    axes[0].plot(run.time, rate, color="C0", lw=1.2, label=label)
    axes[0].plot(ideal.time, other, "k--", lw=0.9, label="ideal")
    axes[0].set_ylabel("angular velocity [rad/s]")
    sheet.legend()
    sheet.title(f"Angular velocity of the {body} about the z axis")
    axes[1].plot(run.time, rate - other, color="C0", lw=0.7)
    axes[1].axhline(0.0, color="k", lw=0.6)
    axes[1].set_ylabel("difference from ideal [rad/s]")
    axes[1].set_xlabel("time [s]")
    return warned(sheet, {label: run, "ideal": ideal})


@answering
def journal_ends(run: Trajectory, joint: str, *, ax: Any = None) -> Any:
    """Centres of the journal's two ends in the bearing's end planes, with the clearance circle.

    The indentation is of the order of a thousandth of the clearance, so points in contact lie on
    the circle.

    Args:
        run: the run.
        joint: name of a `clearance.JournalBearing`.
        ax: two `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such joint or it has no two ends.
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


@answering
def end_centres(run: Trajectory, joint: str) -> np.ndarray:
    """Points where the journal's axis pierces the bearing's lower and upper end plane.

    Args:
        run: the run.
        joint: name of a `clearance.JournalBearing`.

    Returns:
        Points [m] in the bearing's x and y axes, shape (2, time, 2).

    Raises:
        ValueError: if there is no such joint or it has no two ends.
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


PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


@answering
def journal_orbit(
    run: Trajectory, joint: str, *, plane: str = "xy", since: float = 0.0, ax: Any = None
) -> Any:
    """Path of a journal's (or ball's) centre in its bearing, with the clearance circle.

    The path is coloured by time. `plot.journal_ends` draws both ends of a journal that tilts.

    Args:
        run: the run.
        joint: name of a joint with radial clearance.
        plane: name of the plane of the bearing's axes: "xy" (default), "xz" or "yz".
        since: time from which the path is drawn [s]; 0 by default.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such joint or plane, or the joint has no radial clearance.
    """
    check_run(run)
    check_name("plane of journal_orbit", plane, PLANES)
    check_number("since of journal_orbit", since, "s")
    history = run.contact(joint)
    gap: Any = run.mechanism.connections[joint].joint
    gap = getattr(gap, "gap", gap)
    if not {"x", "y"} <= set(getattr(gap, "ideal_rows", ())):
        raise ValueError(
            f'the joint "{joint}" is a {type(gap).__name__}, which has no radial clearance; take '
            "plot.phase_portrait."
        )
    factor, unit = readable([float(gap.clearance)], "m")
    clearance, mask = factor * float(gap.clearance), reached(run, since)
    path = factor * np.asarray(history.offset)[mask][:, PLANES[plane]]
    sheet = panels("journal_orbit", ax, size=(5.8, 5.0))
    axis, turn = sheet.one, np.linspace(0, 2 * np.pi, 400)
    axis.plot(clearance * np.cos(turn), clearance * np.sin(turn), "r-", lw=0.8,
              label="clearance")  # fmt: skip
    lines = over_time(axis, path[:, 0], path[:, 1], np.asarray(run.time)[mask])
    axis.set_aspect("equal")
    axis.set_xlim(-1.15 * clearance, 1.15 * clearance)
    axis.set_ylim(-1.15 * clearance, 1.15 * clearance)
    sheet.figure_of.colorbar(lines, ax=axis, label="time [s]")
    axis.set_xlabel(f"{plane[0]} of the centre [{unit}]")
    axis.set_ylabel(f"{plane[1]} of the centre [{unit}]")
    key(axis, loc="upper right")
    sheet.title(f"Orbit in {joint}{setting(run, joint)}")
    return warned(sheet, {"": run})


@answering
def hysteresis(run: Trajectory, joint: str, *, since: float = 0.0, ax: Any = None) -> Any:
    """Friction of a joint over its displacement and over its sliding speed.

    Of a joint that slides the force along z [N] is drawn, of one that turns the torque about z [N
    m], as they act on the child. The curves are coloured by time.

    Args:
        run: the run.
        joint: name of a joint with friction.
        since: time from which the curves are drawn [s]; 0 by default.
        ax: two `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such joint, it has no contacts or friction, or it slides in
            several directions.
    """
    check_run(run)
    check_number("since of hysteresis", since, "s")
    history, motion = run.contact(joint), relative_motion(run, joint)
    itself: Any = run.mechanism.connections[joint].joint
    gap = getattr(itself, "gap", itself)
    if rows_of(gap) == {"x", "y", "z"}:
        raise ValueError(
            f'the joint "{joint}" is a {type(gap).__name__}, which slides in more than one '
            "direction; its friction has no single displacement."
        )
    linear = slides(gap)
    unit, rub = ("m", "N") if linear else ("rad", "N m")
    travel = motion.offset[:, 2] if linear else motion.turn
    speed = motion.rate[:, 2] if linear else motion.spin
    friction = np.asarray(history.force if linear else history.torque)[:, 2]
    if gap is itself and joint not in run.mechanism.topology.clearances:
        friction = _of_ideal(itself, history, speed, linear)
    mask = reached(run, since)
    scale, rub = readable(friction[mask], rub)
    rubbed, time = scale * friction[mask], np.asarray(run.time)[mask]
    sheet = panels("hysteresis", ax, 1, 2, (9.5, 4.2), sharey=True)
    labels = ("displacement", "sliding speed") if linear else ("turn", "angular velocity")
    for axis, values, label, per in zip(
        sheet.axes.flat, (travel[mask], speed[mask]), labels, ("", "/s"), strict=True
    ):
        factor, label_unit = readable(values, unit)
        lines = over_time(axis, factor * values, rubbed, time)
        axis.axhline(0.0, color="0.7", lw=0.6, zorder=0)
        axis.set_xlabel(f"{label} in {joint} [{label_unit}{per}]")
    what = "force" if linear else "torque"
    sheet.one.set_ylabel(f"friction {what} on the child [{rub}]")
    sheet.figure_of.colorbar(lines, ax=sheet.axes.flat[-1], label="time [s]")
    sheet.title(f"Friction of {joint}")
    return warned(sheet, {"": run})


def _of_ideal(joint: Any, history: Any, speed: np.ndarray, slides: bool) -> np.ndarray:
    """Friction of an ideal joint that rubs, which is told without its sign: against the sliding;
    nan where the joint sticks and it may have either."""
    force, torque = joint.friction_wrench(np.asarray(history.traction).sum(axis=1))
    size = (force if slides else torque)[2]
    return np.where(speed == 0.0, np.nan, -np.sign(speed) * size)


# Free flight is the paper's white; an impact is drawn at least so wide, as a share of the chart.
COLOURS = {Mode.FREE_FLIGHT: "#e8edf2", Mode.IMPACT: "#c23b22", Mode.CONTACT: "#4a7fb0"}
LEAST_WIDTH = 1e-3
BAR = 0.8


@answering
def modes(run: Trajectory, *joints: str, ax: Any = None) -> Any:
    """Free flight, impact and contact over time, a strip for each joint.

    Impacts are drawn on top, with a width of at least a thousandth of the chart.

    Args:
        run: the run.
        joints: names of joints; all with clearance by default.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if there is no such joint with clearance.
    """
    check_run(run)
    names = joints or tuple(run.formulation.contact_joints(run.mechanism))
    colours = {mode.label: colour for mode, colour in COLOURS.items()}
    span = MILLI * float(run.time[-1] - run.time[0])
    sheet = panels("modes", ax, size=(9.0, 1.3 + 0.45 * len(names)))
    axes = sheet.one
    for row, name in enumerate(names):
        for label, phases in run.modes(name).groupby("mode"):
            start = MILLI * phases["from [s]"].to_numpy()
            width = MILLI * phases["to [s]"].to_numpy() - start
            thin = LEAST_WIDTH * span if label == Mode.IMPACT.label else 0.0
            axes.broken_barh(
                list(zip(start, width.clip(thin), strict=True)),
                (row - 0.5 * BAR, BAR),
                color=colours[label],
                zorder=3 if label == Mode.IMPACT.label else 2,
            )
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(MILLI * float(run.time[0]), MILLI * float(run.time[-1]))
    axes.set_xlabel("time [ms]")
    sheet.title("Modes of motion of the journals")
    patches = [Patch(color=colour) for colour in COLOURS.values()]
    sheet.legend(patches, [mode.label for mode in COLOURS])
    return warned(sheet, {"": run})


@answering
def pointing_budget(error: PointingError, *, ax: Any = None) -> Any:
    """Pointing and position error of a tip over time, with the contribution of each joint.

    The exact error is drawn with that of the first-order model; bars show the root mean squares,
    each with its share of the mean square.

    Args:
        error: a `PointingError`, as `jaxclear.pointing_error` returns it.
        ax: four `matplotlib.axes.Axes` to draw in, row by row (over time, bars); by default a new
            figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `error` is something else.
    """
    expect(error, PointingError, "the error", "what jaxclear.pointing_error returns")
    sheet = panels("pointing_budget", ax, 2, 2, (10.0, 6.4), width_ratios=(2.4, 1.0))
    axes = sheet.axes
    table = error.budget()
    quantities = (
        ("pointing", error.pointing_angle, turn, "rad"),
        ("position", error.position_error, shift, "m"),
    )
    for (along_time, bars), (what, exact, size, base_unit) in zip(axes, quantities, strict=True):
        factor, unit = readable(exact, base_unit)
        shades = dict(zip(error.names, (f"C{k}" for k in range(len(error.names))), strict=True))
        for name, shade in shades.items():
            values = factor * size(error.contributions[name])
            along_time.plot(
                error.time, values, color=shade, lw=0.9, alpha=0.85, label=f"{name} alone"
            )
        along_time.plot(error.time, factor * exact, color="0.55", lw=3.0, label="exact", zorder=2.5)
        along_time.plot(
            error.time, factor * size(error.model), "k--", lw=1.0, label="adjoint model", zorder=3
        )
        along_time.set_ylabel(f"{what} error [{unit}]")
        along_time.set_ylim(bottom=0)
        column = factor * table[f"rms {what} [{base_unit}]"]
        colours = [shades.get(name, "k" if name == "model" else "0.55") for name in table.index]
        bars.barh(range(len(table)), column, color=colours)
        for row, (value, share) in enumerate(
            zip(column, table[f"share of {what} [1]"], strict=True)
        ):
            text = "" if np.isnan(share) or row >= len(error.names) else f"{100 * share:.3g} %"
            bars.text(value, row, f" {text}", va="center", fontsize=8)
        bars.set_yticks(range(len(table)), table.index)
        bars.set_xlim(0.0, 1.25 * max(column.max(), np.finfo(float).tiny))
        bars.invert_yaxis()
        bars.set_xlabel(f"rms [{unit}]; %: share of its square")
    axes[1][0].set_xlabel("time [s]")
    sheet.legend()
    sheet.title(f'Error of the tip on "{error.tip}" seen from "{error.base}"')
    return sheet.done(as_warnings(error.warnings))
