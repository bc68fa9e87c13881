"""Counts what a reader of the book meets: long paragraphs and heads, terms without an entry in the
glossary, signatures that cannot be typed, colliding texts, warnings nobody speaks of, build time.

    python -m benchmarks.claims.book [--list] [--built build/book] [--json FILE]
    python -m benchmarks.claims.book --run [PAGE ...] [--into build/pages] [--json FILE]

Paragraphs, heads, terms and signatures are read from the sources and the docstrings, in seconds.
Warnings, figures and seconds are known where the book is built: `--built` names that folder.
`--run` executes the pages that are notebooks (or those named), each in a kernel of its own that
finds no compiled program, and prints their CPU time and first error; what a page prints and draws
is written into a folder.
A page marks a term where it explains it: as {term}`rung`, or in bold in a paragraph. A list item
and a cell of a table are paragraphs as any other; programs and their output are none.
"""

import ast
import base64
import inspect
import json
import math
import os
import re
import sys
import tempfile
from html import unescape
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from markdown_it.renderer import RendererHTML
from myst_parser.config.main import MdParserConfig
from myst_parser.parsers.mdit import create_md_parser

from benchmarks.measure import arguments, date, report, sign, stored_rows

ROOT = Path(__file__).resolve().parents[2]
BOOK = ROOT / "notebooks"
sys.path.insert(0, str(BOOK / "_extensions"))
import reference

LIMITS = {
    "longest paragraph [words]": 150,
    "longest head of a page [words]": 150,
    "terms without an entry in the glossary": 0,
    "public names on no page of the API": 0,
    "entries of the API with another signature": 0,
    "figures with colliding text": 0,
    "warnings that their page does not name": 0,
    "build [s]": 900,
}
PAGE_SECONDS = 60  # of CPU time, at most
EXECUTED = "pages executed"
# Directives whose content is text of the page.
BOXES = {
    "admonition",
    "note",
    "tip",
    "warning",
    "important",
    "hint",
    "dropdown",
    "details",
    "fold",
    "seealso",
}
BOX = re.compile(r"\{(\w+)\}")
OPTION = re.compile(r"\A(?::[\w-]+:[^\n]*\n|\s*\n)+")
ENTRY = re.compile(r'<dt class="sig[^"]*" id="([^"]+)">(.*?)</dt>', re.DOTALL)
# What Python writes of a warning: where, its class, its text.
WARNED = re.compile(r"^\S+:\d+: (\w+): (.*)$", re.MULTILINE)
SELF = {"self", "cls"}
COLLIDING = "CollidingText"
TERM_WORDS = 4  # a longer phrase in bold is a sentence that is stressed
SAME_WORDS = 6  # so many words of a warning in a row are told by nothing else
PARSER = create_md_parser(
    MdParserConfig(enable_extensions={"amsmath", "colon_fence", "deflist", "dollarmath"}),
    RendererHTML,
)


class Paragraph(NamedTuple):
    """A piece of text as a reader sees it."""

    text: str
    terms: list[str]
    is_head: bool


def pages() -> dict[str, str]:
    """Sources by name of the page; the changelog is no page that is read."""
    found = {str(p.relative_to(BOOK))[:-3]: p.read_text() for p in sorted(BOOK.rglob("*.md"))}
    return {name: text for name, text in found.items() if name != "changelog"}


def words(text: str) -> int:
    """Pieces between spaces that hold a letter or a digit."""
    return sum(any(map(str.isalnum, piece)) for piece in text.split())


def paragraphs(source: str) -> Iterator[Paragraph]:
    """Paragraphs, items, cells and headings' followers of a page, boxes too."""
    head, lists, heading = True, 0, False
    for token in PARSER.parse(source):
        lists += {"list_item_open": 1, "list_item_close": -1}.get(token.type, 0)
        if token.type == "heading_open":
            heading, head = True, head and token.tag == "h1"
        elif token.type == "heading_close":
            heading = False
        elif token.type in ("fence", "colon_fence"):
            box = BOX.match(token.info)
            if box and box[1] in BOXES:
                for inner in paragraphs(OPTION.sub("", token.content)):
                    yield inner._replace(is_head=False)
            head = False
        elif token.type == "table_open":
            head = False
        elif token.type == "inline" and not heading:
            yield Paragraph(_shown(token.children), _terms(token.children, lists == 0), head)


