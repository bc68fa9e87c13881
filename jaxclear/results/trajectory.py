"""What a simulation returns: states over time, and by name everything that follows from them.

Poses, contacts, reactions and energies are computed from the saved states when asked for, so a run
pays for none of them. The methods here are fronts of the functions that do it.

What a run tells of a singular position: where rows of closed loops depend on each other, a
linkage stretched flat, say. There drives do not say which way the linkage goes on, and reactions
are not determined.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.beam import on_piece
from jaxclear.components.body import Marker
from jaxclear.formulations.base import AbstractFormulation
from jaxclear.ground.arguments import check_count, check_flags, check_known
from jaxclear.ground.printing import AbstractShown, shown_in_words
from jaxclear.ground.quantity import constant, is_traced, on_host, on_numbers
from jaxclear.ground.table import as_table
from jaxclear.integrators.checks import Checks, Outcome
from jaxclear.integrators.events import Events
from jaxclear.multibody import state
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.native import explain
from jaxclear.results import beams, export, histories, modes, transmissions
from jaxclear.results.histories import (
    BodyHistory,
    ContactHistory,
    EnergyHistory,
    MarkerHistory,
    ReactionHistory,
)
from jaxclear.results.state_history import SavedMotion, State, StateHistory, one_of
from jaxclear.results.transmissions import CouplingHistory
from jaxclear.results.verification import AbstractVerification, Estimate, Unverified, checked


@shown_in_words
class SingularPosition(eqx.Module):
    """A singular position of a run, at the `time` [s]: the loop is the one that `joint` closes.

    `free`: the joint of which drives do not say how it goes on there, with its `speeds` before and
    after [rad/s, m/s]; `turned`: whether the run left by another way than that by which its inertia
    leads on (None: not known). `drives`: joints whose drives hold the loop. A run that ended there
    tells `joint` and `time` alone.
    """

    joint: str = eqx.field(static=True)
    time: float = eqx.field(static=True)
    free: str = eqx.field(static=True, default="")
    drives: tuple[str, ...] = eqx.field(static=True, default=())
    turned: bool | None = eqx.field(static=True, default=None)
    speeds: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))

    @property
    def passed(self) -> bool:
        """Whether the run went on as its inertia has it."""
        return self.turned is False

    def __str__(self) -> str:
        if not self.free:
            return f'The loop is that through joint "{self.joint}", at about {self.time:.4g} s.'
        drives = " and ".join(f'"{name}"' for name in self.drives)
        plural = "drives" if len(self.drives) > 1 else "drive"
        verb = "do" if len(self.drives) > 1 else "does"
        first = (
            f'At {self.time:.4g} s the loop through joint "{self.joint}" is at a singular position '
            f'(a dead centre): {plural} {drives} {verb} not say which way joint "{self.free}" goes '
            "on there."
        )
        before, after = (f"{speed:.3g}" for speed in self.speeds)
        if self.turned is None:
            return f"{first} Saved states do not tell which way it went: save more often."
        if self.turned:
            turned = f"The run turned it round, its speed from {before} to {after}"
            return f"{first} {turned}; nothing pushed it."
        return f"{first} It went on as its inertia has it."


def in_sentences(found: tuple[SingularPosition, ...]) -> tuple[str, ...]:
    """A sentence for the first of each loop and kind, and how many more there are."""
    kinds: dict[tuple, list[SingularPosition]] = {}
    for one in found:
        kinds.setdefault((one.joint, one.free, one.turned), []).append(one)
    told = []
    for alike in kinds.values():
        more = len(alike) - 1
        again = f" So it did {more} more {'time' if more == 1 else 'times'}." if more else ""
        told.append(f"{alike[0]}{again}")
    return tuple(told)


class RunStats(AbstractShown):
    """What a run took: steps accepted and rejected; `verdict` on its time loops is a number,
    `loops` its sentence.
    """

    accepted_steps: Int[Array, ""]
    rejected_steps: Int[Array, ""]
    verdict: Int[Array, ""]

    def _shown(self):
        if is_traced(self) or np.ndim(self.verdict):
            return "what traced runs, or several, took"
        taken, tried = int(self.accepted_steps), int(self.rejected_steps)
        return f"{taken} steps, {tried} more taken back. {self.loops}"

    @property
    def loops(self) -> str:
        """Whether the time loops ran as machine code, or why not."""
        return explain(np.max(self.verdict))


class Extremes(AbstractShown):
    """The largest of all steps, whatever the saving times: `indentation` [m] of every possible
    contact and normal `force` [N] (None: no contact damps, so that it follows from the
    indentation); `contacts`: their joints, or couplings with play, whose flanks are pressed by an
    angle [rad] and a torque [N m] where they `turn`."""

    indentation: Float[Array, "*batch contacts"]
    force: Float[Array, "*batch contacts"] | None
    contacts: tuple[str, ...] = eqx.field(static=True)
    turn: tuple[bool, ...] = eqx.field(static=True, default=())

    def _shown(self):
        if is_traced(self) or np.ndim(self.indentation) != 1:
            return "the largest of traced runs, or of several"
        columns = {"contact in": self.contacts, "indentation": np.asarray(self.indentation)}
        columns |= {} if self.force is None else {"normal force": np.asarray(self.force)}
        if not any(self.turn):
            return (as_table(columns, units={"indentation": "m", "normal force": "N"}),)
        columns["unit"] = ["rad, N m" if turn else "m, N" for turn in self.turn]
        return (as_table(columns),)


class Trajectory(AbstractShown):
    """A simulated run. `history` holds the states; `worn` are depth maps [m] by joint and surface
    at the end, `outcome` tells how the run ended (an `Outcome`), `ended` when [s], `stats` what it
    cost, `invariants` what no finer run would tell of it, `verification` how far its numbers are
    off; `extremes`: of all its steps (None: its integrator follows none); `noted`: touches and
    releases, where they were asked for; `doubts` are sentences on how it was assembled,
    `singular_positions` where drives did not say which way its loops go on.
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
    doubts: tuple[str, ...] = eqx.field(static=True, default=())
    singular_positions: tuple[SingularPosition, ...] = ()

    def __getitem__(self, index: int) -> "Trajectory":
        """One run of a batch, as `jax.vmap` makes it of a function that simulates."""
        return one_of(self, self.time, index)

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism as its formulation saw it."""
        return self.history.mechanism

    @property
    def formulation(self) -> AbstractFormulation:
        """How contact entered the equations of motion."""
        return self.history.formulation

    @property
    def time(self) -> Float[Array, " time"]:
        """Saving times [s]."""
        return self.history.time

    @property
    def states(self) -> Float[Array, "time n"]:
        """Raw states at the saving times; `state_names()` names the columns."""
        return self.history.states

    @property
    def accepted_steps(self) -> Int[Array, ""]:
        """Steps taken."""
        return self.stats.accepted_steps

    @property
    def rejected_steps(self) -> Int[Array, ""]:
        """Steps tried and taken back."""
        return self.stats.rejected_steps

    @property
    def succeeded(self) -> Any:
        """True where the run reached its end."""
        return on_host(self.outcome) == Outcome.REACHED

    @property
    @on_numbers
    def result(self) -> str:
        """A sentence: that the run reached its end, or when and why it did not; and what it warns
        of."""
        self.history.check_single()
        run = constant(self)
        sentence = Outcome(int(run.outcome)).sentence
        if not run.succeeded:
            told = f"The run ended early, after {float(run.ended):.6g} s. {sentence}"
            if run.outcome == Outcome.SINGULAR_POSITION:
                return " ".join([told, *in_sentences(run.singular_positions)])
            why = run.invariants.before_the_end if run.outcome == Outcome.NOT_FINITE else ()
            return " ".join([told, *why])
        if not run.warnings:
            return sentence
        return f"{sentence.removesuffix('.')}, with warnings: {' '.join(run.warnings)}"

    @property
    @on_numbers
    def warnings(self) -> tuple[str, ...]:
        """Its `doubts`, a sentence for each of its `invariants` beyond its limit, one for answers
        whose numerical error is beyond what the integrator promises, and one where a loop left a
        singular position by another way than its inertia's; empty for a clean run. Of one that
        ended early, those of boundless figures only where there is no other."""
        self.history.check_single()
        if self.succeeded:
            turned = in_sentences(tuple(one for one in self.singular_positions if not one.passed))
            return self.doubts + self.invariants.warnings + turned + self.verification.warnings
        return self.doubts + (self.invariants.before_the_end or self.invariants.warnings)

    def estimate(self, response: Callable[["Trajectory"], Any]) -> Estimate:
        """The value of a response, or of any function of a run that returns numbers, and its
        numerical error: twice what half the steps (tolerances 16 times tighter, surfaces worn twice
        as often) change. Without replicas the error is nan, and the estimate says why.

        Source: Richardson 1911, doi:10.1098/rsta.1911.0009; Roache 1994, J. Fluids Eng. 116, 405.
        """
        return self.verification.estimate(self, checked(response)).of(response, self.mechanism)

    def _shown(self):
        if is_traced(self.outcome):
            return repr(self)
        if np.ndim(self.outcome):
            many, ended = np.size(self.outcome), int(np.sum(self.succeeded))
            return f"A batch of {many} runs, of which {ended} reached their end; run[i] is one."
        steps = f"{int(self.accepted_steps)} steps, {len(self.time)} saved instants"
        lines = [self.result, f"{float(constant(self.ended)):.6g} s in {steps}."]
        topology = self.mechanism.topology
        known = [f"The loops are {topology.redundancy}"] if topology.overconstrained else []
        if self.succeeded:
            known += in_sentences(tuple(one for one in self.singular_positions if one.passed))
        return *lines, *self.verification._parts(), *known

    def state_names(self) -> list[str]:
        """Names of the columns of `states`."""
        model = self.history.model()
        return state.names(model.system, model.layout)

    def state(self, index: int = -1) -> State:
        """The state at a saving time, by default the last, for another run to begin there:
        `simulate(..., state=run.state())`. Raises `ValueError` for a time that the run did not
        reach, and before its end where surfaces wear: their depths are known there only.
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
        layout, names, row = self.history.layout(), self.state_names(), self.states[index]
        first, middle, beside = layout.coordinates, layout.memory_start, layout.remembered
        parts = row[:first], row[first:middle], row[beside]
        known = tuple(names[:middle]), tuple(names[beside]), self.mechanism.topology.redundancy
        motion = SavedMotion(self.time[index], *parts, *known)
        return State(self.worn or None, motion=motion)

    def body(self, name: str) -> BodyHistory:
        """Motion of a body."""
        return histories.body(self.history, name)

    def marker(self, body: str | Marker, at: Any = None) -> MarkerHistory:
        """Motion of a point of a body, `at` in the body frame [m], or of a `Marker`: position,
        velocity, acceleration, and what an accelerometer there reads."""
        where = body if isinstance(body, Marker) or at is None else Marker(body, at)
        at = at if isinstance(body, Marker) else None
        return histories.marker(self.body, on_piece(self.mechanism.bodies, where), at)

    def deflection(
        self, name: str, relative_to: Literal["chord", "start"] = "chord"
    ) -> Float[Array, "time place 3"]:
        """How far the axis of a `Beam` lies from a straight line.

        Args:
            name: of the beam.
            relative_to: the line through both ends ("chord", the default), or that along which the
                beam starts ("start").

        Returns:
            [m], in axes along and across that line, by saving time, place along the beam
            (`run.mechanism.bodies[name].ends()` [m]), and axis; along the line what is undeformed
            is taken off.

        Raises:
            ValueError: for a name that is no beam's.
        """
        return beams.deflection(self, name, relative_to)

    def stress(self, name: str) -> Float[Array, "time element"]:
        """Largest normal stress in the outer fibre of a `Beam`, by bending and stretching.

        Args:
            name: of the beam.

        Returns:
            Its size [Pa], by saving time and element, in the middle of each.

        Raises:
            ValueError: for a name that is no beam's, or a section without a shape.
        """
        return beams.stress(self, name)

    def contact(self, name: str) -> ContactHistory:
        """Forces and gaps of a clearance joint.

        Where forces are no functions of the state (rigid contact, joints that always touch) they
        are means over the saving intervals, at the start over the first; a joint that always
        touches leans in its gap as its reaction says.
        """
        return histories.contact(self.history, name)

    def contact_impulse(self, name: str) -> Float[Array, " time"]:
        """Impulse of a joint's normal forces since the start, summed over its contacts [N s]: the
        run's steps add up the forces with which they were made, so it misses no impact between the
        saving times."""
        return histories.contact_impulse(self.history, name)

    @on_numbers
    def modes(self, name: str) -> Any:
        """How the journal of a clearance joint moves: free flight, impact, contact (`Mode`), as a
        pandas table of the phases (from [s], to [s], mode, approach speed [m/s] of an impact, what
        tells of its start). What parts impact from contact stands in `results.modes`. A run with
        `save=Saving(events=...)` knows touches and releases within its steps; without, they are
        those of the saving times (`.attrs["instants"]` says which), and one saves a few times a
        contact. Forces that are means over saving intervals (MoreauJean) tell them to an interval.
        """
        return modes.table(self.history, name, self.noted)

    @on_numbers
    def events(self, *names: str) -> Any:
        """Touches and releases of joints (all with clearance by default) in their order, as a
        pandas table (time [s], joint, contact, event, speed [m/s], of flanks that turn [rad/s]):
        instants of the run, located within its steps, whatever the saving times. Needs
        `save=Saving(events=...)`; warns where there were more than that many of a contact between
        two saving times."""
        return modes.events(self.history, self.noted, names)

    @on_numbers
    def combined_modes(self, *names: str) -> Any:
        """The modes of several joints (all with clearance by default) side by side, as a pandas
        table: a row whenever one of them changes."""
        known = self.formulation.contact_joints(self.mechanism)
        return modes.combined(self.history, names or known, self.noted)

    def situations(self, name: str) -> Int[Array, " time"]:
        """How a joint that always touches carries: 0 not at all, 1 at one point, 2 at two points on
        opposite sides, 3 along a line (two points on one side). Needs a run by
        integrator.NonColliding."""
        return histories.situations(self.history, name)

    @on_numbers
    def switchings(self, name: str) -> Any:
        """Instants at which such a joint begins to carry in another way, or another flank of a
        coupling with play to press, as a pandas table (time [s], from, to).
        """
        if name in self.mechanism.couplings:
            return transmissions.switchings(self.history, name)
        return histories.switchings(self.history, name)

    def reaction(self, name: str) -> ReactionHistory:
        """Force and torque in a connection, ideal or with clearance; friction that is no function
        of the state enters as its mean over the saving interval, as in `contact`. Where loops are
        overconstrained and leave a reaction open it is the least one, and a warning says so."""
        return histories.reaction(self.history, name)

    def transmitted(self, name: str) -> Float[Array, " time"]:
        """What a coupling transmits over time, or a drive gives: of coordinates the torque [N m]
        (force [N] where it slides) on the first of them; of bodies the force [N] along its line of
        action; of a driven joint the torque or force along its coordinate, the friction of its own
        bearing taken off. Of drives it is unique by power where reactions are not; where redundant
        couplings leave it open it is the least, and a warning says so. Of a coupling with play or
        stiffness where its play is seen; of a motor that turns with a joint on that joint. Of a
        load on a coordinate, by its name, what it gives there: friction at rest what it holds;
        where it is no function of the state (a rigid stop, friction that sticks) means over the
        saving intervals."""
        return transmissions.transmitted(self.history, name)

    def coupling(self, name: str) -> CouplingHistory:
        """Twist and torque of a coupling with play or stiffness over time, and which flank presses;
        touches and releases of its flanks tell `events`."""
        return transmissions.coupling(self.history, name)

    def coordinate(self, name: str) -> Float[Array, "time ..."]:
        """Coordinate [rad, m] of a connection of the tree, of a driven joint or of a motor (by its
        coupling's name and ".motor"), over time; of one
        with several (or a floating body) an array (time, coordinates)."""
        return self.history.coordinate(name, speeds=False)

    def speed(self, name: str) -> Float[Array, "time ..."]:
        """Speed [rad/s, m/s] of a connection of the tree or of a driven joint, over time; of one
        with several (or a floating body) an array (time, speeds)."""
        return self.history.coordinate(name, speeds=True)

    def worn_volume(self, joint: str, surface: str) -> Float[Array, " time"]:
        """Volume lost by a surface of a joint, or a flank ("upper", "lower") of a coupling, over
        time [m3]."""
        self._check_wears(joint, surface)
        return histories.worn_volume(self.history, joint, surface)

    def worn_depth(self, joint: str, surface: str) -> Float[Array, "around along"]:
        """Wear map of a surface of a joint, or a flank of a coupling, at the end of the run [m]."""
        self._check_wears(joint, surface)
        return self.worn[joint][surface]

    def _check_wears(self, joint, surface):
        self.history.check_single()
        known = [*self.mechanism.connections, *self.mechanism.couplings]
        check_known("joint or coupling", joint, known, " in this mechanism")
        if not isinstance(surface, str) or surface not in self.worn.get(joint, {}):
            wearing = ", ".join(f'"{j}" {s}' for j, surfaces in self.worn.items() for s in surfaces)
            raise ValueError(
                f'surface "{surface}" of joint "{joint}" does not wear; there are '
                f"{wearing or 'none that do'}."
            )

    def drift(self) -> dict[str, Float[Array, " time"]]:
        """Largest residual [m, 1] of each loop closure over time, by the joint that closes the
        loop.
        """
        return histories.drift(self.history)

    def energy_balance(self) -> EnergyHistory:
        """Energies over time; needs a run with `balance=True`."""
        return histories.energies(self.history)

    @on_numbers
    def to_dataset(self, *, flat: bool = False) -> Any:
        """Everything as an xarray DataTree by body and joint, with units: `tree["crank"].com`,
        `tree["B/bearing"].worn_depth`. `flat`: as one Dataset with names such as "crank.com", which
        NetCDF 3 holds; the tree answers to these names too, with a warning, for this version."""
        check_flags("to_dataset", flat=flat)
        said = {"result": self.result, "warnings": " ".join(self.warnings)}
        attributes = {**said, "accepted_steps": int(self.accepted_steps)}
        attributes.update(self.invariants.attributes() | self.verification.attributes())
        return export.of_run(self.history, self.worn, attributes, flat)

    @on_numbers
    def to_vtk(self, folder: Any, *, frames: int = 200, meshes: Any = None) -> Path:
        """Writes a time series for ParaView into a folder: `run.pvd` names a file for each of at
        most so many `frames`, spread over the saving times; returns its path. Each holds bodies
        (shapes and `meshes` as in `plot.animate`) and worn walls where they are then, the
        `velocity` [m/s] of points, the `body` of cells (0 the ground, then in the order of
        `mechanism.bodies`) and the `worn depth` [m] at the end of the run. Needs
        `pip install "jaxclear[mesh]"`."""
        return export.write_vtk(self, folder, frames, meshes)
