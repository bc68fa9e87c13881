"""Answers the command line, with what `jaxclear_command` has read and found in order.

A study of a ready scene is a module with a function `study`, a line here and its declaration there.
A click exception ends the process with its sentence; so do a run that ends early and a folder that
holds another study.
"""

import os
from collections.abc import Callable
from typing import Any

import click
import jax

import jaxclear as jc
from jaxclear.commands import antenna, arm, design, flap, four_bar, guide, parallel_3rsr, wear_life
from jaxclear.commands.cache import cache
from jaxclear.commands.drawing_yield import drawing_yield
from jaxclear.commands.report import report
from jaxclear.commands.scene_file import example, fmu, identify, monte_carlo, parameters, run
from jaxclear.ground import cache_folder
from jaxclear.studies.store.store import OtherStudyError, StoreError

STUDIES = (antenna, arm, design, flap, four_bar, guide, parallel_3rsr, wear_life)
# Programs that compile faster than this are not kept [s].
WORTH_KEEPING = 0.5

# What answers each command, by its name with low lines.
SCENE_COMMANDS = (run, monte_carlo, identify, fmu, report, example, parameters, cache)
COMMANDS: dict[str, Callable[..., None]] = {one.__name__: one for one in SCENE_COMMANDS}
COMMANDS |= {"yield": drawing_yield} | {
    study.__name__.rpartition(".")[2].removeprefix("parallel_"): study.study for study in STUDIES
}


def answer(name: str, options: dict[str, Any]) -> None:
    """Runs the command of a name with its arguments, where `out` is a folder and `quiet` shows no
    progress."""
    _keep_compiled_programs()
    arguments = {"folder" if one == "out" else one: value for one, value in options.items()}
    if "quiet" in arguments:
        arguments["show"] = not arguments.pop("quiet")
    try:
        COMMANDS[name.replace("-", "_")](**arguments)
    except (jc.SimulationError, OtherStudyError, StoreError) as error:
        raise click.ClickException(str(error)) from None


def _keep_compiled_programs() -> None:
    """JAX keeps the programs of a command, too: those of its own functions, which no other process
    of this package's would find. In $JAX_COMPILATION_CACHE_DIR, or beside the others."""
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR") or cache_folder.jax_folder()
    if folder is not None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)
