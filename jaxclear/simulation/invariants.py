"""What a run finds out about itself that no finer run of the same model would tell, from up to
`MOST` of its saved states and its worn surfaces: open loops, energy gained, indentation beyond the
law, scars narrower than a cell, and what the model leaves out (`model_limits`). The run ends where
one of these is beyond what a run can mend.

Nothing here touches the motion: what reached its end does so with the same numbers, bit for bit.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.components.surface import AbstractSurface
from jaxclear.components.wear_map import AbstractWearMap
from jaxclear.formulations.base import AbstractFormulation
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent_reactions import touching
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import MANY, unstacked
from jaxclear.ground.numerics import positive_part, power, safe_divide, safe_sqrt
from jaxclear.ground.pose import REST
from jaxclear.ground.quantity import constant
from jaxclear.integrators.checks import (
    COLLARS,
    CONTACTS,
    IN_GAPS,
    LOOPS,
    MECHANISM,
    RUBBING,
    SLIDING,
    SURFACES,
    TOUCHING,
    UNHELD,
    Check,
    Checks,
    Outcome,
)
from jaxclear.multibody import constraints, dynamics, kinematics, loops, state
from jaxclear.multibody.contact_point import depths
from jaxclear.multibody.length_scales import rooms, shortest_part
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import System, longest_arm, wear_maps
from jaxclear.multibody.topology import moves_along
from jaxclear.native import through_rows
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.model_limits import (
    collared_bearings,
    contact_loss,
    coulomb_friction,
    gap_motion,
    gap_placements,
    in_gaps,
    indeterminate_forces,
    is_held_by_others,
    laws_of_others,
    lighter_masses,
    power_by_coulomb,
    pressed,
    share_along,
    sharing_of_forces,
    sliding_bearings,
    uncollared_bearings,
)
from jaxclear.simulation.wear import Worn, losses, losses_between

# Saved states of a run, at most, that are looked at: a loop that has come open stays so for long.
MOST = 50
# A surface that wears less than this share of the one that wears most is judged beside that.
NEGLIGIBLE = 0.01
# Share of the longest arm by which masses may rise without a cause: rounding and what contacts at
# rest are moved by stay far below it.
LEAST_LIFT = 0.01
# Figures of every look.
OF_LOOKS = (Check.INDENTATION, Check.LOOP_DRIFT, Check.LOOP_DRIFT_IN_GAPS)
Figures = dict[Check, Float[Array, "*looks places"]]


class Looks(NamedTuple):
    """The saving `intervals` at whose ends a run looks, at its start too; its `history`, of which
    nothing is differentiated, and its `model`."""

    intervals: np.ndarray
    history: StateHistory
    model: Model

    @property
    def rows(self) -> np.ndarray:
        """Their places among the saving times, the start in front."""
        return np.concatenate([[0], 1 + self.intervals])

    def of(self, function: Callable[[Instant], dict[str, Any]]) -> dict[str, Any]:
        """What a function of an instant says of every look. No derivatives."""
        rows, times, states = self.rows, jnp.asarray(self.history.time), self.history.states
        worn = self.history.read
        # Means of forces are those from one look to the next.
        starts, ends = np.append(rows[:1], rows[:-1]), np.append(rows[1:2], rows[1:])
        impulses = range(self.model.layout.impulse_start, self.model.layout.energy_start)

        def look_at(row: Any, begin: Any, end: Any) -> dict[str, Any]:
            before, after = (_entries_of_row(states, k, impulses) for k in (begin, end))
            length = times[end] - times[begin]
            means = [(late - early) / length for early, late in zip(before, after, strict=True)]
            time, entries = times[row], _entries_of_row(states, row)
            read = jax.tree.map(lambda depths: depths[row], worn)
            model, system = self.model, self.model.system
            q, v = state.unpack_motion(system, entries)
            model_at = Model(system, read, model.stabilisation, model.layout, model.projects)
            now = model_at.seeing(read)
            motions = kinematics.link_motions(system, q, v, time)
            return sp.dense(function(Instant(now, motions, q, v, time, entries, means)))

        return through_rows(look_at, rows, starts, ends)


def _entries_of_row(rows: Array, row: Any, columns: Any = None) -> list[Array]:
    """The numbers of a row of many, one by one: so a kernel reads any number of them by index."""
    columns = range(rows.shape[1]) if columns is None else columns
    if len(columns) >= MANY:
        numbers = jax.lax.dynamic_slice(rows, (row, columns[0]), (1, len(columns)))
        return unstacked(numbers[0])
    return [jax.lax.dynamic_slice(rows, (row, k), (1, 1))[0, 0] for k in columns]


def look_at_run(history: StateHistory, model: Model) -> Looks:
    """The looks of a run at itself: up to `MOST`, evenly spread, the last saving time among
    them."""
    count = len(history.time) - 1
    intervals = np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(int))
    return Looks(intervals, *constant((history, model)))


def judged(
    trajectory: Trajectory,
    model: Model,
    initial: Worn,
    residual: Any = None,
    steps_are_counted: bool = False,
) -> Trajectory:
    """The run with its checks; it ends early where one of them calls for it.

    Args:
        trajectory: whose saved states are looked at.
        model: of the run.
        initial: depth maps [m] at its start.
        residual: that of the laws for which steps solve (None: they solve for none).
        steps_are_counted: whether surfaces wear at the saving times alone.
    """
    history = trajectory.history
    looks, ends = look_at_run(history, model), jnp.asarray(history.time)[1:]
    figures, of_run, verdict = _figures_of_looks(looks)
    of_run |= wear_by_cells(model, initial, trajectory.worn)
    of_run |= wear_of_both_parts(model, history.states, trajectory.worn)
    if steps_are_counted:
        of_run |= path_between_saves(model, history.states)
    if residual is not None:
        of_run[Check.LAW_RESIDUAL] = jnp.atleast_1d(residual)
    if trajectory.extremes is not None and trajectory.extremes.contacts:
        depths = trajectory.extremes.indentation[: model.layout.joint_contacts]
        of_run[Check.INDENTATION] = depths / contact_radii(model.system) if depths.size else depths
    checks = _join_figures(model, history.formulation, of_run, figures, ends[looks.intervals])
    if verdict is None:
        return dataclasses.replace(trajectory, invariants=checks)
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
        invariants=checks,
    )


def _join_figures(
    model: Model,
    formulation: AbstractFormulation,
    of_run: Figures,
    of_looks: Figures,
    ends: Float[Array, " looks"],
) -> Checks:
    """All figures, those of looks as the worst that was met and when; what is not a number counts
    as infinite. A short run would pay for every array that it hands over, so they are two rows."""
    places = _place_names(model, formulation)
    of_run = {check: each for check, each in of_run.items() if places[check.of]}
    named = [(check, places[check.of]) for check in (*of_run, *of_looks)]
    if not named:
        return Checks()
    worst = [jnp.concatenate(list(of_run.values()))] if of_run else []
    when = [jnp.full(each.shape, ends[-1]) for each in worst]
    if of_looks:
        figures = jnp.concatenate(list(of_looks.values()), axis=1)
        figures = jnp.where(jnp.isnan(figures), jnp.inf, figures)
        worst.append(jnp.max(figures, axis=0))
        when.append(ends[jnp.argmax(figures, axis=0)])
    values = jnp.concatenate(worst)
    values = jax.lax.stop_gradient(jnp.where(jnp.isnan(values), jnp.inf, values))
    return Checks(values, jnp.concatenate(when), tuple(named))


def _outcome(figures: Figures, outcome: Any = None) -> Any:
    """`Outcome` that figures at an instant call for, `REACHED` where none is certainly wrong, or
    else this one; None where there is none."""
    for check, each in figures.items():
        if np.isfinite(check.ends_at):
            bad = jnp.any(~(each <= check.ends_at), axis=-1)
            default = int(Outcome.REACHED) if outcome is None else outcome
            outcome = jnp.where(bad, int(check.outcome), default)
    return outcome


def is_too_deep(system: System, depths: Float[Array, " contacts"]) -> Bool[Array, ""]:
    """Whether a contact is so deep [m] that its part has sunk into the wall that holds it."""
    if not system.bearings:
        return jnp.zeros((), bool)
    radii = contact_radii(system)
    return jnp.any(depths[: len(radii)] > Check.INDENTATION.ends_at * radii)


def contact_radii(system: System) -> Float[Array, " contacts"]:
    """Radius of journal or ball in every possible contact [m]."""
    return sp.stack([radius for one in system.bearings.values() for radius in one.radii])


def contact_names(model: Model) -> tuple[str, ...]:
    """The joint, or the coupling with play, of every possible contact."""
    joints = tuple(name for name, kinds in model.layout.memories for _ in kinds)
    return joints + tuple(name for name in model.layout.plays for _ in range(2))


def contact_labels(mechanism: Mechanism, model: Model) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """Their names, and of each whether it is pressed by an angle: the flanks of most couplings."""
    plays = [not moves_along(mechanism, mechanism.couplings[n]) for n in model.layout.plays]
    flanks = tuple(x for play in plays for x in (play, play))
    return contact_names(model), (False,) * model.layout.joint_contacts + flanks


def _place_names(model: Model, formulation: AbstractFormulation) -> dict[str, tuple[str, ...]]:
    """Names of the places of figures."""
    return {
        LOOPS: model.system.topology.loops,
        CONTACTS: contact_names(model)[: model.layout.joint_contacts],
        SURFACES: tuple(slot.bearing for slot in model.layout.wear),
        RUBBING: tuple(laws_of_others(model, formulation)),
        COLLARS: collared_bearings(model),
        UNHELD: uncollared_bearings(model),
        SLIDING: sliding_bearings(model.system),
        TOUCHING: tuple(joint.name for joint in touching(model.system)),
        IN_GAPS: tuple(in_gaps(model)),
        MECHANISM: ("",),
    }


def _figures_of_looks(looks: Looks) -> tuple[Figures, Figures, Array | None]:
    """What a run's looks at its saved states tell: figures by look, figures of the run as a whole,
    the `Outcome` that each look calls for (None: none ever ends a run)."""
    model, system = looks.model, looks.model.system
    means = looks.history.formulation.forces_are_means
    looked = looks.of(_make_look(looks))
    energies = looked.get("energies")
    # Without the start.
    at_looks, verdict = jax.tree.map(lambda each: each[1:], (looked["told"], looked.get("verdict")))
    figures = {check: at_looks[check] for check in OF_LOOKS if check in at_looks}
    if energies is not None:
        small = _small_energy(system, looks.history.time[-1] - looks.history.time[0])
        gains = _gains(small, energies, means)[1:, None]
        figures[Check.ENERGY_GAIN] = gains
        verdict = _outcome({Check.ENERGY_GAIN: gains}, verdict)
    times = looks.history.time[looks.rows]
    of_run = {check: share_along(each) for check, each in looked["along"].items()}
    if "rubbed" in looked:
        of_run[Check.COULOMB_FRICTION] = coulomb_friction(looked["rubbed"], times)
    if "gaps" in looked:
        heavy = lighter_masses(in_gaps(model), looks.history.mechanism)
        of_run[Check.GAP_MOTION] = gap_motion(looked["gaps"], times, heavy)
    if "shared" in looked:
        of_run[Check.INDETERMINATE_FORCE] = indeterminate_forces(looked["shared"])
    if Check.JOURNAL_REACH in at_looks:
        of_run[Check.JOURNAL_REACH] = jnp.max(at_looks[Check.JOURNAL_REACH], axis=0, initial=0.0)
    return figures, of_run, verdict


def _make_look(looks: Looks) -> Callable[[Instant], dict[str, Any]]:
    """What is worked out at every look."""
    system, formulation = looks.model.system, looks.history.formulation
    driven, mechanism = looks.history.mechanism.driven, looks.history.mechanism
    others, narrowest = laws_of_others(looks.model, formulation), _smallest_clearance(looks.model)
    collars, free = collared_bearings(looks.model), uncollared_bearings(looks.model)
    gaps, loose = in_gaps(looks.model), sliding_bearings(system)

    def judged(now: Instant) -> dict[str, Any]:
        by_check: dict[Check, Array] = {}
        by_check |= _loop_drifts(now, narrowest) if system.closures else {}
        verdict = _outcome({check: by_check[check] for check in OF_LOOKS if check in by_check})
        values = {"told": by_check} | ({} if verdict is None else {"verdict": verdict})
        # Worked out once, for all that ask.
        report = functools.cache(lambda name: formulation.contact(now, name))
        values |= {"rubbed": power_by_coulomb(others, report)} if others else {}
        reports = lambda names: [report(name) for name in names]
        values["along"] = {}
        if collars:
            values["along"][Check.COLLAR_FORCE] = pressed(reports(collars), [True] * len(collars))
        if free:
            counted = [not joint for joint in is_held_by_others(now, mechanism, free)]
            values["along"][Check.UNHELD_FORCE] = pressed(reports(free), counted)
        if loose:
            by_check[Check.JOURNAL_REACH] = contact_loss(
                system, {name: report(name) for name in loose}
            )
        if gaps:
            values["gaps"] = gap_placements({name: report(name) for name in gaps}, now, mechanism)
        sharing = sharing_of_forces(now, report, mechanism)
        values |= {} if sharing is None else {"shared": sharing}
        return values | ({} if driven else _energies_at(now, formulation))

    return judged


def _energies_at(now: Instant, formulation: AbstractFormulation) -> dict[str, Float[Array, "3"]]:
    """Kinetic energy, potential energy, at most stored in contacts [J]; nothing where a load gives
    energy from outside."""
    forces = formulation.forces(now)
    if not sp.is_zero(forces.external_power):
        return {}
    kinetic, potential = dynamics.mechanical_energy(now.model.system, forces)
    points = [point for report in forces.reports.values() for point in report.points]
    stored = sp.total(point.normal_force * positive_part(point.indentation) for point in points)
    return {"energies": sp.stack([kinetic, potential, stored])}


def _small_energy(system: System, duration: Any) -> Any:
    """What lifts all masses by `LEAST_LIFT` of the longest arm, or moves them by it within the
    duration [s] of a run [J]: what is at rest has no other energy to compare with."""
    mass = sp.total(link.mass for link in system.links)
    gravity = safe_sqrt(jnp.asarray(sp.dot(system.gravity, system.gravity), float))
    lift = LEAST_LIFT * longest_arm(system)
    return mass * (gravity * lift + 0.5 * (lift / duration) ** 2)


def _gains(small: Any, energies: Float[Array, "looks 3"], moved: bool) -> Float[Array, " looks"]:
    """Energy above that of the start beside all that there was to change, and a `small` one [J].
    `moved`: rigid contacts that overlap at the start are moved apart, whatever that takes."""
    if moved:
        energies = energies.at[0].max(energies[1])
    kinetic, potential, stored = energies.T
    start = kinetic[0] + potential[0] + stored[0]
    scale = start - jnp.min(potential) + jnp.max(kinetic) + small
    return safe_divide(positive_part(kinetic + potential - start), scale)


def _smallest_clearance(model: Model) -> Any:
    """Of joints that may open and of those that always touch [m]; None without clearance."""
    system = model.system
    gaps = [rooms(system)] if system.bearings else []
    gaps += [abs(sp.stack(depths(gap, REST, {}))) for gap in in_gaps(model).values()]
    return jnp.min(jnp.concatenate(gaps)) if gaps else None


def _loop_drifts(now: Instant, clearance: Any) -> Figures:
    """How far each loop is open, beside its shortest part and beside the smallest clearance."""
    opened, system = openings(now), now.model.system
    if clearance is None:
        return {Check.LOOP_DRIFT: opened}
    parts = sp.stack([shortest_part(system, closure) for closure in system.closures])
    return {Check.LOOP_DRIFT: opened, Check.LOOP_DRIFT_IN_GAPS: opened * parts / clearance}


def openings(now: Instant) -> Float[Array, " loops"]:
    """Largest residual of each loop's closure: displacements beside its shortest part, cosines as
    they are."""
    openings, system = [], now.model.system
    for closure in system.closures:
        part = shortest_part(system, closure)
        residuals = constraints.residuals(now.motions, closure)
        values = zip(closure.rows, residuals, strict=True)
        shares = [abs(x) / part if loops.is_length(row) else abs(x) for row, x in values]
        openings.append(jnp.max(sp.stack(shares), initial=0.0))
    return jnp.stack(openings)


def wear_by_cells(model: Model, initial: Worn, ended: Worn) -> Figures:
    """How narrow each worn scar is in cells, by contact (`narrowness`).

    It is 0 for a surface that has lost nothing since the run began. Depths of a scar hardly wider
    than a cell depend on the number of cells.

    Args:
        model: of the run.
        initial, ended: depth maps [m] at its start and end, by joint and surface.
    """
    if not ended or not model.layout.wear:
        return {}
    initial, ended = jax.lax.stop_gradient((initial, ended))
    least = NEGLIGIBLE * jnp.max(jnp.stack([*map(jnp.max, jax.tree.leaves(ended))]))
    shares = {}
    for joint, surfaces in wear_maps(model.system).items():
        for surface, (wear_map, _) in surfaces.items():
            depth, before = ended[joint][surface], initial[joint][surface]
            share = narrowness(wear_map, depth, least)
            shares[joint, surface] = jnp.where(jnp.any(depth > before), share, 0.0)
    places = [shares[slot.bearing, slot.surface] for slot in model.layout.wear]
    return {Check.WEAR_BY_CELLS: jnp.stack(places)}


def wear_of_both_parts(model: Model, states: Array, ended: Worn) -> Figures:
    """By which share of its depth each scar may be too deep because its joint's other part, which
    wears at the same place, is taken to wear evenly all round; nothing where one part wears.

    Parts that conform wear as if both losses were one scar (`tests/rigs/worn_scar.py`). Where its
    area goes with a power m of its depth (1/2 of a line contact, 1 of a point, and of a corner on a
    flat face), the depth goes with the power 1/(1 + m) of its volume. Scars are as alike as they
    are long, of round parts beside the circumference.

    Args:
        model: of the run.
        states: saved, shape (time, n).
        ended: depth maps [m] at its end, by joint and surface.
    """
    pairs = {
        joint: {surface: wear_map for surface, (wear_map, _) in surfaces.items()}
        for joint, surfaces in wear_maps(model.system).items()
        if len(surfaces) > 1 and all(isinstance(m, AbstractSurface) for m, _ in surfaces.values())
    }
    if not any(slot.bearing in pairs for slot in model.layout.wear):
        return {}
    states, ended = jax.lax.stop_gradient((states, ended))
    lost, shares = losses(model.layout, states[0], states[-1]), {}
    for joint, surfaces in pairs.items():
        depths, areas = ended[joint], {name: m.areas() for name, m in surfaces.items()}
        is_flat = all(m.flat for m in surfaces.values())
        if is_flat:
            # Each wall by itself.
            wall = jnp.argmax(sum(jnp.max(depths[s], axis=1) for s in surfaces))
            depths, areas = ({s: each[s][wall] for s in surfaces} for each in (depths, areas))
        worn = {s: jnp.sum(depths[s] * areas[s]) for s in surfaces}
        deepest = {s: jnp.max(depths[s]) for s in surfaces}
        scars = jnp.stack([safe_divide(worn[s], deepest[s]) for s in surfaces])
        alike = safe_divide(jnp.min(scars), jnp.max(scars))
        if not is_flat:
            alike = alike * (1.0 - jnp.max(scars) / jnp.sum(areas[next(iter(surfaces))]))
        for surface, wear_map in surfaces.items():
            volumes, places = lost[joint, surface]
            place = safe_divide(volumes @ places, jnp.sum(volumes))
            sizes = lambda d, m=wear_map, at=place: jnp.stack(m.cells_per_contact(at, d))
            depth = sum(deepest.values())
            cells, slopes = jax.jvp(sizes, (depth,), (depth,))
            growth = -jnp.sum(safe_divide(slopes, cells))
            share = safe_divide(worn[surface], sum(worn.values()))
            figure = alike * (1.0 - power(share, growth / (1.0 + growth)))
            shares[joint, surface] = jnp.where(jnp.sum(volumes) > 0, figure, 0.0)
    slots = model.layout.wear
    return {Check.BOTH_WORN: sp.stack([shares.get((s.bearing, s.surface), 0.0) for s in slots])}


def path_between_saves(model: Model, states: Array) -> Figures:
    """The mean path of each contact on the surface that it wears from one saving time to the next
    [cells], as what it loses there weighs it; where one step at one place is all that lies between
    these, half of that over two intervals.

    Args:
        model: of the run.
        states: saved, shape (time, n).
    """
    if not model.layout.wear:
        return {}
    maps = wear_maps(model.system)
    means: dict[tuple[str, str], Any] = {}
    for every in range(1, min(len(states), 3)):
        for at, lost in losses_between(model.layout, constant(states), every).items():
            volumes, places = lost
            paths = jax.vmap(jax.vmap(maps[at[0]][at[1]][0].path))(places)
            paths = jnp.where(volumes > 0, jnp.broadcast_to(paths, volumes.shape), 0.0)
            mean = safe_divide(jnp.sum(volumes * paths), every * jnp.sum(volumes))
            means[at] = jnp.maximum(means.get(at, 0.0), mean)
    slots = model.layout.wear
    return {Check.WEAR_AT_SAVES: jnp.stack([means[s.bearing, s.surface] for s in slots])}


def narrowness(
    wear_map: AbstractWearMap, depth: Float[Array, "around along"], least: Array | float = 0.0
) -> Array:
    """Relative difference between the deepest cell and the deepest mean over 3 x 3 cells [1].

    A mean over three cells is nine times as far off as that over one where a scar is smooth, so
    this tells how many cells a scar is wide.

    Args:
        wear_map: cells of the surface.
        depth: worn depth of each cell [m].
        least: smallest depth [m] beside which the difference counts.
    """
    deepest = jnp.max(depth)
    return safe_divide(deepest - jnp.max(wear_map.over_three(depth)), jnp.maximum(deepest, least))
