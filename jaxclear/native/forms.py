"""The form of a function's arguments as a text that every process writes alike: what decides which
program they are compiled to.

Trees are written node by node, with what nodes hold that are no numbers: texts, whole numbers,
classes and functions of this package and of the libraries under it by their names, functions and
classes of a user by what they do (`ground.description`). `Untold` is raised where that cannot be
seen: a function of a user reads files or the surroundings while it is traced.
"""

import enum
import functools
import hashlib
import os
import platform
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxclear.ground.description import LIBRARIES as FOLDERS
from jaxclear.ground.description import Description
from jaxclear.native import object_code, source_check

# What is told by its name: its version is told beside it.
LIBRARIES = ("jax", "jaxlib", "numpy", "equinox", "diffrax", "optimistix", "lineax", "jaxlie")
TRUSTED = ("jaxclear", "builtins", *LIBRARIES)
# How the names of variables begin that say how programs are compiled.
VARIABLES = ("JAXCLEAR_PLAIN", "XLA_", "JAX_")
# A user's function that names one of these may give something else although its code is the same.
READING = {"open", "read", "read_text", "read_bytes", "read_csv", "load", "loadtxt", "genfromtxt"}
READING |= {"fromfile", "memmap", "urlopen", "environ", "getenv", "random", "default_rng"}
# Settings of JAX that no program hangs on have one of these in their names.
IGNORED = ("cache", "log", "explain", "traceback", "dump")


class Untold(Exception):
    """Something of which no text tells all."""


def tree_in_text(tree: Any) -> str:
    """The structure of a tree."""
    return "".join(_iterate_nodes(tree))


def _iterate_nodes(tree: Any) -> Iterator[str]:
    data = tree.node_data()
    if data is None:
        yield "*"
        return
    kind, content = data
    yield f"{_name_in_library(kind)}[{in_text(content)}]("
    for child in tree.children():
        yield from _iterate_nodes(child)
        yield ","
    yield ")"


def in_text(thing: Any) -> str:
    """A thing that is no number of a program. Raises `Untold`."""
    if isinstance(thing, enum.Enum):
        return f"{_name_in_library(type(thing))}.{thing.name}"
    if thing is None or isinstance(thing, (bool, int, float, complex, str, bytes)):
        return f"{_name_in_library(type(thing))}:{thing!r}"
    if isinstance(thing, type):
        return _name_in_library(thing)
    if isinstance(thing, slice):
        return f"slice{in_text((thing.start, thing.stop, thing.step))}"
    if isinstance(thing, (tuple, list)):
        return f"{_name_in_library(type(thing))}({','.join(map(in_text, thing))})"
    if isinstance(thing, (set, frozenset)):
        return f"{_name_in_library(type(thing))}({','.join(sorted(map(in_text, thing)))})"
    if isinstance(thing, dict):
        pairs = (f"{in_text(key)}={in_text(value)}" for key, value in thing.items())
        return f"{_name_in_library(type(thing))}({','.join(pairs)})"
    if isinstance(thing, (np.ndarray, np.generic, jax.Array)):
        return _array_text(np.asarray(thing))
    if isinstance(thing, np.dtype):
        return f"kind {thing.str}"
    if fields := getattr(type(thing), "__dataclass_fields__", ()):
        field_texts = (f"{name}={in_text(getattr(thing, name))}" for name in fields)
        return f"{_name_in_library(type(thing))}({','.join(field_texts)})"
    if callable(thing):
        return function_in_text(thing)
    if not getattr(thing, "__dict__", True) or type(thing).__module__.startswith("equinox."):
        # One of a kind, that holds nothing.
        return _name_in_library(type(thing))
    return _text_of_user_code(thing)


def function_in_text(function: Callable) -> str:
    """A function: of a library by the name under which it, or what is made of it, is there; another
    by what it does. Raises `Untold`."""
    if _is_trusted(function):
        name = _name_in_library(function)
        module, path = name.split(":")
        resolved: Any = sys.modules.get(module)
        for part in path.split("."):
            resolved = getattr(resolved, part, None)
        if resolved is function or getattr(resolved, "__wrapped__", None) is function:
            return name
    return _text_of_user_code(function)


def _name_in_library(thing: Any) -> str:
    """The name of a class or function of a library; what one of a user does. Raises `Untold`."""
    if _is_trusted(thing):
        return f"{thing.__module__}:{thing.__qualname__}"
    return _text_of_user_code(thing)


def _is_trusted(thing: Any) -> bool:
    """Whether a class or function of a library is found by its name."""
    module, name = getattr(thing, "__module__", None), getattr(thing, "__qualname__", "<")
    return isinstance(module, str) and module.partition(".")[0] in TRUSTED and "<" not in name


def _text_of_user_code(thing: Any) -> str:
    """A thing that is a user's by what it does and holds. Raises `Untold` where that may hang on
    what no text shows."""
    description = Description()
    description.add(thing, "")
    if hidden := description.opaque | (description.names & READING):
        raise Untold(f"{type(thing).__name__}: {', '.join(sorted(hidden))}")
    return f"{sorted(description.texts.items())}{_installed_distributions()}"


@functools.cache
def _installed_distributions() -> list[str]:
    """What is installed, with versions: the names of folders that tell them."""
    return sorted(path.name for folder in FOLDERS for path in folder.glob("*.dist-info"))


def _array_text(values: np.ndarray) -> str:
    if values.dtype == object:
        raise Untold("an array of things")
    digest = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
    return f"array{values.shape}{values.dtype}{digest}"


def environment_of_program() -> str:
    """All beside its arguments that a program hangs on: versions, the processor, settings. Raises
    `Untold` where this package is not what its files say."""
    if not source_check.is_unmodified():
        raise Untold("a package that was changed in this process")
    environment = {name: value for name, value in os.environ.items() if name.startswith(VARIABLES)}
    settings: Any = jax.config
    names = [name for name in sorted(settings.values) if not any(part in name for part in IGNORED)]
    setting_values = [(name, str(getattr(settings, name, settings.values[name]))) for name in names]
    return f"{_environment_text()}{sorted(environment.items())}{setting_values}"


@functools.cache
def _environment_text() -> str:
    """Versions, the processor, and what stands in this package's files: one that is being worked on
    changes within a version."""
    versions = [(name, version(name)) for name in LIBRARIES]
    files = _files(Path(__file__).parents[1])
    return f"{versions}{platform.python_version()}{object_code.processor()}{files}"


def _files(root: Path) -> str:
    """A digest of all files of a package. Raises `Untold` where one is younger than this process:
    another may have been read before."""
    digest = hashlib.sha256()
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.ll")]):
        status, content = path.stat(), path.read_bytes()
        # A copy may carry an older date; when it came here is told beside it.
        if max(status.st_mtime, status.st_ctime) > source_check.UNCHANGED_SINCE:
            raise Untold(f"{path}, edited since it was read")
        digest.update(f"{path.relative_to(root)} {len(content)} ".encode() + content)
    return digest.hexdigest()
