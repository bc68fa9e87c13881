"""A run's judgement of itself: the figures of its saving intervals gathered, and its end where they
show that the numbers are certainly wrong.

Nothing here touches the motion: what reached its end does so with the same numbers, bit for bit.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.formulations.base import AbstractFormulation
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent_reactions import touching
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.integrators.check_words import (
    COLLARS,
    CONTACTS,
    JOINTS,
    LOOPS,
    RUBBING,
    SLIDING,
    SPEEDS,
    SURFACES,
    TOUCHING,
    UNHELD,
    WHOLE,
)
from jaxclear.integrators.checks import Check
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody import energy, kinematics, loops
from jaxclear.multibody.system import System, longest_arm
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.collars import (
    by_others,
    collared,
    left,
    pressed,
    share_along,
    sliding,
    unheld,
)
from jaxclear.simulation.coulomb_friction import coulomb_friction, laws_of_others
from jaxclear.simulation.coulomb_friction import taken as rubbed_as_coulombs
from jaxclear.simulation.damper_steps import damper_step, damping
from jaxclear.simulation.found import met_by, seen_by, together
from jaxclear.simulation.friction_steps import KINDS, contacts, friction_steps, rubbing, taken
from jaxclear.simulation.gap_motion import gap_motion, in_gaps, masses, placed
from jaxclear.simulation.indeterminate import indeterminate_forces, shared
from jaxclear.simulation.looks import Looks, look
from jaxclear.simulation.rebound import rebound_steps
from jaxclear.simulation.tally import PEAKS, Figures, Tally

# Share of the longest arm by which masses may rise without a cause: rounding and what contacts at
# rest are moved by stay far below it.
LEAST_LIFT = 0.01
# Figures of every look beyond which a run ends.
ENDING = (Check.INDENTATION, Check.LOOP_DRIFT)


def refereed(
    trajectory: Trajectory,
    model: Model,
    tally: Tally,
    figures: Figures,
    windows: dict[Check, Float[Array, " places"]],
) -> Trajectory:
    """The run with its checks: the worst that its integrator met, those of its `windows`, and those
    that its saved states tell, with the `figures` of the saving intervals that end with a look. It
    ends where one of these is beyond what a run can mend.
    """
    history = trajectory.history
    looks, ends = look(history, model, figures), jnp.asarray(history.time)[1:]
    seen, rubbed, verdict = _of_saved_states(looks)
    of_run = windows | rubbed
    met, when = dict(tally.worst), dict(tally.when)
    rebound = met.pop(Check.REBOUND_STEP, None)
    if rebound is not None:
        rises = met[Check.CONTACT_STEP], met[Check.INDENTATION]
        of_run[Check.REBOUND_STEP] = rebound_steps(model, *rises, rebound)
    places = _places(model, history.formulation)
    met = _of_contacts(model.system, met) | of_run
    kept = {check: met[check] for check in PEAKS if check in tally.worst}
    met = jax.lax.stop_gradient(met) | kept
    when |= {check: jnp.full(each.shape, ends[-1]) for check, each in of_run.items()}
    seen = jax.lax.stop_gradient(seen)
    checks = together(met_by(met, when, places), seen_by(seen, ends[looks.intervals], places))
    if verdict is None:
        return dataclasses.replace(trajectory, checks=checks)
    bad = (verdict != Outcome.REACHED) & (ends[looks.intervals] <= trajectory.ended)
    worst, stops = jnp.argmax(bad), jnp.any(bad)
    first = jnp.asarray(looks.intervals)[worst]
    # As of every run that ended early, the last state is kept up to its planned end.
    later = (jnp.arange(len(history.time)) > first + 1)[:, None]
    states = jnp.where(stops & later, history.states[first + 1], history.states)
    return dataclasses.replace(
        trajectory,
        history=dataclasses.replace(history, states=states),
        outcome=jnp.where(stops, verdict[worst], trajectory.outcome),
        ended=jnp.where(stops, ends[first], trajectory.ended),
        checks=checks,
    )


def _ending(found: Figures, outcome: Any = None) -> Any:
    """`Outcome` that figures at an instant call for, `REACHED` where none is certainly wrong, or
    else this one; None where there is none."""
    for check, each in found.items():
        if np.isfinite(check.ends_at):
            bad = jnp.any(~(each <= check.ends_at), axis=-1)
            known = int(Outcome.REACHED) if outcome is None else outcome
            outcome = jnp.where(bad, int(check.outcome), known)
    return outcome


def _of_contacts(system: System, figures: Figures) -> Figures:
    """The worst figures with those of contacts, which integrators keep in metres, beside what they
    are measured by: the largest indentation of all, and the radius of each joint."""
    if Check.INDENTATION not in figures:
        return figures
    depths = figures[Check.INDENTATION]
    deepest = jnp.max(depths, initial=0.0)
    rises = {
        check: safe_divide(figures[check], deepest)
        for check in (Check.CONTACT_STEP, Check.IMPACT_STEP)
        if check in figures
    }
    return figures | rises | {Check.INDENTATION: depths / _radii(system)}


def _radii(system: System) -> Float[Array, " contacts"]:
    """Radius of journal or ball in every possible contact [m]."""
    return sp.stack([radius for one in system.bearings.values() for radius in one.radii])


def _places(model: Model, formulation: AbstractFormulation) -> dict[str, tuple[str, ...]]:
    """Names of the places of figures."""
    contacts = tuple(name for name, kinds in model.layout.memories for _ in kinds)
    topology = model.system.topology
    return {
        LOOPS: topology.loops,
        SPEEDS: tuple(b.name for b in topology.branches for _ in range(b.speed_count)),
        CONTACTS: contacts,
        JOINTS: tuple(name for name, count in model.layout.impulses for _ in range(count)),
        SURFACES: tuple(slot.bearing for slot in model.layout.wear),
        RUBBING: tuple(laws_of_others(model, formulation)),
        COLLARS: collared(model),
        UNHELD: unheld(model),
        SLIDING: sliding(model.system),
        TOUCHING: tuple(held.name for held in touching(model.system)),
        WHOLE: ("",),
    }


class Seen(NamedTuple):
    """What the looks tell: figures by look, figures of the run as a whole, the `Outcome` that each
    look calls for (None: none ever ends a run)."""

    figures: dict[Check, Float[Array, "looks places"]]
    of_run: dict[Check, Float[Array, " contacts"]]
    verdict: Int[Array, " looks"] | None


def _of_saved_states(looks: Looks) -> Seen:
    """What a run's looks at its saved states tell."""
    model, system = looks.model, looks.model.system
    means = looks.history.formulation.forces_are_means
    said = looks.of(_judging(looks))
    energies = said.get("energies")
    # Without the start.
    told, verdict = jax.tree.map(lambda each: each[1:], (said["told"], said.get("verdict")))
    figures = {check: told[check] for check in ENDING if check in told}
    if energies is not None:
        gains = _gains(_small_energy(system), energies, means)[1:, None]
        figures[Check.ENERGY_GAIN] = gains
        verdict = _ending({Check.ENERGY_GAIN: gains}, verdict)
    times = looks.history.time[looks.rows]
    of_run = {check: friction_steps(model, told[check]) for check in KINDS if check in told}
    if "rubbed" in said:
        rubbed = said["rubbed"]
        of_run[Check.COULOMB_FRICTION] = coulomb_friction(rubbed, times)
    of_run |= {check: share_along(each) for check, each in said["along"].items()}
    if "gaps" in said:
        heavy = masses(in_gaps(model), looks.history.mechanism)
        of_run[Check.GAP_MOTION] = gap_motion(said["gaps"], times, heavy)
    if "shared" in said:
        of_run[Check.INDETERMINATE_FORCE] = indeterminate_forces(said["shared"])
    for check in (Check.DAMPER_STEP, Check.JOURNAL_REACH):
        if check in told:
            of_run[check] = jnp.max(told[check], axis=0, initial=0.0)
    return Seen(figures, of_run, verdict)


