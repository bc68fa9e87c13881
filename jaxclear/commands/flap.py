"""The study of the flap actuation system from one command: modes of the four joints, their forces,
the shaft beside that of ideal joints, and who carries most as the lever ratio changes.

Writes figures (PNG) and tables (CSV) into a folder and prints what it found.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import StudyFolder, report_warnings
from jaxclear.ground.table import as_table
from jaxclear.plot.canvas import MILLI, canvas, warned
from jaxclear.scenes.flap import JOINTS, flap

# Steps that resolve the stiff dampers: at twice their length runs warn of creep.
STEP = 1e-6
SAVES_PER_SECOND = 100_000
LEVER_RATIOS = (0.5, 0.8, 1.0, 1.25, 2.0)
# Of the runs over the lever ratio [s]: the first stroke.
STROKE_TIME = 0.1
# Clearances [m] over which ratios of forces spread: impacts come at other times in each.
CLEARANCES = (0.95e-4, 1.0e-4, 1.05e-4)
PAIRS = (("J1", "J2"), ("J3", "J4"), ("J1", "J3"))
# Contact of all joints that lasts so long [s], less what still rings from the impact before it.
LASTING, RINGING = 20e-3, 5e-3


def simulated(rig: jc.Mechanism, duration: float, show: bool = False) -> Any:
    """A run of the mechanism, saved densely enough to resolve impacts.

    Args:
        rig: the mechanism.
        duration: of the run [s].
        show: whether a progress bar is shown.
    """
    return jc.simulate(
        rig,
        duration,
        save=round(duration * SAVES_PER_SECOND) + 1,
        integrator=jc.integrator.ImplicitStep(STEP),
        progress_bar=show,
    )


def mean_forces(run: Any) -> dict[str, float]:
    """Mean normal force of each joint [N]."""
    return {name: float(jc.response.MeanContactForce(name)(run)) for name in JOINTS}


def over_ratio() -> pandas.DataFrame:
    """Mean force of each joint over the lever ratio; of pairs of joints their ratio, the mean over
    nearly equal clearances, and its spread, from the least to the most."""
    rows = []
    for ratio in LEVER_RATIOS:
        rigs = [flap(clearance=clearance, lever_ratio=ratio) for clearance in CLEARANCES]
        forces = as_table([mean_forces(simulated(rig, STROKE_TIME)) for rig in rigs])
        row = {"lever ratio": ratio} | {f"{n} [N]": forces[n].mean() for n in JOINTS}
        for one, other in PAIRS:
            shares = forces[one] / forces[other]
            row |= {f"{one}/{other}": shares.mean(), f"{one}/{other} spread": np.ptp(shares)}
        rows.append(row)
    return as_table(rows)


def lasting_contact(run: Any, ideal: Any) -> pandas.DataFrame:
    """Intervals in which all joints stay in contact, and how far the shaft then is from that of
    ideal joints: its speed at most, its acceleration root mean square, beside the largest ideal
    ones. No state is left to match: ideal joints leave nothing free."""
    modes = run.combined_modes()
    moment = np.asarray(run.time)
    speed, selected = (np.asarray(one.body("shaft").spin)[:, 2] for one in (run, ideal))
    rates = [np.gradient(phase_rows, moment) for phase_rows in (speed, selected)]
    rows = []
    for _, row in modes[(modes[list(JOINTS)] == "contact").all(axis=1)].iterrows():
        starts, ends = row["from [s]"], row["to [s]"]
        inside = (moment > starts + RINGING) & (moment < ends)
        if ends - starts < LASTING:
            continue
        away = np.abs(speed - selected)[inside].max() / np.abs(selected).max()
        shaken = np.sqrt(np.mean((rates[0] - rates[1])[inside] ** 2)) / np.abs(rates[1]).max()
        rows.append(
            {"from [s]": starts, "to [s]": ends, "speed off [1]": away}
            | {"acceleration off [1]": shaken}
        )
    return as_table(rows)


def phases(run: Any) -> pandas.DataFrame:
    """Phases of all joints, one after the other."""
    tables = [run.modes(name).assign(joint=name) for name in JOINTS]
    return pandas.concat(tables, ignore_index=True)


def forces_figure(run: Any) -> Figure:
    """Normal force of the four joints over time."""
    figure, axes = canvas(len(JOINTS), 1, (8.0, 7.0), sharex=True, sharey=True)
    for axis, name in zip(axes, JOINTS, strict=True):
        force = np.asarray(run.contact(name).normal_force).sum(axis=1)
        axis.plot(MILLI * np.asarray(run.time), force, lw=0.5, color="C0")
        axis.axhline(jc.response.PeakContactForce(name)(run), ls=":", lw=0.8, color="C0")
        axis.set_ylabel(f"{name} [N]")
    # Impacts are a hundred times what is carried between them.
    axes[0].set_yscale("symlog", linthresh=100.0)
    axes[0].set_ylim(bottom=0.0)
    axes[-1].set_xlabel("time [ms]")
    axes[0].set_title(
        "Normal force of the joints (linear up to 100 N, logarithmic beyond); dotted: the largest "
        "of a contact in all steps"
    )
    return warned(figure, {"": run})


def shaft_figure(run: Any, ideal: Any, lasting: pandas.DataFrame) -> Figure:
    """Angular velocity and acceleration of the shaft beside those with ideal joints.

    Args:
        run: with clearance.
        ideal: with ideal joints.
        lasting: intervals in which all joints stay in contact, which are shaded.
    """
    figure, axes = canvas(2, 1, (8.0, 6.0), sharex=True)
    for starts, ends in zip(lasting["from [s]"], lasting["to [s]"], strict=True):
        for axis in axes:
            axis.axvspan(MILLI * starts, MILLI * ends, color="C2", alpha=0.12, lw=0)
    for one, style, label in ((run, "C0-", "four joints with clearance"), (ideal, "k--", "ideal")):
        moment, speed = np.asarray(one.time), np.asarray(one.body("shaft").spin)[:, 2]
        axes[0].plot(MILLI * moment, speed, style, lw=0.9, label=label)
        axes[1].plot(MILLI * moment, np.gradient(speed, moment), style, lw=0.6)
    # The first impacts are far above all that follows.
    largest = 4 * np.abs(np.gradient(speed, moment)).max()
    axes[1].set_ylim(-largest, largest)
    axes[0].set_ylabel("angular velocity [rad/s]")
    axes[1].set_ylabel("angular acceleration [rad/s²], peaks cut")
    axes[1].set_xlabel("time [ms]")
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8
    )
    axes[0].set_title("The shaft; shaded: all joints stay in contact")
    return warned(figure, {"with clearance": run, "ideal": ideal})


def ratio_figure(table: pandas.DataFrame) -> Figure:
    """Ratios of mean forces with their spread, over the lever ratio."""
    figure, axes = canvas()
    ratio = table["lever ratio"]
    for (one, other), marker in zip(PAIRS, "os^", strict=True):
        name = f"{one}/{other}"
        bars = {"yerr": 0.5 * table[f"{name} spread"], "marker": marker, "capsize": 3}
        axes.errorbar(ratio, table[name], **bars, lw=0.8, label=name, alpha=0.8)
    axes.plot(ratio, ratio, "k:", lw=0.8, label="lever ratio")
    axes.set_xlabel("lever ratio: distance of J3 from the pivot over that of J2")
    axes.set_ylabel("ratio of mean forces")
    axes.legend(fontsize=8)
    axes.set_title("The lever ratio decides who carries most")
    return figure


def study(folder: Path, duration: float = 0.5, show: bool = True) -> None:
    """Runs the study of the flap and writes its tables and figures.

    Args:
        folder: for the files.
        duration: of the runs [s].
        show: whether progress bars are shown.
    """
    files = StudyFolder(folder)
    clear = simulated(flap(), duration, show)
    ideal = jc.simulate(flap("ideal"), duration, save=len(clear.time))
    report_warnings({"four joints with clearance": clear, "ideal": ideal})
    tables = {
        "modes": phases(clear),
        "combined_modes": clear.combined_modes(),
        "lever_ratio": over_ratio(),
        "lasting_contact": lasting_contact(clear, ideal),
    }
    files.write_tables(**tables)
    spent = tables["modes"].assign(time=lambda rows: rows["to [s]"] - rows["from [s]"])
    shares = spent.pivot_table("time", "joint", "mode", "sum", 0.0) / duration
    print(f"share of the time in each mode\n{shares.to_string(float_format='%.3f')}\n")
    for name in ("lever_ratio", "lasting_contact"):
        print(f"{tables[name]}\n")
    files.write_figures(
        modes=plot.modes(clear),
        forces=forces_figure(clear),
        shaft=shaft_figure(clear, ideal, tables["lasting_contact"]),
        lever_ratio=ratio_figure(tables["lever_ratio"]),
    )
    print(files.sentence())
