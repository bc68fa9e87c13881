"""The commands, each with what it may be asked: what is done with a scene file of one's own, and
the studies of ready scenes.
"""

from collections.abc import Callable
from typing import NamedTuple

import click

from jaxclear_command.parameters import (
    Command,
    Read,
    flag,
    integer,
    number,
    one_of,
    out,
    page,
    quiet,
    readable_file,
    store,
)

EXAMPLES = ("slider-crank", "four-bar", "antenna")
METHODS = ("statistics", "signal")
TEXT_OF = Read("text", str)


def several(name: str, text: str) -> click.Option:
    """An argument that may be given more than once."""
    return click.Option([name], multiple=True, type=TEXT_OF, help=text)


SCENE = click.Argument(["scene"], type=readable_file)
MAYBE_SCENE = click.Argument(["scene"], type=readable_file, required=False)


class Offer(NamedTuple):
    """What a command does, what it may be asked, and examples as they are typed."""

    text: str
    arguments: list[click.Parameter]
    examples: list[str]


SCENE_FILES = {
    "run": Offer(
        "runs a scene file once: summary with warnings, data set, figures",
        [
            SCENE,
            out(None, "folder for data set, figures and tables (default SCENE_run)"),
            flag("--duration", "time [s], in place of the file's", number(0.0, "s", above=True)),
            flag("--saves", "saved instants, in place of the file's", integer(2)),
            quiet(),
        ],
        [
            "jaxclear run scene.yaml",
            "jaxclear run scene.yaml --duration 0.5 --saves 2001 --out first",
        ],
    ),
    "monte-carlo": Offer(
        "samples what varies of a scene file, kept in a folder; goes on if interrupted",
        [
            SCENE,
            flag("--samples", "samples in all", integer(2), 1024),
            out(None, "folder of the samples (default SCENE_store)"),
            flag("--seed", "of the samples", integer(0), 0, "0"),
            flag("--chunk", "samples kept at a time (default by the problem)", integer(1)),
            quiet(),
        ],
        [
            "jaxclear monte-carlo scene.yaml --samples 1e5 --out store",
            "jaxclear monte-carlo scene.yaml --samples 64 --quiet",
        ],
    ),
    "yield": Offer(
        "share of parts within limits, from the drawing of a scene file: at rest, in motion",
        [
            SCENE,
            click.Option(
                ["--limit"],
                multiple=True,
                required=True,
                help='a response and its largest value, or both limits: "error: 40e-6"',
            ),
            flag("--samples", "runs in motion", integer(32), 256),
            out(None, "folder for tables and pictures (default SCENE_yield)"),
            quiet(),
        ],
        ['jaxclear yield scene.yaml --limit "error: 40e-6"'],
    ),
    "identify": Offer(
        "what records of sensors (CSV) tell of what varies of a scene file",
        [
            SCENE,
            click.Argument(["record"], type=readable_file, nargs=-1, required=True),
            click.Option(
                ["--signal"],
                multiple=True,
                required=True,
                help="a column and its sensor, COLUMN=SENSOR:PLACE:AXIS:noise=NUMBER; SENSOR is "
                "accelerometer, gyroscope or displacement of a body, force or encoder of a joint",
            ),
            flag(
                "--time",
                "column of the time [s]; t:ms where it is in ms, t:ms:0.1:0.6 for the part "
                "from 0.1 to 0.6 s",
                TEXT_OF,
                "time",
            ),
            flag("--turn", "column of an encoder, or the period [s]", TEXT_OF),
            flag("--runs", "runs that the records are compared with", integer(64), 256),
            flag("--how", "statistics of signals, or signals", one_of(METHODS), "statistics"),
            out(None, "folder for table and figure (default SCENE_identified)"),
            quiet(),
        ],
        [
            "jaxclear identify scene.yaml run3.csv --signal a_x=accelerometer:slider:x:noise=0.3 "
            "--turn 0.042"
        ],
    ),
    "fmu": Offer(
        "a scene file as an FMI 3.0 unit (FMU) of machine code for simulators of systems",
        [
            SCENE,
            flag("--out", "the unit (default SCENE.fmu)", page),
            several("--input", "a number of a load that may change, NAME=NUMBER"),
            several("--parameter", "a number that may be set before a run, NAME=NUMBER"),
            several("--slope", "NAME of an input or parameter along which slopes are carried"),
            click.Option(["--model-exchange"], is_flag=True, help="for model exchange, too"),
            flag("--interval", "usual communication step [s]", number(0.0, "s", above=True), 1e-3),
            flag("--target", "x86_64-linux, x86_64-windows, ... (default this system)", TEXT_OF),
        ],
        [
            "jaxclear fmu scene.yaml --out crank.fmu",
            "jaxclear fmu scene.yaml --parameter 'gap=connections[\"B\"].joint.clearance'",
        ],
    ),
    "report": Offer(
        "one HTML page of a folder: figures, tables, what was run, versions",
        [
            click.Argument(["store"], type=store),
            flag("--to", "the page (default report.html in the folder)", page),
        ],
        ["jaxclear report store", "jaxclear report store --to store.html"],
    ),
    "example": Offer(
        f"prints a scene file to begin with: {', '.join(EXAMPLES)}",
        [click.Argument(["name"], type=one_of(EXAMPLES))],
        [f"jaxclear example {name} > scene.yaml" for name in EXAMPLES],
    ),
    "parameters": Offer(
        "all numbers of a scene file, or of the four-bar, with unit and meaning",
        [MAYBE_SCENE],
        ["jaxclear parameters scene.yaml", "jaxclear parameters"],
    ),
}


