"""One cycle of a machine: from a state and worn surfaces to the state at its end, what wore, and
the responses; how far it ends from where it began, and whether the drives repeat. Compiled once for
a whole life: state, surfaces and numbers are inputs of the program.

How far a state is from the one a cycle before, each thing in its own measure: poses are compared,
not coordinates, as a crank that has made a whole turn stands where it stood, and a quaternion and
its opposite are one attitude. A journal counts in shares of its clearance, because that is what
decides its contact.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.joint.base import drive_of
from jaxclear.formulations.base import model_of
from jaxclear.ground.arguments import check_number, expect
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.warning import warn
from jaxclear.integrators import AbstractIntegrator, Outcome
from jaxclear.integrators.checks import Checks
from jaxclear.multibody import closure_coordinates
from jaxclear.multibody.mechanism import Mechanism, ungiven
from jaxclear.multibody.start_equations import Start
from jaxclear.multibody.state import names
from jaxclear.multibody.system import longest_arm
from jaxclear.multibody.validation import check_values
from jaxclear.native import stoppable
from jaxclear.native.compiled import AROUND_A_KERNEL, compiled_quickly
from jaxclear.results import histories, response
from jaxclear.results.state_history import SavedMotion, State, StateHistory, columns, over_time
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.initial_state import Past, beginning
from jaxclear.simulation.loop import run
from jaxclear.simulation.singular_positions import diagnosed
from jaxclear.simulation.wear import Losses, Worn, losses_between, unworn, worn_by
from jaxclear.studies.life.losses import Footprints, footprints
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_experiment import RunExperiment

# Of saving times are left, to tell what hangs on them.
FOURTH = 4
# A place within this of where it was [rad, m] is the same place; a period is written with so many
# digits.
SAME_PLACE = 1e-5
# Parts of a cycle after which drives are looked at: no drive repeats after a ratio of Fibonacci
# numbers that does not repeat throughout.
LOOKS = (0.0, 2 / 13, 3 / 8, 8 / 13, 7 / 8)
# Beyond so many cycles one more is no other number in double precision.
MOST_CYCLES = 2.0**53


class Cycle(eqx.Module):
    """What is kept of a cycle: the motion at its `end`, by joint and surface the worn
    depth [m] (`wore`) and the worn `volumes` [m3], the depth of a fourth of its saving times alone
    (`wore_by_fourths`), the `losses` from one saving time to the next and which cells they wear
    (`footprints`), the problem's `responses`, the relative `changes` between its two ends, how its
    run ended (`outcome`) and when [s], and its `checks`. Arrays on the host.
    """

    end: SavedMotion
    wore: Worn
    volumes: dict[str, dict[str, Array]]
    wore_by_fourths: Worn
    losses: Losses
    footprints: Footprints
    responses: dict[str, Array]
    changes: dict[str, Array]
    outcome: Int[Array, ""]
    ended: Float[Array, ""]
    checks: Checks

    @property
    def distance(self) -> float:
        """How far its ends are apart [1], at the worst place; `nan` where its run failed."""
        return float(np.max(list(self.changes.values()))) if self.changes else 0.0

    @property
    def worst(self) -> str:
        """Where its ends are furthest apart."""
        return max(self.changes, key=lambda name: float(self.changes[name])) if self.changes else ""

    @property
    def fault(self) -> str:
        """Why it is of no use, in a sentence; "" for one that reached its end."""
        if self.outcome != Outcome.REACHED:
            sentence = Outcome(int(self.outcome)).sentence
            return f"the run of a cycle ended early, at {float(self.ended):.6g} s. {sentence}"
        numbers = [*jax.tree.leaves(self.wore), self.distance]
        if not all(np.all(np.isfinite(each)) for each in numbers):
            return "the run of a cycle reached its end with numbers that are not finite."
        return ""


class Request(eqx.Module):
    """What a cycle needs of its problem: neither its variables nor its own start, so that one
    program serves all of these. `times` [s] count from its beginning."""

    mechanism: Mechanism
    integrator: AbstractIntegrator
    response: dict[str, Callable]
    times: Float[Array, " saves"]


def cycle_request(problem: Problem, values: Any) -> Request:
    """What a cycle needs, with the problem's variables at these values."""
    times = problem.shares * problem.duration
    return Request(
        ungiven(problem.model(problem.setting(values))), problem.integrator, problem.response, times
    )


