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

__all__ = ["scene_files"]

EXAMPLES = ("slider-crank", "four-bar", "antenna")


def scene_files(answered: Callable[[str], Callable[..., None]]) -> list[click.Command]:
    """All of them; `answered` gives what runs when the command of a name is called."""
    scene = click.Argument(["scene"], type=readable_file)
    maybe_scene = click.Argument(["scene"], type=readable_file, required=False)
    return [
        Command(
            "run",
            [
                "jaxclear run scene.yaml",
                "jaxclear run scene.yaml --duration 0.5 --saves 2001 --out first",
            ],
            answered("run"),
            help="runs a scene file once: summary with warnings, data set, figures",
            params=[
                scene,
                out(None, "folder for data set, figures and tables (default SCENE_run)"),
                flag(
                    "--duration", "time [s], in place of the file's", number(0.0, "s", above=True)
                ),
                flag("--saves", "saved instants, in place of the file's", whole(2)),
                quiet(),
            ],
        ),
        Command(
            "monte-carlo",
            [
                "jaxclear monte-carlo scene.yaml --samples 1e5 --out store",
                "jaxclear monte-carlo scene.yaml --samples 64 --quiet",
            ],
            answered("monte-carlo"),
            help="samples what varies of a scene file, kept in a folder; goes on if interrupted",
            params=[
                scene,
                flag("--samples", "samples in all", whole(2), 1024),
                out(None, "folder of the samples (default SCENE_store)"),
                flag("--seed", "of the samples", whole(0), 0, "0"),
                flag("--chunk", "samples kept at a time (default by the problem)", whole(1)),
                quiet(),
            ],
        ),
        Command(
            "report",
            ["jaxclear report store", "jaxclear report store --to store.html"],
            answered("report"),
            help="one HTML page of a folder: figures, tables, what was run, versions",
            params=[
                click.Argument(["store"], type=store),
                flag("--to", "the page (default report.html in the folder)", page),
            ],
        ),
        Command(
            "example",
            [f"jaxclear example {name} > scene.yaml" for name in EXAMPLES],
            answered("example"),
            help=f"prints a scene file to begin with: {', '.join(EXAMPLES)}",
            params=[click.Argument(["name"], type=one_of(EXAMPLES))],
        ),
        Command(
            "parameters",
            ["jaxclear parameters scene.yaml", "jaxclear parameters"],
            answered("parameters"),
            help="all numbers of a scene file, or of the four-bar, with unit and meaning",
            params=[maybe_scene],
        ),
    ]
