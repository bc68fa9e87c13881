"""Reads the command line.

A command is declared in `command_list`, which reports mistakes at once; a function in
`jaxclear.commands.cli` executes it. Exit codes: 0 done; 1 a run failed or ended early; 2 what was
typed cannot be; 130 interrupted.
"""

import importlib
import importlib.metadata
import sys
from collections.abc import Callable
from typing import Any

import click

from jaxclear_command.command_list import make_commands
from jaxclear_command.parameters import Group, error_sentence

FAILED, MISTAKEN, INTERRUPTED = 1, 2, 130
TEXT = "Mechanisms whose joints have clearance, contact, friction and wear."
CODES = "0 done, 1 a run failed or ended early, 2 what was typed cannot be, 130 interrupted."


def answered(name: str) -> Callable[..., None]:
    """What runs when a command is called."""

    def answer(**options: Any) -> None:
        # Only now, when there is something to compute: it loads JAX.
        importlib.import_module("jaxclear.commands.cli").answer(name, options)

    return answer


def _version_of(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "of unknown version, not installed"


def _tell_version(ctx: click.Context, param: click.Parameter, is_requested: bool) -> None:
    if is_requested and not ctx.resilient_parsing:
        python = ".".join(map(str, sys.version_info[:3]))
        click.echo(
            f"jaxclear {_version_of('jaxclear')} (JAX {_version_of('jax')}, Python {python})"
        )
        ctx.exit()


def commands() -> Group:
    """Every command of `jaxclear`."""
    version = click.Option(
        ["--version"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_tell_version,
        help="this version, JAX's and Python's",
    )
    return Group(
        make_commands(answered),
        [
            "jaxclear example slider-crank > scene.yaml",
            "jaxclear run scene.yaml",
            "jaxclear monte-carlo scene.yaml --samples 1e4 --out store",
            "jaxclear report store",
            "jaxclear run --help",
        ],
        name="jaxclear",
        help=f"{TEXT}\n\nExit codes: {CODES}",
        params=[version],
        # Without a command there is a sentence, not pages of help.
        no_args_is_help=False,
        context_settings={"max_content_width": 100},
        subcommand_metavar="COMMAND [ARGUMENTS]",
    )


def _exit_with(code: int, sentence: str, path: str = "jaxclear") -> None:
    """Ends the process with a sentence."""
    click.echo(f"{path}: {sentence}", err=True)
    sys.exit(code)


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `jaxclear` command; returns where all was done, exits otherwise."""
    group = commands()
    try:
        code = group.main(arguments, prog_name="jaxclear", standalone_mode=False)
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx else "jaxclear"
        sentence = error_sentence(error)
        if sentence == "Missing command.":
            sentence = f"a command must be named; there are {', '.join(group.commands)}."
        stop = "" if sentence.endswith(("?", ".")) else "."
        _exit_with(MISTAKEN, f"{sentence}{stop} See {path} --help.", path)
    except click.ClickException as error:
        _exit_with(FAILED, error.format_message())
    except (click.Abort, KeyboardInterrupt) as error:
        # A command that keeps its work says where.
        cause = error.__cause__ if isinstance(error, click.Abort) else error
        _exit_with(INTERRUPTED, str(cause or "") or "interrupted.")
    else:
        if code:
            sys.exit(code)


if __name__ == "__main__":
    main()
