"""The API from the docstrings.

    ```{reference} jaxclear.contact
    ```

describes every public name of a module, under the name by which a user reaches it, not by the file
it lives in: functions first, then classes, then the abstract bases of one's own. Of a member of a
family its arguments are shown, and methods that the family has not; of a base what a member must
define. What else a class has `help` shows.

Docstrings are read as Markdown, so that `code` and $mathematics$ are what they look like; their
sections `Args:`, `Returns:` and `Raises:` become lists. Where a class does not list its arguments,
a table shows its numbers with default, unit, range and meaning, from the fields.
"""

import dataclasses
import functools
import importlib
import inspect
import re
import sys
import textwrap
import types
import typing
from collections.abc import Callable, Collection
from pathlib import Path
from types import ModuleType

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from jaxclear.ground.quantity import numbers, range_in_words

BOOK = Path(__file__).resolve().parents[1]
# A page's directives: module and names.
ASKED = re.compile(r"^```\{reference\} (\S+) ?(.*)$", re.MULTILINE)
DOI = re.compile(r"doi:\s?(10\.\d+/[^\s,;]*[^\s,;.)])")
# Where a sentence, or a part of one, ends before a name, an error or a source.
APART = ("Raises ", "Source: ", "Sources: ")
CUT = re.compile(r"(?<=[.;]) (?=`\w+`|Raises |Sources?: )")
HEADINGS = {"Args": "Arguments", "Returns": "Returns", "Raises": "Raises"}
SECTION = re.compile(r"^(Args|Returns|Raises):\n((?:(?: {4}.*)?\n)+)", re.MULTILINE)
ROLE = re.compile(r":math:`([^`]*)`", re.DOTALL)


def module_at(path: str) -> ModuleType:
    """The module that a user reaches as `path`, which may be an attribute and no file."""
    first, *rest = path.split(".")
    found = importlib.import_module(first)
    for name in rest:
        found = getattr(found, name, None)
    return importlib.import_module(path) if found is None else found


