"""The study of the 3RSR parallel mechanism from one command: force of the ball joint and the
platform's acceleration beside those of ideal joints in three regimes, what becomes of the
difference as the clearance vanishes, worn volume over the drive angle, and the worn socket.

Writes figures (PNG) and tables (CSV) into a folder and prints what it found.
"""

from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import pandas
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import StudyFolder, report_warnings
from jaxclear.ground.table import as_table
from jaxclear.plot.canvas import MICRO, MILLI, canvas, warned
from jaxclear.scenes.parallel_3rsr import PAPER, QUIET, RATTLING, parallel_3rsr, usual_drive

REGIMES = {"paper": PAPER, "quiet": QUIET, "rattling": RATTLING}
CLEARANCES = (5e-4, 5e-5, 5e-6)
# All runs are saved so often, so that they share a program: 3 cycles densely, or many cycles.
SAVES, DENSE = 6000, 3
PER_CYCLE = SAVES // DENSE
# Of the drive angle.
BINS = 15
# The paper's: each simulated cycle stands for so many.
FACTOR = 25_000
# Width of the moving mean, as a share of the cycle.
WINDOW = 0.05
AXES = "xyz"


def simulated(rig: jc.Mechanism, duration: float, state: Any = None, show: bool = False) -> Any:
    """A run with as many saving times as all others.

    Args:
        rig: the mechanism.
        duration: of the run [s].
        state: in which it begins; None: the mechanism's own start.
        show: whether a progress bar is shown.
    """
    return jc.simulate(rig, duration, save=SAVES + 1, state=state, progress_bar=show)


def ideal_run(period: float) -> Any:
    """A cycle of the mechanism with ideal joints."""
    return jc.simulate(parallel_3rsr("ideal", period=period), period, save=PER_CYCLE + 1)


def force(run: Any) -> np.ndarray:
    """Force on transmission rod 1 at S1 over the last cycle [N]."""
    return np.asarray(run.reaction("S1").force)[-PER_CYCLE - 1 :]


def acceleration(run: Any) -> np.ndarray:
    """That of the platform's centre of mass over the last cycle [m/s2]."""
    velocity = np.asarray(run.body("platform").velocity)
    return np.gradient(velocity, np.asarray(run.time), axis=0)[-PER_CYCLE - 1 :]


def filtered(values: np.ndarray) -> np.ndarray:
    """Moving mean over `WINDOW` of a cycle; shorter by that at both ends together."""
    width = round(WINDOW * PER_CYCLE)
    return np.stack([np.convolve(x, np.ones(width) / width, "valid") for x in values.T], axis=1)


def over_clearance(ideal: np.ndarray) -> pandas.DataFrame:
    """By how much the filtered force is off that of the ideal ball, which has no friction."""
    rows = []
    for clearance in CLEARANCES:
        rig = parallel_3rsr("one", clearance, period=QUIET)
        smooth = eqx.tree_at(lambda m: m.connections["S1"].joint.friction.mu_kinetic, rig, 0.0)
        off = {}
        for name, x in (("with friction", rig), ("without friction", smooth)):
            away = filtered(force(simulated(x, DENSE * QUIET)) - ideal)
            off[f"{name} [N]"] = np.abs(away).max()
        rows.append({"clearance [m]": clearance} | off)
    return as_table(rows)


def deviations(clear: Any, ideal: Any) -> dict[str, float]:
    """Largest differences from the ideal mechanism over the last cycle, and the share of it in
    which the ball touches nothing."""
    pushed = force(clear)
    off, shaken = np.abs(pushed - force(ideal)), np.abs(acceleration(clear) - acceleration(ideal))
    return (
        {"apart [1]": float((np.abs(pushed).max(axis=1) == 0).mean())}
        | {f"force {x} [N]": off[:, k].max() for k, x in enumerate(AXES)}
        | {f"acceleration {x} [m/s2]": shaken[:, k].max() for k, x in enumerate(AXES)}
    )


def volumes(worn: Any, cycles: int) -> pandas.DataFrame:
    """Volume worn off at each drive angle in a quarter, a half ... of all cycles."""
    worn_off = worn.worn_volume("S1", "socket")
    volume, time = np.asarray(worn_off), np.asarray(worn.time - worn.time[0])
    drive = usual_drive(QUIET)
    # Bins that begin and end at the same angles on the way up and on the way down.
    low, high = (float(drive.motion(at * QUIET)[0]) for at in (0.0, 0.5))
    edges = np.linspace(low, high, BINS + 1)
    up = np.arccos(1 - 2 * (edges - low) / (high - low)) / (2 * np.pi)
    shares = np.concatenate([up, 1 - up[-2::-1]])
    moments = QUIET * (np.arange(cycles)[:, None] + shares)
    losses = np.diff(np.interp(moments, time, volume), axis=1)
    per_bin = np.cumsum(losses[:, :BINS] + losses[:, BINS:][:, ::-1], axis=0)
    middles = np.degrees(0.5 * (edges[1:] + edges[:-1]))
    counts = sorted({max(1, round(share * cycles)) for share in (0.25, 0.5, 0.75, 1.0)})
    rows = [
        as_table({"cycles": n, "drive angle [deg]": middles, "volume [m3]": per_bin[n - 1]})
        for n in counts
    ]
    return pandas.concat(rows, ignore_index=True)


