"""What happens in a joint: the path of a journal in its clearance, and its friction over the way
and the speed with which it slides.
"""

from typing import Any

import numpy as np

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_known, check_number
from jaxclear.plot.canvas import check_run, over_time, panels, readable, setting, warned
from jaxclear.plot.fitting import key
from jaxclear.plot.signal import reached
from jaxclear.results.relative_motion import relative_motion
from jaxclear.results.trajectory import Trajectory

__all__ = ["hysteresis", "journal_orbit"]

PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


@answering
def journal_orbit(
    run: Trajectory, joint: str, *, plane: str = "xy", since: float = 0.0, ax: Any = None
) -> Any:
    """Path of a journal's (or ball's) centre in its bearing, coloured by time, with the circle of
    the clearance. `plane` of the bearing's axes: "xy", "xz" or "yz"; `since` [s]: from when on.
    `ax`: axes to draw in. Of both ends of a journal that tilts: `plot.journal_ends`. Raises
    `ValueError` for a joint without radial clearance.
    """
    check_run(run)
    check_known("plane of journal_orbit", plane, PLANES)
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
    clearance, kept = factor * float(gap.clearance), reached(run, since)
    path = factor * np.asarray(history.offset)[kept][:, PLANES[plane]]
    sheet = panels("journal_orbit", ax, size=(5.8, 5.0))
    axis, turn = sheet.one, np.linspace(0, 2 * np.pi, 400)
    axis.plot(clearance * np.cos(turn), clearance * np.sin(turn), "r-", lw=0.8,
              label="clearance")  # fmt: skip
    lines = over_time(axis, path[:, 0], path[:, 1], np.asarray(run.time)[kept])
    axis.set_aspect("equal")
    axis.set_xlim(-1.15 * clearance, 1.15 * clearance)
    axis.set_ylim(-1.15 * clearance, 1.15 * clearance)
    sheet.whole.colorbar(lines, ax=axis, label="time [s]")
    axis.set_xlabel(f"{plane[0]} of the centre [{unit}]")
    axis.set_ylabel(f"{plane[1]} of the centre [{unit}]")
    key(axis, loc="upper right")
    sheet.title(f"Orbit in {joint}{setting(run, joint)}")
    return warned(sheet, {"": run})


@answering
def hysteresis(run: Trajectory, joint: str, *, since: float = 0.0, ax: Any = None) -> Any:
    """Friction of a joint over the displacement and over the speed with which it slides, coloured
    by time: of a joint that slides its force along z [N], of one that turns its torque about z
    [N m], as they act on the child. `since` [s]: from when on. `ax`: two axes to draw in. Raises
    `ValueError` for a joint that does not rub.
    """
    check_run(run)
    check_number("since of hysteresis", since, "s")
    history, motion = run.contact(joint), relative_motion(run, joint)
    own: Any = run.mechanism.connections[joint].joint
    gap = getattr(own, "gap", own)
    stated: Any = getattr(gap, "rows", None) or getattr(gap, "ideal_rows", ())
    rows = set(stated)
    if rows == {"x", "y", "z"}:
        raise ValueError(
            f'the joint "{joint}" is a {type(gap).__name__}, which slides in more than one '
            "direction; its friction has no single displacement."
        )
    slides = "z" not in rows and "x.z" in rows
    unit, rub = ("m", "N") if slides else ("rad", "N m")
    way = motion.offset[:, 2] if slides else motion.turn
    speed = motion.rate[:, 2] if slides else motion.spin
    friction = np.asarray(history.force if slides else history.torque)[:, 2]
    if gap is own and joint not in run.mechanism.topology.clearances:
        friction = _of_ideal(own, history, speed, slides)
    kept = reached(run, since)
    scale, rub = readable(friction[kept], rub)
    rubbed, time = scale * friction[kept], np.asarray(run.time)[kept]
    sheet = panels("hysteresis", ax, 1, 2, (9.5, 4.2), sharey=True)
    labels = ("displacement", "sliding speed") if slides else ("turn", "angular velocity")
    for axis, values, label, per in zip(
        sheet.axes.flat, (way[kept], speed[kept]), labels, ("", "/s"), strict=True
    ):
        factor, shown = readable(values, unit)
        lines = over_time(axis, factor * values, rubbed, time)
        axis.axhline(0.0, color="0.7", lw=0.6, zorder=0)
        axis.set_xlabel(f"{label} in {joint} [{shown}{per}]")
    what = "force" if slides else "torque"
    sheet.one.set_ylabel(f"friction {what} on the child [{rub}]")
    sheet.whole.colorbar(lines, ax=sheet.axes.flat[-1], label="time [s]")
    sheet.title(f"Friction of {joint}")
    return warned(sheet, {"": run})


def _of_ideal(joint: Any, history: Any, speed: np.ndarray, slides: bool) -> np.ndarray:
    """Friction of an ideal joint that rubs, which is told without its sign: against the sliding;
    nan where the joint sticks and it may have either."""
    force, torque = joint.friction_wrench(np.asarray(history.traction).sum(axis=1))
    size = (force if slides else torque)[2]
    return np.where(speed == 0.0, np.nan, -np.sign(speed) * size)
