"""What the command line does with a scene file: a run of it, a campaign over what varies of it,
what records tell of that, a list of its numbers, what is kept of these in a folder; and files of
ready scenes to begin with.
"""

import contextlib
import dataclasses
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import DOTS_PER_INCH, report_samples, report_warnings
from jaxclear.ground.arguments import check_name
from jaxclear.ground.datasets import library_versions
from jaxclear.ground.table import as_table
from jaxclear.plot.canvas import canvas, key, readable, warned
from jaxclear.plot.overview import draw_forces

DATA, JOINTS, SCENE, SUMMARY = "run.nc", "joints.csv", "scene.yaml", "run.json"
STANDING, PLACES = "positions.nc", "positions.csv"
# Lines in one figure; more would not be told apart.
MOST_LINES = 8


def keep(scene: jc.Scene, run: jc.Trajectory, folder: Path, name: str) -> pandas.DataFrame:
    """Writes a run to a folder; returns its table of joints.

    Args:
        scene: that was run.
        run: its trajectory.
        folder: created if it does not exist.
        name: of the scene, for the title.
    """
    folder.mkdir(parents=True, exist_ok=True)
    table = joint_table(run)
    if len(table):
        table.to_csv(folder / JOINTS, index=False)
    for title, figure in _draw_figures(run).items():
        figure.savefig(folder / f"{title}.png", dpi=DOTS_PER_INCH)
    data = run.to_dataset(flat=True)
    data.to_netcdf(folder / DATA, engine="scipy")
    texts = {"result": run.result, "warnings": list(run.warnings), "checks": str(run)}
    _write_description(scene, folder, {"title": f"Run of {name}", **texts})
    return table


def keep_positions(scene: jc.Scene, positions: Any, folder: Path, name: str) -> pandas.DataFrame:
    """Writes positions to a folder; returns a table with a row for each.

    Args:
        scene: with the positions of its drives.
        positions: where the mechanism stands.
        folder: created if it does not exist.
        name: of the scene, for the title.
    """
    folder.mkdir(parents=True, exist_ok=True)
    data = positions.to_dataset()
    columns = {}
    for what in data.data_vars:
        x = data[what]
        if x.dims == ("position",) and what != "found":
            columns[f"{what} [{x.units}]"] = x.values
        elif x.dims == ("position", "axis"):
            columns |= {
                f"{what} {axis} [{x.units}]": x.values[:, i] for i, axis in enumerate("xyz")
            }
    table = as_table(columns)
    table.to_csv(folder / PLACES, index=False)
    plot.positions(positions).savefig(folder / "positions.png", dpi=DOTS_PER_INCH)
    data.to_netcdf(folder / STANDING, engine="scipy")
    sentence = f"The mechanism stands at {len(table)} positions."
    texts = {"result": sentence, "warnings": [], "checks": sentence}
    _write_description(scene, folder, {"title": f"Positions of {name}", **texts})
    return table


def _write_description(scene: jc.Scene, folder: Path, texts: dict[str, Any]) -> None:
    """Keeps the scene, how it ended, and by which versions."""
    jc.write_scene(scene, folder / SCENE)
    text = json.dumps(texts | {"versions": library_versions()}, indent=1)
    (folder / SUMMARY).write_text(text, encoding="utf-8")


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


def _draw_figures(run: jc.Trajectory) -> dict[str, Figure]:
    """Figures by the names of their files."""
    joints = run.formulation.contact_joints(run.mechanism)
    figures = {"motion": _draw_motion(run)}
    if joints:
        figures["contact_forces"] = _forces(run, joints)
        figures["modes"] = plot.modes(run)
    for joint, surfaces in run.worn.items():
        for surface in surfaces:
            figures[f"wear_of_{joint}_{surface}"] = plot.wear_unrolled(run, joint, surface)
    return figures


def _draw_motion(run: jc.Trajectory) -> Figure:
    """Places of the bodies' centres of mass over time, an axis for each direction that they move
    in."""
    places = {
        name: np.asarray(run.body(name).com) for name in list(run.mechanism.bodies)[:MOST_LINES]
    }
    moved = [i for i in range(3) if any(np.ptp(p[:, i]) > 0 for p in places.values())] or [0]
    figure, axes = canvas(len(moved), 1, (8.0, 2.3 * len(moved)), sharex=True, squeeze=False)
    for axis, direction in zip(axes[:, 0], moved, strict=True):
        p = {name: place[:, direction] for name, place in places.items()}
        factor, unit = readable(np.concatenate(list(p.values())), "m")
        for name, values in p.items():
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


def example(name: str) -> None:
    """Prints the scene file of a ready mechanism."""
    file = Path(__file__).parent / "examples" / f"{name}.yaml"
    click.echo(file.read_text(encoding="utf-8"), nl=False)


