"""Folds of the book hide what follows them in their section, and nothing else."""

import sys
from pathlib import Path

import pytest

testing = pytest.importorskip("sphinx.testing.util")
pytest.importorskip("myst_nb")
EXTENSIONS = Path(__file__).parents[1] / "notebooks" / "_extensions"
PAGE = """# Title

Rule.

## Measured

Shown.

:::{fold} How & why
:::

Hidden.

### Part

Deep.

## After

Plain.

:::{fold} Inner
Within.
:::

Last.
"""
SETTINGS = """
import sys
sys.path.insert(0, {path!r})
extensions = ["myst_nb", "fold"]
myst_enable_extensions = ["colon_fence"]
nb_execution_mode = "off"
"""


def built(folder, page):
    """HTML of a page, and what the build warned of."""
    (folder / "conf.py").write_text(SETTINGS.format(path=str(EXTENSIONS)))
    (folder / "index.md").write_text(page)
    app = testing.SphinxTestApp("html", srcdir=folder)
    try:
        app.build()
        return (folder / "_build/html/index.html").read_text(), app.warning.getvalue()
    finally:
        app.cleanup()
        sys.path[:] = [path for path in sys.path if path != str(EXTENSIONS)]


def test_an_empty_fold_takes_the_rest_of_its_section(tmp_path):
    html, warned = built(tmp_path, PAGE)
    outside, first, second = html.split('<details class="fold">')
    first, between = first.split("</details>")
    second, after = second.split("</details>")
    assert not warned and "How &amp; why" in first
    for word, place in {"Shown": outside, "Hidden": first, "Deep": first, "After": between}.items():
        assert word in place
    assert "Plain" in between and "Within" in second and "Last" in after


def test_a_cell_within_a_fold_is_refused(tmp_path):
    cell = ":::{fold} Title\n```{code-cell} python\n1 + 1\n```\n:::\n"
    _, warned = built(tmp_path, f"# Title\n\n{cell}")
    assert "a cell within a fold does not run" in warned
