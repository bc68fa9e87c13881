"""Which share of parts keeps limits, from the drawing of a scene file: at rest and in motion, what
each line of the drawing contributes, and the worst case."""

from pathlib import Path
from typing import Any

import click

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.own_scene import mistakes_told, read
from jaxclear.commands.study import StudyFolder
from jaxclear.ground.arguments import check_name
from jaxclear.ground.table import as_table

# A position costs far less than a run.
MORE_AT_REST = 4


def limit_of(text: str) -> tuple[str, tuple[float | None, float | None]]:
    """A response and its limits as they are typed: "error: 40e-6", or "error: -1e-5 1e-5"; a single
    one is the largest. Raises `ValueError`."""
    name, _, ends = text.partition(":")
    try:
        numbers = [float(end) for end in ends.split()]
        low, high = [None, *numbers] if len(numbers) == 1 else numbers
    except ValueError:
        raise ValueError(
            f'the limit is "{text}"; write a response and its largest value, or both limits, as in '
            '"error: 40e-6".'
        ) from None
    return name.strip(), (low, high)


def drawing_yield(
    scene: Path,
    limit: tuple[str, ...],
    samples: int = 256,
    folder: Path | None = None,
    show: bool = True,
) -> None:
    """Prints the drawing of a scene file, the yield of its responses within limits at rest and in
    motion, the share of each line of the drawing, and the worst case; tables and pictures go to
    `folder` (by default named after the scene)."""
    with mistakes_told():
        content = read(scene)
        drawn, limits = content.drawn(), dict(map(limit_of, limit))
        if not drawn.names:
            raise ValueError("this scene states no drawing; give it one, with a line at least.")
        for name in limits:
            check_name("response", name, content.responses, " in this scene")
        timed = content.positions is None
        resting = (content.at_rest() if timed else content).problem()
        moving = content.problem() if timed else None
        click.echo(f"{drawn}\n")
        shares: dict[str, Any] = {}
        rows = []
        for title, problem, count in (("at rest", resting, MORE_AT_REST), ("in motion", moving, 1)):
            if problem is None:
                continue
            study = jc.monte_carlo(problem, count * samples, progress_bar=show)
            click.echo(f"Yield {title}: {study.share_within(limits)}. {study.sentence()}")
            of: Any = problem if count > 1 else jc.surface(problem, study)
            shares[title] = (
                jc.sobol_indices(of, samples // 2) if count > 1 else jc.sobol_indices(of)
            )
            for (response, line), total in shares[title].total.items():
                rows.append(
                    {"response": response, "line": line, "when": title, "share": total.value}
                )
                rows[-1]["share error"] = total.error
        worst = jc.worst_case(resting, progress_bar=show)
    click.echo(f"\nShares of the variance, interplay counted in:\n{as_table(rows)}\n")
    click.echo(f"Worst case at rest: {worst.sentence()}")
    kept = StudyFolder(Path(f"{scene.stem}_yield") if folder is None else folder)
    kept.write_tables(drawing=drawn.table(), shares=as_table(rows))
    figures = {
        f"shares {title}".replace(" ", "_"): plot.sobol_indices(own)
        for title, own in shares.items()
    }
    kept.write_figures(drawing=plot.drawing(drawn), **figures)
    click.echo(kept.sentence())
