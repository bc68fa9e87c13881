"""`jaxclear report`: one HTML page of what a folder holds, a campaign, a run, or the figures and
tables of a study.

Of a campaign it tells how many samples ended how, statistics with errors, what decides the spread,
failures and warnings, what was run and by which versions; of a run also how it ended. Figures are
PNG within the text, and there are no scripts and no fonts from elsewhere: the page opens without a
network, and can be sent by mail.
"""

import base64
import importlib.util
import io
import json
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import pandas
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.ground.table import as_table
from jaxclear.studies.store.samples import holds_campaign

DOTS_PER_INCH = 130


class Shown(NamedTuple):
    """One thing on a page. `kind`: "text", "warning", "verbatim", "table", "figure" or "hidden" (a
    text that opens when it is asked for); `content`: the text, the table as HTML, or the figure's
    bytes as base64; `title`: its caption."""

    kind: str
    content: Any
    title: str = ""


class Section(NamedTuple):
    """A heading and what stands below it."""

    title: str
    shown: list[Shown]


class Page(NamedTuple):
    """A page: what it is of, how it ended in a sentence, and its sections."""

    title: str
    sentence: str
    sections: list[Section]

    def write(self, path: Path) -> None:
        """Writes it as HTML. Ends with a sentence where jinja2 is not installed."""
        if importlib.util.find_spec("jinja2") is None:
            raise click.ClickException(
                'a report needs jinja2: python -m pip install "jaxclear[report]".'
            )
        import jinja2

        loader = jinja2.FileSystemLoader(Path(__file__).parent)
        environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True)
        template = environment.get_template("page.html.jinja")
        path.write_text(template.render(page=self), encoding="utf-8")


def drawn(figure: Figure, title: str = "") -> Shown:
    """A figure."""
    kept = io.BytesIO()
    figure.savefig(kept, format="png", dpi=DOTS_PER_INCH)
    return Shown("figure", base64.b64encode(kept.getvalue()).decode(), title)


def figure_file(path: Path) -> Shown:
    """A figure that was written before."""
    content = base64.b64encode(path.read_bytes()).decode()
    return Shown("figure", content, path.stem.replace("_", " "))


def hidden(title: str, text: str) -> Shown:
    """Text that opens when its title is clicked at."""
    return Shown("hidden", text, title)


def table(frame: Any, title: str = "") -> Shown:
    """A pandas table."""
    return Shown("table", as_table(frame)._repr_html_(), title)


SCENE = "scene.yaml"
# Sentences that are told of failures and warnings; samples that are named for each.
MOST_SENTENCES, MOST_NAMED = 20, 5
# Fewer good samples than this tell no budget.
LEAST_SAMPLES = 32
STATISTICS = ("mean", "standard deviation", "5 %", "median", "95 %")


def campaign_page(folder: Path) -> Page:
    """The page of the campaign in a folder."""
    found = jc.open_campaign(folder)
    sections = [_results(found)] if found.finished else []
    return Page(
        f"Monte Carlo of {folder.resolve().name}",
        found.sentence() if found.finished else "No sample is finished yet.",
        [*sections, _endings(found), _variables(found), _what_was_run(found)],
    )


def _results(found: Any) -> Section:
    """Statistics, histograms, budget."""
    shown: list[Shown] = []
    if not found.is_complete:
        words = f"{found.finished} of {found.count} samples are finished; the same command goes on."
        shown.append(Shown("warning", words))
    shown.append(table(_statistics(found), "Statistics, with the errors that they have (95 %)"))
    if found.finished > len(found.failed):
        shown.append(drawn(plot.monte_carlo(found.sample), "Spread of the responses"))
    if found.finished - len(found.failed) >= LEAST_SAMPLES and len(found.problem.names) > 1:
        shown += _contributions(found)
    return Section("Results", shown)


def _contributions(found: Any) -> list[Shown]:
    """The budget of the responses that have a variance, and a sentence for each of the others."""
    names = found.problem.response_names
    endless = [name for name in names if np.isinf(found.sample.good(name)[0]).any()]
    told = [name for name in names if name not in endless]
    shown = []
    if told:
        title = "What each variable contributes to the variance"
        shown.append(drawn(plot.error_budget(found, *told), title))
    for name in endless:
        words = f'"{name}" is infinite in some samples: there is no variance of it to share out.'
        shown.append(Shown("text", words))
    return shown


def _statistics(found: Any) -> pandas.DataFrame:
    """Of the summary what has an error, and how many samples there are."""
    known = [name for kind in STATISTICS for name in (kind, f"{kind} error")]
    return found.summary()[["response", "unit", "samples", "failed", "warned", *known]]


