"""A run's judgement of itself: the figures of its saving intervals gathered, and its end where they
show that the numbers are certainly wrong.

Nothing here touches the motion: what reached its end does so with the same numbers, bit for bit.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.joint.base import drive_of
from jaxclear.formulations.base import AbstractFormulation
from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.integrators.checks import (
    CONTACTS,
    LOOPS,
    SPEEDS,
    SURFACES,
    WHOLE,
    Check,
    over_run,
)
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody import energy, kinematics, loops
from jaxclear.multibody.system import System, longest_arm
from jaxclear.results.state_history import StateHistory, over_time
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.friction_steps import KINDS, friction_steps

# Saved states of a run, at most, that are looked at: a loop that has come open stays so for long.
LOOKS = 50
# Share of the longest arm by which masses may rise without a cause: rounding and what contacts at
# rest are moved by stay far below it.
LEAST_LIFT = 0.01


def refereed(
    trajectory: Trajectory, figures: dict[Check, Float[Array, "intervals places"]]
) -> Trajectory:
    """The run with its checks: those that its integrator kept in each saving interval, and those
    that its saved states tell. It ends where one of them is beyond what a run can mend.
    """
    history = trajectory.history
    rubbed = {check: figures[check] for check in KINDS if check in figures}
    kept = {check: each for check, each in figures.items() if check not in KINDS}
    depths = kept.get(Check.INDENTATION)
    told = _of_saved_states(history) | _of_friction(history, depths, rubbed)
    found = jax.lax.stop_gradient(_of_contacts(history, kept) | told)
    ends = jnp.asarray(history.time)[1:]
    checks = over_run(found, ends, _places(history))
    verdict = _ending(found)
    if jnp.ndim(verdict) == 0:
        return dataclasses.replace(trajectory, checks=checks)
    bad = (verdict != Outcome.REACHED) & (ends <= trajectory.ended)
    first, stops = jnp.argmax(bad), jnp.any(bad)
    # As of every run that ended early, the last state is kept up to its planned end.
    later = (jnp.arange(len(history.time)) > first + 1)[:, None]
    states = jnp.where(stops & later, history.states[first + 1], history.states)
    return dataclasses.replace(
        trajectory,
        history=dataclasses.replace(history, states=states),
        outcome=jnp.where(stops, verdict[first], trajectory.outcome),
        ended=jnp.where(stops, ends[first], trajectory.ended),
        checks=checks,
    )


def _ending(
    found: dict[Check, Float[Array, "intervals places"]],
) -> Float[Array, " intervals"]:
    """`Outcome` that each interval's figures call for: `REACHED` where none is certainly wrong."""
    outcome: Any = Outcome.REACHED
    for check, each in found.items():
        if np.isfinite(check.ends_at):
            bad = jnp.any(~(each <= check.ends_at), axis=-1)
            outcome = jnp.where(bad, check.outcome, outcome)
    return outcome


def _of_contacts(history: StateHistory, figures: dict[Check, Array]) -> dict[Check, Array]:
    """The figures with those of contacts, which integrators keep in metres, beside what they are
    measured by: the largest indentation of all, and the radius of each joint."""
    if Check.INDENTATION not in figures:
        return figures
    depths = figures[Check.INDENTATION]
    deepest = jnp.max(depths, initial=0.0)
    rises = {
        check: safe_divide(figures[check], deepest)
        for check in (Check.CONTACT_STEP, Check.IMPACT_STEP)
        if check in figures
    }
    bearings = history.model().system.bearings.values()
    radii = [radius for bearing in bearings for radius in bearing.radii]
    return figures | rises | {Check.INDENTATION: depths / sp.stack(radii)}


def _places(history: StateHistory) -> dict[str, tuple[str, ...]]:
    """Names of the places of figures."""
    model = history.model()
    contacts = tuple(name for name, kinds in model.layout.memories for _ in kinds)
    topology = model.system.topology
    return {
        LOOPS: topology.loops,
        SPEEDS: tuple(b.name for b in topology.branches for _ in range(b.speed_count)),
        CONTACTS: contacts,
        SURFACES: tuple(slot.bearing for slot in model.layout.wear),
        WHOLE: ("",),
    }


