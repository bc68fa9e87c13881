"""Tables of measurements, from the JSON documents that the benchmarks write.

    ```{measured} peers
    ```

reads `benchmarks/results/peers.json`: {title: [rows]} as `--json` writes it, beside "about" with
the command, the machine and the date, or these of its parts where they come from calls of their
own. No number of a table is typed in the book. Of wide tables a page may show some columns, by
their names:

    ```{measured} peers alone
    :columns: program; CPU [ms]
    ```
"""

import json
import re
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

RESULTS = Path(__file__).resolve().parents[2] / "benchmarks" / "results"


# Words of the benchmarks and the book's: a rung is an integrator, from coarse settings to fine.
WORDS = {"rung": "integrator", "rungs": "integrators", "told": "estimated"}


def in_words(text: str) -> str:
    """A title or a column's name in the book's words."""
    return re.sub(r"\w+", lambda word: WORDS.get(word[0], word[0]), text)


def cell(value: object) -> str:
    """A cell's text: numbers with three digits, bars kept out of the table's own."""
    text = f"{value:.3g}" if isinstance(value, float) else "–" if value is None else str(value)
    return text.replace("|", "\\|")


def table(rows: list[dict], columns: list[str]) -> list[str]:
    """Markdown lines of a table; the first row names the columns, unless some are asked for."""
    names = columns or list(rows[0])
    lines = ["| " + " | ".join(cell(in_words(name)) for name in names) + " |"]
    lines.append("|" + " --- |" * len(names))
    lines += ["| " + " | ".join(cell(row.get(name)) for name in names) + " |" for row in rows]
    return lines


def origin(about: dict, title: str) -> str:
    """Where the numbers of a title come from."""
    known = about.get("parts", {}).items()
    own = [told for part, told in known if part.startswith(title) or title.startswith(part)]
    calls = dict.fromkeys(f"`{told['command']}`, {told['date']}" for told in own or [about])
    return f"{'; '.join(calls)}, {about['machine']}."


class Measured(SphinxDirective):
    """`{measured} NAME [TITLE]`: the tables, or the one that TITLE begins the title of, and below
    them where the numbers come from.
    """

    required_arguments = 1
    optional_arguments = 1
    final_argument_whitespace = True
    option_spec: ClassVar = {"columns": lambda names: [name.strip() for name in names.split(";")]}

    def run(self) -> list[nodes.Node]:
        path = RESULTS / f"{self.arguments[0]}.json"
        self.env.note_dependency(str(path))
        document = json.loads(path.read_text())
        about = document.pop("about", {})
        lines, last, columns = [], "", self.options.get("columns", [])
        wanted = self.arguments[1] if len(self.arguments) > 1 else ""
        chosen = {title: rows for title, rows in document.items() if title.startswith(wanted)}
        if not chosen:
            raise self.error(f"no table of {path.name} begins with {wanted!r}")
        for title, rows in chosen.items():
            missing = [name for name in columns if name not in rows[0]]
            if missing:
                raise self.error(f"{path.name}, {title!r}: no column is named {missing[0]!r}")
            said = origin(about, title) if about else ""
            lines += [last, ""] if said != last else []
            lines += [f"*{in_words(title)}*", "", *table(rows, columns), ""]
            last = said
        lines.append(last)
        found = nodes.container(classes=["measured"])
        self.state.nested_parse(StringList(lines, str(path)), self.content_offset, found)
        return [found]


def setup(app: Sphinx) -> dict:
    app.add_directive("measured", Measured)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
