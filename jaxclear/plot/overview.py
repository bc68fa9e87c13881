"""A run, or positions of a mechanism, at a glance; and the figure of any result."""

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxclear.components.beam import whole_bodies
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import expect
from jaxclear.ground.wording import described, listed
from jaxclear.plot.canvas import check_run, key, panels, readable, warned
from jaxclear.plot.identification import identification, remaining_life
from jaxclear.plot.life import design, largest, steady_cycle, wear_life, wear_life_sample
from jaxclear.plot.motion import pointing_budget
from jaxclear.plot.signal import reached
from jaxclear.plot.studies import (
    corrected_statistics,
    monte_carlo,
    multi_fidelity,
    reliability,
    screening,
    sensitivity,
    shapley_effects,
    sobol_indices,
    surface,
    sweep,
    work_precision,
    worst_case,
)
from jaxclear.results.pointing_error import PointingError
from jaxclear.results.response import PeakContactForce
from jaxclear.results.trajectory import Trajectory
from jaxclear.statics.positions import Positions
from jaxclear.studies.advice import Advice
from jaxclear.studies.design.largest import Largest
from jaxclear.studies.design.result import Design
from jaxclear.studies.fidelity.result import MultiFidelity
from jaxclear.studies.identification.remaining_life import RemainingLife
from jaxclear.studies.identification.result import Identified
from jaxclear.studies.life.result import WearLife
from jaxclear.studies.life.steady_cycle import SteadyCycle
from jaxclear.studies.life.wear_life import WearLifeSample
from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.reliability.result import Reliability
from jaxclear.studies.screening import Screening
from jaxclear.studies.sensitivity.derivative import Sensitivity
from jaxclear.studies.statistics.shapley import ShapleyEffects
from jaxclear.studies.statistics.sobol_indices import SobolIndices
from jaxclear.studies.store.result import Campaign
from jaxclear.studies.surface.correction import CorrectedStatistics
from jaxclear.studies.surface.response_surface import ResponseSurface
from jaxclear.studies.sweep import Sweep
from jaxclear.studies.worst_case import WorstCase


@answering
def overview(run: Trajectory, *, ax: Any = None) -> Any:
    """Displacement and angular velocity of each body, and normal forces of joints with contacts.

    Displacements are distances from the start. Dotted lines show the largest force of a contact in
    all steps.

    Args:
        run: the run.
        ax: three `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `run` is no run.
    """
    check_run(run)
    sheet = panels("overview", ax, 3, 1, (8.0, 8.0), sharex=True)
    places, turns, forces = sheet.axes.flat
    mask = reached(run, -np.inf)
    time = np.asarray(run.time)[mask]
    distances, spins = {}, {}
    for name in whole_bodies(run.mechanism.bodies):
        motion = run.body(name)
        com = np.asarray(motion.com)[mask]
        distances[name] = np.linalg.norm(com - com[0], axis=1)
        spins[name] = np.asarray(motion.spin)[mask]
    factor, unit = readable(np.concatenate(list(distances.values())), "m")
    for name, distance in distances.items():
        places.plot(time, factor * distance, lw=1.0, label=name)
    places.set_ylabel(f"displacement from the start [{unit}]")
    about_z = all(np.all(spin[:, :2] == 0.0) for spin in spins.values())
    for name, spin in spins.items():
        rate = spin[:, 2] if about_z else np.linalg.norm(spin, axis=1)
        turns.plot(time, rate, lw=1.0, label=name)
    turns.set_ylabel(f"angular {'velocity' if about_z else 'speed'} [rad/s]")
    draw_forces(forces, run, *run.formulation.contact_joints(run.mechanism))
    forces.set_xlabel("time [s]")
    key(places)
    if forces.lines:
        key(forces)
    sheet.title(run.result.partition(",")[0].rstrip(".") + ".")
    return warned(sheet, {"": run})


