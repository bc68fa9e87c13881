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


class Item(NamedTuple):
    """One thing on a page. `kind`: "text", "warning", "verbatim", "table", "figure" or "hidden" (a
    text that opens when it is asked for); `content`: the text, the table as HTML, or the figure's
    bytes as base64; `title`: its caption."""

    kind: str
    content: Any
    title: str = ""


class Section(NamedTuple):
    """A heading and what stands below it."""

    title: str
    items: list[Item]


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


def drawn(figure: Figure, title: str = "") -> Item:
    """A figure."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return Item("figure", base64.b64encode(buffer.getvalue()).decode(), title)


def figure_file(path: Path) -> Item:
    """A figure that was written before."""
    content = base64.b64encode(path.read_bytes()).decode()
    return Item("figure", content, path.stem.replace("_", " "))


def hidden(title: str, text: str) -> Item:
    """Text that opens when its title is clicked at."""
    return Item("hidden", text, title)


def table(frame: Any, title: str = "") -> Item:
    """A pandas table."""
    return Item("table", as_table(frame)._repr_html_(), title)


SCENE = "scene.yaml"
# Sentences that are told of failures and warnings; samples that are named for each.
MOST_SENTENCES, MOST_NAMED = 20, 5
# Fewer good samples than this tell no budget.
LEAST_SAMPLES = 32
STATISTICS = ("mean", "standard deviation", "5 %", "median", "95 %")


def campaign_page(folder: Path) -> Page:
    """The page of the campaign in a folder."""
    study = jc.open_campaign(folder)
    sections = [_result_items(study)] if study.finished else []
    return Page(
        f"Monte Carlo of {folder.resolve().name}",
        study.sentence() if study.finished else "No sample is finished yet.",
        [*sections, _ending_sentences(study), _variable_items(study), _provenance_items(study)],
    )


def _result_items(study: Any) -> Section:
    """Statistics, histograms, budget."""
    items: list[Item] = []
    if not study.is_complete:
        words = f"{study.finished} of {study.count} samples are finished; the same command goes on."
        items.append(Item("warning", words))
    items.append(table(_statistics(study), "Statistics, with the errors that they have (95 %)"))
    if study.finished > len(study.failed):
        items.append(drawn(plot.monte_carlo(study.sample), "Spread of the responses"))
    if (
        study.finished - len(study.failed) >= LEAST_SAMPLES
        and len(study.problem.variable_names) > 1
    ):
        items += _budget_items(study)
    return Section("Results", items)


def _budget_items(study: Any) -> list[Item]:
    """The budget of the responses that have a variance, and a sentence for each of the others."""
    names = study.problem.response_names
    endless = [name for name in names if np.isinf(study.sample.good(name)[0]).any()]
    finite = [name for name in names if name not in endless]
    items = []
    if finite:
        title = "What each variable contributes to the variance"
        items.append(drawn(plot.error_budget(study, *finite), title))
    for name in endless:
        words = f'"{name}" is infinite in some samples: there is no variance of it to share out.'
        items.append(Item("text", words))
    return items


def _statistics(study: Any) -> pandas.DataFrame:
    """Of the summary what has an error, and how many samples there are."""
    columns = [name for kind in STATISTICS for name in (kind, f"{kind} error")]
    return study.summary()[["response", "unit", "samples", "failed", "warned", *columns]]


def _ending_sentences(study: Any) -> Section:
    """Sentences of failures and warnings, each with how often it was said."""
    if not study.finished:
        return Section("Failures and warnings", [Item("text", "None yet.")])
    failures, warnings = study.failures(), study.warnings()
    items = []
    groups = [("failed", [(i, text) for i, text in failures.items()])]
    groups += [("warned", [(i, text) for i, texts in warnings.items() for text in texts])]
    for kind, entries in groups:
        if entries:
            items.append(table(_counted(entries), f"{len({i for i, _ in entries})} {kind}"))
    return Section("Failures and warnings", items or [Item("text", "None.")])


def _counted(entries: list[tuple[int, str]]) -> pandas.DataFrame:
    """A row a sentence; numbers within sentences are those of its first sample."""
    first: dict[str, tuple[str, list[int]]] = {}
    count: Counter = Counter()
    for index, text in entries:
        key = "".join(letter for letter in text if not letter.isdigit())
        count[key] += 1
        first.setdefault(key, (text, []))[1].append(index)
    rows = [
        {
            "samples": number,
            "such as": ", ".join(map(str, first[key][1][:MOST_NAMED])),
            "sentence (of the first)": first[key][0],
        }
        for key, number in count.most_common(MOST_SENTENCES)
    ]
    return pandas.DataFrame(rows)


def _variable_items(study: Any) -> Section:
    """What varied."""
    problem, rows = study.problem, []
    values = study.values if study.finished else np.zeros((0, len(problem.names)))
    nominal = np.asarray(problem.nominal(), float)
    for i, name in enumerate(problem.names):
        column = values[:, i]
        row = {"variable": name, "unit": problem.variable_units[i], "nominal": nominal[i]}
        if len(column):
            row |= {"mean": column.mean(), "standard deviation": column.std()}
            row |= {"smallest": np.min(column), "largest": np.max(column)}
        rows.append(row)
    return Section("What varied", [table(pandas.DataFrame(rows))])


def _provenance_items(study: Any) -> Section:
    """The scene, the plan, the versions."""
    plan = pandas.DataFrame([study.plan._asdict() | {"finished": study.finished}])
    items = [table(plan, "Plan"), table(pandas.DataFrame(study.versions), "Computed by")]
    scene = study.folder / SCENE
    if scene.exists():
        items.append(hidden("The scene", scene.read_text(encoding="utf-8")))
    parts = json.loads(study.to_dataset().attrs["problem"])
    problem_text = "\n\n".join(f"{name}: {text}" for name, text in parts.items())
    items.append(hidden("The problem, part by part, as the store knows it", problem_text))
    return Section("What was run", items)


RUN = "run.json"


def folder_page(folder: Path) -> Page | None:
    """The page of a folder; None where it holds neither figures nor tables."""
    figures, tables = sorted(folder.glob("*.png")), sorted(folder.glob("*.csv"))
    if not figures and not tables:
        return None
    about = json.loads((folder / RUN).read_text()) if (folder / RUN).exists() else {}
    sections = []
    if about:
        warned = [Item("warning", one) for one in about["warnings"]]
        sections.append(Section("How it ended", [*warned, Item("verbatim", about["checks"])]))
    if tables:
        items = [table(pandas.read_csv(path), path.stem.replace("_", " ")) for path in tables]
        sections.append(Section("Tables", items))
    if figures:
        sections.append(Section("Figures", [figure_file(path) for path in figures]))
    items = [table(pandas.DataFrame([about["versions"]]), "Computed by")] if about else []
    items += [
        hidden(f"The scene ({path.name})", path.read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*.yaml"))
    ]
    if items:
        sections.append(Section("What was run", items))
    sentence = about.get("result", f"{len(figures)} figures and {len(tables)} tables.")
    return Page(about.get("title", folder.resolve().name), sentence, sections)


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
