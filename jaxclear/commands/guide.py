"""The study of the slider in a guide from one command: permanent contact beside a compliant
run with a small clearance.

Writes figures (PNG) and tables (CSV) into a folder and prints what it found.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import StudyFolder, report_warnings
from jaxclear.components.clearance import SITUATIONS
from jaxclear.ground.table import as_table
from jaxclear.plot.canvas import warned
from jaxclear.scenes.guide import CRANK_SPEED, guide

TURN = 2 * np.pi / CRANK_SPEED
# An even number of steps: one of them ends where the slider turns round.
STEPS = 2000
# Gap of the compliant run [m] and the tolerance it is integrated with.
SMALL_CLEARANCE, RTOL = 1e-5, 1e-6


def impacts(compliant: Any, instants: np.ndarray) -> pandas.DataFrame:
    """For every switching: when a corner of the small clearance's model next strikes a wall after
    it let go.
    """
    moment, touch = np.asarray(compliant.time), np.asarray(compliant.contact("P").normal_force) > 0
    strikes = moment[1:][(touch[1:] & ~touch[:-1]).any(axis=1)]
    rows = []
    for instant in instants:
        after = strikes[strikes > instant]
        rows.append((instant, after[0] if len(after) else np.nan))
    table = as_table(rows, columns=["switching [s]", "next impact [s]"])
    table["delay [ms]"] = 1e3 * (table["next impact [s]"] - table["switching [s]"])
    return table


def _draw_wear(touching: Any) -> dict[str, Figure]:
    """Figures of the surfaces that wear, and what each loses, said."""
    figures = {}
    for surface in touching.worn.get("P", {}):
        figures[f"wear_of_the_{surface}"] = plot.wear_unrolled(touching, "P", surface)
        volume = float(touching.worn_volume("P", surface)[-1])
        deepest = float(touching.worn_depth("P", surface).max())
        print(f"the {surface} loses {1e9 * volume:.3g} mm3 a turn, {1e9 * deepest:.3g} nm at most")
    return figures


def study(
    folder: Path, clearance: float = SMALL_CLEARANCE, wear: bool = False, show: bool = True
) -> None:
    """Runs one turn of the crank with permanent and compliant contact; writes tables and figures.

    Args:
        folder: for the files.
        clearance: of the compliant run [m].
        wear: whether both parts wear in the run with permanent contact.
        show: whether progress bars are shown.
    """
    files = StudyFolder(folder)
    touching = jc.simulate(
        guide("wearing" if wear else "guide"),
        TURN,
        save=STEPS + 1,
        integrator=jc.integrator.NonColliding(TURN / STEPS),
        balance=True,
        progress_bar=show,
    )
    compliant = jc.simulate(
        guide(clearance=clearance, friction="regularised"),
        TURN,
        save=4 * STEPS + 1,
        integrator=jc.integrator.Adaptive(rtol=RTOL),
        progress_bar=show,
    )
    report_warnings({"permanent contact": touching, "small clearance": compliant})
    switchings = touching.switchings("P")
    instants = np.asarray(switchings["time [s]"])
    tables = {"switchings": switchings, "impacts": impacts(compliant, instants)}
    files.write_tables(**tables)
    for table in tables.values():
        print(f"{table}\n")
    energy = touching.energy_balance()
    error = float(np.abs(np.asarray(energy.error)).max())
    print(
        f"friction takes {float(energy.friction_loss[-1]):.1f} J a turn; the balance is open by at "
        f"most {error:.2g} J"
    )
    figures = {
        "corner_forces": corner_forces(touching, instants),
        "switchings": switching_window(touching, compliant, instants),
        "reactions": reactions(touching, compliant, instants),
    }
    figures |= _draw_wear(touching)
    files.write_figures(**figures)
    print(f"\n{files.sentence()}")


CORNERS = ("lower, back", "lower, front", "upper, back", "upper, front")
# Colour and line of each corner: the colour tells the side, the line the end.
LOOKS = (("C0", "-"), ("C0", "--"), ("C1", "-"), ("C1", "--"))
JOINTS = {"O": "ground and crank", "A": "crank and slider"}
LINE = len(SITUATIONS) - 1
# Situations of the strip: those of a joint, a line told apart by its side.
SITUATION_NAMES = (*SITUATIONS[:LINE], "a line on the lower side", "a line on the upper side")
COLOURS = ("#bdbdbd", "#4c9f70", "#d1495b", "C0", "C1")
# Half the length of the window about a switching [s].
HALF_WINDOW = 0.02


def _crank_angle_degrees(run: Any) -> np.ndarray:
    return np.degrees(CRANK_SPEED * np.asarray(run.time))


def _mark_switchings(axes: Any, instants: np.ndarray) -> None:
    """Vertical lines at the switchings."""
    for axis in np.ravel(axes):
        for i, angle in enumerate(np.degrees(CRANK_SPEED * instants)):
            label = "switching" if i == 0 else None
            axis.axvline(angle, color="k", lw=0.7, ls=":", label=label, zorder=0)


def _plot_corners(axis: Any, over: np.ndarray, forces: np.ndarray) -> None:
    """A line for each corner; gaps where it does not touch."""
    for force, name, (colour, line) in zip(forces.T, CORNERS, LOOKS, strict=True):
        axis.plot(over, force, line, color=colour, lw=1.3, label=name)
    axis.set_ylim(bottom=0)


def corner_forces(run: Any, instants: np.ndarray) -> Figure:
    """Forces of the four corners and friction over the crank angle, and how the joint carries."""
    figure = Figure(figsize=(8.5, 7.0), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(5, 3, 0.6))
    contact, angle = run.contact("P"), _crank_angle_degrees(run)
    # Means over the saving intervals belong to their middles.
    middle = 0.5 * (angle[1:] + angle[:-1])
    forces, total = np.asarray(contact.normal_force)[1:], np.asarray(contact.force)[1:]
    _plot_corners(axes[0], middle, np.where(forces > 0, forces, np.nan))
    axes[0].set_ylabel("force of a corner [N]")
    axes[1].plot(middle, total[:, 2], color="C3", lw=1.2)
    axes[1].axhline(0.0, color="k", lw=0.5)
    axes[1].set_ylabel("friction on the\nslider, outwards [N]")
    _mark_switchings(axes[:2], instants)
    axes[0].legend(fontsize=8, loc="upper right")
    codes = np.asarray(run.situations("P"))[1:]
    upper = total[:, 0] < 0
    _draw_band(axes[2], angle, np.where((codes == LINE) & upper, LINE + 1, codes))
    axes[0].set_title("Slider in its guide: which corners carry")
    return warned(figure, {"": run})


def _draw_band(axis: Any, edges: np.ndarray, codes: np.ndarray) -> None:
    """A band coloured by contact situation; short situations are widened to be seen."""
    changes = np.flatnonzero(np.diff(codes)) + 1
    least = (edges[-1] - edges[0]) / 400
    present = set()
    for first, last in zip([0, *changes], [*changes, len(codes)], strict=True):
        code, start = int(codes[first]), edges[first]
        width = max(edges[last] - start, least)
        above = 2 if width == least else 1
        axis.axvspan(start, start + width, color=COLOURS[code], zorder=above)
        present.add(code)
    handles = [Patch(color=COLOURS[code], label=SITUATION_NAMES[code]) for code in sorted(present)]
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.9), "frameon": False}
    axis.legend(handles=handles, fontsize=8, ncols=3, **below)
    axis.set_yticks([])
    axis.set_xlim(edges[0], edges[-1])
    axis.set_xticks(np.arange(0, edges[-1] + 1, 45))
    axis.set_xlabel("crank angle [°]")


def switching_window(run: Any, compliant: Any, instants: np.ndarray) -> Figure:
    """Corner forces around two switchings, in permanent contact and with a small clearance.

    Args:
        run: with permanent contact.
        compliant: with a small clearance.
        instants: of the switchings [s]; the first and last are shown.
    """
    figure = Figure(figsize=(9.5, 5.5), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col")
    gap = 1e6 * float(compliant.mechanism.connections["P"].joint.clearance)
    for column, centre in enumerate((instants[0], instants[-1])):
        # Means over the saving intervals belong to their middles.
        for axis, one, back in ((axes[0, column], run, 0.5), (axes[1, column], compliant, 0.0)):
            moment = np.asarray(one.time)
            here = np.flatnonzero(np.abs(moment - centre) < HALF_WINDOW)
            middle = moment - back * (moment[1] - moment[0])
            _plot_corners(axis, 1e3 * middle[here], np.asarray(one.contact("P").normal_force)[here])
            for instant in instants[np.abs(instants - centre) < HALF_WINDOW]:
                axis.axvline(1e3 * instant, color="k", lw=0.7, ls=":")
        axes[1, column].set_xlabel("time [ms]")
        axes[0, column].set_title(f"switching at {1e3 * centre:.1f} ms")
    axes[0, 0].set_ylabel("corner force, permanent contact [N]")
    axes[1, 0].set_ylabel(f"corner force, gap of {gap:g} µm [N]")
    axes[0, 0].legend(fontsize=8)
    return warned(figure, {"permanent contact": run, "small clearance": compliant})


def reactions(run: Any, compliant: Any, instants: np.ndarray) -> Figure:
    """Reactions of the crank's two joints, beside the compliant run, and the difference.

    Args:
        run: with permanent contact.
        compliant: with a small clearance.
        instants: of switchings [s], which are marked.
    """
    figure = Figure(figsize=(8.5, 7.5), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    angle, other_angle = _crank_angle_degrees(run), _crank_angle_degrees(compliant)
    for axis, (joint, name) in zip(axes[:2], JOINTS.items(), strict=True):
        force, other = (np.asarray(one.reaction(joint).force) for one in (run, compliant))
        force, other = np.linalg.norm(force, axis=1), np.linalg.norm(other, axis=1)
        label = "regularised friction, small clearance"
        axis.plot(other_angle, other, color="C1", lw=0.8, label=label)
        axis.plot(angle, force, color="C0", lw=1.4, label="permanent contact, Coulomb")
        axis.set_ylabel(f"{name} [N]")
        # Peaks of impacts would hide everything else.
        axis.set_ylim(0, 1.3 * np.max(force))
        difference = np.abs(np.interp(run.time, compliant.time, other) - force)
        axes[2].plot(angle, difference + 1e-3, lw=0.8, label=name)
    axes[2].set_yscale("log")
    axes[2].set_ylabel("difference [N]")
    axes[2].set_xlabel("crank angle [°]")
    axes[2].set_xlim(0, 360)
    axes[2].set_xticks(np.arange(0, 361, 45))
    _mark_switchings(axes, instants)
    axes[0].legend(fontsize=8, loc="upper right")
    axes[2].legend(fontsize=8, loc="upper right")
    axes[0].set_title("Reactions of the crank's joints over one turn")
    return warned(figure, {"permanent contact": run, "small clearance": compliant})
