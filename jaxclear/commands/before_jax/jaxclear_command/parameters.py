"""A command and a group of commands that answer a mistake with one sentence and whose --help ends
in examples; and what a command may be asked: numbers with a range, names, folders and files.
"""

import difflib
import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn

import click


def hint(name: str, names: Iterable[str]) -> str:
    """ " Did you mean ...?" for the known name most like another; "" where none is."""
    matches = difflib.get_close_matches(name.lower(), list(names), 1)
    return f' Did you mean "{matches[0]}"?' if matches else ""


def _option_names(command: click.Command) -> list[str]:
    """Names of the arguments that a command takes by name."""
    return [one for p in command.params if isinstance(p, click.Option) for one in p.opts]


def extra_argument(command: click.Command, argument: str) -> str:
    """A sentence for an argument that a command does not take."""
    flags = _option_names(command)
    listed = ", ".join(flags) or "none"
    return f'no argument "{argument}"; there are {listed}.{hint(argument, flags)}'


def error_sentence(error: click.UsageError) -> str:
    """The sentence for a mistake, without a stop where it ends in a question."""
    command = error.ctx.command if error.ctx else None
    if isinstance(error, click.NoSuchOption) and command:
        return extra_argument(command, error.option_name)
    if isinstance(error, click.BadOptionUsage):
        return f"{error.option_name}: {_describe_misuse(error)}"
    if isinstance(error, click.MissingParameter) and error.param:
        kind = error.param.type.name
        return f"{(error.param.name or '').upper()} is missing; it must be named ({kind})"
    if isinstance(error, click.BadParameter) and error.param:
        named = isinstance(error.param, click.Option)
        return f"{error.param.opts[0]}: {error.message}" if named else error.message
    return error.message


def _describe_misuse(error: click.BadOptionUsage) -> str:
    takes = "requires an argument" in error.message
    return "it must have a value" if takes else "it takes no value"


def _refuse(text: str, required: str) -> NoReturn:
    raise click.BadParameter(f"{text} was given; it must be {required}")


