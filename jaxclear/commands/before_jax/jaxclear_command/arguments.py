"""What a study may be asked: numbers with a range, a folder, flags; and sentences for what is
wrong.
"""

import argparse
import difflib
import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NoReturn

__all__ = ["Parser", "add_out", "add_quiet", "hint", "number", "whole"]


def hint(name: str, known: Iterable[str]) -> str:
    """ " Did you mean ...?" for the known name most like another; "" where none is."""
    found = difflib.get_close_matches(name.lower(), list(known), 1)
    return f' Did you mean "{found[0]}"?' if found else ""


class Parser(argparse.ArgumentParser):
    """A parser that answers with one sentence, and takes no abbreviations."""

    def __init__(self, **settings):
        argparse.ArgumentParser.__init__(self, **settings | {"allow_abbrev": False})
        self.flags: list[str] = []

    def flag(self, name: str, text: str, **settings) -> None:
        """An argument by name, with its text for --help."""
        self.flags.append(name)
        self.add_argument(name, help=text, **settings)

    def error(self, message: str) -> NoReturn:
        message = message.removeprefix("argument ")
        if message.endswith("expected one argument"):
            flag = message.partition(":")[0]
            message = f"{flag}: it must have a value, a negative one as {flag}=-1"
        stop = "" if message.endswith(("?", ".")) else "."
        self.exit(2, f"{self.prog}: {message}{stop} See {self.prog} --help.\n")


def _folder(text: str) -> Path:
    """A folder that is there or can be made."""
    if not text.strip():
        raise argparse.ArgumentTypeError("is empty; it must be a folder")
    path = Path(text)
    place = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not place.is_dir():
        raise argparse.ArgumentTypeError(f"{place} is a file; it must be a folder")
    if not os.access(place, os.W_OK):
        raise argparse.ArgumentTypeError(f"{place} may not be written to; give another folder")
    return path


def add_out(parser: Parser, default: str) -> None:
    """`--out`: folder for figures and tables."""
    text = f"folder for figures and tables (default {default})"
    parser.flag("--out", text, type=_folder, default=Path(default))


def add_quiet(parser: Parser) -> None:
    """`--quiet`: no progress bars."""
    parser.flag("--quiet", "no progress bars", action="store_true")


def _read(text: str, kind: type, fits: Callable[[float], bool], wanted: str) -> float:
    try:
        value = kind(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} was given; it must be {wanted}") from None
    if not math.isfinite(value) or not fits(value):
        raise argparse.ArgumentTypeError(f"{text} was given; it must be {wanted}")
    return value


def number(least: float, unit: str, above: bool = False) -> Callable[[str], float]:
    """A reader of finite numbers [unit] that are at least `least`, or above it."""
    wanted = f"a number {'above' if above else 'of at least'} {least:g} {unit}".rstrip()
    fits = (lambda x: x > least) if above else (lambda x: x >= least)
    return lambda text: _read(text, float, fits, wanted)


def whole(least: int) -> Callable[[str], float]:
    """A reader of whole numbers that are at least `least`."""
    wanted = f"a whole number of at least {least}"
    return lambda text: _read(text, int, lambda x: x >= least, wanted)
