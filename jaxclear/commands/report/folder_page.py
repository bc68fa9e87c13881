"""What a report says of a folder with figures (PNG) and tables (CSV): of a run, which also tells
how it ended, or of a study of the command line.
"""

import json
from pathlib import Path

import pandas

from jaxclear.commands.report.page import Page, Section, Shown, figure_file, hidden, table

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
