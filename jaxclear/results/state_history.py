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
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.body import GROUND
from jaxclear.components.joint.base import drive_of
from jaxclear.formulations.base import AbstractFormulation, model_of
from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.arguments import check_count, check_flags, expect
from jaxclear.ground.module import AbstractModule
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import AbstractQuantified, Scalar
from jaxclear.ground.wording import unknown
from jaxclear.multibody import kinematics, state
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.start_constraints import is_reversed, reversed_rows
from jaxclear.multibody.state import Layout
from jaxclear.multibody.system import geared_motors
from jaxclear.multibody.topology import Redundancy, joint_of
from jaxclear.native import over_rows


class StateHistory(AbstractModule):
    """The saved states of a run, with what is needed to read them.

    Args:
        mechanism: the mechanism as the formulation treats it.
        formulation: how contact enters the equations of motion.
        time: saving times [s], shape (time,).
        states: raw states [m, rad, m/s, ...], shape (time, n).
        read: worn surfaces as the gaps used them up to each saving time, by joint.
        balanced: whether energies are tracked.
    """

    mechanism: Mechanism
    formulation: AbstractFormulation
    time: Float[Array, " time"]
    states: Float[Array, "time n"]
    read: dict[str, dict[str, Any]]
    balanced: bool = eqx.field(static=True)

    def check_single(self) -> None:
        """Refuse a batch of runs.

        Raises:
            ValueError: if there are several runs.
        """
        check_single(self.time)

    def model(self) -> Model:
        """The model that the states belong to, with new surfaces."""
        self.check_single()
        return model_of(self.mechanism, self.formulation, self.balanced)

    def layout(self) -> Layout:
        """The positions of all quantities in a state."""
        return self.model().layout

    def coordinate(self, name: str, speeds: bool) -> Float[Array, "time ..."]:
        """Coordinates or speeds over time.

        Args:
            name: name of a connection of the tree, floating body, driven joint or motor.
            speeds: True for speeds [rad/s, m/s], False for coordinates [rad, m].

        Returns:
            Shape (time,) for a single coordinate, else (time, coordinates).

        Raises:
            ValueError: if there is no such connection or it has no coordinates.
        """
        self.check_single()
        topology = self.mechanism.topology
        floating = [b.body for b in topology.branches if b.connection is None]
        names = [*self.mechanism.connections, *floating, *topology.motors]
        check_name(name, names, "joint or floating body")
        if name in dict(topology.geared):
            x = geared_motors(self.mechanism)[name]
            values = x.ratio * self.coordinate(x.joint, speeds)
            return values if speeds or x.offset is None else values + x.offset
        connection = self.mechanism.connections.get(name)
        drive = None if connection is None else drive_of(connection.joint)
        if drive is not None:
            motion = lambda time: jnp.asarray(drive.motion(time)[speeds], float)
            return jax.vmap(motion)(self.time)
        start = topology.coordinate_count
        branch = next((x for x in topology.branches if x.name == name), None)
        if branch is None or not branch.speed_count:
            raise ValueError(
                f'"{name}" carries no coordinates: it has clearance, closes a loop, or is welded.'
            )
        last = start + branch.speeds.stop
        values = (
            self.states[:, branch.coordinates],
            self.states[:, start + branch.speeds.start : last],
        )
        joint = joint_of(branch, self.mechanism.bodies, self.mechanism.connections)
        if is_reversed(branch, joint):
            values = reversed_rows(joint, *values)
        return single(values[speeds])

    def mean_forces(self, layout: Layout) -> Float[Array, "time components"]:
        """Mean forces over the saving intervals, at the end of each [N, N m].

        Args:
            layout: the positions of all quantities in a state.

        Returns:
            Shape (time, components); the first row is that of the first interval.
        """
        impulses = self.states[:, layout.impulse_start : layout.energy_start]
        means = jnp.diff(impulses, axis=0) / jnp.diff(self.time)[:, None]
        return jnp.concatenate([means[:1], means])


def check_single(along: Array) -> None:
    """Refuse what `jax.vmap` has made a batch of.

    Args:
        along: an array over the times or positions of one run.

    Raises:
        ValueError: if the array has more than one axis.
    """
    if len(along.shape) > 1:
        count = along.shape[0]
        raise ValueError(
            f"this is a batch of {count} runs: take one of them, run[i] with i up to {count - 1}, "
            "or map what is read from it: jax.vmap(response)(run)."
        )


def take_one(batch: Any, along: Array, index: int) -> Any:
    """One run, or one set of positions, of a batch.

    Args:
        batch: the batch, a pytree of arrays with the batch first.
        along: an array of the batch over times or positions.
        index: number of the run; negative numbers count from the end.

    Returns:
        The run, of the same type as the batch.

    Raises:
        ValueError: if it is no batch.
        IndexError: if the batch has fewer runs.
    """
    if len(along.shape) == 1:
        raise ValueError(
            "this is one run, not a batch of them; saved instants are rows of what is read from "
            "it, such as run.body(name).com[index]."
        )
    count = along.shape[0]
    check_count("index of a run", index, at_least=-count)
    if index >= count:
        raise IndexError(f"run {index} was asked for; the batch has {count}.")
    return jax.tree.map(lambda leaf: leaf[index] if eqx.is_array(leaf) else leaf, batch)