def _judging(looks: Looks) -> Callable[[Instant, Figures], dict[str, Any]]:
    """What is worked out at every look, from the figures of its saving interval."""
    system, formulation = looks.model.system, looks.history.formulation
    slides, driven = bool(rubbing(looks.model)), looks.history.mechanism.driven
    sinks = bool(system.bearings) and not formulation.forces_are_means
    others = laws_of_others(looks.model, formulation)
    collars, free = collared(looks.model), unheld(looks.model)
    gaps, loose, mechanism = in_gaps(looks.model), sliding(system), looks.history.mechanism

    def judged(now: Instant, figures: Figures) -> dict[str, Any]:
        told: dict[Check, Array] = {}
        steps = {check: figures[check] for check in KINDS if check in figures and slides}
        length = figures.get(Check.DAMPER_STEP) if damping(system) else None
        depths = figures.get(Check.INDENTATION)
        if steps or length is not None:
            met = contacts(now, formulation)
            told |= taken(looks.model, met, 0.0 if depths is None else depths, steps)
            told |= {} if length is None else {Check.DAMPER_STEP: damper_step(met, length)}
        if depths is None and sinks:
            told[Check.INDENTATION] = _depths(now, formulation) / _radii(system)
        told |= {Check.LOOP_DRIFT: _openings(now)} if system.closures else {}
        judging = {} if depths is None else {Check.INDENTATION: depths / _radii(system)}
        verdict = _ending(judging | {check: told[check] for check in ENDING if check in told})
        said = {"told": told} | ({} if verdict is None else {"verdict": verdict})
        # Worked out once, for all that ask.
        report = functools.cache(lambda name: formulation.contact(now, name))
        said |= {"rubbed": rubbed_as_coulombs(others, report)} if others else {}
        told_of = lambda names: [report(name) for name in names]
        said["along"] = {}
        if collars:
            said["along"][Check.COLLAR_FORCE] = pressed(told_of(collars), [True] * len(collars))
        if free:
            counted = [not held for held in by_others(now, mechanism, free)]
            said["along"][Check.UNHELD_FORCE] = pressed(told_of(free), counted)
        if loose:
            told[Check.JOURNAL_REACH] = left(system, {name: report(name) for name in loose})
        if gaps:
            said["gaps"] = placed({name: report(name) for name in gaps}, now, mechanism)
        sharing = shared(now, report, mechanism)
        said |= {} if sharing is None else {"shared": sharing}
        return said | ({} if driven else _energies(now, formulation))

    return judged


