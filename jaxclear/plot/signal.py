"""A number of a run over time with its rate, by name: what phase portraits, sections, spectra and
bifurcations are drawn of.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.arguments import check_known
from jaxclear.plot.canvas import check_run, readable
from jaxclear.results.relative_motion import relative_motion
from jaxclear.results.trajectory import Trajectory

__all__ = ["Signal", "signal"]

AXES, TURN, FORCE = ("x", "y", "z"), "turn", "force"


class Signal(NamedTuple):
    """`values` over `time` [s] in `unit`, their `rates` [unit/s] (None where there are none), and
    how they are called."""

    time: np.ndarray
    values: np.ndarray
    rates: np.ndarray | None
    unit: str
    label: str
    rate_label: str

    def shown(self) -> tuple[np.ndarray, str]:
        """Values in a readable unit, and the axis label with it."""
        factor, unit = readable(self.values, self.unit)
        return factor * self.values, f"{self.label} [{unit}]"

    def rates_shown(self) -> tuple[np.ndarray, str]:
        """Likewise of the rates. Raises `ValueError` where there are none."""
        if self.rates is None:
            raise ValueError(f"the {self.label} has no rate; name a place or a turn instead.")
        factor, unit = readable(self.rates, self.unit)
        return factor * self.rates, f"{self.rate_label} [{unit}/s]"


def signal(run: Trajectory, of: str, axis: str | None = None) -> Signal:
    """A number of a body or a joint. Of a body: the place "x", "y" or "z" of its centre of mass, or
    its "turn" about the z axis, in the ground frame. Of a joint: the place or the turn of the
    child's marker in the axes of the parent's, or, of one with contacts, the normal "force" of all
    of them. By default the place of a body or of a journal in its clearance, the coordinate of a
    joint without. Raises `ValueError`.
    """
    check_run(run)
    mechanism = run.mechanism
    check_known("body or joint", of, [*mechanism.bodies, *mechanism.connections],
                " in this mechanism")  # fmt: skip
    time = np.asarray(run.time)
    if of in mechanism.bodies:
        axis = "x" if axis is None else axis
        check_known("axis", axis, (*AXES, TURN), f' of body "{of}"')
        motion = run.body(of)
        if axis == TURN:
            turn = np.asarray(motion.rotation)
            angle = np.unwrap(np.arctan2(turn[:, 1, 0], turn[:, 0, 0]))
            return Signal(time, angle, np.asarray(motion.spin)[:, 2], "rad", f"turn of {of}",
                          f"angular velocity of {of}")  # fmt: skip
        at = AXES.index(axis)
        values, rates = np.asarray(motion.com)[:, at], np.asarray(motion.velocity)[:, at]
        return Signal(time, values, rates, "m", f"{axis} of {of}", f"velocity {axis} of {of}")
    return _of_joint(run, of, _usual(run, of) if axis is None else axis)


def _usual(run: Trajectory, of: str) -> str:
    joint: Any = run.mechanism.connections[of].joint
    if of in run.mechanism.topology.clearances:
        return "x"
    return TURN if "z" in getattr(joint, "rows", ()) else "z"


def _of_joint(run: Trajectory, of: str, axis: str) -> Signal:
    touching = of in run.formulation.contact_joints(run.mechanism)
    known = (*AXES, TURN, *([FORCE] if touching else []))
    check_known("axis", axis, known, f' of joint "{of}"')
    time = np.asarray(run.time)
    if axis == FORCE:
        force = np.asarray(run.contact(of).normal_force).sum(axis=1)
        return Signal(time, force, None, "N", f"normal force in {of}", "")
    motion = relative_motion(run, of)
    if axis == TURN:
        return Signal(time, motion.turn, motion.spin, "rad", f"turn in {of}",
                      f"angular velocity in {of}")  # fmt: skip
    at = AXES.index(axis)
    return Signal(time, motion.offset[:, at], motion.rate[:, at], "m", f"{axis} in {of}",
                  f"velocity {axis} in {of}")  # fmt: skip


def reached(run: Trajectory, since: float) -> np.ndarray:
    """Which saving times a run reached, from `since` [s] on."""
    time = np.asarray(run.time)
    return (time >= since) & (time <= float(run.ended) * (1 + 1e-12))