class Read(click.ParamType):
    """What a function makes of a text; `name` stands for it in --help."""

    def __init__(self, name: str, function: Callable[[str], Any]):
        self.name, self.function = name, function

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value of an argument, from its text; other values are returned unchanged.

        Args:
            value: text of the command line, or a default.
            param, ctx: click's, not needed.
        """
        return self.function(value) if isinstance(value, str) else value


def number(least: float, unit: str, above: bool = False) -> Read:
    """A kind of argument: a finite number with a lower bound.

    Args:
        least: lower bound.
        unit: of the number, in messages.
        above: whether the bound itself is excluded.
    """
    required = f"a number {'above' if above else 'of at least'} {least:g} {unit}".rstrip()

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            _refuse(text, required)
        if not math.isfinite(value) or not (value > least if above else value >= least):
            _refuse(text, required)
        return value

    return Read("number", read)


def integer(least: int) -> Read:
    """Whole numbers that are at least `least`; 1e5 is one."""
    required = f"a whole number of at least {least}"

    def read(text: str) -> int:
        try:
            value = int(text) if text.strip("+-").isdecimal() else float(text)
        except ValueError:
            _refuse(text, required)
        if not math.isfinite(value) or value != int(value) or value < least:
            _refuse(text, required)
        return int(value)

    return Read("whole number", read)


def one_of(names: Iterable[str]) -> Read:
    """One of some names."""
    names = list(names)

    def read(text: str) -> str:
        if text not in names:
            _refuse(text, f"{', '.join(names[:-1])} or {names[-1]}.{hint(text, names)}")
        return text

    return Read("|".join(names), read)


def _read_folder(text: str) -> Path:
    """A folder that is there or can be made."""
    if not text.strip():
        raise click.BadParameter("is empty; it must be a folder")
    path = Path(text)
    place = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not place.is_dir():
        raise click.BadParameter(f"{place} is a file; it must be a folder")
    if not os.access(place, os.W_OK):
        raise click.BadParameter(f"{place} may not be written to; give another folder")
    return path


def _read_store(text: str) -> Path:
    """A folder that is there."""
    path = Path(text)
    if not path.is_dir():
        what = "is a file" if path.exists() else "is not there"
        raise click.BadParameter(f"{text} {what}; it must be a folder that a study has written")
    return path


def _read_input_file(text: str) -> Path:
    """A file that is there and can be read; where there is none, the one with a like name."""
    path = Path(text)
    if path.is_dir():
        raise click.BadParameter(f"{text} is a folder; it must be a file")
    if not path.is_file():
        place = path.parent
        near = [p.name for p in place.iterdir() if p.is_file()] if place.is_dir() else []
        raise click.BadParameter(f"no file {text}.{hint(path.name, near)}")
    if not os.access(path, os.R_OK):
        raise click.BadParameter(f"{text} may not be read")
    return path


def _read_output_file(text: str) -> Path:
    """A file that can be written."""
    path = Path(text)
    if path.is_dir() or not path.parent.is_dir():
        raise click.BadParameter(f"{text} was given; it must be a file in a folder that is there")
    return path


page = Read("file", _read_output_file)
store, readable_file = Read("folder", _read_store), Read("file", _read_input_file)


def flag(name: str, text: str, kind: Read, default: Any = None, note: str = "") -> click.Option:
    """An option of a command.

    Args:
        name: such as "--duration".
        text: for --help.
        kind: what it accepts.
        default: its value where it is not given.
        note: the default in words, for --help.
    """
    return click.Option(
        [name], type=kind, default=default, help=text, show_default=note or default is not None
    )


def out(default: str | None, text: str = "folder for figures and tables") -> click.Option:
    """`--out`: where results are written."""
    return flag("--out", text, Read("folder", _read_folder), default)


def quiet() -> click.Option:
    """`--quiet`: no progress bars."""
    return click.Option(["--quiet"], is_flag=True, help="no progress bars")


class Command(click.Command):
    """A command with examples, of which each is a line as it is typed."""

    def __init__(self, name: str, examples: list[str], callback: Callable[..., None], **settings):
        # What is too many is refused in our own words.
        settings["context_settings"] = {"allow_extra_args": True}
        click.Command.__init__(self, name, callback=callback, **settings)
        self.examples = examples

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Reads what was typed; a mistake knows the command that it was made in."""
        try:
            return click.Command.parse_args(self, ctx, args)
        except click.UsageError as error:
            error.ctx = error.ctx or ctx
            raise

    def invoke(self, ctx: click.Context) -> Any:
        """Runs it, once all that was typed has been understood."""
        if ctx.args:
            raise click.UsageError(extra_argument(self, ctx.args[0]), ctx)
        return click.Command.invoke(self, ctx)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The examples."""
        _write_examples(self.examples, formatter)


class Group(click.Group):
    """Commands under headings. `headings`: names of commands by what they are for."""

    def __init__(self, headings: dict[str, list[click.Command]], examples: list[str], **settings):
        every = [command for under in headings.values() for command in under]
        click.Group.__init__(self, commands=every, **settings)
        self.headings, self.examples = headings, examples

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command that is named first."""
        first = args[0]
        if first not in self.commands and not first.startswith("-") and not ctx.resilient_parsing:
            names = ", ".join(self.commands)
            raise click.UsageError(
                f'no command "{first}"; there are {names}.{hint(first, self.commands)}', ctx
            )
        return click.Group.resolve_command(self, ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A section for each heading."""
        for heading, commands in self.headings.items():
            rows = [(one.name or "", one.get_short_help_str(limit=90)) for one in commands]
            with formatter.section(heading):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The examples."""
        _write_examples(self.examples, formatter)


def _write_examples(examples: list[str], formatter: click.HelpFormatter) -> None:
    if examples:
        with formatter.section("Examples"):
            for line in examples:
                formatter.write(f"  {line}\n")
