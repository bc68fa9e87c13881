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

from jaxclear.formulations.base import AbstractFormulation
from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.ground.pose import REST
from jaxclear.integrators.checks import CONTACTS, LOOPS, SPEEDS, SURFACES, WHOLE, Check
from jaxclear.integrators.figures import Checks, Figure
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody import contact_point, energy, kinematics, loops
from jaxclear.multibody.reach import rooms
from jaxclear.multibody.system import System, longest_arm
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.damper_steps import damper_steps, damping
from jaxclear.simulation.friction_steps import contacts, friction_steps, rubbing
from jaxclear.simulation.looks import Looks, look
from jaxclear.simulation.rebound import rebound_steps
from jaxclear.simulation.spot_checks import GAPS, beside_way
from jaxclear.simulation.tally import LENGTHS, Figures, Tally

# Share of the longest arm by which masses may rise without a cause: rounding and what contacts at
# rest are moved by stay far below it.
LEAST_LIFT = 0.01


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
    looks, ends = look(history, model), jnp.asarray(history.time)[1:]
    steps = {check: figures[check] for check in LENGTHS if check in figures}
    sunk = figures.get(Check.INDENTATION)
    seen, rubbed, inside, ways = _of_saved_states(looks, steps, sunk)
    if ways is None:
        ways = beside_way(model, history.states[looks.rows], tally, history.time)
    inside, ways = jax.lax.stop_gradient((inside, ways))
    trajectory = dataclasses.replace(trajectory, places=inside, ways=ways)
    of_run = {check: each[None] for check, each in (windows | rubbed).items()}
    met, when = dict(tally.worst), dict(tally.when)
    rebound = met.pop(Check.REBOUND_STEP, None)
    if rebound is not None:
        rises = met[Check.CONTACT_STEP], met[Check.INDENTATION]
        of_run[Check.REBOUND_STEP] = rebound_steps(model, *rises, rebound)[None]
    places = _places(model)
    parts = [(seen, ends[looks.intervals]), (of_run, ends[-1:])]
    others = _over_run([(jax.lax.stop_gradient(each), at) for each, at in parts], places)
    checks = Checks(_met(_of_contacts(model.system, met), when, places) | others)
    judged = seen if sunk is None else {Check.INDENTATION: sunk / _radii(model.system)} | seen
    verdict = _ending(judged)
    if jnp.ndim(verdict) == 0:
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


def _met(worst: Figures, when: Figures, places: dict[str, tuple[str, ...]]) -> dict[Check, Figure]:
    """The worst figures that were met, and when; `places` as for `_over_run`."""
    return {
        check: Figure(jnp.where(jnp.isnan(each), jnp.inf, each), when[check], places[check.of])
        for check, each in worst.items()
        if places[check.of]
    }


def _over_run(
    parts: list[tuple[dict[Check, Float[Array, "looks places"]], Float[Array, " looks"]]],
    places: dict[str, tuple[str, ...]],
) -> dict[Check, Figure]:
    """The worst of figures found by looks, at such times [s]; `places`: names of the places by what
    they are of. What is not a number counts as infinite.
    """
    figures = {}
    for found, ends in parts:
        for check, each in found.items():
            if not places[check.of]:
                continue
            known = jnp.where(jnp.isnan(each), jnp.inf, each)
            latest = jnp.argmax(known, axis=0)
            worst = jnp.take_along_axis(known, latest[None], axis=0)[0]
            figures[check] = Figure(worst, ends[latest], places[check.of])
    return figures


def _ending(found: dict[Check, Float[Array, "looks places"]]) -> Float[Array, " looks"]:
    """`Outcome` that the figures of each look call for: `REACHED` where none is certainly wrong."""
    outcome: Any = Outcome.REACHED
    for check, each in found.items():
        if np.isfinite(check.ends_at):
            bad = jnp.any(~(each <= check.ends_at), axis=-1)
            outcome = jnp.where(bad, check.outcome, outcome)
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


def _places(model: Model) -> dict[str, tuple[str, ...]]:
    """Names of the places of figures."""
    contacts = tuple(name for name, kinds in model.layout.memories for _ in kinds)
    topology = model.system.topology
    return {
        LOOPS: topology.loops,
        SPEEDS: tuple(b.name for b in topology.branches for _ in range(b.speed_count)),
        CONTACTS: contacts,
        SURFACES: tuple(slot.bearing for slot in model.layout.wear),
        WHOLE: ("",),
    }