def _shown(children: list[Any]) -> str:
    """What is read of a paragraph; a formula is one word."""
    text = ""
    for token in children:
        if token.type in ("text", "code_inline"):
            text += token.content
        elif token.type == "myst_role":
            text += token.content.split("<")[0]
        elif token.type in ("softbreak", "hardbreak"):
            text += " "
        elif token.type.startswith("math"):
            text += "x"
    return text


def _terms(children: list[Any], bold: bool) -> list[str]:
    """Terms that a paragraph marks; stressed words at the start of an item are none."""
    found, opened = [], None
    for token in children:
        if token.type == "myst_role" and token.meta["name"] == "term":
            found.append(token.content.split("<")[-1].rstrip(">"))
        elif token.type == "strong_open":
            opened = ""
        elif token.type == "strong_close":
            if bold and opened and len(opened.split()) <= TERM_WORDS and opened[-1].isalnum():
                found.append(opened)
            opened = None
        elif opened is not None:
            opened += token.content
    return [" ".join(term.split()).lower() for term in found]


def glossary() -> set[str]:
    """Words that the glossary explains: what it sets in bold, in its tables above all."""
    return {term for paragraph in paragraphs(pages()["glossary"]) for term in paragraph.terms}


def without_entry() -> list[str]:
    """Marked terms that the glossary does not have, with the page that marks them."""
    known = glossary()
    return [
        f"{term} ({name})"
        for name, source in pages().items()
        for paragraph in paragraphs(source)
        for term in paragraph.terms
        if name != "glossary"
        and not known & {term, term.removesuffix("s"), term.removesuffix("es")}
    ]


class Entry(NamedTuple):
    """A callable on a page of the API, with the text of its arguments as shown."""

    value: Any
    shown: str


def entries() -> dict[str, Entry]:
    """Every class, function and method that the pages of the API describe."""
    found = {}
    for name, source in pages().items():
        for path, asked in reference.ASKED.findall(source) if name.startswith("api/") else ():
            module = reference.module_at(path)
            for word in asked.split() or reference.public_names(module):
                value = getattr(module, word)
                shown = reference.signature(value) if reference.is_own(value) else ""
                found[f"{path}.{word}"] = Entry(value, shown)
                for kind, own, method in reference.methods(value) if inspect.isclass(value) else ():
                    if kind == "method":
                        place = f"{path}.{word}.{own}"
                        found[place] = Entry(method, reference.signature(method))
    return found


def typed(arguments: str) -> list[tuple[str, str]]:
    """(name, how it is given) of every argument of a signature's text."""
    plain = re.sub(r"<[^<>]*>|…", "0", arguments)
    given = ast.parse(f"def f{plain}: ...").body[0].args
    found = [(a.arg, "by place") for a in (*given.posonlyargs, *given.args)]
    found += [(given.vararg.arg, "many")] if given.vararg else []
    found += [(a.arg, "by name") for a in given.kwonlyargs]
    return found + ([(given.kwarg.arg, "many by name")] if given.kwarg else [])


def may_be_typed(value: Any) -> list[tuple[str, str]] | None:
    """The same of what Python accepts; None where it cannot tell."""
    how = {"VAR_POSITIONAL": "many", "KEYWORD_ONLY": "by name", "VAR_KEYWORD": "many by name"}
    try:
        known = inspect.signature(value).parameters.values()
    except (TypeError, ValueError):
        return None
    return [(p.name, how.get(p.kind.name, "by place")) for p in known if p.name not in SELF]


def other_signatures(built: Path | None = None) -> list[str]:
    """Entries that show what cannot be typed, or hide what can; where a built book is given, as its
    pages show them."""
    on_pages = built_signatures(built) if built else {}
    found = []
    for path, entry in entries().items():
        accepted = may_be_typed(entry.value) if entry.shown else None
        shown = on_pages.get(path, "(on_no_page)") if built else entry.shown
        if accepted is not None and typed(shown) != accepted:
            found.append(path)
    return found


def built_signatures(built: Path) -> dict[str, str]:
    """Arguments of every entry as the built pages of the API show them."""
    found = {}
    for page in sorted((built / "api").glob("*.html")):
        for path, shown in ENTRY.findall(page.read_text()):
            given = unescape(re.sub(r"<[^>]*>", "", shown))
            arguments = given[given.find("(") : given.rfind(")") + 1] if "(" in given else "()"
            found[path] = re.sub(r"\s+", " ", arguments)
    return found