def _simulate_cycle(request: Request, begin: SavedMotion, worn: Worn) -> tuple[Cycle, Trajectory]:
    """A cycle and its run."""
    times, past = begin.time + request.times, Past(worn, begin.remembered)
    motion = begin.coordinates, begin.speeds
    trajectory = run(request.mechanism, *motion, times, request.integrator, past=past)
    end = trajectory.state().motion
    assert end is not None
    model = trajectory.history.model()
    system, layout = model.system, model.layout
    rare = losses_between(layout, trajectory.states, FOURTH)
    losses = losses_between(layout, trajectory.states)
    result = Cycle(
        end,
        jax.tree.map(lambda after, before: after - before, trajectory.worn, worn),
        volumes(trajectory),
        jax.tree.map(lambda after, before: after - before, worn_by(system, worn, rare), worn),
        losses,
        footprints(system, losses),
        {name: jnp.asarray(f(trajectory), float) for name, f in request.response.items()},
        relative_changes(trajectory.history),
        trajectory.outcome,
        trajectory.ended,
        trajectory.invariants,
    )
    return result, trajectory


compiled_cycle = compiled_quickly(_simulate_cycle, AROUND_A_KERNEL)


def cycle(request: Request, begin: SavedMotion, worn: Worn) -> tuple[Cycle, Trajectory]:
    """A cycle simulated, and its run.

    Args:
        request: problem, responses and settings of a life.
        begin: motion at its start.
        worn: depth maps [m] by joint and surface.
    """
    with stoppable():
        result, trajectory = jax.block_until_ready(compiled_cycle(request, begin, worn))
        trajectory = diagnosed(trajectory)
    result = dataclasses.replace(result, outcome=trajectory.outcome)
    return jax.tree.map(np.asarray, result), trajectory


def kind_of_cycle(request: Request, begin: SavedMotion, worn: Worn) -> Cycle:
    """A cycle with shapes instead of numbers; nothing is simulated.

    Args:
        request: problem, responses and settings of a life.
        begin: motion at its start.
        worn: depth maps [m] by joint and surface.
    """
    return eqx.filter_eval_shape(compiled_cycle, request, begin, worn)[0]


def volumes(trajectory: Trajectory) -> Worn:
    """Volume [m3] lost in a run, by joint and surface."""
    return {
        joint: {surface: trajectory.worn_volume(joint, surface)[-1] for surface in surfaces}
        for joint, surfaces in trajectory.worn.items()
    }


def first_state(problem: Problem, values: Any) -> tuple[SavedMotion, Worn]:
    """Where the first cycle begins, and on which surfaces. Raises `ValueError` with a sentence for
    numbers or a start that cannot be."""
    formulation = problem.integrator.formulation
    mechanism = problem.with_values(values)
    check_values("this mechanism", mechanism)
    mechanism = formulation.modelled(mechanism)
    mechanism, start, past = beginning(mechanism, formulation, problem.state)[:3]
    kept, motion, worn = _begin(problem, mechanism, start, past)
    if not kept:
        raise ValueError(Outcome.OTHER_MODE.sentence)
    return motion, worn


@compiled_quickly
def _begin(
    problem: Problem, mechanism: Mechanism, start: Start, past: Past
) -> tuple[Any, SavedMotion, Worn]:
    """Whether a start is of the nominal mode; the motion and the surfaces there."""
    model = model_of(mechanism, problem.integrator.formulation)
    layout = model.layout
    rest = jnp.zeros(layout.size - layout.memory_start)
    state = jnp.concatenate([start.coordinates, start.speeds, rest])
    time = jnp.asarray(problem.state.start_time, float)
    state = closure_coordinates.started(mechanism, model.system, layout, time, state)
    remembered = state[layout.remembered] if past.remembered is None else past.remembered
    named = names(model.system, layout)
    first, memory_start = layout.memory_start, layout.remembered
    parts = start.coordinates, start.speeds, remembered
    details = tuple(named[:first]), tuple(named[memory_start]), mechanism.topology.redundancy
    motion = SavedMotion(time, *parts, *details)
    worn = unworn(model.system) if past.worn is None else past.worn
    return problem.keeps_mode(mechanism, start), motion, worn


def check_cycle(what: str, problem: Any) -> None:
    """Raises `ValueError` with a sentence for what is no problem of a mechanism in time."""
    expect(problem, Problem, what, "a jaxclear.Problem of one cycle")
    expect(problem.experiment, RunExperiment, what, "a jaxclear.Problem of one cycle")


