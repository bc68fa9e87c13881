"""A problem in texts, one for each of its parts: two problems are one where these are the same,
also in another process, and where one of them lies in a folder.

A function is told by what it does and with what: its code and that of the functions in it, what it
holds and has by default, and the things outside that it uses by name. What libraries bring is told
by its name: whoever keeps texts keeps the libraries' versions beside them.
"""

import dataclasses
import dis
import functools
import hashlib
import importlib.util
import inspect
import re
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, MemberDescriptorType, ModuleType
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.quantity import IF_ANY
from jaxclear.ground.wording import listed
from jaxclear.studies.problem import Problem

# Longest text of one piece, in characters; what is longer ends in a digest.
LONGEST = 60
# Of a digest.
DIGITS = 16
# How a function begins to be told.
FUNCTION = "the function"
# How what belongs to a class begins, and what stands for a thing whose parts are told.
CLASS, TOLD = "class ", "told"
# Names by which a class tells of its fields; beside those that begin and end in a line.
OF_FIELDS = ("_fields", "_field_defaults")
# Functions of a class that make a thing, whose numbers are told, or show it.
OF_NO_NUMBER = {
    f"__{name}__"
    for name in (
        "init",
        "new",
        "post_init",
        "check_init",
        "init_subclass",
        "repr",
        "str",
        "format",
        "hash",
        "eq",
        "ne",
        "setattr",
        "delattr",
        "reduce",
        "reduce_ex",
        "getstate",
        "setstate",
        "replace",
        "annotate",
        "annotate_func",
        "getnewargs",
    )
}
# Where in memory a thing lies is no part of what it is.
ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")
# Where libraries lie.
LIBRARIES = tuple(
    Path(sysconfig.get_paths()[kind]) for kind in ("stdlib", "platstdlib", "purelib", "platlib")
)


def in_texts(problem: Problem) -> dict[str, str]:
    """A text for each part of a problem, by its path. Numbers with all their digits, large arrays
    and functions by a digest."""
    found: dict[str, str] = {}
    for what, part in problem.parts().items():
        tell(part, what, found)
    for name in problem.names:
        tell(problem.variables[name].distribution, f'distribution of "{name}"', found)
    if problem.correlation is not None:
        tell(problem.correlation, "correlation of the variables", found)
    return found


def difference(one: Problem, other: Problem) -> str:
    """The first thing in which `one` differs from `other`, in words; "" where they are the same. A
    problem built anew by the same lines is the same."""
    if one.names != other.names:
        return f"its variables are {_named(one.names)}, not {_named(other.names)}"
    if one.response_names != other.response_names:
        named = _named(one.response_names)
        return f"its responses are {named}, not {_named(other.response_names)}"
    if type(one.experiment) is not type(other.experiment):
        return (
            f"it is of a {type(one.experiment).__name__}, not a {type(other.experiment).__name__}"
        )
    return first_difference(in_texts(one), in_texts(other))


def first_difference(one: dict[str, str], other: dict[str, str]) -> str:
    """The first part in which two descriptions differ, in words; "" where they are the same."""
    for part in [*one, *(name for name in other if name not in one)]:
        mine, others = (own.get(part, "absent") for own in (one, other))
        if mine.startswith(FUNCTION) and others.startswith(FUNCTION) and mine != others:
            return f"{part} is another function"
        if mine != others:
            return f"{part} is {mine} there, {others} here"
    return ""


def _named(names: tuple[str, ...]) -> str:
    return listed(names) or "none"


def parts_of(thing: Any) -> dict[str, Any] | None:
    """What a thing consists of, each by what follows its own name; None for what is one piece."""
    if dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        own = {f: getattr(thing, f.name) for f in dataclasses.fields(thing)}
        # What a folder of an earlier version does not know is told where there is some.
        told = (f for f, value in own.items() if not f.metadata.get(IF_ANY, False) or value)
        return {f".{f.name}": own[f] for f in told}
    if isinstance(thing, dict):
        return {f'["{key}"]': value for key, value in thing.items()}
    if isinstance(thing, (tuple, list)):
        return {f"[{i}]": value for i, value in enumerate(thing)}
    if isinstance(thing, functools.partial):
        return {".function": thing.func, ".given": thing.args, ".named": thing.keywords}
    return None