def on_no_page() -> list[str]:
    """Public names that no page of the API describes."""
    described = {id(entry.value) for entry in entries().values()}
    return [path for key, (path, _) in reference.public().items() if key not in described]


def page_rows() -> list[dict[str, Any]]:
    """Longest paragraph, head and terms without an entry, page by page; the longest first."""
    lacking = without_entry()
    rows = []
    for name, source in pages().items():
        read = list(paragraphs(source))
        for path, asked in reference.ASKED.findall(source):
            module = reference.module_at(path)
            for word in asked.split() or reference.public_names(module):
                lines = reference.described(f"{path}.{word}", getattr(module, word))
                # A list of arguments is no paragraph.
                read += [
                    p._replace(is_head=False)
                    for p in docstrings("\n".join(lines))
                    if not p.text.startswith("Args:")
                ]
        rows.append(
            {
                "page": name,
                "longest paragraph [words]": max((words(p.text) for p in read), default=0),
                "head [words]": sum(words(p.text) for p in read if p.is_head),
                "terms without an entry": sum(f"({name})" in term for term in lacking),
            }
        )
    return sorted(rows, key=lambda row: -row["longest paragraph [words]"])


def docstrings(text: str) -> Iterator[Paragraph]:
    """Paragraphs of what the directive for the API writes: boxes in boxes."""
    for token in PARSER.parse(text):
        if token.type == "colon_fence":
            yield from docstrings(token.content)
        elif token.type == "inline":
            yield Paragraph(_shown(token.children), [], False)


def executed(built: Path) -> dict[str, dict]:
    """Notebooks that ran in a build, by page."""
    folder = built.parent / "jupyter_execute"
    found = {str(p.relative_to(folder))[:-6]: p for p in sorted(folder.rglob("*.ipynb"))}
    return {name: json.loads(path.read_text()) for name, path in found.items() if name in pages()}


def told(built: Path) -> Iterator[tuple[str, int, str, str]]:
    """(page, number of the cell, class, text) of what cells of a built book warned of; a figure
    whose texts collide is such a warning too, which the build adds (`_extensions/figures.py`)."""
    for page, notebook in executed(built).items():
        for number, cell in enumerate(notebook["cells"]):
            errors = [o["text"] for o in cell.get("outputs", []) if o.get("name") == "stderr"]
            for kind, text in WARNED.findall("".join("".join(lines) for lines in errors)):
                yield page, number, kind, text


def colliding_figures(built: Path) -> list[str]:
    """Cells whose figures have texts that lie upon each other, and what is first told of it."""
    first: dict[str, str] = {}
    for page, number, kind, text in told(built):
        if kind == COLLIDING:
            first.setdefault(f"{page}, cell {number}", text)
    return [f"{place}: {text}" for place, text in first.items()]


def unnamed_warnings(built: Path) -> list[str]:
    """Warnings of cells of which their page says nothing: it names a warning by its class, or by
    some words of it in a row, in its text or in what a cell prints."""
    said = {}
    for page, notebook in executed(built).items():
        outputs = [o for cell in notebook["cells"] for o in cell.get("outputs", [])]
        printed = "".join("".join(o["text"]) for o in outputs if o.get("name") == "stdout")
        said[page] = " ".join([*(p.text for p in paragraphs(pages()[page])), printed])
    found = [
        f"{page}: {kind}: {text}"
        for page, _, kind, text in told(built)
        if kind != COLLIDING and not named(kind, text, said[page])
    ]
    return list(dict.fromkeys(found))


def named(kind: str, text: str, said: str) -> bool:
    """Whether a page names a warning."""
    if kind not in ("UserWarning", "RuntimeWarning") and kind in said:
        return True
    own, plain = text.split(), " ".join(said.split())
    rows = range(max(len(own) - SAME_WORDS, 0) + 1)
    return any(" ".join(own[i : i + SAME_WORDS]) in plain for i in rows)


def built_rows(built: Path) -> dict[str, float]:
    """What only a book tells whose cells ran."""
    times = built / "build.json"
    spent = json.loads(times.read_text()) if times.exists() else {"pages": {}}
    if not spent["pages"]:
        return {}
    return {
        "figures with colliding text": len(colliding_figures(built)),
        "warnings that their page does not name": len(unnamed_warnings(built)),
        "build [s]": spent["seconds"],
        "build [CPU s]": spent["CPU seconds"],
        "cells [s]": sum(spent["pages"].values()),
    }