STUDIES = {
    "four-bar": Offer(
        "four-bar with three-dimensional clearance and wear: runs, Monte Carlo, derivatives",
        [
            out("four_bar_study"),
            flag("--samples", "Monte Carlo samples", integer(16), 256),
            flag("--duration", "time of the paper's runs [s]", number(0.01, "s"), 5.0),
            flag("--turns", "turns of the crank in the Monte Carlo", number(0.01, ""), 2.0),
            quiet(),
        ],
        ["jaxclear four-bar --samples 1000 --out study"],
    ),
    "antenna": Offer(
        "antenna on a satellite with clearance and dry friction: motion, errors of the tip",
        [
            out("antenna_study"),
            flag("--duration", "time of the periodic drive [s]", number(0.01, "s"), 4.0),
        ],
        ["jaxclear antenna --duration 2"],
    ),
    "guide": Offer(
        "slider in a rotating guide: corner forces, switchings, impacts of a small clearance",
        [
            out("guide_study"),
            flag(
                "--clearance", "gap of the run with impacts [m]", number(0.0, "m", above=True), 1e-5
            ),
            click.Option(["--wear"], is_flag=True, help="wear both parts, and draw their depth"),
            quiet(),
        ],
        ["jaxclear guide --clearance 2e-5", "jaxclear guide --wear"],
    ),
    "flap": Offer(
        "flap actuation with four clearance joints: modes, impacts, forces, lever ratio",
        [
            out("flap_study"),
            flag("--duration", "simulated time [s]", number(0.01, "s"), 0.5),
            quiet(),
        ],
        ["jaxclear flap --duration 1"],
    ),
    "3rsr": Offer(
        "3RSR parallel mechanism: a ball's force in three regimes, its limit, its worn socket",
        [
            out("3rsr_study"),
            flag("--cycles", "cycles over which the socket is worn", integer(1), 40),
            quiet(),
        ],
        ["jaxclear 3rsr --cycles 100"],
    ),
    "arm": Offer(
        "robot arm with play in its reducers: errors of the tip, lost motion, which to buy better",
        [out("arm_study"), flag("--samples", "Monte Carlo samples", integer(16), 128), quiet()],
        ["jaxclear arm --samples 1000"],
    ),
    "wear-life": Offer(
        "wear of a bearing over a life: settled cycle, depth and forces over cycles, groove",
        [
            out("wear_life_study"),
            flag("--cycles", "cycles of the machine's life", number(1.0, ""), 1e6, "1e6"),
            flag(
                "--tolerance",
                "error of the depth asked for, as a share of it",
                number(0.0, "", above=True),
                0.01,
            ),
            quiet(),
        ],
        ["jaxclear wear-life --cycles 1e7 --tolerance 0.02"],
    ),
    "design": Offer(
        "tolerances and clearances that cost least and keep limits on error and wear",
        [
            flag(
                "--scene",
                "antenna (pointing error) or four-bar (worn depth and follower error)",
                one_of(("antenna", "four-bar")),
                "antenna",
            ),
            out("design_study"),
            flag(
                "--accuracy",
                "by how much of itself a limit may be missed",
                number(0.0, "", above=True),
                5e-3,
            ),
            quiet(),
        ],
        ["jaxclear design --scene four-bar"],
    ),
}


CACHE_COMMANDS = {
    "cache": Offer(
        "the compiled programs that are kept between runs, in $JAXCLEAR_CACHE (0: none are)",
        [click.Option(["--clear"], is_flag=True, help="remove them all")],
        ["jaxclear cache", "jaxclear cache --clear"],
    )
}


HEADINGS = {
    "Your own scene": SCENE_FILES,
    "Studies of ready scenes": STUDIES,
    "Compiled programs": CACHE_COMMANDS,
}


def make_commands(answered: Callable[[str], Callable[..., None]]) -> dict[str, list[click.Command]]:
    """Commands by heading; `answered` gives what runs when the command of a name is called."""
    return {
        heading: [
            Command(name, offer.examples, answered(name), help=offer.text, params=offer.arguments)
            for name, offer in offers.items()
        ]
        for heading, offers in HEADINGS.items()
    }