def force_figure(clear: dict[str, Any], ideal: dict[str, Any]) -> Figure:
    """Force at S1 over the last cycle of each regime, beside that of the ideal ball."""
    figure, axes = canvas(len(REGIMES), 2, (9.0, 7.0))
    for row, (name, period) in zip(axes, REGIMES.items(), strict=True):
        moments = np.linspace(0.0, period, PER_CYCLE + 1)
        slack, target, edge = force(clear[name]), force(ideal[name]), round(WINDOW * PER_CYCLE) // 2
        means = filtered(slack)
        for axis, k in zip(row, (0, 2), strict=True):
            axis.plot(moments, slack[:, k], lw=0.5, color="C0", label="0.5 mm of play")
            inner = moments[edge : edge + len(means)]
            axis.plot(inner, means[:, k], lw=1.2, color="C1", label="its moving mean")
            axis.plot(moments, target[:, k], "k--", lw=0.9, label="ideal")
            axis.set_ylabel(f"force {AXES[k]} [N]")
            axis.set_title(f"{name}: period {period:g} s", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time in the last cycle [s]")
    handles = axes[0][0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=3, fontsize=8)
    return warned(figure, clear)


def limit_figure(table: pandas.DataFrame) -> Figure:
    """The filtered force's difference from the ideal reaction over the clearance."""
    figure, axes = canvas()
    clearance = MILLI * table["clearance [m]"]
    for name, marker in (("with friction", "o"), ("without friction", "s")):
        axes.loglog(clearance, table[f"{name} [N]"], marker=marker, label=name)
    first = table["without friction [N]"].iloc[0]
    axes.loglog(clearance, first * clearance / clearance.iloc[0], "k:", label="first order")
    axes.set_xlabel("clearance of S1 [mm]")
    axes.set_ylabel("filtered force beside the ideal reaction [N]")
    axes.legend(fontsize=8)
    return figure


def volume_figure(table: pandas.DataFrame) -> Figure:
    """Worn volume at each drive angle."""
    figure, axes = canvas()
    for cycles, rows in table.groupby("cycles"):
        angles, volume = rows["drive angle [deg]"], MICRO**3 * rows["volume [m3]"]
        axes.plot(angles, volume, marker=".", label=f"{cycles} cycles")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("drive angle [deg]")
    axes.set_ylabel(
        f"worn off the socket in {np.ptp(table['drive angle [deg]']) / (BINS - 1):.0f}° of it [µm³]"
    )
    axes.legend(fontsize=8)
    return figure


def study(folder: Path, cycles: int = 40, show: bool = True) -> None:
    """Runs the study of the parallel mechanism and writes its tables and figures.

    Args:
        folder: for the files.
        cycles: of the run from whose wear the socket is extrapolated.
        show: whether progress bars are shown.
    """
    files = StudyFolder(folder)
    rigs = {name: parallel_3rsr("one", period=period) for name, period in REGIMES.items()}
    clear = {name: simulated(rig, DENSE * REGIMES[name], show=show) for name, rig in rigs.items()}
    ideal = {name: ideal_run(period) for name, period in REGIMES.items()}
    # From a cycle that has settled: the first one falls through the play.
    many = simulated(rigs["quiet"], cycles * QUIET, clear["quiet"].state(), show)
    depth = many.worn_depth("S1", "socket") - clear["quiet"].worn_depth("S1", "socket")
    state = jc.State({"S1": {"socket": FACTOR * depth}})
    worn = {name: simulated(rig, DENSE * REGIMES[name], state, show) for name, rig in rigs.items()}
    report_warnings(clear | {f"{n}, worn": r for n, r in worn.items()} | {"many cycles": many})
    rows = [
        {"period": name, "socket": surface} | deviations(runs[name], ideal[name])
        for surface, runs in (("new", clear), ("worn", worn))
        for name in REGIMES
    ]
    tables = {
        "deviations": as_table(rows),
        "clearance": over_clearance(force(ideal["quiet"])),
        "volume": volumes(many, cycles),
    }
    files.write_tables(**tables)
    for name in ("deviations", "clearance"):
        print(f"{tables[name]}\n")
    deepest, touched = float(depth.max()), float((depth > 0.01 * depth.max()).mean())
    print(
        f"after {cycles} cycles x {FACTOR}: {MILLI * FACTOR * deepest:.3g} mm deep, "
        f"{100 * touched:.0f} % of the cells worn by more than a hundredth of that"
    )
    figures = {
        "force": force_figure(clear, ideal),
        "clearance": limit_figure(tables["clearance"]),
        "volume": volume_figure(tables["volume"]),
        "socket": plot.wear_surface(many, "S1", "socket"),
        "socket_unrolled": plot.wear_unrolled(many, "S1", "socket"),
    }
    files.write_figures(**figures)
    print(files.sentence())