class PageRun(NamedTuple):
    """What came of executing a page: CPU time [s] and error ("": none)."""

    seconds: float
    error: str


def run_page(name: str, into: Path) -> PageRun:
    """Execute a page; what it prints (`NAME.txt`) and draws (`NAME_1.png`) goes into a folder."""
    import nbformat
    from myst_nb.core.read import read_myst_markdown_notebook
    from nbclient import NotebookClient

    source = BOOK / f"{name}.md"
    notebook = read_myst_markdown_notebook(source.read_text(), path=source)
    clock = "import os; print('CPU', sum(os.times()[:4]))"
    notebook.cells.append(nbformat.v4.new_code_cell(clock))
    where = {"metadata": {"path": str(source.parent)}}
    error = ""
    with tempfile.TemporaryDirectory() as cache:
        os.environ |= {"JAXCLEAR_CACHE": cache}
        client = NotebookClient(
            notebook, timeout=1800, kernel_name="python3", resources=where, allow_errors=True
        )
        client.execute()
    into.mkdir(parents=True, exist_ok=True)
    stem, figures, texts = name.replace("/", "_"), 0, []
    seconds = math.nan
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if output.output_type == "error":
                error = error or f"{output.ename}: {output.evalue}"
                texts.append(error)
            elif output.get("text", "").startswith("CPU "):
                seconds = float(output.text.split()[1])
            elif "image/png" in data:
                figures += 1
                (into / f"{stem}_{figures}.png").write_bytes(base64.b64decode(data["image/png"]))
                texts.append(f"[figure {figures}]")
            else:
                prefix = "stderr: " if output.get("name") == "stderr" else ""
                texts.append(prefix + (output.get("text") or data.get("text/plain", "")).rstrip())
    (into / f"{stem}.txt").write_text("\n".join(texts) + "\n")
    return PageRun(seconds, error)


def run_pages(names: list[str], options: Any) -> None:
    """Execute pages one after the other (all notebooks where none is named), and report each when
    it is through, with the others as they stand in the file."""
    notebooks = [name for name, text in pages().items() if "file_format: mystnb" in text]
    unknown = set(names) - set(notebooks)
    if unknown:
        raise SystemExit(f"no page of the book is executed under the name {sorted(unknown)}")
    for name in names or notebooks:
        run = run_page(name, options.into)
        row = {
            "page": name,
            "CPU time [s]": round(run.seconds, 1),
            "at most": PAGE_SECONDS,
            "error": run.error.split("\n")[0],
            "executed": date(),
        }
        others = [old for old in stored_rows(EXECUTED, options) if old["page"] in notebooks]
        rows = {old["page"]: old for old in [*others, row]}
        report(EXECUTED, [rows[page] for page in sorted(rows)], options)


def measure(built: Path | None = None) -> dict[str, float]:
    """All counts by name."""
    rows = page_rows()
    found: dict[str, float] = {
        "longest paragraph [words]": max(row["longest paragraph [words]"] for row in rows),
        "longest head of a page [words]": max(row["head [words]"] for row in rows),
        "terms without an entry in the glossary": len(set(without_entry())),
        "public names on no page of the API": len(on_no_page()),
        "entries of the API with another signature": len(other_signatures(built)),
    }
    return found | (built_rows(built) if built else {})


def main() -> None:
    """Prints the counts with their limits."""
    options = arguments(
        str(__doc__),
        list={"action": "store_true", "help": "name what is beyond a limit"},
        built={"type": Path, "help": "folder of the built book"},
        run={"nargs": "*", "metavar": "PAGE", "help": "execute pages (all by default)"},
        into={"type": Path, "default": ROOT / "build" / "pages", "help": "their output"},
    )
    if options.run is not None:
        run_pages(options.run, options)
        return
    rows = [
        {"measure": name, "value": value, "at most": LIMITS.get(name)}
        for name, value in measure(options.built).items()
    ]
    report("the book", rows, options)
    report("pages", page_rows(), options)
    if options.json:
        sign("benchmarks.claims.book", options.json)
    if options.list:
        lists = {
            "terms without an entry": sorted(set(without_entry())),
            "on no page of the API": on_no_page(),
            "with another signature": other_signatures(options.built),
            "figures": colliding_figures(options.built) if options.built else [],
            "warnings that are not named": unnamed_warnings(options.built) if options.built else [],
        }
        for name, found in lists.items():
            print(f"\n{name}: {len(found)}", *found, sep="\n  ")


if __name__ == "__main__":
    main()