def tell(thing: Any, path: str, found: dict[str, str], inside: tuple[int, ...] = ()) -> None:
    """Puts the texts of a thing and of its parts into `found`. `inside`: whose part it is."""
    if id(thing) in inside:
        found[path] = "what it is a part of"
        return
    inside = (*inside, id(thing))
    if eqx.is_array(thing) or isinstance(thing, np.ndarray):
        found[path] = _array(np.asarray(thing))
    elif isinstance(thing, ModuleType):
        found[path] = _module(thing)
    elif isinstance(thing, type):
        found[path] = f"the class {_tell_class(thing, found, inside)}"
    elif (function := _function(thing)) is not None:
        _tell_function(function, path, found, inside)
    elif (parts := parts_of(thing)) is not None:
        # Of a library's dictionary its names say all, whatever its class.
        by_library = isinstance(thing, dict) and _of_library(type(thing).__module__)
        found[path] = _tell_class(dict if by_library else type(thing), found, inside)
        if not dataclasses.is_dataclass(thing):
            parts |= _attributes(thing)
        for key, part in parts.items():
            tell(part, f"{path}{key}", found, inside)
    else:
        _tell_piece(thing, path, found, inside)


def _tell_piece(thing: Any, path: str, found: dict[str, str], inside: tuple[int, ...]) -> None:
    """What has no parts that are known: of a user's class by what it holds and what the class does,
    of a library's by how it shows itself, or by what it holds where that says nothing."""
    shown = repr(sorted(map(repr, thing)) if isinstance(thing, (set, frozenset)) else thing)
    held = _attributes(thing)
    if not _of_library(type(thing).__module__) or (ADDRESS.search(shown) and held):
        found[path] = _tell_class(type(thing), found, inside)
        for name, value in held.items():
            tell(value, f"{path}{name}", found, inside)
    else:
        found[path] = _short(ADDRESS.sub("", shown))


def _attributes(thing: Any) -> dict[str, Any]:
    """What a thing holds, in slots too, each by what follows its own name."""
    held = dict(getattr(thing, "__dict__", {}))
    for owner in type(thing).__mro__:
        slots = (n for n, own in vars(owner).items() if isinstance(own, MemberDescriptorType))
        # A slot that has no value counts as None.
        held |= {name: getattr(thing, name, None) for name in slots}
    return {f".{name}": value for name, value in held.items()}


def _tell_class(kind: type, found: dict[str, str], inside: tuple[int, ...]) -> str:
    """The name of a class. What the functions of one that no library brings do, and with which
    values of the class, is told once."""
    for owner in kind.__mro__:
        path = f"{CLASS}{owner.__module__}.{owner.__qualname__}"
        if path in found or _of_library(owner.__module__):
            continue
        found[path] = TOLD
        for name in vars(owner):
            member = inspect.getattr_static(owner, name)
            if isinstance(member, property):
                member = member.fget
            elif isinstance(member, functools.cached_property):
                member = member.func
            else:
                member = getattr(owner, name, None)
            special = name.startswith("__") and name.endswith("__")
            if (function := _function(member)) is not None:
                if name not in OF_NO_NUMBER:
                    _tell_function(function, f"{path}.{name}", found, inside)
            elif not (special or inspect.isdatadescriptor(member) or _is_field(owner, name)):
                tell(member, f"{path}.{name}", found, inside)
    return kind.__name__


def _is_field(kind: type, name: str) -> bool:
    """Whether a class's value is what a field has by default, or tells of fields: its things tell
    their own."""
    own = name in OF_FIELDS or (name.startswith("_") and name.endswith("_"))
    return own or name in getattr(kind, "__dataclass_fields__", {})


