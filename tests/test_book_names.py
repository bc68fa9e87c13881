"""What the book asks of the package by name is there: building it is slow, and seldom done."""

import ast
import importlib.util
import inspect
import re
from pathlib import Path

import pytest

import jaxclear as jc
from jaxclear import plot

BOOK = Path(__file__).parents[1] / "notebooks"
REFERENCE = re.compile(r"^```\{reference\} (\S+) ?(.*)$", re.MULTILINE)
ASKED = [
    (page.name, path, names.split())
    for page in sorted((BOOK / "api").glob("*.md"))
    for path, names in REFERENCE.findall(page.read_text())
]


@pytest.mark.parametrize("page", sorted({page for page, _, _ in ASKED}))
def test_pages_of_the_api_name_what_there_is(page):
    """A page named `Statistic` for long after it was `CorrectedStatistic`."""
    for path, names in ((path, names) for own, path, names in ASKED if own == page):
        first, *rest = path.split(".")
        module = importlib.import_module(first)
        for part in rest:
            module = getattr(module, part, None) or importlib.import_module(path)
        missing = [name for name in names if not hasattr(module, name)]
        assert not missing, f"{path} has no {', '.join(missing)}"


EXAMPLE = re.compile(r"```python\n(.*?)```", re.DOTALL)
PUBLIC = re.compile(r"(jc|plot)[.\w]+")
PAGES = [page for page in sorted((BOOK / "api").glob("*.md")) if page.stem != "index"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_page_of_the_api_begins_with_an_example_of_calls_that_there_are(page):
    """Names exist, and arguments are those of the signatures."""
    text = page.read_text()
    (example,) = EXAMPLE.findall(text)
    assert text.index("```python") < text.index("```{reference}")
    calls = [node for node in ast.walk(ast.parse(example)) if isinstance(node, ast.Call)]
    calls = [call for call in calls if PUBLIC.fullmatch(ast.unparse(call.func))]
    for call in calls:
        function = eval(ast.unparse(call.func), {"jc": jc, "plot": plot})
        named = {keyword.arg: None for keyword in call.keywords}
        inspect.signature(function).bind(*call.args, **named)
    assert calls or page.stem == "extensions"


def is_there(module, name):
    """Whether a name can be imported from a module: what it has, or a module in its folder."""
    in_folder = hasattr(module, "__path__") and importlib.util.find_spec(
        f"{module.__name__}.{name}"
    )
    return hasattr(module, name) or bool(in_folder)


PROGRAM = re.compile(r"```(?:\{code-cell\} )?python\n(?:[:%][^\n]*\n|\n)*(.*?)```", re.DOTALL)


@pytest.mark.parametrize(
    "source",
    [*sorted((BOOK / "_extensions").glob("*.py")), *sorted(BOOK.rglob("*.md"))],
    ids=lambda path: str(path.relative_to(BOOK)),
)
def test_programs_of_the_book_import_what_there_is(source):
    """An extension asked for a function that was gone, two pages for a class that had moved."""
    text = source.read_text()
    for program in [text] if source.suffix == ".py" else PROGRAM.findall(text):
        for node in ast.walk(ast.parse(program)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxclear"):
                module = importlib.import_module(node.module)
                missing = [name.name for name in node.names if not is_there(module, name.name)]
                assert not missing, f"{node.module} has no {', '.join(missing)}"


def test_subscripts_of_letters_with_a_dot_stand_beside_them():
    """docutils sets them under the letter, as limits under a sum."""
    pytest.importorskip("sphinx")
    where = importlib.util.spec_from_file_location(
        "offline_math", BOOK / "_extensions" / "offline_math.py"
    )
    offline_math = importlib.util.module_from_spec(where)
    where.loader.exec_module(offline_math)
    for tex in (r"\dot\delta_0", r"{\dot\delta}_0"):
        formula = "".join(offline_math.mathml(tex, False).split())
        assert '<msub><moveraccent="true"><mi>δ</mi>' in formula and "<mn>0</mn></msub>" in formula
    assert "munderover" in offline_math.mathml(r"\sum_{i=1}^n i", True)
