"""From the text of a file to plain values, each with its line: mappings, lists, texts, numbers.

YAML is read event by event, so that depth and size are bounded before anything is built and a tag
never becomes an object. Plain words are read as YAML 1.2 says (core schema: `1e-5` is a number,
`on` a text). JSON is read by Python's own reader. Everything that is wrong ends in a `Misread`.

Values of a file as numbers and texts; what they are not is refused by line and place.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from jaxclear.ground.wording import described

# Largest file [bytes], values in it once aliases are written out, and nesting.
LARGEST, MOST_VALUES, DEEPEST = 32_000_000, 1_000_000, 60
# Longest number [characters]: Python refuses to read whole numbers of thousands of digits.
LONGEST_NUMBER = 400
# Longest place and sentence of a refusal [characters]: a name may be as long as a file.
LONGEST_PLACE, LONGEST_SENTENCE = 300, 1500
# So PyYAML (6.0.4 on) tells that lists open far deeper than that, before it hands them on.
TOO_DEEP = "maximum nesting depth"
TOO_MANY = f"holds more than {MOST_VALUES} values"
# A text of JSON, and a list or mapping without values.
QUOTED, EMPTY = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"'), re.compile(r"[\[{]\s*[\]}]")
YAML, JSON = (".yaml", ".yml"), (".json",)
# YAML 1.2.2, section 10.3.2, https://yaml.org/spec/1.2.2/.
NULLS = {"", "~", "null", "Null", "NULL"}
FLAGS = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
INTEGER = re.compile(r"[-+]?[0-9]+")
DECIMAL = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
STRANGE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class Misread(ValueError):
    """A file that says what cannot be; the sentence names line and place."""


@dataclass(frozen=True, slots=True)
class Node:
    """A value of a file: a dictionary by name, a list, a text, a number, a flag or None. `line`: 0
    where the reader does not tell it. `raw`: the text of what is written without quotes. `size`:
    values in it."""

    value: Any
    line: int = 0
    raw: str | None = None
    size: int = 1

    @property
    def words(self) -> str:
        """The value in a few words."""
        if isinstance(self.value, dict):
            names = ", ".join(self.value)[:60]
            return f"a mapping of {names}" if names else "an empty mapping"
        if isinstance(self.value, list):
            return f"a list of {len(self.value)}"
        return described(self.value)


def misread(node: Node, path: str, sentence: str) -> Misread:
    """The error for a value of a file that is not what it must be.

    Args:
        node: the value with its line.
        path: its place in the file.
        sentence: follows the place: what is wrong, and what it must be.
    """
    line = f"line {node.line}, " if node.line else ""
    place = path if len(path) <= LONGEST_PLACE else f"{path[:LONGEST_PLACE]}..."
    if len(sentence) > LONGEST_SENTENCE:
        sentence = f"{sentence[:LONGEST_SENTENCE]}..."
    return Misread(f"{line}{place}: {sentence}")


def text_of(path: Path) -> str:
    """The text of a file. Raises `Misread` for what is no text file of bearable size."""
    try:
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "does not exist"
            raise Misread(f"{what}; give the path of a file.")
        if path.stat().st_size > LARGEST:
            raise Misread(f"has {path.stat().st_size} bytes; it may have {LARGEST} at the most.")
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Misread(f"is no text in UTF-8 (byte {error.start}).") from None
    except OSError as error:
        raise Misread(f"cannot be read: {error.strerror}.") from None


def parse_values(text: str, suffix: str) -> Node:
    """The values in a text of YAML or JSON, by the file's ending. Raises `Misread`."""
    if suffix.lower() in JSON:
        return _parse_json(text)
    if suffix.lower() in YAML:
        return _parse_yaml(text)
    raise Misread(f'ends in "{suffix}"; a scene file ends in .yaml, .yml or .json.')


def _parse_json(text: str) -> Node:
    # Before anything is built: millions of values take minutes and gigabytes.
    if _bound_value_count(text) > MOST_VALUES and values_of(text) > MOST_VALUES:
        raise Misread(f"{TOO_MANY}.")
    try:
        entries = json.loads(text, object_pairs_hook=_Pairs, parse_constant=_refuse_constant)
    except json.JSONDecodeError as error:
        raise Misread(f"line {error.lineno}: {error.msg} (JSON).") from None
    except RecursionError:
        raise Misread(f"is nested more than {DEEPEST} deep.") from None
    except Misread:
        raise
    except ValueError:
        raise Misread("holds a whole number of thousands of digits.") from None
    return _node_of_value(entries, 0)


def _bound_value_count(text: str) -> int:
    """A bound of the values in a text of JSON: each but the outermost follows a comma or opens a
    list or mapping."""
    return 1 + sum(map(text.count, ",[{"))


def values_of(text: str) -> int:
    """The values in a text of JSON, names not counted."""
    bare = QUOTED.sub('"', text)
    return _bound_value_count(bare) - len(EMPTY.findall(bare))


class _Pairs(list):
    """What stands in an object of JSON: names may come twice."""


def _refuse_constant(word: str) -> NoReturn:
    raise Misread(f"holds {word}, which is no number of JSON.")


def _node_of_value(value: Any, depth: int) -> Node:
    if depth > DEEPEST:
        raise Misread(f"is nested more than {DEEPEST} deep.")
    if isinstance(value, _Pairs):
        entries: dict[str, Node] = {}
        for name, inner in value:
            if name in entries:
                raise Misread(f'the name "{name[:60]}" stands twice in one mapping.')
            entries[name] = _node_of_value(inner, depth + 1)
        return Node(entries)
    if isinstance(value, list):
        return Node([_node_of_value(inner, depth + 1) for inner in value])
    return Node(value)