def _function(thing: Any) -> Any:
    """The function that was written: of what JAX or another library has made of it, too; else
    None."""
    if not callable(thing) or isinstance(thing, type):
        return None
    thing = inspect.unwrap(thing, stop=lambda own: not _of_library(_module_of(own)))
    return thing if getattr(thing, "__code__", None) is not None else None


def _module_of(thing: Any) -> str:
    """Where a function was written, or the class of a thing that is called as one."""
    return getattr(thing, "__globals__", {}).get("__name__", type(thing).__module__)


def _tell_function(
    function: Any, path: str, found: dict[str, str], inside: tuple[int, ...]
) -> None:
    """A function by what it does and with what."""
    text = _digest(_code(function.__code__).encode())
    found[path] = f"{FUNCTION} {function.__name__} {text}"
    for what, part in _held(function):
        tell(part, f"{path} {what}", found, inside)
    outside = function.__globals__
    if _of_library(outside.get("__name__", "")):
        return
    for name in sorted(_names_outside(function.__code__)):
        place = f"{outside.get('__name__')}.{name}"
        # Told once: two functions may call one another.
        if name in outside and place not in found:
            found[place] = TOLD
            tell(outside[name], place, found)


def _held(function: Any) -> Iterator[tuple[str, Any]]:
    """What a function holds, by what it is called in texts."""
    if inspect.ismethod(function):
        yield "of", function.__self__
    for i, cell in enumerate(function.__closure__ or ()):
        yield f"holds [{i}]", _content(cell)
    for i, value in enumerate(function.__defaults__ or ()):
        yield f"by default [{i}]", value
    for name, value in (function.__kwdefaults__ or {}).items():
        yield f"by default {name}", value


def _content(cell: Any) -> Any:
    """What is in a cell, which is empty until the name that it stands for has a value."""
    try:
        return cell.cell_contents
    except ValueError:
        return None


def _code(code: CodeType) -> str:
    """What a code does, without where it was written; of the functions in it, too."""
    constants = []
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            constants.append(_code(constant))
        elif isinstance(constant, frozenset):
            constants.append(repr(sorted(map(repr, constant))))
        else:
            constants.append(repr(constant))
    return repr((code.co_code, constants, code.co_names, code.co_varnames))


def _names_outside(code: CodeType) -> set[str]:
    """The names by which a code, and what is written in it, reaches things outside."""
    names = {
        step.argval for step in dis.get_instructions(code) if step.opname.startswith("LOAD_GLOBAL")
    }
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= _names_outside(constant)
    return names


@functools.cache
def _of_library(module: str) -> bool:
    """Whether a module is jaxclear's, Python's, or of an installed library."""
    top = module.partition(".")[0]
    if top in ("jaxclear", "builtins"):
        return True
    if top == "__main__":
        return False
    try:
        found = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return False
    if found is None or found.origin is None:
        return False
    places = Path(found.origin).parents
    return found.origin in ("built-in", "frozen") or any(place in places for place in LIBRARIES)


def _module(module: ModuleType) -> str:
    """A library by its name; a user's own module with a digest of its file."""
    file = getattr(module, "__file__", None)
    if _of_library(module.__name__) or file is None or not Path(file).is_file():
        return f"the module {module.__name__}"
    return f"the module {module.__name__} {_digest(Path(file).read_bytes())}"


def _array(values: np.ndarray) -> str:
    if values.ndim == 0:
        return repr(values.item())
    if values.dtype == object:
        return _short(ADDRESS.sub("", repr(values.tolist())))
    return f"an array {values.shape} {values.dtype} {_digest(np.ascontiguousarray(values))}"


def _short(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}... {_digest(text.encode())}"


def _digest(content: Any) -> str:
    return hashlib.sha256(content).hexdigest()[:DIGITS]