def draw_forces(axis: Any, run: Trajectory, *joints: str) -> None:
    """Draw normal forces of joints at the saving times, and their peaks as dotted lines.

    Args:
        axis: matplotlib axes to draw in.
        run: the run.
        joints: names of the joints, whose contacts are summed.
    """
    mask = reached(run, -np.inf)
    saved = [np.asarray(run.contact(name).normal_force)[mask].sum(axis=1) for name in joints]
    peaks = [float(PeakContactForce(name)(run)) for name in joints]
    factor, unit = readable([*peaks, *(forces_of.max() for forces_of in saved)], "N")
    for number, (name, force, peak) in enumerate(zip(joints, saved, peaks, strict=True)):
        how: dict[str, Any] = {"color": f"C{number}", "lw": 0.8}
        axis.plot(np.asarray(run.time)[mask], factor * force, label=name, **how)
        label = f"largest of a contact in all steps, {factor * peak:.4g} {unit}"
        axis.axhline(factor * peak, ls=":", label=label, **how)
    # A peak between saved instants may be a hundred times as high: its line then lies outside.
    highest = max((factor * force.max() for force in saved), default=0.0)
    if highest > 0:
        axis.set_ylim(top=1.1 * highest)
    axis.set_ylabel(f"normal force [{unit}]")


@answering
def positions(result: Positions, *, ax: Any = None) -> Any:
    """Centres of mass (x and y), and journals in their gaps, over positions of the drives.

    Args:
        result: a `Positions`, as `jaxclear.positions` returns it.
        ax: two `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    expect(result, Positions, "the positions", "what jaxclear.positions returns")
    sheet = panels("positions", ax, 1, 2, (10.0, 4.4))
    places_axis, seats_axis = sheet.axes.flat
    coms = {name: np.asarray(result.body(name).com) for name in result.scene.mechanism.bodies}
    factor, unit = readable(np.concatenate(list(coms.values())), "m")
    for name, com in coms.items():
        places_axis.plot(factor * com[:, 0], factor * com[:, 1], "o-", ms=3, lw=0.8, label=name)
    places_axis.set_aspect("equal", adjustable="datalim")
    places_axis.set_xlabel(f"x [{unit}]")
    places_axis.set_ylabel(f"y [{unit}]")
    key(places_axis)
    seats = {name: np.asarray(result.offset(name)) for name in result.seats}
    every = np.concatenate(list(seats.values())) if seats else np.zeros((0, 3))
    factor, unit = readable(every, "m")
    for name, offset in seats.items():
        seats_axis.plot(factor * offset[:, 0], factor * offset[:, 1], "o", ms=3, label=name)
    if len(every):
        # Journals that all lie in one place, too, have room around them.
        low, high = factor * every.min(axis=0), factor * every.max(axis=0)
        half = max(0.55 * (high - low)[:2].max(), 1e-3 * np.abs(factor * every).max()) or 1.0
        seats_axis.set_xlim(0.5 * (low + high)[0] - half, 0.5 * (low + high)[0] + half)
        seats_axis.set_ylim(0.5 * (low + high)[1] - half, 0.5 * (low + high)[1] + half)
    seats_axis.set_aspect("equal")
    seats_axis.set_xlabel(f"x of the journal in its bearing [{unit}]")
    seats_axis.set_ylabel(f"y [{unit}]")
    if seats:
        key(seats_axis)
    missing = int(np.sum(~np.asarray(result.is_solved)))
    sheet.title(f"{len(result.is_solved)} positions, {missing} not found")
    return sheet.done()


# The figure of each kind of result.
FIGURES: dict[type, Callable] = {
    Advice: work_precision,
    Campaign: lambda campaign, **how: monte_carlo(campaign.sample, **how),
    CorrectedStatistics: corrected_statistics,
    Design: design,
    Identified: identification,
    Largest: largest,
    MonteCarlo: monte_carlo,
    MultiFidelity: multi_fidelity,
    PointingError: pointing_budget,
    Positions: positions,
    Reliability: reliability,
    RemainingLife: remaining_life,
    ResponseSurface: surface,
    Screening: screening,
    Sensitivity: sensitivity,
    SteadyCycle: steady_cycle,
    ShapleyEffects: shapley_effects,
    SobolIndices: sobol_indices,
    Sweep: sweep,
    Trajectory: overview,
    WearLife: wear_life,
    WearLifeSample: wear_life_sample,
    WorstCase: worst_case,
}


@answering
def result(result: Any, *, ax: Any = None) -> Any:
    """The figure that belongs to a result of jaxclear, a run or the answer of a study.

    Args:
        result: the result.
        ax: `matplotlib.axes.Axes` to draw in, as many as the figure's own function takes; by
            default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is no result with a figure.
    """
    draw = FIGURES.get(type(result))
    if draw is None:
        kinds = listed(sorted(kind.__name__ for kind in FIGURES))
        raise ValueError(f"the result is {described(result)}; it must be one of {kinds}.")
    return draw(result, ax=ax)
