"""What the command line does with a scene file: a run of it, a campaign over what varies of it, a
list of its numbers; and files of ready scenes to begin with.
"""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

import jaxclear as jc
from jaxclear.commands.kept_run import keep, keep_positions
from jaxclear.commands.reported import report_samples, report_warnings

__all__ = ["monte_carlo", "parameters", "run"]

SCENE = "scene.yaml"


@contextlib.contextmanager
def _mistakes() -> Iterator[None]:
    """A scene that cannot be read, run or asked ends the command with its sentence."""
    try:
        yield
    except jc.SimulationError:
        raise
    except (ValueError, TypeError) as error:
        raise click.UsageError(str(error)) from None
    except ImportError as error:
        raise click.ClickException(str(error)) from None


def _read(scene: Path, **changes: Any) -> jc.Scene:
    """The scene in a file, with what was asked otherwise."""
    asked = {name: value for name, value in changes.items() if value is not None}
    return dataclasses.replace(jc.read_scene(scene), **asked)


def parameters(scene: Path | None = None) -> None:
    """Prints the numbers of a scene file, or of the four-bar."""
    with _mistakes():
        mechanism = jc.scenes.four_bar() if scene is None else _read(scene).mechanism
    click.echo(mechanism.parameters())


def run(
    scene: Path,
    folder: Path | None = None,
    duration: float | None = None,
    saves: int | None = None,
    show: bool = True,
) -> None:
    """Runs a scene once, prints how it went, and writes data set, figures and tables to `folder`
    (by default named after the file); of a scene over positions where it stands. `duration` [s] and
    `saves` instead of the file's own.
    """
    folder = Path(f"{scene.stem}_run") if folder is None else folder
    with _mistakes():
        asked = _read(scene, duration=duration, save=saves)
        if asked.positions is not None:
            table = keep_positions(asked, asked.stand(), folder, scene.name)
            click.echo(f"The mechanism stands at {len(table)} positions.")
            click.echo(
                f"Data set, figure and table in {folder.resolve()}; jaxclear report {folder}"
            )
            return
        found = asked.simulate(progress_bar=show, throw=False)
    click.echo(str(found))
    table = keep(asked, found, folder, scene.name)
    if len(table):
        click.echo(f"\n{table}\n")
    report_warnings({scene.stem: found})
    click.echo(f"Data set, figures and tables in {folder.resolve()}; jaxclear report {folder}")
    if not found.succeeded:
        raise click.ClickException(found.result)


def monte_carlo(
    scene: Path,
    samples: int,
    folder: Path | None = None,
    seed: int = 0,
    chunk: int | None = None,
    show: bool = True,
) -> None:
    """A campaign over what varies of a scene, kept in `folder` (by default named after the file)
    chunk by chunk; goes on where an earlier one was interrupted. Prints statistics with errors,
    failures and warnings."""
    folder = Path(f"{scene.stem}_store") if folder is None else folder
    try:
        with _mistakes():
            asked = _read(scene)
            found = jc.campaign(
                asked.problem(), samples, folder=folder, seed=seed, chunk=chunk, progress_bar=show
            )
    finally:
        _remember(scene, folder)
    table = found.summary()
    click.echo(f"\n{table}\n")
    report_samples(found)
    click.echo(f"Samples in {folder.resolve()}; jaxclear report {folder}")
    if len(found.failed) == found.finished:
        raise click.ClickException("every sample failed.")


def _remember(scene: Path, folder: Path) -> None:
    """Keeps the scene beside its samples, once there are any."""
    kept = folder / SCENE
    if folder.is_dir() and any(folder.iterdir()) and not kept.exists():
        with contextlib.suppress(ValueError):
            jc.write_scene(jc.read_scene(scene), kept)
