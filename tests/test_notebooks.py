"""Every notebook of the book runs from top to bottom; its own assertions are the test."""

from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient")
read = pytest.importorskip("myst_nb.core.read")
BOOK = Path(__file__).parents[1] / "notebooks"
# Notebooks are Markdown that says so in its head.
NOTEBOOKS = [p for p in sorted(BOOK.rglob("*.md")) if "file_format: mystnb" in p.read_text()]


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: str(path.relative_to(BOOK)))
def test_notebook_runs(path):
    notebook = read.read_myst_markdown_notebook(path.read_text(), path=path)
    where = {"metadata": {"path": str(path.parent)}}
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=where).execute()