def as_problem(
    owner: str, subject: Any, period: Any, cycles: int, state: State | None = None
) -> Problem:
    """The problem whose duration is one cycle.

    Args:
        owner: function in messages.
        subject: such a problem, or a mechanism.
        period: of a mechanism's cycle [s]; None with a problem.
        cycles: after how many of them drives must repeat at the latest.
        state: in which a mechanism begins; None: its own start.

    Raises:
        ValueError: arguments do not fit together, or drives do not repeat.
    """
    if isinstance(subject, Problem):
        check_cycle(f"the first argument of {owner}", subject)
        if period is not None or state is not None:
            raise ValueError(
                f"{owner} is given a Problem, whose duration is the period and which has its own "
                "state, and one of them besides: leave it out, and give cycles by name, cycles=..."
            )
        return subject
    expect(subject, Mechanism, f"the first argument of {owner}", "a Mechanism or a Problem")
    if period is None:
        raise ValueError(f"{owner} of a mechanism needs its period [s]: how long one cycle takes.")
    check_number(f"period of {owner}", period, "s", above=0)
    # Before a problem looks for its integrator by runs, which are long where cycles are meant.
    begins = float(state.start_time) if isinstance(state, State) else 0.0
    check_period(owner, subject, begins, float(period), cycles)
    warn_of_several(owner, subject, begins, float(period))
    return Problem(subject, usual_responses(subject), {}, duration=period, state=state)


def usual_responses(mechanism: Mechanism) -> dict[str, Callable]:
    """Mean and peak force of each joint with clearance; without any, the largest speed."""
    joints = mechanism.topology.clearances
    means: dict[str, Callable] = {
        f"mean force {name}": response.MeanContactForce(name) for name in joints
    }
    peaks: dict[str, Callable] = {
        f"peak force {name}": response.PeakContactForce(name) for name in joints
    }
    return means | peaks or {"largest speed [m/s]": largest_speed}


def largest_speed(run: Trajectory) -> Array:
    """Of the centres of mass of all bodies [m/s]."""
    speeds = [jnp.linalg.norm(run.body(b).velocity, axis=-1) for b in run.mechanism.bodies]
    return jnp.max(jnp.stack(speeds))


def as_state(motion: SavedMotion, worn: Worn) -> State:
    """The state from which a run goes on."""
    return State(worn or None, motion=motion)


def worst_of(checks: Sequence[Checks]) -> Checks:
    """Of each figure at each place the worst of all these."""
    return functools.reduce(_worse_figures, checks)


def _worse_figures(one: Checks, other: Checks) -> Checks:
    """Of each figure at each place the worse of two."""
    figures = {}
    for check, mine in one.figures.items():
        theirs = other.figures[check]
        more = theirs.worst > mine.worst
        figures[check] = type(mine)(
            jnp.where(more, theirs.worst, mine.worst),
            jnp.where(more, theirs.time, mine.time),
            mine.places,
        )
    return Checks.of(figures)


def relative_changes(history: StateHistory) -> dict[str, Float[Array, ""]]:
    """How far the last saved state is from the first, by what it is of: places of bodies in longest
    arms of the mechanism, attitudes [rad], velocities in the largest in between (a spin counts as
    the speed of a longest arm that turns so), journals in clearances, angles that wind up springs
    [rad]."""
    motions = {name: histories.body(history, name) for name in history.mechanism.bodies}
    arm = longest_arm(history.model().system)
    fastest = jnp.max(
        jnp.stack(
            [jnp.max(_size(body.velocity) + arm * _size(body.spin)) for body in motions.values()]
        )
    )
    changes = {}
    for name, body in motions.items():
        changes[f'the place of "{name}"'] = _change_over(body.com) / arm
        # For small angles this is the angle.
        turn = _size((body.rotation[-1] - body.rotation[0]).reshape(-1)) / jnp.sqrt(2.0)
        changes[f'the attitude of "{name}"'] = turn
        changes[f'the velocity of "{name}"'] = safe_divide(_change_over(body.velocity), fastest)
        changes[f'the spin of "{name}"'] = safe_divide(arm * _change_over(body.spin), fastest)
    for name, clearance in _clearances_of(history).items():
        offset = over_time(history, lambda now: now.pose(name).translation)
        changes[f'the journal in joint "{name}"'] = _change_over(columns(offset)) / clearance
    layout = history.layout()
    for i, name in enumerate(layout.angles):
        angle = history.states[:, layout.angle_start + i]
        changes[f'the angle of joint "{name}"'] = jnp.abs(angle[-1] - angle[0])
    return changes


