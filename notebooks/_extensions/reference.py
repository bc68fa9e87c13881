"""The API from the docstrings.

    ```{reference} jaxclear.contact
    ```

describes every public name of a module, under the name by which a user reaches it, not by the file
it lives in. Docstrings are read as Markdown, so that `code` and $mathematics$ are what they look
like. A table lists every number of a class with its default, unit, range and meaning; it is read
from the fields themselves.
"""

import dataclasses
import importlib
import inspect
import re
from collections.abc import Callable
from types import ModuleType

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from jaxclear.ground.quantity import numbers, range_in_words

DOI = re.compile(r"doi:\s?(10\.\d+/[^\s,;]*[^\s,;.)])")
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


def markdown(text: str | None) -> list[str]:
    """A docstring as lines of Markdown."""
    text = ROLE.sub(lambda found: f"${' '.join(found[1].split())}$", inspect.cleandoc(text or ""))
    text = DOI.sub(r"[doi:\1](https://doi.org/\1)", text)
    return re.sub(r"^\.\. math::\n\n((?:[ ].*\n?)+)", r"$$\n\1\n$$\n", text, flags=re.M).split("\n")


class Short:
    """A default as it is written, without the zeros of `repr`."""

    def __init__(self, number: float):
        self.number = number

    def __repr__(self) -> str:
        return f"{self.number:g}"


def default_text(field: dataclasses.Field) -> str:
    if field.default is not dataclasses.MISSING:
        given = field.default
        return repr(Short(given) if isinstance(given, float) else given)
    return "" if field.default_factory is dataclasses.MISSING else "…"


def fields_of(kind: type) -> list[dataclasses.Field]:
    if not dataclasses.is_dataclass(kind):
        return []
    return [field for field in dataclasses.fields(kind) if field.init]


def signature(value: object) -> str:
    """Arguments and defaults; annotations stand in the text."""
    fields = fields_of(value) if inspect.isclass(value) else []
    if fields:
        names, keyword = [], False
        for field in fields:
            if field.kw_only and not keyword:
                names.append("*")
            keyword = keyword or field.kw_only
            default = default_text(field)
            names.append(f"{field.name}={default}" if default else field.name)
        return f"({', '.join(names)})"
    try:
        found = inspect.signature(value)
    except (TypeError, ValueError):
        return "()"
    plain = []
    for p in found.parameters.values():
        default = Short(p.default) if isinstance(p.default, float) else p.default
        if p.name != "self":
            plain.append(p.replace(annotation=p.empty, default=default))
    return str(found.replace(parameters=plain, return_annotation=found.empty))


def number_table(kind: type) -> list[str]:
    """Numbers of a class: default, unit, range and meaning."""
    found = [field for field in fields_of(kind) if field.metadata.get("meaning")]
    if not found:
        return []
    lines = ["", "| number | default | unit | meaning |", "| --- | --- | --- | --- |"]
    for field in found:
        words = range_in_words(field.metadata)
        meaning = field.metadata["meaning"] + (f" ({words})" if words else "")
        cells = (f"`{field.name}`", default_text(field), field.metadata.get("unit", "1"), meaning)
        lines.append("| " + " | ".join(text.replace("|", "\\|") for text in cells) + " |")
    return [*lines, ""]


def built_table(function: Callable) -> list[str]:
    """Numbers of the law that a function builds, where it needs no arguments."""
    needed = [p for p in inspect.signature(function).parameters.values() if p.default is p.empty]
    if not function.__module__.startswith("jaxclear.laws") or needed:
        return []
    lines = ["", "| number | default | unit | meaning |", "| --- | --- | --- | --- |"]
    for path, leaf, metadata in numbers(function()):
        name = path.split(".")[-1]
        told = metadata.get("unit", "1"), metadata.get("meaning", "")
        cells = (f"`{name}`", f"{float(leaf):g}", *told)
        lines.append("| " + " | ".join(text.replace("|", "\\|") for text in cells) + " |")
    return [*lines, ""] if len(lines) > 3 else []


def methods(kind: type) -> list[tuple[str, str, object]]:
    """(directive, name, function) of what the class itself defines and describes."""
    found = []
    for name, value in vars(kind).items():
        function = value.fget if isinstance(value, property) else value
        function = getattr(function, "__func__", function)
        if name.startswith("_") or not callable(function) or inspect.isclass(function):
            continue
        if getattr(function, "__doc__", None):
            found.append(("property" if isinstance(value, property) else "method", name, function))
    return found


def described(path: str, value: object) -> list[str]:
    """Markdown of one public name."""
    if isinstance(value, ModuleType):
        return []
    own = (getattr(value, "__module__", None) or "").startswith("jaxclear")
    if not callable(value) or not own:
        return [f"::::{{py:data}} {path}", "::::", ""]
    what = "class" if inspect.isclass(value) else "function"
    lines = [f":::::{{py:{what}}} {path}{signature(value)}", "", *markdown(value.__doc__), ""]
    if what == "function":
        lines += built_table(value)
    if what == "class":
        lines += number_table(value)
        for kind, name, function in methods(value):
            arguments = "" if kind == "property" else signature(function)
            lines += [f"::::{{py:{kind}}} {name}{arguments}", "", *markdown(function.__doc__)]
            lines += ["::::", ""]
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
        for name in chosen:
            lines += described(f"{path}.{name}", getattr(module, name))
        found = nodes.container()
        self.state.nested_parse(StringList(lines, module.__file__), self.content_offset, found)
        return found.children


def setup(app: Sphinx) -> dict:
    app.add_directive("reference", Reference)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
