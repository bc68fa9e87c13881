"""A page as it is written: sections of text, tables and figures, in one file that needs no other.

Figures are PNG within the text, and there are no scripts and no fonts from elsewhere: it opens
without a network, and can be sent by mail.
"""

import base64
import importlib.util
import io
from pathlib import Path
from typing import Any, NamedTuple

import click
from matplotlib.figure import Figure

from jaxclear.ground.table import as_table

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
