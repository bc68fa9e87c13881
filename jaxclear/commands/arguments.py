"""Arguments that the studies share: the folder for the results, numbers with a least value, no
progress bars.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

__all__ = ["add_out", "add_quiet", "at_least", "positive"]


def add_out(parser: argparse.ArgumentParser, default: str) -> None:
    """`--out`: folder for figures and tables."""
    text = f"folder for figures and tables (default {default})"
    parser.add_argument("--out", type=Path, default=Path(default), help=text)


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """`--quiet`: no progress bars."""
    parser.add_argument("--quiet", action="store_true", help="no progress bars")


def at_least(least: float, kind: type = float) -> Callable[[str], float]:
    """A number of `kind` that is at least `least`."""

    def read(text: str) -> float:
        value = kind(text)
        if not value >= least:
            raise argparse.ArgumentTypeError(f"{text} is too small; it must be at least {least}")
        return value

    read.__name__ = kind.__name__
    return read


def positive(text: str) -> float:
    """A number above zero."""
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} is not positive")
    return value