class _Open:
    """A mapping or list that is being read."""

    def __init__(self, named: bool, line: int, anchor: str | None):
        self.named, self.line, self.anchor = named, line, anchor
        self.values: Any = {} if named else []
        self.name: str | None = None
        self.size = 1

    def take(self, node: Node) -> None:
        """The next name or value."""
        if not self.named:
            self.values.append(node)
        elif self.name is None:
            self.name = _check_node_name(node, self.values)
            return
        else:
            self.values[self.name] = node
            self.name = None
        self.size += node.size


def _check_node_name(node: Node, names: dict) -> str:
    name = node.raw if node.raw is not None else node.value
    if not isinstance(name, str):
        raise Misread(f"line {node.line}: a name is {node.words}; it must be a text.")
    if name in names:
        raise Misread(f'line {node.line}: the name "{name[:60]}" stands twice in one mapping.')
    return name


def _parse_yaml(text: str) -> Node:
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return _build_document(yaml.parse(text, Loader=loader), yaml)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = "" if mark is None else f"line {mark.line + 1}: "
        problem = error.problem or error.context
        if TOO_DEEP in problem:
            raise Misread(f"{line}is nested more than {DEEPEST} deep.") from None
        raise Misread(f"{line}{problem} (YAML).") from None
    except yaml.YAMLError as error:
        raise Misread(f"{str(error).splitlines()[0].rstrip('.')} (YAML).") from None
    except RecursionError:
        raise Misread(f"is nested more than {DEEPEST} deep.") from None


def _build_document(events: Any, yaml: Any) -> Node:
    """The one document of a stream of events."""
    anchors: dict[str, Node | None] = {}
    stack: list[_Open] = []
    entries: Node | None = None
    for event in events:
        node = _finish_value(event, yaml, anchors, stack)
        if node is None:
            continue
        if node.size > MOST_VALUES or (stack and stack[-1].size > MOST_VALUES):
            raise Misread(f"line {node.line}: {TOO_MANY}, aliases written out.")
        if stack:
            stack[-1].take(node)
        elif entries is not None:
            raise Misread(f"line {node.line}: a second document begins; a file holds one.")
        else:
            entries = node
    if entries is None:
        raise Misread("is empty.")
    return entries


def _finish_value(event: Any, yaml: Any, anchors: dict, stack: list[_Open]) -> Node | None:
    """The value that ends with an event; None where none does."""
    line = event.start_mark.line + 1
    if isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
        if len(stack) == DEEPEST:
            raise Misread(f"line {line}: is nested more than {DEEPEST} deep.")
        named = isinstance(event, yaml.MappingStartEvent)
        _check_tag(event.tag, ("map",) if named else ("seq",), line)
        if event.anchor:
            anchors[event.anchor] = None
        stack.append(_Open(named, line, event.anchor))
        return None
    if isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
        closed = stack.pop()
        node = Node(closed.values, closed.line, None, closed.size)
        if closed.anchor:
            anchors[closed.anchor] = node
        return node
    if isinstance(event, yaml.ScalarEvent):
        node = _scalar_node(event, line)
        if event.anchor:
            anchors[event.anchor] = node
        return node
    if isinstance(event, yaml.AliasEvent):
        if anchors.get(event.anchor) is None:
            raise Misread(f'line {line}: the alias "{event.anchor[:60]}" names nothing above it.')
        return anchors[event.anchor]
    return None


def _scalar_node(event: Any, line: int) -> Node:
    plain = event.implicit[0]
    _check_tag(event.tag, ("str", "int", "float", "bool", "null"), line)
    if not plain and event.tag in (None, "!", "tag:yaml.org,2002:str"):
        return Node(event.value, line)
    text = event.value
    if text in NULLS:
        return Node(None, line)
    if text in FLAGS:
        return Node(FLAGS[text], line, text)
    if len(text) <= LONGEST_NUMBER:
        if INTEGER.fullmatch(text):
            return Node(int(text), line, text)
        if DECIMAL.fullmatch(text) or STRANGE.fullmatch(text):
            return Node(float(text.replace(".inf", "inf").replace(".nan", "nan")), line, text)
    return Node(text, line, text)


def _check_tag(tag: str | None, tags: tuple[str, ...], line: int) -> None:
    """A tag would name a type of another program: only YAML's own are read."""
    plain = ("!", *(f"tag:yaml.org,2002:{word}" for word in tags))
    if tag is not None and tag not in plain:
        raise Misread(
            f'line {line}: the tag "{tag[:60]}" asks for an object; a scene file holds mappings, '
            "lists, texts and numbers only."
        )


def is_number(node: Node) -> bool:
    """Whether a value is a number; a flag is none."""
    return isinstance(node.value, (int, float)) and not isinstance(node.value, bool)


def as_float(node: Node, path: str) -> float:
    """A number. Raises `Misread` for one beyond all that a computer holds."""
    try:
        return float(node.value)
    except OverflowError:
        raise misread(node, path, "is a number beyond all that a computer holds.") from None


def plain_text(node: Node, path: str) -> str:
    """A text; a number without quotes is one, too."""
    if isinstance(node.value, str):
        return node.value
    if node.raw is not None:
        return node.raw
    raise misread(node, path, f"is {node.words}; it must be a text.")


def read_nested(node: Node, path: str) -> Any:
    """Numbers in nested lists, all of one shape."""
    if is_number(node):
        return as_float(node, path)
    if not isinstance(node.value, list):
        raise misread(node, path, f"is {node.words}; it must be a list of numbers.")
    values = [read_nested(entry, path) for entry in node.value]
    if len({np.shape(entry) for entry in values}) > 1:
        raise misread(node, path, "is a list whose entries have different lengths.")
    return values
