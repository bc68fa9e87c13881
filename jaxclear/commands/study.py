"""What the studies of the command line have in common: a folder that holds their tables and
figures, and what they print of their runs."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg

# So many samples of a Monte Carlo are told one by one; the table on disk has them all.
MOST_SENTENCES = 5
DOTS_PER_INCH = 130


class StudyFolder:
    """A folder into which a study writes, made where it is not there. Names of files begin with
    `prefix`."""

    def __init__(self, path: Path, prefix: str = ""):
        path.mkdir(parents=True, exist_ok=True)
        self.path, self.prefix, self.start_time = path, prefix, time.perf_counter()
        self.count = {"figures": 0, "tables": 0}

    def write_tables(self, **tables: Any) -> None:
        """Tables by the names of their files (CSV)."""
        for name, table in tables.items():
            table.to_csv(self.path / f"{self.prefix}{name}.csv", index=False)
        self.count["tables"] += len(tables)

    def write_figures(self, **figures: Any) -> None:
        """Figures by the names of their files (PNG)."""
        for name, figure in figures.items():
            figure.set_dpi(DOTS_PER_INCH)
            # `savefig` draws all of it twice.
            FigureCanvasAgg(figure).print_png(self.path / f"{self.prefix}{name}.png")
        self.count["figures"] += len(figures)

    def sentence(self, also: str = "") -> str:
        """What it holds, where, and how long that took."""
        figures, tables = (f"{number} {what}" for what, number in self.count.items())
        holds = f"{figures}, {tables} and {also}" if also else f"{figures} and {tables}"
        taken = time.perf_counter() - self.start_time
        return f"{holds} in {self.path.resolve()}, {taken:.0f} s"


def report_warnings(runs: Mapping[str, Any]) -> None:
    """Prints a line for every warning of runs, each with what its run is called."""
    for name, run in runs.items():
        for sentence in run.warnings:
            print(f"warning, {name}: {sentence}", flush=True)


def report_samples(sample: Any) -> None:
    """Prints how many samples of a Monte Carlo failed and warn, and the first of them in words."""
    print(sample.sentence())
    sentences = {index: f"failed. {sentence}" for index, sentence in sample.failures().items()}
    sentences |= {index: f"warns. {' '.join(texts)}" for index, texts in sample.warnings().items()}
    for index in sorted(sentences)[:MOST_SENTENCES]:
        print(f"sample {index} {sentences[index]}")
    if len(sentences) > MOST_SENTENCES:
        print(f"and {len(sentences) - MOST_SENTENCES} more, in the table.", flush=True)