def _endings(found: Any) -> Section:
    """Sentences of failures and warnings, each with how often it was said."""
    if not found.finished:
        return Section("Failures and warnings", [Shown("text", "None yet.")])
    failures, warnings = found.failures(), found.warnings()
    shown = []
    told = [("failed", [(i, said) for i, said in failures.items()])]
    told += [("warned", [(i, said) for i, own in warnings.items() for said in own])]
    for kind, entries in told:
        if entries:
            shown.append(table(_counted(entries), f"{len({i for i, _ in entries})} {kind}"))
    return Section("Failures and warnings", shown or [Shown("text", "None.")])


def _counted(entries: list[tuple[int, str]]) -> pandas.DataFrame:
    """A row a sentence; numbers within sentences are those of its first sample."""
    first: dict[str, tuple[str, list[int]]] = {}
    count: Counter = Counter()
    for index, said in entries:
        key = "".join(letter for letter in said if not letter.isdigit())
        count[key] += 1
        first.setdefault(key, (said, []))[1].append(index)
    rows = [
        {
            "samples": number,
            "such as": ", ".join(map(str, first[key][1][:MOST_NAMED])),
            "sentence (of the first)": first[key][0],
        }
        for key, number in count.most_common(MOST_SENTENCES)
    ]
    return pandas.DataFrame(rows)


def _variables(found: Any) -> Section:
    """What varied."""
    problem, rows = found.problem, []
    values = found.values if found.finished else np.zeros((0, len(problem.names)))
    nominal = np.asarray(problem.nominal(), float)
    for i, name in enumerate(problem.names):
        own = values[:, i]
        row = {"variable": name, "unit": problem.variable_units[i], "nominal": nominal[i]}
        if len(own):
            row |= {"mean": own.mean(), "standard deviation": own.std()}
            row |= {"smallest": np.min(own), "largest": np.max(own)}
        rows.append(row)
    return Section("What varied", [table(pandas.DataFrame(rows))])


def _what_was_run(found: Any) -> Section:
    """The scene, the plan, the versions."""
    plan = pandas.DataFrame([found.plan._asdict() | {"finished": found.finished}])
    shown = [table(plan, "Plan"), table(pandas.DataFrame(found.versions), "Computed by")]
    scene = found.folder / SCENE
    if scene.exists():
        shown.append(hidden("The scene", scene.read_text(encoding="utf-8")))
    parts = json.loads(found.to_dataset().attrs["problem"])
    told = "\n\n".join(f"{name}: {text}" for name, text in parts.items())
    shown.append(hidden("The problem, part by part, as the store knows it", told))
    return Section("What was run", shown)


RUN = "run.json"


def folder_page(folder: Path) -> Page | None:
    """The page of a folder; None where it holds neither figures nor tables."""
    figures, tables = sorted(folder.glob("*.png")), sorted(folder.glob("*.csv"))
    if not figures and not tables:
        return None
    told = json.loads((folder / RUN).read_text()) if (folder / RUN).exists() else {}
    sections = []
    if told:
        warned = [Shown("warning", one) for one in told["warnings"]]
        sections.append(Section("How it ended", [*warned, Shown("verbatim", told["checks"])]))
    if tables:
        shown = [table(pandas.read_csv(path), path.stem.replace("_", " ")) for path in tables]
        sections.append(Section("Tables", shown))
    if figures:
        sections.append(Section("Figures", [figure_file(path) for path in figures]))
    shown = [table(pandas.DataFrame([told["versions"]]), "Computed by")] if told else []
    shown += [
        hidden(f"The scene ({path.name})", path.read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*.yaml"))
    ]
    if shown:
        sections.append(Section("What was run", shown))
    sentence = told.get("result", f"{len(figures)} figures and {len(tables)} tables.")
    return Page(told.get("title", folder.resolve().name), sentence, sections)


PAGE = "report.html"


def report(store: Path, to: Path | None = None) -> None:
    """Writes one page of what a folder holds, beside it as report.html or to a file."""
    page = campaign_page(store) if holds_campaign(store) else folder_page(store)
    if page is None:
        raise click.UsageError(
            f"{store} holds neither a campaign nor figures or tables; it must be a folder that "
            "jaxclear has written."
        )
    path = store / PAGE if to is None else to
    page.write(path)
    click.echo(f"{path.resolve()} ({path.stat().st_size / 1e3:.0f} kB)")
