"""Docstrings of the public surface list the arguments: each once under `Args:`, with its unit in
brackets (`[m]`; `[1]` or `[-]` for a number without unit) or a word for the kind of thing it is.

What is not complete yet stands in refdata/undocumented.json, a list for each package, which only
shrinks: `python -m tests.test_docstrings` takes out what is complete, and says what others lack."""

import dataclasses
import enum
import inspect
import json
import re
import sys
from pathlib import Path

import pytest

from tests.test_public_surface import owner, public_modules

PENDING = Path(__file__).parent / "refdata" / "undocumented.json"
SECTION = re.compile(r"^Args:\n((?:(?: {4}.*)?\n)*)", re.MULTILINE)
ENTRY = re.compile(r"^ {4}(?=\S)", re.MULTILINE)
NAMES = re.compile(r"((?:\*{0,2}\w+)(?:, \*{0,2}\w+)*): (.*)", re.DOTALL)
# What an argument is where it has no unit; a name of a class or literal in backticks says it, too.
KINDS = (
    "array|body|bodies|class|clearance|column|connection|contact|count|coupling|"
    "coupled|data|dict|distribution|drive|driven|event|factor|file|folder|frame|"
    "friction|function|identifier|index|integer|integrator|joint|key|label|law|"
    "list|load|loads|map|mapping|material|mechanism|mesh|message|model|module|"
    "name|names|number|option|part|path|pose|problem|quantity|response|result|row|"
    "run|scene|seed|sequence|series|settings|signal|solution|solver|state|states|"
    "study|surface|table|text|time|trajectory|tuple|type|unit|value|values|"
    "variable|vector|wear|whether|word"
)
CLASS_OR_TEXT = r"`(?!None|True|False)[\w.]*[\"'A-Z][^`]*`"
WORD = rf"\b(?i:{KINDS})s?\b"
UNIT_OR_KIND = re.compile(rf"\[[^\]]+\]|{CLASS_OR_TEXT}|{WORD}")


def listed_arguments(text):
    """[(name, description)] of the entries under `Args:` of a docstring."""
    section = SECTION.search(inspect.cleandoc(text or "") + "\n")
    entries = []
    for entry in ENTRY.split(section[1])[1:] if section else []:
        match = NAMES.match(entry)
        names, description = (match[1], match[2]) if match else (entry, "")
        entries += [(name.strip("* "), " ".join(description.split())) for name in names.split(",")]
    return entries


def argument_names(function):
    try:
        names = inspect.signature(function).parameters
    except (TypeError, ValueError):
        return []
    return [name for name in names if name not in ("self", "cls")]


def own_classes(kind):
    return [base for base in kind.__mro__ if base.__module__.startswith("jaxclear")]


def class_docstrings(kind):
    """Of the class and those it derives from, in which a field may be described."""
    for base in own_classes(kind):
        yield vars(base).get("__doc__")
        yield getattr(vars(base).get("__init__"), "__doc__", None)


def method_docstrings(kind, name):
    members = (vars(base)[name] for base in own_classes(kind) if name in vars(base))
    for member in members:
        yield getattr(member, "__func__", member).__doc__


QUALIFIED_NAMES = {}


def identifier(thing):
    name = f"{thing.__module__}.{thing.__qualname__}".removeprefix("jaxclear.")
    QUALIFIED_NAMES[name] = thing.__qualname__
    return name


def is_described_elsewhere(kind, name):
    """Whether another library describes a method, such as diffrax those of its solvers."""
    others = (base for base in kind.__mro__ if not base.__module__.startswith("jaxclear"))
    return any(name in vars(base) for base in others)


def documented_things():
    """{name: (its arguments, docstrings that may list them)} of the public surface."""
    things = {}
    for module in public_modules().values():
        for thing in (getattr(module, name) for name in module.__all__):
            if not (getattr(thing, "__module__", None) or "").startswith("jaxclear"):
                continue
            if inspect.isclass(thing) and not issubclass(thing, enum.Enum):
                things[identifier(thing)] = argument_names(thing), [*class_docstrings(thing)]
                for name, member in inspect.getmembers(thing, inspect.isroutine):
                    # A cached property counts as a routine, and has no name of its own.
                    own = not name.startswith("_") and hasattr(member, "__qualname__")
                    own = own and owner(thing, name).startswith("jaxclear")
                    if own and not is_described_elsewhere(thing, name):
                        docstrings = [*method_docstrings(thing, name)]
                        things[identifier(member)] = argument_names(member), docstrings
            elif inspect.isfunction(thing):
                things[identifier(thing)] = argument_names(thing), [thing.__doc__]
    return things


