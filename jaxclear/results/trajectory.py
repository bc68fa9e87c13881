"""What a simulation returns: states over time, and by name everything that follows from them.

Poses, contacts, reactions and energies are computed from the saved states when asked for, so a run
pays for none of them. The methods here are fronts of the functions that do it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.body import Marker
from jaxclear.formulations.base import AbstractFormulation
from jaxclear.ground.arguments import check_count, check_flags, check_name, expect
from jaxclear.ground.datasets import write_csv
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.quantity import constant, is_traced, on_host, on_numbers
from jaxclear.ground.table import as_table
from jaxclear.integrators.checks import Checks, Outcome
from jaxclear.integrators.events import Events
from jaxclear.multibody import state
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.transmissions import between_worn_flanks
from jaxclear.native import explain
from jaxclear.results import beams, export, histories, modes, transmissions
from jaxclear.results.histories import (
    BodyHistory,
    ContactHistory,
    EnergyHistory,
    MarkerHistory,
    ReactionHistory,
)
from jaxclear.results.singular_position import SingularPosition, sentences_of
from jaxclear.results.state_history import SavedMotion, State, StateHistory, take_one
from jaxclear.results.transmissions import CouplingHistory
from jaxclear.results.verification import AbstractVerification, Estimate, Unverified, checked


class RunStats(AbstractShown):
    """The number of steps of a run.

    Args:
        accepted_steps: steps taken, shape ().
        rejected_steps: steps tried and repeated with another length, shape ().
        verdict: a code for how the time loops were executed, shape (); `loops` says it in words.
    """

    accepted_steps: Int[Array, ""]
    rejected_steps: Int[Array, ""]
    verdict: Int[Array, ""]

    def _summary(self):
        if is_traced(self) or np.ndim(self.verdict):
            return "what traced runs, or several, took"
        taken, tried = int(self.accepted_steps), int(self.rejected_steps)
        return f"{taken} steps, {tried} more taken back. {self.loops}"

    @property
    def loops(self) -> str:
        """Whether the time loops ran as machine code, or the reason why not."""
        return explain(np.max(self.verdict))


class Extremes(AbstractShown):
    """Largest indentations and forces in all steps of a run, independent of the saving times.

    Args:
        indentation: largest indentation of each possible contact [m], shape (contacts,); for flanks
            of a coupling that turns an angle [rad].
        force: largest normal force of each contact [N], shape (contacts,), for such flanks a torque
            [N m]; None where no contact has damping, so that it follows from the indentation.
        contacts: the joint, or coupling with play, of each contact.
        turn: whether each contact is a flank that turns.
        transmitted: largest torque [N m] or force [N] of each coupling whose force follows from the
            state, shape (couplings,); None where there is none.
        couplings: their names.
    """

    indentation: Float[Array, "*batch contacts"]
    force: Float[Array, "*batch contacts"] | None
    contacts: tuple[str, ...] = eqx.field(static=True)
    turn: tuple[bool, ...] = eqx.field(static=True, default=())
    transmitted: Any = None
    couplings: tuple[str, ...] = eqx.field(static=True, default=())

    def _summary(self):
        if is_traced(self) or np.ndim(self.indentation) != 1:
            return "the largest of traced runs, or of several"
        tables: list[Any] = []
        columns = {"contact in": self.contacts, "indentation": np.asarray(self.indentation)}
        columns |= {} if self.force is None else {"normal force": np.asarray(self.force)}
        units = None if any(self.turn) else {"indentation": "m", "normal force": "N"}
        if any(self.turn):
            columns["unit"] = ["rad, N m" if turn else "m, N" for turn in self.turn]
        if self.contacts:
            tables.append(as_table(columns, units=units))
        if self.couplings:
            sent = np.asarray(self.transmitted)
            columns = {"coupling": self.couplings, "transmitted": sent}
            tables.append(as_table(columns, units={"transmitted": "N m, N"}))
        return tuple(tables)


_POINT = "run.path(marker), run.body(name).com or run.coordinate(joint)"
# What is meant by names that a run does not have.
MEANT = {
    **dict.fromkeys(("plot", "show"), "from jaxclear import plot; plot.result(run)"),
    **dict.fromkeys(("animate", "animation"), "from jaxclear import plot; plot.animate(run)"),
    **dict.fromkeys(("position", "positions"), _POINT),
    **dict.fromkeys(("velocity", "speeds"), "run.body(name).velocity or run.speed(joint)"),
    **dict.fromkeys(("force", "forces"), "run.contact(joint) or run.reaction(joint)"),
    **dict.fromkeys(("energy", "energies"), "run.energy_balance()"),
    **dict.fromkeys(("save", "to_pandas"), "run.to_csv(path) or run.to_dataset()"),
}


class Trajectory(AbstractShown):
    """A simulated run: its saved states and everything that is read from them.

    `print` shows how the run ended and its answers with their numerical errors. Methods compute
    bodies, contacts, reactions and energies from the saved states on demand.

    Args:
        history: the saved states.
        worn: worn depths [m] at the end, by joint and surface, shape (around, along).
        outcome: how the run ended, an `Outcome`, shape ().
        ended: time at which it ended [s], shape ().
        stats: number of steps.
        invariants: checks of the run that finer steps would not reveal.
        extremes: largest indentations and forces of all steps; None where the integrator records
            none.
        noted: touches and releases, where `save=Saving(events=...)` records them; else None.
        verification: numerical errors of the run.
        assembly_warnings: warnings about the assembly of the mechanism.
        singular_positions: positions at which the drives do not determine the motion.
    """

    history: StateHistory
    worn: dict[str, dict[str, Array]]
    outcome: Int[Array, ""]
    ended: Float[Array, ""]
    stats: RunStats
    invariants: Checks = eqx.field(default_factory=Checks)
    extremes: Extremes | None = None
    noted: Events | None = None
    verification: AbstractVerification = eqx.field(default_factory=Unverified)
    assembly_warnings: tuple[str, ...] = eqx.field(static=True, default=())
    singular_positions: tuple[SingularPosition, ...] = ()

    def __getitem__(self, index: int) -> "Trajectory":
        """One run of a batch that `jax.vmap` has made.

        Args:
            index: number of the run; negative numbers count from the end.

        Returns:
            The run.

        Raises:
            ValueError: if this is one run.
            IndexError: if the batch has fewer runs.
        """
        return take_one(self, self.time, index)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            text = f": write {MEANT[name]}" if name in MEANT else ""
            raise AttributeError(f"a run has no {name!r}{text}.", name=name, obj=self)

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism as the formulation treats it."""
        return self.history.mechanism

    @property
    def formulation(self) -> AbstractFormulation:
        """How contact enters the equations of motion."""
        return self.history.formulation

    @property
    def time(self) -> Float[Array, " time"]:
        """Saving times [s], shape (time,)."""
        return self.history.time

    @property
    def states(self) -> Float[Array, "time n"]:
        """Raw states at the saving times, shape (time, n); `state_names()` names the columns."""
        return self.history.states

    @property
    def accepted_steps(self) -> Int[Array, ""]:
        """Number of steps taken."""
        return self.stats.accepted_steps

    @property
    def rejected_steps(self) -> Int[Array, ""]:
        """Number of steps tried and repeated with another length."""
        return self.stats.rejected_steps

    @property
    def succeeded(self) -> Any:
        """Whether the run reached its end."""
        return on_host(self.outcome) == Outcome.REACHED

    @property
    @on_numbers
    def result(self) -> str:
        """Whether the run reached its end, or when and why it did not; then its warnings."""
        self.history.check_single()
        run = constant(self)
        sentence = Outcome(int(run.outcome)).sentence
        if not run.succeeded:
            ending = f"The run ended early, after {float(run.ended):.6g} s. {sentence}"
            if run.outcome == Outcome.SINGULAR_POSITION:
                return " ".join([ending, *sentences_of(run.singular_positions)])
            why = run.invariants.before_the_end if run.outcome == Outcome.NOT_FINITE else ()
            return " ".join([ending, *why])
        if not run.warnings:
            return sentence
        return f"{sentence.removesuffix('.')}, with warnings: {' '.join(run.warnings)}"

    @property
    @on_numbers
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the run, a sentence each; empty for a run without.

        They are about the assembly, invariants beyond their limits, numerical errors beyond the
        tolerance of the integrator, and singular positions that the run left in another direction
        than inertia requires. A run that ended early gives those about unbounded numbers only where
        there are no others.
        """
        self.history.check_single()
        if self.succeeded:
            odd = sentences_of(tuple(one for one in self.singular_positions if not one.is_passed))
            return (
                self.assembly_warnings + self.invariants.warnings + odd + self.verification.warnings
            )
        return self.assembly_warnings + (self.invariants.before_the_end or self.invariants.warnings)

    @property
    @on_numbers
    def notes(self) -> tuple[str, ...]:
        """Remarks about the run, a sentence each, that leave its numbers right.

        They are about loops with more constraints than needed, singular positions that the run
        passed as inertia requires, and from when on a path in gaps is chaotic.
        """
        self.history.check_single()
        topology = self.mechanism.topology
        remarks = [f"The loops are {topology.redundancy}"] if topology.overconstrained else []
        if self.succeeded:
            remarks += sentences_of(tuple(one for one in self.singular_positions if one.is_passed))
        return *remarks, *self.verification.notes

    def estimate(self, response: Callable[["Trajectory"], Any]) -> Estimate:
        """The value of a response with its numerical error.

        The error is twice the difference from companion runs with half the step (tolerances 16
        times tighter, surfaces updated twice as often). Without companion runs (replicas) it is
        nan, and the estimate gives the reason. A function of a run reads the saved instants, which
        are the same in companion runs: a largest value between them is that of a response
        (`response.PeakTransmitted`, `PeakContactForce`), not of a maximum over the run's arrays.

        Args:
            response: an `AbstractResponse`, or any function of a run that returns numbers.

        Returns:
            The `Estimate`.

        Raises:
            ValueError: if the response is no function.

        Source: Richardson 1911, doi:10.1098/rsta.1911.0009; Roache 1994, J. Fluids Eng. 116, 405.
        """
        return self.verification.estimate(self, checked(response)).of(response, self.mechanism)

    def _summary(self):
        if is_traced(self.outcome):
            return repr(self)
        if np.ndim(self.outcome):
            many, ended = np.size(self.outcome), int(np.sum(self.succeeded))
            return f"A batch of {many} runs, of which {ended} reached their end; run[i] is one."
        steps = f"{int(self.accepted_steps)} steps, {len(self.time)} saved instants"
        lines = [self.result, f"{float(constant(self.ended)):.6g} s in {steps}."]
        return *lines, *self.verification._parts(), *self.notes

    def state_names(self) -> list[str]:
        """Names of the columns of `states`.

        Returns:
            A list of names.
        """
        model = self.history.model()
        return state.names(model.system, model.layout)

    def state(self, index: int = -1) -> State:
        """The state at a saving time, from which another run can begin.

        Use it as `simulate(..., state=run.state())`.

        Args:
            index: number of the saving time; the last (-1) by default.

        Returns:
            The `State`.

        Raises:
            ValueError: if there is no such saving time, if the run ended before it, or if surfaces
                wear and it is not the last: depths are saved at the end only.
        """
        self.history.check_single()
        count = len(self.time)
        check_count("index of a saving time", index, at_least=-count)
        if index >= count:
            raise ValueError(f"saving time {index} was asked for; the run has {count}.")
        if self.worn and index % count != count - 1:
            raise ValueError(
                f"saving time {index} was asked for; worn depths are known at the end of a run "
                "only, so simulate up to there."
            )
        if not is_traced((self.ended, self.time)) and self.time[index] > self.ended:
            raise ValueError(
                f"the run ended at {float(self.ended):.6g} s, before the saving time at "
                f"{float(self.time[index]):.6g} s."
            )
        model = self.history.model()
        names = state.names(model.system, model.layout)
        # Surfaces have worn by what was lost until then, and shafts lie on flanks.
        read = jax.tree.map(lambda rows: rows[index], self.history.read)
        layout, worn = model.layout, (read, self.worn)
        row = between_worn_flanks(model.system, layout, worn, self.states[index])
        first, middle, memory = layout.coordinates, layout.memory_start, layout.remembered
        parts = row[:first], row[first:middle], row[memory]
        labels = tuple(names[:middle]), tuple(names[memory]), self.mechanism.topology.redundancy
        motion = SavedMotion(self.time[index], *parts, *labels)
        return State(self.worn or None, motion=motion)

    def body(self, name: str) -> BodyHistory:
        """Motion of a body.

        Args:
            name: name of the body.

        Returns:
            A `BodyHistory`: positions, rotations and velocities over time.

        Raises:
            ValueError: if there is no such body.
        """
        return histories.body(self.history, name)

    def marker(self, body: str | Marker, at: Any = None) -> MarkerHistory:
        """Motion of a point of a body.

        Args:
            body: name of the body, or a `Marker`.
            at: position of the point in the body frame [m], 2 or 3 numbers; not beside a `Marker`.

        Returns:
            A `MarkerHistory`: position, velocity, acceleration, and the reading of an
            accelerometer.

        Raises:
            ValueError: if there is no such body, or `at` is given beside a `Marker`.
        """
        return histories.marker(self.body, self.mechanism, body, at)

    @on_numbers
    def path(self, marker: Marker | str) -> Any:
        """Path of a point of a body in the ground frame.

        `np.asarray(run.path(marker))` are its positions, shape (time, 3), and
        `run.path(marker).to_csv(file)` writes them. Inside a derivative take
        `run.marker(marker).position`.

        Args:
            marker: a `Marker`, or the name of a body, whose centre of mass it then is.

        Returns:
            A pandas table, its index the time [s], its columns x [m], y [m] and z [m].

        Raises:
            ValueError: if there is no such body, or numbers are being traced.
        """
        expect(marker, (Marker, str), "the point of a path", "a jaxclear.Marker or a body's name")
        named = isinstance(marker, str)
        position = self.body(str(marker)).com if named else self.marker(marker).position
        columns = {"time [s]": np.asarray(self.time)}
        for axis, values in zip("xyz", np.asarray(position).T, strict=True):
            columns[f"{axis} [m]"] = values
        return as_table(columns, index="time [s]")

    def deflection(
        self, name: str, relative_to: Literal["chord", "start"] = "chord"
    ) -> Float[Array, "time place 3"]:
        """How far the axis of a `Beam` lies from a straight line.

        Args:
            name: name of the beam.
            relative_to: word for the line: through both ends ("chord", the default), or along
                which the beam starts ("start").

        Returns:
            [m], in axes along and across that line, by saving time, place along the beam
            (`run.mechanism.bodies[name].ends()` [m]), and axis; along the line what is undeformed
            is taken off.

        Raises:
            ValueError: for a name that is no beam's.
        """
        return beams.beam_deflection(self, name, relative_to)

    def stress(self, name: str) -> Float[Array, "time element"]:
        """Largest normal stress in the outer fibre of a `Beam`, by bending and stretching.

        Args:
            name: name of the beam.

        Returns:
            Its size [Pa], by saving time and element, in the middle of each.

        Raises:
            ValueError: for a name that is no beam's, or a section without a shape.
        """
        return beams.beam_stress(self, name)

    def contact(self, name: str) -> ContactHistory:
        """Forces and gaps of a clearance joint.

        Where forces are no functions of the state (rigid contact, joints that always touch) they
        are means over the saving intervals, at the start over the first interval. A joint that
        always touches has the offset that its reaction causes.

        Args:
            name: name of the joint.

        Returns:
            A `ContactHistory`.

        Raises:
            ValueError: if there is no such clearance joint.
        """
        return histories.contact(self.history, name)

    def contact_impulse(self, name: str) -> Float[Array, " time"]:
        """Impulse of a joint's normal forces since the start, summed over its contacts.

        The steps of the run add it up, so impacts between saving times are included.

        Args:
            name: name of the joint.

        Returns:
            Impulse [N s], shape (time,).

        Raises:
            ValueError: if there is no such clearance joint.
        """
        return histories.contact_impulse(self.history, name)

    @on_numbers
    def modes(self, name: str) -> Any:
        """Free flight, impact and contact of a clearance joint over time.

        `results.modes` defines when an impact becomes contact. With `save=Saving(events=...)`
        instants of touches and releases are located within the steps; without, between the saving
        times (`.attrs["instants"]` says which), which must then lie a few in each contact. Where
        forces are means over the saving intervals (MoreauJean) instants are known to an interval.

        Args:
            name: name of the joint.

        Returns:
            A pandas table with a row for each phase: from [s], to [s], mode, approach speed [m/s]
            of an impact, source of the start.

        Raises:
            ValueError: if there is no such clearance joint, or numbers are being traced.
        """
        return modes.table(self.history, name, self.noted)

    @on_numbers
    def events(self, *names: str) -> Any:
        """Touches and releases in the order of time, located within the steps.

        Needs `save=Saving(events=...)`. Warns where a contact had more events between two saving
        times than that.

        Args:
            names: names of joints with clearance, or of couplings with play; all by default.

        Returns:
            A pandas table: time [s], joint, contact, event, speed [m/s] (of flanks that turn
            [rad/s]).

        Raises:
            ValueError: if the run recorded no events, there is no such joint, or numbers are being
                traced.
        """
        return modes.event_table(self.history, self.noted, names)

    @on_numbers
    def combined_modes(self, *names: str) -> Any:
        """The modes of several joints side by side.

        Args:
            names: names of joints with clearance; all by default.

        Returns:
            A pandas table with a row whenever one of them changes: from [s], to [s], a column of
            modes for each joint.

        Raises:
            ValueError: if there is no such clearance joint, or numbers are being traced.
        """
        joints = self.formulation.contact_joints(self.mechanism)
        return modes.combined(self.history, names or joints, self.noted)

    def situations(self, name: str) -> Int[Array, " time"]:
        """Number and arrangement of the contacts of a joint that always touches.

        Args:
            name: name of the joint, in a run by `integrator.NonColliding`.

        Returns:
            Shape (time,): 0 no contact, 1 one point, 2 two points on opposite sides, 3 a line (two
            points on one side).

        Raises:
            ValueError: if there is no such joint or another integrator ran.
        """
        return histories.situations(self.history, name)

    @on_numbers
    def switchings(self, name: str) -> Any:
        """Instants at which the arrangement of contacts, or the flank in contact, changes.

        Args:
            name: name of a joint that always touches, or of a coupling with play.

        Returns:
            A pandas table: time [s], from, to.

        Raises:
            ValueError: if there is no such joint or coupling, or numbers are being traced.
        """
        if name in self.mechanism.couplings:
            return transmissions.flank_switchings(self.history, name)
        return histories.switchings(self.history, name)

    def reaction(self, name: str) -> ReactionHistory:
        """Force and torque in a connection, ideal or with clearance.

        Friction that is no function of the state enters as its mean over the saving interval, as in
        `contact`. Where overconstrained loops do not determine a reaction, it is the one of least
        norm, and a warning says so.

        Args:
            name: name of the connection, or of a coupling of bodies.

        Returns:
            A `ReactionHistory`: on the child, in ground axes.

        Raises:
            ValueError: if there is no such connection.
        """
        return histories.reaction_history(self.history, name)

    def transmitted(self, name: str) -> Float[Array, " time"]:
        """Force or torque of a coupling, a drive or a load on a coordinate, over time.

        Of a coupling of coordinates: on its first coordinate; with play or stiffness, where the
        play is measured; of a motor, on the joint that it turns. Of a coupling of bodies: the force
        along its line of action. Of a driven joint: along its coordinate, without the friction of
        its own bearing; it is unique even where reactions are not. Of a load: along its coordinate.
        Where redundant couplings do not determine it, it is the one of least norm, and a warning
        says so. Where it is no function of the state (rigid stops, sticking friction) it is a mean
        over the saving intervals.

        Args:
            name: name of the coupling, driven joint or load.

        Returns:
            Torque [N m] or force [N], shape (time,).

        Raises:
            ValueError: if there is no such coupling, driven joint or load.
        """
        return transmissions.transmitted(self.history, name)

    def coupling(self, name: str) -> CouplingHistory:
        """Twist, torque and flank in contact of a coupling with play or stiffness.

        Args:
            name: name of the coupling.

        Returns:
            A `CouplingHistory`. `events` gives touches and releases of the flanks.

        Raises:
            ValueError: if there is no such coupling.
        """
        return transmissions.coupling(self.history, name)

    def coordinate(self, name: str) -> Float[Array, "time ..."]:
        """Coordinates over time.

        Args:
            name: name of a connection of the tree, a driven joint, a floating body, or a motor (its
                coupling's name and ".motor").

        Returns:
            Coordinate [rad, m], shape (time,); (time, coordinates) where there are several.

        Raises:
            ValueError: if there is no such joint or it has no coordinates.
        """
        return self.history.coordinate(name, speeds=False)

    def speed(self, name: str) -> Float[Array, "time ..."]:
        """Speeds over time.

        Args:
            name: name of a connection of the tree, a driven joint, a floating body, or a motor (its
                coupling's name and ".motor").

        Returns:
            Speed [rad/s, m/s], shape (time,); (time, speeds) where there are several.

        Raises:
            ValueError: if there is no such joint or it has no coordinates.
        """
        return self.history.coordinate(name, speeds=True)

    def worn_volume(self, joint: str, surface: str) -> Float[Array, " time"]:
        """Volume worn off a surface over time.

        Args:
            joint: name of a joint or coupling.
            surface: name of the surface, such as "bearing"; "upper" or "lower" for a flank of a
                coupling.

        Returns:
            Volume [m^3], shape (time,).

        Raises:
            ValueError: if there is no such surface that wears.
        """
        self._check_wears(joint, surface)
        return histories.worn_volume(self.history, joint, surface)

    def worn_depth(self, joint: str, surface: str) -> Float[Array, "around along"]:
        """Wear map of a surface at the end of the run.

        Args:
            joint: name of a joint or coupling.
            surface: name of the surface, such as "bearing"; "upper" or "lower" for a flank of a
                coupling.

        Returns:
            Depth [m], shape (around, along).

        Raises:
            ValueError: if there is no such surface that wears.
        """
        self._check_wears(joint, surface)
        return self.worn[joint][surface]

    def _check_wears(self, joint, surface):
        self.history.check_single()
        parts = [*self.mechanism.connections, *self.mechanism.couplings]
        check_name("joint or coupling", joint, parts, " in this mechanism")
        if not isinstance(surface, str) or surface not in self.worn.get(joint, {}):
            wearing = ", ".join(f'"{j}" {s}' for j, surfaces in self.worn.items() for s in surfaces)
            raise ValueError(
                f'surface "{surface}" of joint "{joint}" does not wear; there are '
                f"{wearing or 'none that do'}."
            )

    def drift(self) -> dict[str, Float[Array, " time"]]:
        """Largest residual of each loop closure over time.

        Returns:
            Residuals [m, 1], shape (time,), by the joint that closes the loop.
        """
        return histories.drift_history(self.history)

    def energy_balance(self) -> EnergyHistory:
        """Energies over time.

        Returns:
            An `EnergyHistory`.

        Raises:
            ValueError: if the run was simulated without `balance=True`.
        """
        return histories.energy_history(self.history)

    @on_numbers
    def to_dataset(self, *, flat: bool = False) -> Any:
        """All histories as an xarray DataTree by body and joint, with units.

        Use it as `tree["crank"].com`, `tree["B/bearing"].worn_depth`.

        Args:
            flat: True for one Dataset with names such as "crank.com", which NetCDF 3 can store;
                False by default.

        Returns:
            The DataTree, or Dataset.

        Raises:
            ValueError: if numbers are being traced.
        """
        check_flags("to_dataset", flat=flat)
        texts = {"result": self.result, "warnings": " ".join(self.warnings)}
        attributes = {**texts, "accepted_steps": int(self.accepted_steps)}
        attributes.update(self.invariants.attributes() | self.verification.attributes())
        return export.dataset_of_run(self.history, self.worn, attributes, flat)

    def to_csv(self, path: Any) -> Path:
        """Write a CSV file: a row for each saving time, names with units, every digit.

        It holds what `to_dataset(flat=True)` has over time.

        Args:
            path: name of the file.

        Returns:
            The path of the file.
        """
        return write_csv(self.to_dataset(flat=True), path)

    @on_numbers
    def to_vtk(self, folder: Any, *, frames: int = 200, meshes: Any = None) -> Path:
        """Write a time series for ParaView into a folder.

        `run.pvd` names a file for each frame. Each file holds the bodies and the worn walls, the
        `velocity` [m/s] of points, the `body` of cells (0 the ground, then in the order of
        `mechanism.bodies`) and the `worn depth` [m] at the end of the run. Needs `pip install
        "jaxclear[mesh]"`.

        Args:
            folder: path of the folder, which is created where it does not exist.
            frames: largest number of frames, spread over the saving times, >= 1; 200 by default.
            meshes: shapes of bodies, as of `plot.animate`.

        Returns:
            The path of `run.pvd`.

        Raises:
            ValueError: if the folder is a file, `frames` is no count, or numbers are being traced.
        """
        return export.write_vtk(self, folder, frames, meshes)
