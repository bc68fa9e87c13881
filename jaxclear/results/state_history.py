"""The states of a run at its saving times with all that is needed to read them, and how a function
of an instant is mapped over them.

Where a run begins: at the mechanism's own start or where another run stood, with surfaces new or
worn.
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.body import GROUND
from jaxclear.components.joint.base import drive_of
from jaxclear.formulations.base import AbstractFormulation, model_of
from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.arguments import check_count, check_flags, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import AbstractQuantified, Scalar
from jaxclear.ground.wording import unknown
from jaxclear.multibody import kinematics, state
from jaxclear.multibody.given import goes_backwards, rows_turned_round
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import Layout
from jaxclear.multibody.system import geared_motors
from jaxclear.multibody.topology import Redundancy, joint_of
from jaxclear.native import over_rows


class StateHistory(eqx.Module):
    """`time` [s] and the raw `states` (time, n) [m, rad, m/s ...]; `read`:
    worn surfaces as the gaps saw them up to each saving time; `mechanism` as the formulation sees
    it; `balanced`: energies are tracked.
    """

    mechanism: Mechanism
    formulation: AbstractFormulation
    time: Float[Array, " time"]
    states: Float[Array, "time n"]
    read: dict[str, dict[str, Any]]
    balanced: bool = eqx.field(static=True)

    def check_single(self) -> None:
        """Raises `ValueError` for the runs of a batch."""
        check_single(self.time)

    def model(self) -> Model:
        """The model that the states belong to, its surfaces new."""
        self.check_single()
        return model_of(self.mechanism, self.formulation, self.balanced)

    def layout(self) -> Layout:
        """Where everything sits in a state."""
        return self.model().layout

    def coordinate(self, name: str, speeds: bool) -> Float[Array, "time ..."]:
        """Coordinates or speeds of a connection (or floating body) of the tree, or of a drive: over
        time alone where it has a single one."""
        self.check_single()
        topology = self.mechanism.topology
        floating = [b.body for b in topology.branches if b.connection is None]
        known = [*self.mechanism.connections, *floating, *topology.motors]
        check_known(name, known, "joint or floating body")
        if name in dict(topology.geared):
            own = geared_motors(self.mechanism)[name]
            found = own.ratio * self.coordinate(own.joint, speeds)
            return found if speeds or own.offset is None else found + own.offset
        connection = self.mechanism.connections.get(name)
        drive = None if connection is None else drive_of(connection.joint)
        if drive is not None:
            motion = lambda time: jnp.asarray(drive.motion(time)[speeds], float)
            return jax.vmap(motion)(self.time)
        start = topology.coordinate_count
        branch = next((own for own in topology.branches if own.name == name), None)
        if branch is None or not branch.speed_count:
            raise ValueError(
                f'"{name}" carries no coordinates: it has clearance, closes a loop, or is welded.'
            )
        last = start + branch.speeds.stop
        found = (
            self.states[:, branch.coordinates],
            self.states[:, start + branch.speeds.start : last],
        )
        joint = joint_of(branch, self.mechanism.bodies, self.mechanism.connections)
        if goes_backwards(branch, joint):
            found = rows_turned_round(joint, *found)
        return single(found[speeds])

    def mean_forces(self, layout: Layout) -> Float[Array, "time components"]:
        """Impulses gained over each saving interval, divided by its length; at the start those of
        the first interval.
        """
        impulses = self.states[:, layout.impulse_start : layout.energy_start]
        means = jnp.diff(impulses, axis=0) / jnp.diff(self.time)[:, None]
        return jnp.concatenate([means[:1], means])


def check_single(along: Array) -> None:
    """Raises `ValueError` for what `jax.vmap` has made many of; `along`: an array over the times
    or positions of one."""
    if len(along.shape) > 1:
        count = along.shape[0]
        raise ValueError(
            f"this is a batch of {count} runs: take one of them, run[i] with i up to {count - 1}, "
            "or map what is read from it: jax.vmap(response)(run)."
        )


def one_of(batch: Any, along: Array, index: int) -> Any:
    """One of such a batch."""
    if len(along.shape) == 1:
        raise ValueError(
            "this is one run, not a batch of them; saved instants are rows of what is read from "
            "it, such as run.body(name).com[index]."
        )
    count = along.shape[0]
    check_count("index of a run", index, at_least=-count)
    if index >= count:
        raise IndexError(f"run {index} was asked for; the batch has {count}.")
    return jax.tree.map(lambda own: own[index] if eqx.is_array(own) else own, batch)


def single(values: Float[Array, "time k"]) -> Float[Array, "time ..."]:
    """Coordinates over time, without the axis of a single one: beside an array over time it would
    make a square of both."""
    return values[:, 0] if values.shape[1] == 1 else values


def check_known(name: str, names: Any, kind: str) -> None:
    """Raises `ValueError` where there is no such thing."""
    if not isinstance(name, str) or name not in names or name == GROUND:
        raise ValueError(unknown(kind, name, names, " in this mechanism"))


def over_time(history: StateHistory, function: Callable[[Instant], Any]) -> Any:
    """Maps a function of an `Instant` over the saved states; tuples of numbers become arrays with
    time first.
    """
    check_double_precision()
    model = history.model()
    system, layout = model.system, model.layout

    def one(time, entries, read, means):
        q, v = state.unpack_motion(system, entries)
        own = Model(system, read, model.stabilisation, layout, model.projects)
        now = own.seeing(read)
        motions = kinematics.link_motions(system, q, v, time)
        parts = [means[i] for i in range(len(means))]
        return sp.dense(function(Instant(now, motions, q, v, time, entries, parts)))

    columns = [history.states[:, i] for i in range(layout.size)]
    return over_rows(one, history.time, columns, history.read, history.mean_forces(layout))


def columns(value: Any) -> Any:
    """Nested tuples of columns (time,) as one array with time first."""
    if isinstance(value, tuple):
        return jnp.stack([columns(part) for part in value], axis=1)
    return value


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
