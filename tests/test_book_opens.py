"""The built book opens from disk, without a server and without a network, and no script complains.

What stands in `build/book` is opened; where nothing has been built, the book without its outputs.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("myst_nb")

ROOT = Path(__file__).parents[1]
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
COMPLAINT = re.compile(r"CONSOLE.*", re.MULTILINE)
FETCHED = re.compile(r"<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=[\"']?https?://[^>]*>")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not BROWSER, reason="no browser is installed"),
]


def complaints(page: Path) -> list[str]:
    """What scripts of a page write to the console."""
    asked = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
    asked += ["--virtual-time-budget=5000", "--dump-dom", page.as_uri()]
    ended = subprocess.run(asked, capture_output=True, text=True, timeout=120, check=True)
    assert "</html>" in ended.stdout
    return COMPLAINT.findall(ended.stderr)


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """The folder of the book."""
    known = ROOT / "build" / "book"
    if (known / "index.html").exists():
        return known
    folder = tmp_path_factory.mktemp("built") / "book"
    asked = [sys.executable, "-m", "sphinx", "-q", "-D", "nb_execution_mode=off"]
    subprocess.run([*asked, str(ROOT / "notebooks"), str(folder)], check=True, timeout=600)
    return folder


def test_a_complaint_is_heard(tmp_path):
    page = tmp_path / "page.html"
    page.write_text("<html><body><script>nothing.at_all</script></body></html>")
    assert any("nothing is not defined" in said for said in complaints(page))


def test_pages_open_from_disk_and_nothing_is_fetched(built):
    heard = {}
    for page in sorted(built.rglob("*.html")):
        if "_static" not in page.parts:
            heard[page.name] = complaints(page) + FETCHED.findall(page.read_text())
    assert not {name: found for name, found in heard.items() if found}
