"""Which share of parts keeps limits, from the drawing of a scene file: at rest and in motion, what
each line of the drawing contributes, and the worst case."""

from pathlib import Path

import click

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.scene_file import mistakes_told, read
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
    """Prints the drawing of a scene file, yield within limits, shares of its lines and worst case.

    The yield is that at rest and in motion; tables and figures go to the folder.

    Args:
        scene: path of the file.
        limit: for each response the text of its limit.
        samples: of the Monte Carlo in motion.
        folder: for the files; None: named after the scene.
        show: whether progress bars are shown.
    """
    with mistakes_told():
        content = read(scene)
        drawn, limits = content.drawn(), dict(map(limit_of, limit))
        if not drawn.names:
            raise ValueError("this scene states no drawing; give it one, with a line at least.")
        for name in limits:
            check_name("response", name, content.responses, " in this scene")
        timed = content.positions is None
        resting = (content.at_rest() if timed else content).problem()
        problems = {"at rest": (resting, MORE_AT_REST * samples)}
        if timed:
            problems["in motion"] = content.problem(), samples
        click.echo(f"{drawn}\n")
        shares, rows = {}, []
        for title, (problem, count) in problems.items():
            study = jc.monte_carlo(problem, count, progress_bar=show)
            click.echo(f"Yield {title}: {study.share_within(limits)}. {study.sentence()}")
            shares[title] = (
                jc.sobol_indices(problem, samples // 2)
                if problem is resting
                else jc.sobol_indices(jc.surface(problem, study))
            )
            rows += [
                {"response": response, "line": line, "when": title}
                | {"share": total.value, "share error": total.error}
                for (response, line), total in shares[title].total.items()
            ]
        worst = jc.worst_case(resting, progress_bar=show)
    click.echo(f"\nShares of the variance, interplay counted in:\n{as_table(rows)}\n")
    click.echo(f"Worst case at rest: {worst.sentence()}")
    kept = StudyFolder(Path(f"{scene.stem}_yield") if folder is None else folder)
    kept.write_tables(drawing=drawn.table(), shares=as_table(rows))
    figures = {f"shares_{k.replace(' ', '_')}": plot.sobol_indices(v) for k, v in shares.items()}
    kept.write_figures(drawing=plot.drawing(drawn), **figures)
    click.echo(kept.sentence())