def _depths(now: Instant, formulation: AbstractFormulation) -> Float[Array, " contacts"]:
    """Indentation of every possible contact [m]."""
    reports = formulation.forces(now).reports.values()
    depths = [positive_part(point.indentation) for report in reports for point in report.points]
    return sp.stack(depths)


def _energies(now: Instant, formulation: AbstractFormulation) -> dict[str, Float[Array, "3"]]:
    """Kinetic energy, potential energy, at most stored in contacts [J]; nothing where a load gives
    energy from outside."""
    forces = formulation.forces(now)
    if not sp.is_zero(forces.external_power):
        return {}
    kinetic, potential = energy.mechanical_energy(now.model.system, forces)
    points = [point for report in forces.reports.values() for point in report.points]
    stored = sp.total(point.normal_force * positive_part(point.indentation) for point in points)
    return {"energies": sp.stack([kinetic, potential, stored])}


def _small_energy(system: System) -> Any:
    """What lifts all masses by `LEAST_LIFT` of the longest arm [J]: what is at rest has no other
    energy to compare with."""
    mass = sp.total(link.mass for link in system.links)
    gravity = safe_sqrt(jnp.asarray(sp.dot(system.gravity, system.gravity), float))
    return LEAST_LIFT * mass * gravity * longest_arm(system)


def _gains(small: Any, energies: Float[Array, "looks 3"], moved: bool) -> Float[Array, " looks"]:
    """Energy above that of the start beside all that there was to change, and a `small` one [J].
    `moved`: rigid contacts that overlap at the start are moved apart, whatever that takes."""
    if moved:
        energies = energies.at[0].max(energies[1])
    kinetic, potential, stored = energies.T
    start = kinetic[0] + potential[0] + stored[0]
    scale = start - jnp.min(potential) + jnp.max(kinetic) + small
    return safe_divide(positive_part(kinetic + potential - start), scale)


def _openings(now: Instant) -> Float[Array, " loops"]:
    """Largest residual of each loop's closure: displacements beside the longest arm, cosines as
    they are."""
    openings, arm = [], longest_arm(now.model.system)
    for closure in now.model.system.closures:
        _, pose, _ = kinematics.relative_motion(closure, now.motions)
        values = zip(closure.rows, loops.residuals(closure.rows, pose), strict=True)
        shares = [abs(x) / arm if len(row) == 1 else abs(x) for row, x in values]
        openings.append(jnp.max(sp.stack(shares), initial=0.0))
    return jnp.stack(openings)
