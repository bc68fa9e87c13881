"""The study of the slider in a guide from one command: permanent contact beside a compliant
run with a small clearance.

Writes figures (PNG) and tables (CSV) into a folder and prints what it found.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands import guide_figures as draw
from jaxclear.commands.reported import report_warnings
from jaxclear.ground.table import as_table
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


def _worn(touching: Any) -> dict[str, Figure]:
    """Figures of the surfaces that wear, and what each loses, said."""
    figures = {}
    for surface in touching.worn.get("P", {}):
        figures[f"wear_of_the_{surface}"] = plot.wear_unrolled(touching, "P", surface)
        lost = float(touching.worn_volume("P", surface)[-1])
        deepest = float(touching.worn_depth("P", surface).max())
        print(f"the {surface} loses {1e9 * lost:.3g} mm3 a turn, {1e9 * deepest:.3g} nm at most")
    return figures


def study(
    folder: Path, clearance: float = SMALL_CLEARANCE, wear: bool = False, show: bool = True
) -> None:
    """Runs one turn of the crank on both formulations and writes figures and tables to `folder`;
    `clearance` [m] of the compliant run, `wear`: both parts of the other wear, `show`: progress
    bars.
    """
    begun = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
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
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)
        print(f"{table}\n")
    energy = touching.energy_balance()
    error = float(np.abs(np.asarray(energy.error)).max())
    print(
        f"friction takes {float(energy.friction_loss[-1]):.1f} J a turn; the balance is open by at "
        f"most {error:.2g} J"
    )
    figures = {
        "corner_forces": draw.corner_forces(touching, instants),
        "switchings": draw.switching_window(touching, compliant, instants),
        "reactions": draw.reactions(touching, compliant, instants),
    }
    figures |= _worn(touching)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=130)
    print(
        f"\n{len(figures)} figures and {len(tables)} tables in {folder.resolve()}, "
        f"{time.perf_counter() - begun:.0f} s"
    )