def _clearances_of(history: StateHistory) -> dict[str, Any]:
    """Clearance [m] of each joint whose journal moves freely in it."""
    mechanism = history.mechanism
    joints = {name: mechanism.connections[name].joint for name in mechanism.topology.clearances}
    clearances = {name: getattr(joint, "clearance", None) for name, joint in joints.items()}
    return {name: size for name, size in clearances.items() if eqx.is_array(size)}


def _change_over(values: Float[Array, "time n"]) -> Float[Array, ""]:
    return _size(values[-1] - values[0])


def _size(values: Float[Array, "*batch n"]) -> Float[Array, " *batch"]:
    return safe_sqrt(jnp.sum(values * values, axis=-1))


def restless(mechanism: Mechanism, start: float, period: float) -> dict[str, tuple]:
    """Drives that do not repeat after a period: (travel [rad, m], distance from the start) by
    joint.

    Args:
        mechanism: with drives.
        start: beginning of the period [s].
        period: [s].
    """
    changes = {}
    for name in mechanism.driven:
        joint = mechanism.connections[name].joint
        before, after = (_drive_position(joint, time) for time in (start, start + period))
        poses = [joint.motion((q,)) for q in (before, after)]
        parts = [np.array([[*p.rotation[i], p.translation[i]] for i in range(3)]) for p in poses]
        away = float(np.linalg.norm(parts[1] - parts[0]))
        if away > SAME_PLACE:
            changes[name] = after - before, away
    return changes


def _drive_position(joint: Any, time: float) -> float:
    """Where its drive has a joint at a time [s]."""
    drive = drive_of(joint)
    assert drive is not None
    return float(drive.motion(time)[0])


def check_cycles(owner: str, cycles: Any) -> None:
    """Raises `ValueError` with a sentence for a life of no number of cycles."""
    check_number(f"cycles of {owner}", cycles, above=0, at_most=MOST_CYCLES)


def check_period(
    owner: str, mechanism: Mechanism, start: float, period: float, cycles: int = 1
) -> None:
    """Raises `ValueError` where a drive repeats neither over the first cycle nor over the last.

    A drive may approach what it does for ever.

    Args:
        owner: function in the message.
        mechanism: with drives.
        start: beginning of the first cycle [s].
        period: of a cycle [s].
        cycles: number of cycles.
    """
    later = restless(mechanism, start + (cycles - 1) * period, period)
    for name, (moved, away) in restless(mechanism, start, period).items():
        if name not in later:
            continue
        unit = mechanism.connections[name].joint.units[0]
        turn = 2 * np.pi * period / abs(moved)
        more = f" A turn of it takes {turn:.4g} s; cycles are given by name, cycles=..."
        raise ValueError(
            f'the drive of joint "{name}" moves it by {moved:.6g} {unit} in a period of '
            f"{period:.6g} s, which leaves it {away:.2g} from where it was: give "
            f"{owner} the period after which the drives repeat."
            f"{more if unit == 'rad' and turn < period else ''}"
        )


def warn_of_several(owner: str, mechanism: Mechanism, start: float, period: float) -> None:
    """Warns where all drives repeat after a part of the period, by whole turns.

    Args:
        owner: function in the warning.
        mechanism: with drives.
        start: beginning of the period [s].
        period: [s].
    """
    joints = [mechanism.connections[name].joint for name in mechanism.driven]
    turns = [
        (_drive_position(joint, start + period) - _drive_position(joint, start)) / (2 * np.pi)
        for joint in joints
        if joint.units[0] == "rad"
    ]
    times = int(np.gcd.reduce([round(abs(turn)) for turn in turns])) if turns else 0
    parts = (restless(mechanism, start + share * period, period / times) for share in LOOKS)
    if times < 2 or restless(mechanism, start, period) or any(parts):
        return
    warn(
        f"the drives repeat after {period / times:.4g} s already, {times} times in the period of "
        f"{period:.6g} s that {owner} is given: a cycle is as long as that. How many cycles there "
        "are is given by name, cycles=..."
    )
