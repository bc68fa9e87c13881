"""What is kept of a run of a scene file: its data set, a table of its joints, figures, the scene as
it was run, and how it ended; and of a scene over positions where everything stands.
"""

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.ground.table import as_table
from jaxclear.plot.canvas import canvas, key, readable, warned
from jaxclear.plot.overview import draw_forces

DATA, JOINTS, SCENE, TOLD = "run.nc", "joints.csv", "scene.yaml", "run.json"
STANDING, PLACES = "positions.nc", "positions.csv"
# Lines in one figure; more would not be told apart.
MOST_LINES = 8
DOTS_PER_INCH = 130


def keep(scene: jc.Scene, run: jc.Trajectory, folder: Path, name: str) -> pandas.DataFrame:
    """Writes a run to a folder; its table of joints."""
    folder.mkdir(parents=True, exist_ok=True)
    table = joint_table(run)
    if len(table):
        table.to_csv(folder / JOINTS, index=False)
    for title, figure in _figures(run).items():
        figure.savefig(folder / f"{title}.png", dpi=DOTS_PER_INCH)
    data = run.to_dataset(flat=True)
    data.to_netcdf(folder / DATA, engine="scipy")
    told = {"result": run.result, "warnings": list(run.warnings), "checks": str(run)}
    _tell(scene, folder, {"title": f"Run of {name}", **told})
    return table


def keep_positions(scene: jc.Scene, found: Any, folder: Path, name: str) -> pandas.DataFrame:
    """Writes where a mechanism stands to a folder; a table of it, a row for each position."""
    folder.mkdir(parents=True, exist_ok=True)
    data = found.to_dataset()
    columns = {}
    for what in data.data_vars:
        own = data[what]
        if own.dims == ("position",) and what != "found":
            columns[f"{what} [{own.units}]"] = own.values
        elif own.dims == ("position", "axis"):
            columns |= {
                f"{what} {axis} [{own.units}]": own.values[:, i] for i, axis in enumerate("xyz")
            }
    table = as_table(columns)
    table.to_csv(folder / PLACES, index=False)
    plot.positions(found).savefig(folder / "positions.png", dpi=DOTS_PER_INCH)
    data.to_netcdf(folder / STANDING, engine="scipy")
    sentence = f"The mechanism stands at {len(table)} positions."
    told = {"result": sentence, "warnings": [], "checks": sentence}
    _tell(scene, folder, {"title": f"Positions of {name}", **told})
    return table


def _tell(scene: jc.Scene, folder: Path, told: dict[str, Any]) -> None:
    """Keeps the scene, how it ended, and by which versions."""
    jc.write_scene(scene, folder / SCENE)
    told = told | {"versions": _versions()}
    (folder / TOLD).write_text(json.dumps(told, indent=1), encoding="utf-8")


def joint_table(run: jc.Trajectory) -> pandas.DataFrame:
    """A row for each joint with clearance: its forces and wear, contact at the saving times."""
    rows = []
    for name in run.formulation.contact_joints(run.mechanism):
        contact = run.contact(name)
        force = np.asarray(contact.normal_force).sum(axis=1)
        row = {
            "joint": name,
            "mean normal force [N]": float(jc.response.MeanContactForce(name)(run)),
            "peak normal force of a contact [N]": float(jc.response.PeakContactForce(name)(run)),
            "share of saves in contact [1]": (force > 0).mean(),
            "largest indentation [um]": 1e6 * float(np.asarray(contact.indentation).max()),
        }
        for surface in run.worn.get(name, {}):
            row[f"worn depth of the {surface} [um]"] = 1e6 * float(
                np.asarray(run.worn_depth(name, surface)).max()
            )
        rows.append(row)
    return as_table(rows)


def _figures(run: jc.Trajectory) -> dict[str, Figure]:
    """Figures by the names of their files."""
    joints = run.formulation.contact_joints(run.mechanism)
    found = {"motion": _motion(run)}
    if joints:
        found["contact_forces"] = _forces(run, joints)
        found["modes"] = plot.modes(run)
    for joint, surfaces in run.worn.items():
        for surface in surfaces:
            found[f"wear_of_{joint}_{surface}"] = plot.wear_unrolled(run, joint, surface)
    return found


def _motion(run: jc.Trajectory) -> Figure:
    """Places of the bodies' centres of mass over time, an axis for each direction that they move
    in."""
    places = {
        name: np.asarray(run.body(name).com) for name in list(run.mechanism.bodies)[:MOST_LINES]
    }
    moved = [i for i in range(3) if any(np.ptp(own[:, i]) > 0 for own in places.values())] or [0]
    figure, axes = canvas(len(moved), 1, (8.0, 2.3 * len(moved)), sharex=True, squeeze=False)
    for axis, direction in zip(axes[:, 0], moved, strict=True):
        own = {name: place[:, direction] for name, place in places.items()}
        factor, unit = readable(np.concatenate(list(own.values())), "m")
        for name, values in own.items():
            axis.plot(run.time, factor * values, lw=1.0, label=name)
        axis.set_ylabel(f"{'xyz'[direction]} [{unit}]")
    axes[-1, 0].set_xlabel("time [s]")
    axes[0, 0].set_title("Centres of mass")
    key(axes[0, 0])
    return warned(figure, {"": run})


def _forces(run: jc.Trajectory, joints: Any) -> Figure:
    """Normal force of every joint with clearance over time."""
    figure, axes = canvas(
        len(joints), 1, (8.0, 0.8 + 1.9 * len(joints)), sharex=True, squeeze=False
    )
    for axis, joint in zip(axes[:, 0], joints, strict=True):
        draw_forces(axis, run, joint)
        key(axis)
    axes[-1, 0].set_xlabel("time [s]")
    axes[0, 0].set_title("Normal force in the joints with clearance")
    return warned(figure, {"": run})


def _versions() -> dict[str, str]:
    """Of what computed."""
    found = {"python": platform.python_version(), "jax": jax.__version__}
    for library in ("jaxclear", "numpy"):
        try:
            found[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            found[library] = "not installed"
    return found | {"device": jax.devices()[0].platform}
