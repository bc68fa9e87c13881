"""Reads the command line: `jaxclear four-bar`, `antenna`, `guide`, `flap`, `3rsr`, `wear-life` and
`design` run studies, `jaxclear parameters` lists a scene's numbers with units.

A study is an entry in STUDIES, which declares its arguments, and a module of `jaxclear.commands`
with a function `run`, which answers them.
"""

import argparse
import importlib
import importlib.metadata
import sys
from collections.abc import Callable
from typing import NamedTuple

from jaxclear_command.arguments import Parser, add_out, add_quiet, hint, number, whole

__all__ = ["main", "read"]


class Study(NamedTuple):
    """What a study does, in words, and how its arguments are declared."""

    help: str
    declare: Callable[[Parser], None]


def _four_bar(parser: Parser) -> None:
    add_out(parser, "four_bar_study")
    samples, duration, turns = (
        "Monte Carlo samples (default 256)",
        "simulated time of the paper's runs [s] (default 5)",
        "turns of the crank in the Monte Carlo (default 2)",
    )
    parser.flag("--samples", samples, type=whole(16), default=256)
    parser.flag("--duration", duration, type=number(0.01, "s"), default=5.0)
    parser.flag("--turns", turns, type=number(0.01, ""), default=2.0)
    add_quiet(parser)


def _antenna(parser: Parser) -> None:
    add_out(parser, "antenna_study")
    duration = "simulated time of the periodic drive [s] (default 4)"
    parser.flag("--duration", duration, type=number(0.01, "s"), default=4.0)


def _guide(parser: Parser) -> None:
    add_out(parser, "guide_study")
    gap = "gap of the run with impacts [m] (default 1e-5)"
    parser.flag("--clearance", gap, type=number(0.0, "m", above=True), default=1e-5)
    add_quiet(parser)


def _flap(parser: Parser) -> None:
    add_out(parser, "flap_study")
    duration = "simulated time [s] (default 0.5)"
    parser.flag("--duration", duration, type=number(0.01, "s"), default=0.5)
    add_quiet(parser)


def _parallel_3rsr(parser: Parser) -> None:
    add_out(parser, "3rsr_study")
    cycles = "cycles over which the socket is worn (default 40)"
    parser.flag("--cycles", cycles, type=whole(1), default=40)
    add_quiet(parser)


def _wear_life(parser: Parser) -> None:
    add_out(parser, "wear_life_study")
    cycles = "cycles of the machine's life (default 1e6)"
    parser.flag("--cycles", cycles, type=number(1.0, ""), default=1e6)
    tolerance = "error of the depth asked for, as a share of it (default 0.01)"
    parser.flag("--tolerance", tolerance, type=number(0.0, "", above=True), default=0.01)
    add_quiet(parser)


def _design(parser: Parser) -> None:
    scene = "antenna (pointing error) or four-bar (worn depth and follower error); default antenna"
    parser.flag("--scene", scene, choices=("antenna", "four-bar"), default="antenna")
    add_out(parser, "design_study")
    accuracy = "by how much of itself a limit may be missed (default 0.005)"
    parser.flag("--accuracy", accuracy, type=number(0.0, "", above=True), default=5e-3)
    add_quiet(parser)


STUDIES = {
    "four-bar": Study(
        "four-bar with three-dimensional clearance and wear: runs, Monte Carlo, derivatives",
        _four_bar,
    ),
    "antenna": Study(
        "antenna on a satellite with clearance and dry friction: motion, errors of the tip",
        _antenna,
    ),
    "guide": Study(
        "slider in a rotating guide: corner forces, switchings, impacts of a small clearance",
        _guide,
    ),
    "flap": Study(
        "flap actuation with four clearance joints: modes, impacts, forces, lever ratio", _flap
    ),
    "3rsr": Study(
        "3RSR parallel mechanism: a ball's force in three regimes, its limit, its worn socket",
        _parallel_3rsr,
    ),
    "wear-life": Study(
        "wear of a bearing over a life: settled cycle, depth and forces over cycles, groove",
        _wear_life,
    ),
    "design": Study(
        "tolerances and clearances that cost least and keep limits on error and wear", _design
    ),
    "parameters": Study("all numbers of the four-bar with unit and meaning", lambda parser: None),
}


def _version() -> str:
    try:
        return importlib.metadata.version("jaxclear")
    except importlib.metadata.PackageNotFoundError:
        return "of unknown version, not installed"


def read(arguments: list[str]) -> argparse.Namespace:
    """What was asked. Exits with a sentence for what cannot be."""
    text = "Studies of mechanisms whose joints have clearance, contact, friction and wear."
    parser = Parser(prog="jaxclear", description=text)
    parser.add_argument("--version", action="version", version=f"jaxclear {_version()}")
    commands = parser.add_subparsers(dest="command", required=True, parser_class=Parser)
    readers = {}
    for name, study in STUDIES.items():
        readers[name] = commands.add_parser(name, help=study.help, description=study.help)
        study.declare(readers[name])
    first = next((word for word in arguments if not word.startswith("-")), "")
    known = ", ".join(STUDIES)
    if not arguments:
        parser.error(f"a study must be named; there are {known}.")
    if first and first not in STUDIES:
        parser.error(f'no study "{first}"; there are {known}.{hint(first, STUDIES)}')
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        reader = readers[options.command]
        known = ", ".join(reader.flags) or "none"
        near = hint(unknown[0], reader.flags)
        reader.error(f'no argument "{unknown[0]}"; there are {known}.{near}')
    return options


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `jaxclear` command."""
    options = read(sys.argv[1:] if arguments is None else arguments)
    # Only now, when there is something to compute: it loads JAX.
    importlib.import_module("jaxclear.commands.cli").answer(options)


if __name__ == "__main__":
    main()