def _of_saved_states(history: StateHistory) -> dict[Check, Float[Array, "intervals places"]]:
    """Figures that the states at the saving times tell."""
    system, count = history.model().system, len(history.time) - 1
    looked = _spread(count)
    seen = _at(history, np.concatenate([[0], 1 + looked]))
    found = {}
    if system.closures:
        arm = longest_arm(system)
        found[Check.LOOP_DRIFT] = over_time(seen, lambda now: _openings(now, arm))[1:]
    if all(drive_of(link.joint) is None for link in system.links):
        energies = over_time(seen, lambda now: _energies(now, history.formulation))
        # A load from outside may give energy.
        if energies:
            # Rigid contacts that overlap at the start are moved apart, whatever that takes.
            if history.formulation.forces_are_means:
                energies = tuple(part.at[0].set(jnp.maximum(part[0], part[1])) for part in energies)
            found[Check.ENERGY_GAIN] = _gains(_small_energy(system), *energies)[1:, None]
    return {
        check: jnp.zeros((count, values.shape[1])).at[looked].set(values)
        for check, values in found.items()
    }


def _of_friction(
    history: StateHistory, depths: Array | None, steps: dict[Check, Array]
) -> dict[Check, Float[Array, "intervals places"]]:
    """Figures of friction; they stand for the run as a whole: at its end."""
    count = len(history.time) - 1
    looked = _spread(count)
    seen = _at(history, np.concatenate([[0], 1 + looked]))
    rows = jax.tree.map(lambda each: each[looked], (depths, steps))
    found = friction_steps(seen, *rows)
    return {check: jnp.zeros((count, len(each))).at[-1].set(each) for check, each in found.items()}


def _energies(now: Instant, formulation: AbstractFormulation) -> tuple:
    """(kinetic energy, potential energy, at most stored in contacts) [J]; () where a load gives
    energy from outside."""
    forces = formulation.forces(now)
    if not sp.is_zero(forces.external_power):
        return ()
    kinetic, potential = energy.mechanical_energy(now.model.system, forces)
    points = [point for report in forces.reports.values() for point in report.points]
    stored = sp.total(point.normal_force * positive_part(point.indentation) for point in points)
    return kinetic, potential, jnp.asarray(stored, float)


def _small_energy(system: System) -> Any:
    """What lifts all masses by `LEAST_LIFT` of the longest arm [J]: what is at rest has no other
    energy to compare with."""
    mass = sp.total(link.mass for link in system.links)
    gravity = safe_sqrt(jnp.asarray(sp.dot(system.gravity, system.gravity), float))
    return LEAST_LIFT * mass * gravity * longest_arm(system)


def _gains(
    small: Any,
    kinetic: Float[Array, " looks"],
    potential: Float[Array, " looks"],
    stored: Float[Array, " looks"],
) -> Float[Array, " looks"]:
    """Energy above that of the start beside all that there was to change, and a `small` one [J]."""
    start = kinetic[0] + potential[0] + stored[0]
    scale = start - jnp.min(potential) + jnp.max(kinetic) + small
    return safe_divide(positive_part(kinetic + potential - start), scale)


def _spread(count: int) -> np.ndarray:
    """Up to `LOOKS` of so many saving intervals, evenly spread, the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, LOOKS)).round().astype(int))


def _at(history: StateHistory, rows: np.ndarray) -> StateHistory:
    """The history at some of its saving times."""
    time, states, read = jax.tree.map(
        lambda x: jnp.asarray(x)[rows], (history.time, history.states, history.read)
    )
    return dataclasses.replace(history, time=time, states=states, read=read)


def _openings(now: Instant, arm: Any) -> Float[Array, " loops"]:
    """Largest residual of each loop's closure: displacements beside the longest arm, cosines as
    they are."""
    openings = []
    for closure in now.model.system.closures:
        _, pose, _ = kinematics.relative_motion(closure, now.motions)
        values = zip(closure.rows, loops.residuals(closure.rows, pose), strict=True)
        shares = [abs(x) / arm if len(row) == 1 else abs(x) for row, x in values]
        openings.append(jnp.max(sp.stack(shares), initial=0.0))
    return jnp.stack(openings)
