"""The antenna study from one command: joint models, friction laws, errors of the tip and its path,
for both drives.

Writes figures (PNG) and tables (CSV) into a folder and prints what it found.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands import antenna_figures as draw
from jaxclear.commands.reported import report_warnings
from jaxclear.ground.table import as_table
from jaxclear.scenes.antenna import BASE, BEARING_RADIUS, HOLD, JOINTS, KINDS, TIP, antenna

# Step of the runs [s]; benchmarks/claims/antenna.py shows what it costs in accuracy.
STEP = 1e-3
# A regularised law that nearly holds, with full friction at this slip speed [m/s], beside that of
# Bai & Zhao (0.1 m/s).
STEEP = {"static_speed": 1e-3, "kinetic_speed": 1e-2}
# Slip slower than this is sticking [m/s].
STUCK = 1e-12
# The tip's departure is drawn this many times as large, and the close-up of stick and slip shows
# this interval [s].
EXAGGERATION, CLOSE = 20.0, (0.75, 1.3)
COULOMB, WIDE, NARROW = "Coulomb (sticks)", "three-zone, 0.1 m/s", "three-zone, 1 mm/s"


def _simulate(
    kind: str, drive: str, duration: float, friction: Any = "set_valued", regularised: bool = False
) -> Any:
    """A run saved at every step."""
    rig = antenna(kind, drive=drive, friction=friction)
    integrator = jc.integrator.NonColliding(STEP, regularised=regularised)
    return jc.simulate(rig, duration, save=round(duration / STEP) + 1, integrator=integrator)


def friction_runs(duration: float) -> dict[str, Any]:
    """The step drive over `duration` [s] with Coulomb's law and with two regularised ones."""
    steep = jc.friction.ThreeZone(mu_static=0.15, mu_kinetic=0.1, **STEEP)
    return {
        COULOMB: _simulate("spatial", "step", duration),
        NARROW: _simulate("spatial", "step", duration, steep, True),
        WIDE: _simulate("spatial", "step", duration, "regularised", True),
    }


def motion_table(runs: dict[str, Any]) -> pandas.DataFrame:
    """One row a joint model: swing of both joints, and what they carry and lose."""
    rows = []
    for kind, found in runs.items():
        row: dict[str, Any] = {"joints": kind}
        for name in JOINTS:
            row[f"{name} swing [rad]"] = np.ptp(np.asarray(found.coordinate(name)))
            if kind != "ideal":
                mean = jc.response.MeanContactForce(name)(found)
                friction = np.asarray(found.contact(name).traction).sum(1).mean()
                row[f"{name} mean normal force [N]"] = float(mean)
                row[f"{name} mean friction at the saves [N]"] = friction
        rows.append(row)
    return as_table(rows)


def friction_table(runs: dict[str, Any]) -> pandas.DataFrame:
    """One row a friction law: how slowly joint 1 slips while Coulomb's law makes it stick."""
    first = BEARING_RADIUS * np.abs(np.asarray(runs[COULOMB].speed("J1")))
    held = first < STUCK
    held[0] = False
    rows = []
    for label, found in runs.items():
        slip = BEARING_RADIUS * np.abs(np.asarray(found.speed("J1")))
        share = np.mean(slip[1:] < STUCK)
        row = {"friction": label, "share of time stuck [1]": share}
        row["largest slip while Coulomb sticks [m/s]"] = np.max(slip[held], initial=0.0)
        row["median [m/s]"] = np.median(slip[held]) if held.any() else np.nan
        rows.append(row)
    return as_table(rows)


def study(folder: Path, duration: float = 4.0) -> None:
    """Runs everything and writes it to `folder`; `duration` [s] of the periodic drive."""
    begun = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    print("periodic drive: ideal, planar and spatial joints", flush=True)
    periodic = {kind: _simulate(kind, "periodic", duration) for kind in reversed(KINDS)}
    print("step drive: Coulomb's law and two regularised ones", flush=True)
    stepped = friction_runs(HOLD)
    report_warnings(periodic | stepped)
    found = {
        "periodic": jc.pointing_error(periodic["spatial"], TIP, BASE),
        "step": jc.pointing_error(stepped[COULOMB], TIP, BASE),
    }
    tables = _tables(periodic, stepped, found)
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    for name in ("motion", "stick_slip"):
        print(f"\n{tables[name]}", flush=True)
    for drive, error in found.items():
        print(f"\n{drive} drive: {error.sentence()}")
    figures = _figures(periodic, stepped, found)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=130)
    print(
        f"\n{len(figures)} figures and {len(tables)} tables in {folder.resolve()}, "
        f"{time.perf_counter() - begun:.0f} s"
    )


def _tables(periodic: dict, stepped: dict, found: dict) -> dict[str, pandas.DataFrame]:
    tables = {"motion": motion_table(periodic), "stick_slip": friction_table(stepped)}
    tables |= {f"pointing_{drive}": error.budget().reset_index() for drive, error in found.items()}
    parts = [stepped[COULOMB].switchings(name).assign(joint=name) for name in JOINTS]
    return tables | {"switchings_step": pandas.concat(parts, ignore_index=True)}


def _figures(periodic: dict, stepped: dict, found: dict) -> dict[str, Any]:
    spatial, error = periodic["spatial"], found["periodic"]
    figures = {
        "motion": draw.motion(periodic),
        "stick_slip": draw.stick_slip(stepped, "J1", BEARING_RADIUS, CLOSE),
        "errors": draw.errors(found),
        "tip_path": draw.tip_path(spatial, error, periodic["ideal"], EXAGGERATION),
    }
    budgets = {f"pointing_budget_{drive}": plot.pointing_budget(e) for drive, e in found.items()}
    return figures | budgets
