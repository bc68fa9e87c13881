"""The studies of ready scenes, each with what it may be asked."""

from collections.abc import Callable

import click

from jaxclear_command.arguments import flag, number, one_of, out, quiet, whole
from jaxclear_command.declared import Command

# (what it does, its arguments, examples) by name.
STUDIES: dict[str, tuple[str, list[click.Parameter], list[str]]] = {
    "four-bar": (
        "four-bar with three-dimensional clearance and wear: runs, Monte Carlo, derivatives",
        [
            out("four_bar_study"),
            flag("--samples", "Monte Carlo samples", whole(16), 256),
            flag("--duration", "time of the paper's runs [s]", number(0.01, "s"), 5.0),
            flag("--turns", "turns of the crank in the Monte Carlo", number(0.01, ""), 2.0),
            quiet(),
        ],
        ["jaxclear four-bar --samples 1000 --out study"],
    ),
    "antenna": (
        "antenna on a satellite with clearance and dry friction: motion, errors of the tip",
        [
            out("antenna_study"),
            flag("--duration", "time of the periodic drive [s]", number(0.01, "s"), 4.0),
        ],
        ["jaxclear antenna --duration 2"],
    ),
    "guide": (
        "slider in a rotating guide: corner forces, switchings, impacts of a small clearance",
        [
            out("guide_study"),
            flag(
                "--clearance",
                "gap of the run with impacts [m]",
                number(0.0, "m", above=True),
                1e-5,
            ),
            click.Option(["--wear"], is_flag=True, help="wear both parts, and draw their depth"),
            quiet(),
        ],
        ["jaxclear guide --clearance 2e-5", "jaxclear guide --wear"],
    ),
    "flap": (
        "flap actuation with four clearance joints: modes, impacts, forces, lever ratio",
        [
            out("flap_study"),
            flag("--duration", "simulated time [s]", number(0.01, "s"), 0.5),
            quiet(),
        ],
        ["jaxclear flap --duration 1"],
    ),
    "3rsr": (
        "3RSR parallel mechanism: a ball's force in three regimes, its limit, its worn socket",
        [
            out("3rsr_study"),
            flag("--cycles", "cycles over which the socket is worn", whole(1), 40),
            quiet(),
        ],
        ["jaxclear 3rsr --cycles 100"],
    ),
    "wear-life": (
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
    "design": (
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


def studies(answered: Callable[[str], Callable[..., None]]) -> list[click.Command]:
    """All of them; `answered` gives what runs when the command of a name is called."""
    return [
        Command(name, examples, answered(name), help=text, params=params)
        for name, (text, params, examples) in STUDIES.items()
    ]