@contextlib.contextmanager
def mistakes_told() -> Iterator[None]:
    """A scene that cannot be read, run or asked ends the command with its sentence."""
    try:
        yield
    except jc.SimulationError:
        raise
    except (ValueError, TypeError) as error:
        raise click.UsageError(str(error)) from None
    except ImportError as error:
        raise click.ClickException(str(error)) from None


def read(scene: Path, **changes: Any) -> jc.Scene:
    """The scene in a file, with what was asked otherwise."""
    changed = {name: value for name, value in changes.items() if value is not None}
    return dataclasses.replace(jc.read_scene(scene), **changed)


def parameters(scene: Path | None = None) -> None:
    """Prints the numbers of a scene file, or of the four-bar."""
    with mistakes_told():
        mechanism = jc.scenes.four_bar() if scene is None else read(scene).mechanism
    click.echo(mechanism.parameters())


def run(
    scene: Path,
    folder: Path | None = None,
    duration: float | None = None,
    saves: int | None = None,
    show: bool = True,
) -> None:
    """Runs a scene once, prints how it went, and writes data set, figures and tables.

    A scene over positions is written where it stands.

    Args:
        scene: path of the file.
        folder: for the files; None: named after the scene.
        duration: [s]; None: the file's.
        saves: number of saving times; None: the file's.
        show: whether a progress bar is shown.
    """
    folder = Path(f"{scene.stem}_run") if folder is None else folder
    with mistakes_told():
        content = read(scene, duration=duration, save=saves)
        if content.positions is not None:
            table = keep_positions(content, content.stand(), folder, scene.name)
            click.echo(f"The mechanism stands at {len(table)} positions.")
            click.echo(
                f"Data set, figure and table in {folder.resolve()}; jaxclear report {folder}"
            )
            return
        trajectory = content.simulate(progress_bar=show, throw=False)
    click.echo(str(trajectory))
    table = keep(content, trajectory, folder, scene.name)
    if len(table):
        click.echo(f"\n{table}\n")
    report_warnings({scene.stem: trajectory})
    click.echo(f"Data set, figures and tables in {folder.resolve()}; jaxclear report {folder}")
    if not trajectory.succeeded:
        raise click.ClickException(trajectory.result)


def fmu(
    scene: Path,
    folder: Path | None = None,
    input: tuple[str, ...] = (),
    parameter: tuple[str, ...] = (),
    slope: tuple[str, ...] = (),
    model_exchange: bool = False,
    interval: float = 1e-3,
    target: str | None = None,
) -> None:
    """Exports a scene as an FMU, whose outputs are the scene's responses.

    Without responses, outputs are coordinates and speeds of its joints.

    Args:
        scene: path of the file.
        folder: the FMU's file; None: named after the scene.
        input, parameter: texts NAME=NUMBER: names of the FMU's inputs and parameters, and paths.
        slope: names of inputs and parameters along which derivatives are carried.
        model_exchange: whether it is for model exchange, too.
        interval: communication step [s].
        target: platform; None: this one.
    """
    file = Path(f"{scene.stem}.fmu") if folder is None else folder
    with mistakes_told():
        content = read(scene)
        if content.state is not None:
            raise ValueError(
                f"{scene} begins in a state; an FMU begins at a mechanism's own start."
            )
        kinds = ("co-simulation", "model exchange")[: 1 + model_exchange]
        duration = {} if content.duration is None else {"duration": content.duration}
        unit = jc.export_fmu(
            content.mechanism,
            file,
            integrator=content.integrator,
            inputs=dict(map(_parse_name_and_number, input)),
            outputs=content.responses or None,
            parameters=dict(map(_parse_name_and_number, parameter)),
            slopes=slope,
            kinds=kinds,
            interval=interval,
            target=target,
            **duration,
        )
    click.echo(str(unit))


def _parse_name_and_number(text: str) -> tuple[str, str]:
    """A name and the number that it stands for, as typed. Raises `ValueError`."""
    name, _, number = text.partition("=")
    if not number:
        raise ValueError(f'"{text}" must be NAME=NUMBER; jaxclear parameters lists the numbers.')
    return name, number


SENSORS: dict[str, Any] = {
    "accelerometer": jc.sensor.Accelerometer,
    "gyroscope": jc.sensor.Gyroscope,
    "displacement": jc.sensor.Displacement,
    "force": jc.sensor.ForceGauge,
    "encoder": jc.sensor.Encoder,
}