def faults(arguments, docstrings, abstract=False):
    """What is wrong with the lists of arguments; an entry nearer to the class hides one above."""
    lists = [entries for text in docstrings if (entries := listed_arguments(text))]
    for entries in lists:
        names = [name for name, _ in entries]
        yield from (f"{name} is listed twice" for name in {n for n in names if names.count(n) > 1})
    if lists and docstrings[0] and listed_arguments(docstrings[0]) and not abstract:
        yield from (f"{name} is no argument" for name, _ in lists[0] if name not in arguments)
    described = {name: text for entries in reversed(lists) for name, text in entries}
    for name in arguments:
        if name not in described:
            yield f"{name} is not listed"
        elif not UNIT_OR_KIND.search(described[name]):
            yield f"{name} has neither a unit nor a word for its kind: {described[name]!r}"


RANGES = {"above": ">", "at_least": ">=", "below": "<", "at_most": "<="}


def numbers_with_descriptions():
    """(name, metadata, description) of numbers of public classes that describe them."""
    for kind in {id(thing): thing for thing in public_classes()}.values():
        descriptions = dict(listed_arguments(vars(kind).get("__doc__")))
        for field in dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ():
            if field.name in descriptions and field.metadata.get("unit", "(")[0] != "(":
                name = f"{kind.__qualname__}.{field.name}"
                yield name, field.metadata, descriptions[field.name]


def public_classes():
    offered = (getattr(module, n) for module in public_modules().values() for n in module.__all__)
    return [thing for thing in offered if inspect.isclass(thing)]


THINGS = documented_things()
# Abstract classes may describe the fields that their members have.
ABSTRACT = {name for name in THINGS if name.rpartition(".")[2].startswith("Abstract")}
FAULTS = {name: found for name in THINGS if (found := [*faults(*THINGS[name], name in ABSTRACT)])}
ALLOWED = json.loads(PENDING.read_text()) if PENDING.exists() else {}


def package(name):
    return name.partition(".")[0]


def pending_name(name):
    """A name in the list: that of its package and its own, whatever the file."""
    return f"{package(name)}.{QUALIFIED_NAMES[name]}"


@pytest.mark.parametrize("room", sorted({package(name) for name in THINGS}))
def test_arguments_are_listed_once_with_unit_or_kind(room):
    here = {n: told for n, told in FAULTS.items() if package(n) == room}
    faulty = {n: told for n, told in here.items() if pending_name(n) not in ALLOWED.get(room, [])}
    assert not faulty, f"{faulty}\n(kinds: {KINDS})"


@pytest.mark.parametrize("room", sorted(ALLOWED))
def test_what_is_complete_is_taken_from_the_list_of_what_is_not(room):
    complete = set(ALLOWED[room]) - set(map(pending_name, FAULTS))
    assert not complete, f"{complete} are complete: run `python -m tests.test_docstrings`"


def test_the_rule_finds_each_fault():
    for text, fault in (
        ("Double.\n\nArgs:\n    x: a length [m].\n    n: how often, a count.", None),
        ("Double.\n\nArgs:\n    x, n: numbers [1].\n\nReturns:\n    y: twice x.", None),
        ("Double.\n\nArgs:\n    x: a length [m].", "n is not listed"),
        ("Double.\n\nArgs:\n    x: a length [m].\n    n: often.", "n has neither"),
        ("Double.\n\nArgs:\n    x, n: [1].\n    x: [m].", "x is listed twice"),
        ("Double.\n\nArgs:\n    x, n, y: [1].", "y is no argument"),
        ("Double `x` [m], `n` [1] times.", "x is not listed"),
    ):
        found = "; ".join(faults(["x", "n"], [text]))
        assert fault in found if fault else not found
    # A member of a family inherits the list.
    assert not [*faults(["x"], ["Halved.", "Family.\n\nArgs:\n    x: a length [m]."])]


def test_units_and_ranges_are_those_of_the_fields():
    """A field's metadata say the same as the docstring, which also gives its meaning."""
    numbers = list(numbers_with_descriptions())
    assert len(numbers) > 150
    assert not [(name, *told) for name, *own in numbers if (told := [*disagreements(*own)])]


def disagreements(metadata, text):
    units = [re.split("[;,]", own)[0] for own in re.findall(r"\[([^\]]*)\]", text)]
    if metadata["unit"] not in ("1", *units) or not units:
        yield f"[{metadata['unit']}] is not in {text!r}"
    for key in RANGES.keys() & metadata.keys():
        if f"{RANGES[key]} {metadata[key]:g}" not in text:
            yield f"{RANGES[key]} {metadata[key]:g} is not in {text!r}"
    if metadata.get("sliding", "") and f"{metadata['sliding']} for a sliding" not in text:
        yield f"{metadata['sliding']} for a sliding joint is not in {text!r}"
    if not metadata["meaning"]:
        yield "no meaning"


if __name__ == "__main__":
    faulty = set(map(pending_name, FAULTS))
    kept = {room: [name for name in names if name in faulty] for room, names in ALLOWED.items()}
    PENDING.write_text(json.dumps({r: n for r, n in kept.items() if n}, indent=1) + "\n")
    for name, found in FAULTS.items():
        if not sys.argv[1:] or package(name) in sys.argv[1:]:
            print(f"{name}: {'; '.join(found)}")