def single(values: Float[Array, "time k"]) -> Float[Array, "time ..."]:
    """Coordinates without the axis of a single one.

    Args:
        values: coordinates over time, shape (time, k).

    Returns:
        Shape (time,) for k = 1, else `values`.
    """
    return values[:, 0] if values.shape[1] == 1 else values


def check_name(name: str, names: Any, kind: str) -> None:
    """Refuse a name that does not exist in the mechanism.

    Args:
        name: the name.
        names: the names that exist.
        kind: kind of thing, for the message, such as "joint".

    Raises:
        ValueError: if the name is not among them.
    """
    if not isinstance(name, str) or name not in names or name == GROUND:
        raise ValueError(unknown(kind, name, names, " in this mechanism"))


def over_time(history: StateHistory, function: Callable[[Instant], Any]) -> Any:
    """Map a function of an instant over the saved states.

    Args:
        history: the saved states.
        function: takes an `Instant` and returns numbers, or nested tuples or dictionaries of
            numbers.

    Returns:
        What the function returns, as arrays with time first.
    """
    check_double_precision()
    model = history.model()
    system, layout = model.system, model.layout

    def one(time, entries, read, means):
        q, v = state.unpack_motion(system, entries)
        fresh = Model(system, read, model.stabilisation, layout, model.projects)
        now = fresh.seeing(read)
        motions = kinematics.link_motions(system, q, v, time)
        parts = [means[i] for i in range(len(means))]
        return sp.dense(function(Instant(now, motions, q, v, time, entries, parts)))

    columns = [history.states[:, i] for i in range(layout.size)]
    return over_rows(one, history.time, columns, history.read, history.mean_forces(layout))


def columns(value: Any) -> Any:
    """Nested tuples of columns as one array.

    Args:
        value: an array (time,), or nested tuples of such.

    Returns:
        An array with time first.
    """
    if isinstance(value, tuple):
        return jnp.stack([columns(part) for part in value], axis=1)
    return value


class SavedMotion(eqx.Module):
    """Coordinates and speeds of a mechanism at a time.

    Args:
        time: the time [s], shape ().
        coordinates: coordinates of the tree [m, rad, 1], shape (q,).
        speeds: speeds of the tree [m/s, rad/s], shape (v,).
        remembered: further states of the laws, shape (m,): impact speeds [m/s], deflections of
            bristles [m], angles that count turns [rad].
        names: names of the coordinates and speeds.
        remembered_names: names of the entries of `remembered`.
        redundancy: dependent rows of the loops as the run found them; None without.
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
    """A state at which a run begins.

    `run.state()` is a state of another run: a new run continues from there, at its time, with its
    speeds, the memory of its laws and its worn surfaces. Where lengths have changed since, it
    begins at the nearest state that closes the loops. `jaxclear.resting_state` returns a state in
    which journals rest in their bearings.

    Args:
        worn: worn depths [m] by joint and surface, such as `run.worn`; surfaces that are not named
            are new (all by default).
        concentric: for a start of the mechanism itself: True (default) puts journals in the middle
            of their bearings, moving with them, as far as `start` and `speeds` of the mechanism
            allow; False closes ideal loops only.
        motion: a `SavedMotion` of a run; None (default) for the mechanism's own start.

    Raises:
        ValueError: if an argument is of another kind.
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
            worn = {joint: _check_surfaces(joint, depths) for joint, depths in worn.items()}
        if motion is not None:
            expect(motion, SavedMotion, "motion of a State", "that of a run, run.state().motion")
        self.worn, self.concentric, self.motion = worn, concentric, motion

    @property
    def start_time(self) -> Scalar:
        """Time at which a run from this state begins [s]."""
        return 0.0 if self.motion is None else self.motion.time

    def _summary(self):
        if self.motion is not None:
            many, when = len(self.motion.coordinates), float(self.motion.time)
            where = f"State of a motion of {many} coordinates, at {when:.6g} s"
        else:
            where = "State: the mechanism's own start, "
            where += "journals in the middle" if self.concentric else "only ideal loops closed"
        deepest = [
            f"{surface} of {joint} worn by {float(jnp.max(depths)):.6g} m at the most"
            for joint, depths_of in (self.worn or {}).items()
            for surface, depths in depths_of.items()
        ]
        return f"{'; '.join([where, *deepest])}."


def _check_surfaces(joint: Any, depths: Any) -> Mapping:
    expect(depths, Mapping, f'worn["{joint}"] of a State', "a dictionary of depths by surface")
    copy = lambda each: each.copy() if isinstance(each, np.ndarray) else each
    return {surface: copy(each) for surface, each in depths.items()}