def public_names(module: ModuleType) -> list[str]:
    """What the module offers: `__all__`, or classes and functions of the package defined there."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    own = [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]
    return [name for name in own if callable(vars(module)[name])]


def markdown(text: str | None, names: Collection[str] = ()) -> list[str]:
    """A docstring as lines of Markdown; what it says of each of the arguments `names` is an item of
    a list, and errors and sources stand by themselves.
    """
    text = ROLE.sub(lambda found: f"${' '.join(found[1].split())}$", inspect.cleandoc(text or ""))
    text = re.sub(r"^\.\. math::\n\n((?:[ ].*\n?)+)", r"$$\n\1\n$$\n", text, flags=re.M)
    text = SECTION.sub(section, text + "\n")
    lines: list[str] = []
    for block in re.split(r"\n\s*\n", text):
        plain = not re.search(r"^(\s|[|$*-]|```|\d+\.)", block, re.MULTILINE)
        lines += [*(arranged(" ".join(block.split()), names) if plain else block.split("\n")), ""]
    return [DOI.sub(r"[doi:\1](https://doi.org/\1)", line) for line in lines]


def section(match: re.Match[str]) -> str:
    """A section of a Google-style docstring as a heading and a list, or a sentence."""
    heading, body = HEADINGS[match[1]], textwrap.dedent(match[2]).strip()
    entries = [" ".join(entry.split()) for entry in re.split(r"\n(?=\S)", body)]
    if match[1] == "Args" or len(entries) > 1:
        items = [re.sub(r"^([\w*, ]+):", r"- `\1`:", entry) for entry in entries]
        return "\n".join([f"\n**{heading}**\n", *items, "\n"])
    only = re.sub(r"^(\w+):", r"`\1`", entries[0]) if match[1] == "Raises" else entries[0]
    return f"\n**{heading}** {only}\n\n"


def arranged(paragraph: str, names: Collection[str]) -> list[str]:
    """A paragraph cut where a sentence begins with an argument, or tells errors or the source."""
    lines: list[str] = []
    listed = False
    for piece in CUT.split(paragraph):
        named = re.match(r"`(\w+)`", piece)
        item = named is not None and named[1] in names
        if not lines or item or piece.startswith(APART):
            if lines:
                lines[-1] = re.sub(";$", ".", lines[-1])
                lines += [] if item and listed else [""]
            lines.append(f"- {piece}" if item else piece)
            listed = item
        else:
            lines[-1] += f" {piece}"
    return lines


class Words(str):
    """Text that `repr` and `inspect` leave as it is."""

    def __repr__(self) -> str:
        return str(self)


def default_text(default: object) -> Words:
    """A default as it is written, without the zeros of `repr`; dots for what no literal gives."""
    if isinstance(default, float):
        return Words(f"{default:g}")
    if dataclasses.is_dataclass(default) and not dataclasses.fields(default):
        return Words(f"{type(default).__name__}()")
    plain = isinstance(default, (str, int, tuple, dict, type(None)))
    return Words(repr(default) if plain else "...")


@functools.cache
def public() -> dict[int, tuple[str, object]]:
    """Shortest path by which a user reaches a class or function, and the thing, by its `id`."""
    found: dict[int, tuple[str, object]] = {}
    left = [(path, importlib.import_module(path)) for path in ("jaxclear", "jaxclear.plot")]
    while left:
        path, place = left.pop(0)
        for name in place.__all__:
            value = getattr(place, name)
            if isinstance(value, ModuleType):
                left.append((f"{path}.{name}", value))
            elif callable(value):
                found.setdefault(id(value), (f"{path}.{name}", value))
    return found


@functools.cache
def paths() -> dict[int, str]:
    """Where the book describes a class: under its public path, or that of a page of the API."""
    found = {key: path for key, (path, _) in public().items()}
    for page in sorted((BOOK / "api").glob("*.md")):
        for path, names in ASKED.findall(page.read_text()):
            module = module_at(path)
            for name in names.split() or public_names(module):
                found.setdefault(id(getattr(module, name)), f"{path}.{name}")
    return found


def type_text(kind: object) -> str:
    """A type as a user would write it; "" where anything may be given."""
    inner = [type_text(part) for part in typing.get_args(kind)]
    origin = typing.get_origin(kind)
    if kind in (inspect.Parameter.empty, typing.Any):
        return ""
    if isinstance(kind, str):
        return kind if kind.isidentifier() else ""
    if hasattr(kind, "dim_str"):
        dtype = kind.__name__.split("[")[0]
        scalar = {"Float": "float", "Int": "int", "Bool": "bool"}.get(dtype)
        return scalar if scalar and not kind.dim_str else f"{dtype}[Array, {kind.dim_str!r}]"
    if origin in (typing.Union, types.UnionType):
        return " | ".join(inner) if all(inner) else ""
    if origin is typing.Literal:
        return f"Literal[{', '.join(map(repr, typing.get_args(kind)))}]"
    if origin is Callable:
        return "Callable"
    if origin is not None:
        name = getattr(origin, "__name__", str(origin))
        return f"{name}[{', '.join(text or 'Any' for text in inner)}]" if inner else name
    if kind is Ellipsis:
        return "..."
    if kind in (None, type(None)):
        return "None"
    return paths().get(id(kind), getattr(kind, "__name__", "").split(".")[-1])


def fields_of(kind: object) -> list[dataclasses.Field]:
    """Fields that are given when an object is built."""
    known = inspect.isclass(kind) and dataclasses.is_dataclass(kind)
    return [field for field in dataclasses.fields(kind) if field.init] if known else []


def _meant(kind: object, value: object) -> object:
    """A type that is written as a string, as one names a class within itself."""
    known = vars(sys.modules[value.__module__])
    return known.get(kind, kind) if isinstance(kind, str) else kind


def signature(value: object) -> str:
    """What may be typed: arguments, with types where not anything may be given, and defaults."""
    try:
        found = inspect.signature(inspect.unwrap(value))
    except (TypeError, ValueError):
        return "()"
    fields = {field.name: field for field in fields_of(value)} | getattr(value, "fields", {})
    # What converts a number takes anything: its field says what is meant.
    kept = {name: field.type for name, field in fields.items() if "unit" in field.metadata}
    plain = []
    for given in found.parameters.values():
        if given.name in ("self", "cls"):
            continue
        kind = type_text(_meant(given.annotation, value)) or type_text(
            kept.get(given.name, typing.Any)
        )
        if given.default is not given.empty:
            made = getattr(fields.get(given.name), "default_factory", dataclasses.MISSING)
            default = given.default if made is dataclasses.MISSING else made()
            given = given.replace(default=default_text(default))
        plain.append(given.replace(annotation=Words(kind) if kind else given.empty))
    result = "" if inspect.isclass(value) else type_text(_meant(found.return_annotation, value))
    shown = found.replace(
        parameters=plain, return_annotation=Words(result) if result else found.empty
    )
    return str(shown)


def lists_arguments(value: object) -> bool:
    """Whether the docstring of a class or function lists its arguments."""
    return re.search(r"^\s*Args:$", value.__doc__ or "", re.MULTILINE) is not None


def number_table(kind: type) -> list[str]:
    """Numbers of a class: default, unit, range and meaning; none if its docstring lists them."""
    if any(lists_arguments(base) for base in kind.__mro__):
        return []
    found = [field for field in fields_of(kind) if field.metadata.get("meaning")]
    if not found:
        return []
    lines = ["", "| number | default | unit | meaning |", "| --- | --- | --- | --- |"]
    for field in found:
        words = range_in_words(field.metadata)
        meaning = field.metadata["meaning"] + (f" ({words})" if words else "")
        unset = field.default is field.default_factory
        default = "" if unset else default_text(field.default)
        cells = (f"`{field.name}`", default, field.metadata.get("unit", "1"), meaning)
        lines.append("| " + " | ".join(text.replace("|", "\\|") for text in cells) + " |")
    return [*lines, ""]


def built_table(function: Callable) -> list[str]:
    """Numbers of the law that a function builds, where it needs no arguments."""
    needed = [p for p in inspect.signature(function).parameters.values() if p.default is p.empty]
    if not function.__module__.startswith("jaxclear.laws") or needed or lists_arguments(function):
        return []
    lines = ["", "| number | default | unit | meaning |", "| --- | --- | --- | --- |"]
    for path, leaf, metadata in numbers(function()):
        name = path.split(".")[-1]
        told = metadata.get("unit", "1"), metadata.get("meaning", "")
        cells = (f"`{name}`", f"{float(leaf):g}", *told)
        lines.append("| " + " | ".join(text.replace("|", "\\|") for text in cells) + " |")
    return [*lines, ""] if len(lines) > 3 else []


def is_abstract(value: object) -> bool:
    """Whether a class is the base of a family."""
    return inspect.isclass(value) and value.__name__.startswith("Abstract")


def methods(kind: type) -> list[tuple[str, str, object]]:
    """(directive, name, function) of what a user of the class calls: not what its family does with
    it, and of a base what a member must define."""
    families = [base for base in kind.__mro__[1:] if id(base) in public() and is_abstract(base)]
    of_family = {name for base in families for name in dir(base)}
    found = []
    for name, value in vars(kind).items():
        function = value.fget if isinstance(value, property) else value
        function = getattr(function, "__func__", function)
        if name.startswith("_") or not callable(function) or inspect.isclass(function):
            continue
        required = getattr(value, "__isabstractmethod__", False)
        if name in of_family or (is_abstract(kind) and not required):
            continue
        if getattr(function, "__doc__", None):
            found.append(("property" if isinstance(value, property) else "method", name, function))
    return found


def told(value: Callable) -> list[str]:
    """The docstring of a class or function, its arguments one by one."""
    try:
        names = set(inspect.signature(value).parameters)
    except (TypeError, ValueError):
        names = set()
    return markdown(value.__doc__, names)


def is_own(value: object) -> bool:
    """Whether something is a class or function of the package."""
    return callable(value) and (getattr(value, "__module__", None) or "").startswith("jaxclear")


def described(path: str, value: object) -> list[str]:
    """Markdown of one public name."""
    if isinstance(value, ModuleType):
        return []
    if not is_own(value):
        return [f"::::{{py:data}} {path}", "::::", ""]
    what = "class" if inspect.isclass(value) else "function"
    lines = [f":::::{{py:{what}}} {path}{signature(value)}", "", *told(value), ""]
    if what == "function":
        lines += built_table(value)
    if what == "class":
        lines += number_table(value)
        for kind, name, function in methods(value):
            arguments = "" if kind == "property" else signature(function)
            lines += [f"::::{{py:{kind}}} {name}{arguments}", "", *told(function), "::::", ""]
    return [*lines, ":::::", ""]


class Reference(SphinxDirective):
    """`{reference} MODULE [NAME ...]`: all public names, or those given."""

    required_arguments = 1
    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        path = self.arguments[0]
        module = module_at(path)
        chosen = self.arguments[1].split() if len(self.arguments) > 1 else public_names(module)
        self.env.note_dependency(module.__file__)
        lines = [] if len(self.arguments) > 1 else [*markdown(module.__doc__), ""]
        order = lambda name: (
            is_abstract(getattr(module, name)),
            inspect.isclass(getattr(module, name)),
        )
        for name in sorted(chosen, key=order) if len(self.arguments) == 1 else chosen:
            lines += described(f"{path}.{name}", getattr(module, name))
        found = nodes.container()
        self.state.nested_parse(StringList(lines, module.__file__), self.content_offset, found)
        return found.children


def setup(app: Sphinx) -> dict:
    app.add_directive("reference", Reference)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
