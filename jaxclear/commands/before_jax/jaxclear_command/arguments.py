"""What a command may be asked: numbers with a range, names, folders and files; each refuses with
what was given and what it must be.
"""

import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn

import click

from jaxclear_command.wording import hint


def _refuse(text: str, wanted: str) -> NoReturn:
    raise click.BadParameter(f"{text} was given; it must be {wanted}")


class Read(click.ParamType):
    """What a function makes of a text; `name` stands for it in --help."""

    def __init__(self, name: str, function: Callable[[str], Any]):
        self.name, self.function = name, function

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value; what is no text was made by this function before."""
        return self.function(value) if isinstance(value, str) else value


def number(least: float, unit: str, above: bool = False) -> Read:
    """Finite numbers [unit] that are at least `least`, or above it."""
    wanted = f"a number {'above' if above else 'of at least'} {least:g} {unit}".rstrip()

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            _refuse(text, wanted)
        if not math.isfinite(value) or not (value > least if above else value >= least):
            _refuse(text, wanted)
        return value

    return Read("number", read)


def whole(least: int) -> Read:
    """Whole numbers that are at least `least`; 1e5 is one."""
    wanted = f"a whole number of at least {least}"

    def read(text: str) -> int:
        try:
            value = int(text) if text.strip("+-").isdecimal() else float(text)
        except ValueError:
            _refuse(text, wanted)
        if not math.isfinite(value) or value != int(value) or value < least:
            _refuse(text, wanted)
        return int(value)

    return Read("whole number", read)


def one_of(known: Iterable[str]) -> Read:
    """One of some names."""
    known = list(known)

    def read(text: str) -> str:
        if text not in known:
            _refuse(text, f"{', '.join(known[:-1])} or {known[-1]}.{hint(text, known)}")
        return text

    return Read("|".join(known), read)


def _folder(text: str) -> Path:
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


def _store(text: str) -> Path:
    """A folder that is there."""
    path = Path(text)
    if not path.is_dir():
        what = "is a file" if path.exists() else "is not there"
        raise click.BadParameter(f"{text} {what}; it must be a folder that a study has written")
    return path


def _readable_file(text: str) -> Path:
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


def _page(text: str) -> Path:
    """A file that can be written."""
    path = Path(text)
    if path.is_dir() or not path.parent.is_dir():
        raise click.BadParameter(f"{text} was given; it must be a file in a folder that is there")
    return path


page = Read("file", _page)
store, readable_file = Read("folder", _store), Read("file", _readable_file)


def flag(name: str, text: str, kind: Read, default: Any = None, shown: str = "") -> click.Option:
    """An argument by name, with its text for --help; `shown`: the default in words."""
    return click.Option(
        [name], type=kind, default=default, help=text, show_default=shown or default is not None
    )


def out(default: str | None, text: str = "folder for figures and tables") -> click.Option:
    """`--out`: where results are written."""
    return flag("--out", text, Read("folder", _folder), default)


def quiet() -> click.Option:
    """`--quiet`: no progress bars."""
    return click.Option(["--quiet"], is_flag=True, help="no progress bars")
