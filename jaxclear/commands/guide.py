"""The study of the slider in a guide from one command: joints that always touch beside a compliant
run with a small clearance.

Writes figures (PNG) and tables (CSV) into a folder and prints what it found.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import jaxclear as jc
from jaxclear.components.permanent import SITUATIONS
from jaxclear.scenes.guide import CRANK_SPEED, guide

TURN = 2 * np.pi / CRANK_SPEED
# An even number of steps: one of them ends where the slider turns round.
STEPS = 2000
# Gap of the compliant run [m] and the tolerance it is integrated with.
SMALL_CLEARANCE, RTOL = 1e-5, 1e-6
CORNERS = ("lower, back", "lower, front", "upper, back", "upper, front")
JOINTS = {"O": "ground and crank", "A": "crank and slider"}
LINE = len(SITUATIONS) - 1
# Situations of the strip: those of a joint, a line told apart by its side.
SHOWN = (*SITUATIONS[:LINE], "a line on the lower side", "a line on the upper side")
COLOURS = ("#bdbdbd", "#4c9f70", "#d1495b", "C0", "C1")


def _degrees(run: Any) -> np.ndarray:
    return np.degrees(CRANK_SPEED * np.asarray(run.time))


def _mark(axes: Any, instants: np.ndarray) -> None:
    """Vertical lines at the switchings."""
    for axis in np.ravel(axes):
        for i, instant in enumerate(instants):
            angle = np.degrees(CRANK_SPEED * instant)
            axis.axvline(
                angle, color="k", lw=0.7, ls=":", label="switching" if i == 0 else None, zorder=0
            )


def corner_forces(run: Any, instants: np.ndarray) -> Figure:
    """Forces of the four corners and friction over the crank angle, and how the joint carries."""
    figure = Figure(figsize=(8.5, 7.0), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(5, 3, 0.6))
    contact, angle = run.contact("P"), _degrees(run)
    # Means over the saving intervals belong to their middles.
    middle = 0.5 * (angle[1:] + angle[:-1])
    for i, (name, style) in enumerate(zip(CORNERS, ("-", "--", "-", "--"), strict=True)):
        force = np.asarray(contact.normal_force)[1:, i]
        axes[0].plot(
            middle,
            np.where(force > 0, force, np.nan),
            style,
            color=("C0", "C1")[i // 2],
            lw=1.3,
            label=name,
        )
    axes[0].set_ylabel("force of a corner [N]")
    axes[0].set_ylim(bottom=0)
    axes[1].plot(middle, np.asarray(contact.force)[1:, 2], color="C3", lw=1.2)
    axes[1].axhline(0.0, color="k", lw=0.5)
    axes[1].set_ylabel("friction on the\nslider, outwards [N]")
    _mark(axes[:2], instants)
    axes[0].legend(fontsize=8, loc="upper right")
    codes = np.asarray(run.situations("P"))[1:]
    upper = np.asarray(contact.force)[1:, 0] < 0
    _strip(axes[2], angle, np.where((codes == LINE) & upper, LINE + 1, codes))
    axes[0].set_title("Slider in its guide: which corners carry")
    return figure


def _strip(axis: Any, edges: np.ndarray, codes: np.ndarray) -> None:
    """A band coloured by contact situation; short situations are widened to be seen."""
    changes = np.flatnonzero(np.diff(codes)) + 1
    least = (edges[-1] - edges[0]) / 400
    seen = []
    for first, last in zip([0, *changes], [*changes, len(codes)], strict=True):
        code = int(codes[first])
        width = max(edges[last] - edges[first], least)
        axis.axvspan(
            edges[first],
            edges[first] + width,
            color=COLOURS[code],
            zorder=2 if width == least else 1,
        )
        seen.append(code)
    handles = [Patch(color=COLOURS[code], label=SHOWN[code]) for code in sorted(set(seen))]
    axis.legend(
        handles=handles,
        fontsize=8,
        ncols=3,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.9),
        frameon=False,
    )
    axis.set_yticks([])
    axis.set_xlim(edges[0], edges[-1])
    axis.set_xticks(np.arange(0, edges[-1] + 1, 45))
    axis.set_xlabel("crank angle [°]")


def switching_window(run: Any, compliant: Any, instants: np.ndarray, half: float = 0.02) -> Figure:
    """Corner forces around two switchings, always touching and with a small clearance."""
    figure = Figure(figsize=(9.5, 5.5), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col")
    gap = 1e6 * float(compliant.mechanism.connections["P"].joint.clearance)
    for column, centre in enumerate((instants[0], instants[-1])):
        for axis, one, shift in ((axes[0, column], run, 0.5), (axes[1, column], compliant, 0.0)):
            moment = np.asarray(one.time)
            here = np.flatnonzero(np.abs(moment - centre) < half)
            moment = moment - shift * (moment[1] - moment[0])
            force = np.asarray(one.contact("P").normal_force)
            for i, (name, style) in enumerate(zip(CORNERS, ("-", "--", "-", "--"), strict=True)):
                axis.plot(
                    1e3 * moment[here],
                    force[here, i],
                    style,
                    color=("C0", "C1")[i // 2],
                    lw=1.2,
                    label=name,
                )
            for instant in instants[np.abs(instants - centre) < half]:
                axis.axvline(1e3 * instant, color="k", lw=0.7, ls=":")
            axis.set_ylim(bottom=0)
        axes[1, column].set_xlabel("time [ms]")
        axes[0, column].set_title(f"switching at {1e3 * centre:.1f} ms")
    axes[0, 0].set_ylabel("corner force, always touching [N]")
    axes[1, 0].set_ylabel(f"corner force, gap of {gap:g} µm [N]")
    axes[0, 0].legend(fontsize=8)
    return figure


def reactions(run: Any, compliant: Any, instants: np.ndarray) -> Figure:
    """Size of the reactions of the crank's two joints, beside the compliant run, and the
    difference.
    """
    figure = Figure(figsize=(8.5, 7.5), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    for row, (joint, name) in enumerate(JOINTS.items()):
        own, other = (
            np.linalg.norm(np.asarray(one.reaction(joint).force), axis=1)
            for one in (run, compliant)
        )
        axes[row].plot(
            _degrees(compliant),
            other,
            color="C1",
            lw=0.8,
            label="regularised friction, small clearance",
        )
        axes[row].plot(_degrees(run), own, color="C0", lw=1.4, label="always touching, Coulomb")
        axes[row].set_ylabel(f"{name} [N]")
        # Peaks of impacts would hide everything else.
        axes[row].set_ylim(0, 1.3 * own.max())
        axes[2].plot(
            _degrees(run),
            np.abs(np.interp(run.time, compliant.time, other) - own) + 1e-3,
            lw=0.8,
            label=name,
        )
    axes[2].set_yscale("log")
    axes[2].set_ylabel("difference [N]")
    axes[2].set_xlabel("crank angle [°]")
    axes[2].set_xlim(0, 360)
    axes[2].set_xticks(np.arange(0, 361, 45))
    _mark(axes, instants)
    axes[0].legend(fontsize=8, loc="upper right")
    axes[2].legend(fontsize=8, loc="upper right")
    axes[0].set_title("Reactions of the crank's joints over one turn")
    return figure


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
    table = pandas.DataFrame(rows, columns=["switching [s]", "next impact [s]"])
    table["delay [ms]"] = 1e3 * (table["next impact [s]"] - table["switching [s]"])
    return table


def study(folder: Path, clearance: float = SMALL_CLEARANCE, show: bool = True) -> None:
    """Runs one turn of the crank on both rungs and writes figures and tables to `folder`."""
    begun = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    integrator = jc.integrator.NonColliding(TURN / STEPS)
    run = jc.simulate(
        guide(), TURN, save=STEPS + 1, integrator=integrator, balance=True, progress_bar=show
    )
    rig = guide(clearance=clearance, friction="regularised")
    compliant = jc.simulate(
        rig,
        TURN,
        save=4 * STEPS + 1,
        integrator=jc.integrator.Adaptive(rtol=RTOL),
        progress_bar=show,
    )
    switchings = run.switchings("P")
    instants = np.asarray(switchings["time [s]"])
    switchings.to_csv(folder / "switchings.csv", index=False)
    table = impacts(compliant, instants)
    table.to_csv(folder / "impacts.csv", index=False)
    print(
        f"{switchings.to_string(index=False, float_format='%.6g')}\n\n{table.to_string(index=False, float_format='%.6g')}"
    )
    energy = run.energy_balance()
    print(
        f"friction takes {float(energy.friction_loss[-1]):.1f} J a turn; the balance is open by at "
        "most "
        f"{float(np.abs(np.asarray(energy.error)).max()):.2g} J"
    )
    figures = {
        "corner_forces": corner_forces(run, instants),
        "switchings": switching_window(run, compliant, instants),
        "reactions": reactions(run, compliant, instants),
    }
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=130)
    print(
        f"\n{len(figures)} figures and 2 tables in {folder.resolve()}, "
        f"{time.perf_counter() - begun:.0f} s"
    )
