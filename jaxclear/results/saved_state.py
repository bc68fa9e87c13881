"""Where a run begins: at the mechanism's own start or where another run stood, with surfaces new or
worn."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_flags, expect
from jaxclear.ground.quantity import AbstractQuantified, Scalar
from jaxclear.multibody.topology import Redundancy

__all__ = ["SavedMotion", "State"]


class SavedMotion(eqx.Module):
    """How a mechanism stands and moves at a `time` [s]: `coordinates` and `speeds` of its tree [m,
    rad, 1, m/s, rad/s], and what is `remembered` beside them (impact speeds [m/s], deflections of
    bristles [m], angles with their turns [rad]); `names` and `remembered_names` name their entries.
    `redundancy`: of the loops' rows, as the run knew it.
    """

    time: Float[Array, ""]
    coordinates: Float[Array, " q"]
    speeds: Float[Array, " v"]
    remembered: Float[Array, " m"]
    names: tuple[str, ...] = eqx.field(static=True)
    remembered_names: tuple[str, ...] = eqx.field(static=True)
    redundancy: Redundancy | None = eqx.field(static=True, default=None)

    @property
    def moving(self) -> tuple[Array, Array, Array]:
        """Coordinates, speeds, time."""
        return self.coordinates, self.speeds, self.time


class State(AbstractQuantified):
    """Where a run begins. `run.state()` is where another one stood: from there a run goes on, at
    its time, as it moved, with what its laws remember and its worn surfaces; where lengths have
    changed, from the nearest place that closes the loops.

    `worn`: depths [m] by joint and surface, such as `run.worn`; new surfaces by default, and where
    nothing is given. `concentric`: at the mechanism's own start journals lie in the middle of their
    bearings and move with them, as far as `start` and `speeds` of the mechanism let them; False
    closes ideal loops only. `jaxclear.seated` gives a state in which they lie where reactions press
    them. `motion`: as a run has saved it; None for the mechanism's own start.
    """

    worn: dict[str, dict[str, Array]] | None = None
    concentric: bool = eqx.field(static=True, default=True)
    motion: SavedMotion | None = None

    def __init__(
        self, worn: Any = None, *, concentric: bool = True, motion: SavedMotion | None = None
    ):
        check_flags("State", concentric=concentric)
        if worn is not None:
            expect(worn, Mapping, "worn of a State", "a dictionary by joint, such as run.worn")
            worn = {joint: dict(_surfaces(joint, own)) for joint, own in worn.items()}
        if motion is not None:
            expect(motion, SavedMotion, "motion of a State", "that of a run, run.state().motion")
        self.worn, self.concentric, self.motion = worn, concentric, motion

    @property
    def begins(self) -> Scalar:
        """Time [s] at which a run from it begins."""
        return 0.0 if self.motion is None else self.motion.time

    def _shown(self):
        if self.motion is not None:
            many, when = len(self.motion.coordinates), float(self.motion.time)
            where = f"State of a motion of {many} coordinates, at {when:.6g} s"
        else:
            where = "State: the mechanism's own start, "
            where += "journals in the middle" if self.concentric else "only ideal loops closed"
        deepest = [
            f"{surface} of {joint} worn by {float(jnp.max(depths)):.6g} m at the most"
            for joint, own in (self.worn or {}).items()
            for surface, depths in own.items()
        ]
        return f"{'; '.join([where, *deepest])}."


def _surfaces(joint: Any, depths: Any) -> Mapping:
    expect(depths, Mapping, f'worn["{joint}"] of a State', "a dictionary of depths by surface")
    return depths
