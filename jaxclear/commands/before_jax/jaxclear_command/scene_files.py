"""What is done with a scene file of one's own: a run, a campaign, a report, a list of its numbers,
and files to begin with.
"""

from collections.abc import Callable

import click

from jaxclear_command.arguments import (
    flag,
    number,
    one_of,
    out,
    page,
    quiet,
    readable_file,
    store,
    whole,
)
from jaxclear_command.declared import Command

EXAMPLES = ("slider-crank", "four-bar", "antenna")


SCENE = click.Argument(["scene"], type=readable_file)
MAYBE_SCENE = click.Argument(["scene"], type=readable_file, required=False)
# (what it does, its arguments, examples) by name.
COMMANDS: dict[str, tuple[str, list[click.Parameter], list[str]]] = {
    "run": (
        "runs a scene file once: summary with warnings, data set, figures",
        [
            SCENE,
            out(None, "folder for data set, figures and tables (default SCENE_run)"),
            flag("--duration", "time [s], in place of the file's", number(0.0, "s", above=True)),
            flag("--saves", "saved instants, in place of the file's", whole(2)),
            quiet(),
        ],
        [
            "jaxclear run scene.yaml",
            "jaxclear run scene.yaml --duration 0.5 --saves 2001 --out first",
        ],
    ),
    "monte-carlo": (
        "samples what varies of a scene file, kept in a folder; goes on if interrupted",
        [
            SCENE,
            flag("--samples", "samples in all", whole(2), 1024),
            out(None, "folder of the samples (default SCENE_store)"),
            flag("--seed", "of the samples", whole(0), 0, "0"),
            flag("--chunk", "samples kept at a time (default by the problem)", whole(1)),
            quiet(),
        ],
        [
            "jaxclear monte-carlo scene.yaml --samples 1e5 --out store",
            "jaxclear monte-carlo scene.yaml --samples 64 --quiet",
        ],
    ),
    "report": (
        "one HTML page of a folder: figures, tables, what was run, versions",
        [
            click.Argument(["store"], type=store),
            flag("--to", "the page (default report.html in the folder)", page),
        ],
        ["jaxclear report store", "jaxclear report store --to store.html"],
    ),
    "example": (
        f"prints a scene file to begin with: {', '.join(EXAMPLES)}",
        [click.Argument(["name"], type=one_of(EXAMPLES))],
        [f"jaxclear example {name} > scene.yaml" for name in EXAMPLES],
    ),
    "parameters": (
        "all numbers of a scene file, or of the four-bar, with unit and meaning",
        [MAYBE_SCENE],
        ["jaxclear parameters scene.yaml", "jaxclear parameters"],
    ),
}


def scene_files(answered: Callable[[str], Callable[..., None]]) -> list[click.Command]:
    """All of them; `answered` gives what runs when the command of a name is called."""
    return [
        Command(name, examples, answered(name), help=text, params=params)
        for name, (text, params, examples) in COMMANDS.items()
    ]