def sensor_of(text: str) -> tuple[str, Any]:
    """The column and the sensor of a signal as it is typed:
    a_x=accelerometer:slider:x:noise=0.3:bandwidth=1500. Raises `ValueError` with a sentence."""
    column, _, definition = text.partition("=")
    kind, *parts = definition.split(":")
    check_name("sensor", kind, SENSORS, f' for signal "{column}"')
    numbers = dict(part.split("=", 1) for part in parts if "=" in part)
    places = [part for part in parts if "=" not in part]
    if not 1 <= len(places) <= 2:
        raise ValueError(
            f'signal "{text}" must say where its sensor is, as in '
            "a_x=accelerometer:slider:x:noise=0.3."
        )
    names = ("noise", "bandwidth", "gain", "delay", "sampling")
    settings = {}
    for name, value in numbers.items():
        check_name("number", name, names, f' of the sensor of signal "{column}"')
        try:
            settings[name] = float(value)
        except ValueError:
            sentence = f'{name} of signal "{column}" is "{value}"; it must be one number.'
            raise ValueError(sentence) from None
    axis = {"axis": places[1]} if len(places) > 1 else {}
    return column, SENSORS[kind](places[0], **axis, **settings)


def identify(
    scene: Path,
    record: tuple[Path, ...],
    signal: tuple[str, ...],
    time: str = "time",
    turn: str | None = None,
    runs: int = 256,
    how: str = "statistics",
    folder: Path | None = None,
    show: bool = True,
) -> None:
    """Identifies what varies of a scene from records; prints intervals and writes files.

    Args:
        scene: path of the file.
        record: paths of tables with measured columns.
        signal: columns with their sensors.
        time: column in seconds, or column:unit:begin:end.
        turn: column of an encoder, or period [s]; None: no turns.
        runs: number of runs.
        how: method of `identify`.
        folder: for the files; None: named after the scene.
        show: whether progress bars are shown.
    """
    folder = Path(f"{scene.stem}_identified") if folder is None else folder
    with mistakes_told():
        content = read(scene)
        signals = dict(map(sensor_of, signal))
        column, unit, *part = _parse_time_column(time)
        with contextlib.suppress(TypeError, ValueError):
            turn = float(turn)  # type: ignore[arg-type,assignment]
        records = [
            jc.Measurement.read_csv(
                path, time=column, signals=signals, turn=turn, time_unit=unit
            ).part(*part)
            for path in record
        ]
        result = jc.identify(content.problem(), records, runs, how=how, progress_bar=show)
    click.echo(str(result))
    folder.mkdir(parents=True, exist_ok=True)
    result.table().to_csv(folder / "identified.csv")
    plot.identification(result).savefig(folder / "identified.png", dpi=DOTS_PER_INCH)
    result.to_dataset().to_netcdf(folder / "identified.nc", engine="scipy")
    texts = {"result": result.sentence(), "warnings": list(result.warned), "checks": str(result)}
    _write_description(content, folder, {"title": f"Identification of {scene.name}", **texts})
    click.echo(f"Table, data set and figure in {folder.resolve()}; jaxclear report {folder}")


def _parse_time_column(text: str) -> tuple[str, str, float, float]:
    """Column, unit, and begin and end [s] of what counts, as typed: t, t:ms or t:ms:0.1:0.6."""
    column, unit, begin, end, *more = [*text.split(":"), "", "", ""]
    try:
        if any(more):
            raise ValueError
        return column, unit or "s", float(begin or -math.inf), float(end or math.inf)
    except ValueError:
        raise ValueError(f'the time is "{text}"; give COLUMN:UNIT:BEGIN:END, as t:ms.') from None


def monte_carlo(
    scene: Path,
    samples: int,
    folder: Path | None = None,
    seed: int = 0,
    chunk: int | None = None,
    show: bool = True,
) -> None:
    """A campaign over what varies of a scene; it continues where an earlier one stopped.

    Args:
        scene: path of the file.
        samples: number of samples.
        folder: for the samples; None: named after the scene.
        seed: of the samples.
        chunk: samples computed at once; None: chosen.
        show: whether a progress bar is shown.
    """
    folder = Path(f"{scene.stem}_store") if folder is None else folder
    try:
        with mistakes_told():
            content = read(scene)
            study = jc.campaign(
                content.problem(), samples, folder=folder, seed=seed, chunk=chunk, progress_bar=show
            )
    finally:
        _copy_scene(scene, folder)
    table = study.summary()
    click.echo(f"\n{table}\n")
    report_samples(study)
    click.echo(f"Samples in {folder.resolve()}; jaxclear report {folder}")
    if len(study.failed) == study.finished:
        raise click.ClickException("every sample failed.")


def _copy_scene(scene: Path, folder: Path) -> None:
    """Keeps the scene beside its samples, once there are any."""
    file = folder / SCENE
    if folder.is_dir() and any(folder.iterdir()) and not file.exists():
        with contextlib.suppress(ValueError):
            jc.write_scene(jc.read_scene(scene), file)