def _of_saved_states(
    looks: Looks, steps: dict[Check, Array], depths: Array | None
) -> tuple[
    dict[Check, Float[Array, "looks places"]],
    dict[Check, Float[Array, " contacts"]],
    Float[Array, "looks places"] | None,
    Float[Array, "looks places"] | None,
]:
    """Figures that the looks tell, and those of friction, of the run as a whole, also from the
    lengths [s] of `steps` there and the largest indentations [m] since the saving time before
    (None: those seen count); and where parts were in their gaps, and bodies on their ways (None:
    there are no gaps)."""
    model, formulation = looks.model, looks.seen.formulation
    system = model.system
    driven = looks.seen.mechanism.driven
    damped = steps.pop(Check.DAMPER_STEP, None)
    damped = damped if damping(system) else None
    steps = steps if rubbing(model) else {}
    looking = bool(steps) or damped is not None
    sinking = depths is None and bool(system.bearings) and not formulation.forces_are_means

    def judged(now: Instant) -> dict[str, Array]:
        return (
            ({"openings": _openings(now)} if system.closures else {})
            | ({} if driven else _energies(now, formulation))
            | ({"contacts": contacts(now, formulation)} if looking else {})
            | ({"depths": _depths(now, formulation)} if sinking else {})
            | ({"places": _in_gaps(now), "centres": _centres(now)} if system.bearings else {})
        )

    said = looks.of(judged)
    found = {}
    if "depths" in said:
        found[Check.INDENTATION] = said["depths"][1:] / _radii(system)
    if "openings" in said:
        found[Check.LOOP_DRIFT] = said["openings"][1:]
    if "energies" in said:
        gains = _gains(_small_energy(system), said["energies"], formulation.forces_are_means)
        found[Check.ENERGY_GAIN] = gains[1:, None]
    inside, ways = said.get("places"), None
    if inside is not None:
        ways = _ways(system, said["centres"], inside)
    of_steps = {}
    if damped is not None:
        of_steps[Check.DAMPER_STEP] = damper_steps(said["contacts"][1:], damped)
    if steps:
        of_steps |= friction_steps(model, said["contacts"][1:], depths, steps)
    return found, of_steps, inside, ways


def _centres(now: Instant) -> Float[Array, " components"]:
    """Where the centres of mass are [m] (3 components a body)."""
    places: list[Any] = []
    for link, motion in zip(now.model.system.links, now.motions, strict=True):
        inner = sp.scale(safe_divide(1.0, link.mass), link.first_moment)
        places += motion.pose.point(inner)
    return sp.stack(places)


def _ways(
    system: System, centres: Float[Array, "looks centres"], places: Float[Array, "looks places"]
) -> Float[Array, "looks centres"]:
    """How far the centres of mass [m] have gone, beside the longest way, or `GAPS` times as far as
    a part comes from the middle of its gap, where it has such `places`, if that is more."""
    gone = centres - centres[0]
    off_middle = safe_sqrt(jnp.sum(places.reshape(len(places), -1, 3) ** 2, axis=-1))
    furthest = jnp.max(off_middle * rooms(system), initial=0.0)
    return safe_divide(gone, jnp.maximum(jnp.max(abs(gone), initial=0.0), GAPS * furthest))


def _in_gaps(now: Instant) -> Float[Array, " components"]:
    """Where each contact's parts are in their gap, beside its width: the vector from the middle
    along which it closes, in the bearing's axes (3 components a contact)."""
    places: list[Any] = []
    for name, bearing in now.model.system.bearings.items():
        _, pose, _ = kinematics.relative_motion(bearing.closure, now.motions)
        rooms = contact_point.depths(bearing.joint, REST, {})
        contacts = contact_point.gap_function(bearing.joint, pose, now.model.worn.get(name, {}))
        for room, contact in zip(rooms, contacts, strict=True):
            width = abs(room)
            share = safe_divide(contact.indentation + width, width)
            places += sp.scale(share, contact.slope)
    return sp.stack(places)


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
