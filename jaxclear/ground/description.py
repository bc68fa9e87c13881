"""Anything in texts, one for each of its parts: two things are the same where these are, also in
another process, and where one of them lies in a folder.

A function is described by what it does and with what: its code and that of the functions in it, its
closure and defaults, and the globals that it names; a class by its members; a module of a user by
its file and those of the user's modules that it uses. What libraries bring is described by its
name: whoever keeps texts keeps the libraries' versions with them. A script and the same file
imported give the same texts.
"""

import dataclasses
import dis
import enum
import functools
import hashlib
import importlib.util
import inspect
import re
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from types import CodeType, MemberDescriptorType, ModuleType
from typing import Any

import equinox as eqx
import numpy as np

# Longest text of one piece, in characters; what is longer ends in a digest, of so many.
LONGEST, DIGITS = 60, 16
# How the text of a function begins, and what stands for a thing whose parts are described.
FUNCTION, DESCRIBED = "the function", "described"
# Functions of a class that make a thing, whose numbers are described, or show it.
WITHOUT_NUMBERS = (
    "init new post_init check_init init_subclass repr str format hash eq ne setattr delattr reduce "
    "reduce_ex getstate setstate replace annotate annotate_func getnewargs"
)
# Types whose objects show all that they are.
SHOWN: tuple[type, ...] = (type(None), bool, int, float, complex, str, bytes, set, frozenset)
SHOWN += (enum.Enum, np.generic, np.dtype)
WORD = re.compile(rb"[A-Za-z_]\w*")
# Where in memory a thing lies is no part of what it is.
ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")
# Where libraries lie.
LIBRARIES = tuple(
    Path(sysconfig.get_paths()[kind]) for kind in ("stdlib", "platstdlib", "purelib", "platlib")
)


def describe(things: Iterable[tuple[str, Any]]) -> dict[str, str]:
    """Texts of things, each by the path that it is given, and of all their parts."""
    description = Description()
    for path, thing in things:
        description.add(thing, path)
    return description.texts


class Description:
    """Texts of things by path; `names`: what the user's code in them names, and `opaque`: types of
    objects of which a text shows no content."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.names: set[str] = set()
        self.opaque: set[str] = set()
        # Globals and classes by the path at which they are described, which several functions may
        # use and which may use one another.
        self.described: dict[str, Any] = {}

    def add(self, thing: Any, path: str, ancestors: tuple[int, ...] = ()) -> None:
        """Adds the texts of a thing and of its parts.

        Args:
            thing: any object.
            path: name of the thing among all parts.
            ancestors: identities of the things whose part it is, which end recursion.
        """
        if id(thing) in ancestors:
            self.texts[path] = "what it is a part of"
            return
        ancestors = (*ancestors, id(thing))
        parts: dict[str, Any] = {}
        if eqx.is_array(thing) or isinstance(thing, np.ndarray):
            self.texts[path] = _array_text(np.asarray(thing))
        elif isinstance(thing, ModuleType):
            self.texts[path] = self._module_text(thing)
        elif isinstance(thing, type):
            self.texts[path] = f"the class {self._add_class(thing, ancestors)}"
        elif _is_library_function(thing):
            self.texts[path] = f"{FUNCTION} {thing.__module__}.{thing.__qualname__}"
        elif (function := _underlying_function(thing)) is not None:
            code = _digest(_code_text(function.__code__).encode())
            self.texts[path] = f"{FUNCTION} {function.__name__} {code}"
            parts = _referenced_values(function)
            if function is not thing:
                # What makes it another function, as derivatives of one's own.
                parts |= {n: x for n, x in _attributes_of(thing).items() if callable(x)}
            if not _is_library(scope := function.__globals__.get("__name__", "")):
                self.names |= _used_names(function.__code__)
                for name in sorted(_global_names(function.__code__) & set(function.__globals__)):
                    self._add_global(f"{_module_name(scope)}.{name}", function.__globals__[name])
        elif (items := _parts_of(thing)) is not None:
            # Of a library's dictionary its names say all, whatever its class.
            by_library = isinstance(thing, dict) and _is_library(type(thing).__module__)
            self.texts[path] = self._add_class(dict if by_library else type(thing), ancestors)
            parts = items if dataclasses.is_dataclass(thing) else items | _attributes_of(thing)
        else:
            # Of a user's class by its attributes and what the class does, of a library's by how it
            # shows itself, or by its attributes where that says nothing.
            value = sorted(map(repr, thing)) if isinstance(thing, (set, frozenset)) else thing
            text, attributes = repr(value), _attributes_of(thing)
            if not _is_library(type(thing).__module__) or (ADDRESS.search(text) and attributes):
                self.texts[path], parts = self._add_class(type(thing), ancestors), attributes
            else:
                self.texts[path] = _shorten(ADDRESS.sub("", text))
                if not (callable(thing) or type(thing) is object or isinstance(thing, SHOWN)):
                    self.opaque.add(type(thing).__name__)
        for name, part in parts.items():
            self.add(part, f"{path}{name}", ancestors)

    def _module_text(self, module: ModuleType) -> str:
        """A library by its name; a user's own module with a digest of its file, and of those of
        the user's modules that it uses."""
        texts, unread = dict[str, str](), [module]
        while unread:
            current = unread.pop()
            if current.__name__ in texts or _is_library(current.__name__):
                continue
            file = getattr(current, "__file__", None)
            content = Path(file).read_bytes() if file is not None and Path(file).is_file() else b""
            texts[current.__name__] = _digest(content) if content else ""
            self.names |= {word.decode() for word in WORD.findall(content)}
            for member in list(vars(current).values()):
                name = getattr(member, "__module__", None)
                used = sys.modules.get(name) if isinstance(name, str) else member
                unread += [used] if isinstance(used, ModuleType) else []
        whole = texts.pop(module.__name__, "")
        if texts:
            whole = _digest(f"{whole}{sorted(texts.items())}".encode())
        return f"the module {module.__name__} {whole}".rstrip()

    def _new_path(self, path: str, thing: Any) -> str:
        """The path of a thing that is described here for the first time; "" of another. Two modules
        of one name may have different things of one name."""
        while path in self.described:
            if self.described[path] is thing:
                return ""
            path += "'"
        self.described[path], self.texts[path] = thing, DESCRIBED
        return path

    def _add_global(self, path: str, thing: Any) -> None:
        if path := self._new_path(path, thing):
            self.add(thing, path)

    def _add_class(self, kind: type, ancestors: tuple[int, ...]) -> str:
        """The name of a class; what the functions of one that no library brings do, and with which
        values of the class, is described once."""
        for owner in kind.__mro__:
            if _is_library(owner.__module__):
                continue
            path = f"class {_module_name(owner.__module__)}.{owner.__qualname__}"
            if not (path := self._new_path(path, owner)):
                continue
            for name in vars(owner):
                member = inspect.getattr_static(owner, name)
                if isinstance(member, property):
                    member = member.fget
                elif isinstance(member, functools.cached_property):
                    member = member.func
                else:
                    member = getattr(owner, name, None)
                special = name.startswith("__") and name.endswith("__")
                if _underlying_function(member) is not None:
                    if name.strip("_") not in WITHOUT_NUMBERS.split() or not special:
                        self.add(member, f"{path}.{name}", ancestors)
                elif not (special or inspect.isdatadescriptor(member) or _is_field(owner, name)):
                    self.add(member, f"{path}.{name}", ancestors)
        return kind.__name__


def _parts_of(thing: Any) -> dict[str, Any] | None:
    """What a thing consists of, each by what follows its own path; None for what is one piece."""
    if dataclasses.is_dataclass(thing):
        return {f".{f.name}": getattr(thing, f.name) for f in dataclasses.fields(thing)}
    if isinstance(thing, dict):
        return {f'["{key}"]': value for key, value in thing.items()}
    if isinstance(thing, (tuple, list)):
        return {f"[{i}]": value for i, value in enumerate(thing)}
    if isinstance(thing, functools.partial):
        return {".function": thing.func, ".given": thing.args, ".named": thing.keywords}
    return None


def _attributes_of(thing: Any) -> dict[str, Any]:
    """What a thing holds, in slots too, each by what follows its own path."""
    attributes = dict(getattr(thing, "__dict__", {}))
    for owner in type(thing).__mro__:
        slots = (n for n, member in vars(owner).items() if isinstance(member, MemberDescriptorType))
        # A slot that has no value counts as None.
        attributes |= {name: getattr(thing, name, None) for name in slots}
    # What wraps a function has its module's name, a partial function an address.
    special = ("__module__", "__vectorcalloffset__")
    return {f".{name}": value for name, value in attributes.items() if name not in special}


def _is_field(kind: type, name: str) -> bool:
    """Whether a class's value is what a field has by default, or describes fields: its things have
    their own."""
    of_fields = name in ("_fields", "_field_defaults", "_abc_impl") or (
        name.startswith("_") and name[-1] == "_"
    )
    return of_fields or name in getattr(kind, "__dataclass_fields__", {})


def _underlying_function(thing: Any) -> Any:
    """The function that was written, of what a library has made of it without code of its own, as
    `jax.jit` does, too; else None."""
    if not callable(thing) or isinstance(thing, type):
        return None
    while getattr(thing, "__code__", None) is None and _is_library(type(thing).__module__):
        if (inner := getattr(thing, "__wrapped__", None)) is None:
            return None
        thing = inner
    return thing if getattr(thing, "__code__", None) is not None else None


def _is_library_function(thing: Any) -> bool:
    """Whether a library has a function, or what is made of one, under its name."""
    module, path = getattr(thing, "__module__", None), getattr(thing, "__qualname__", None)
    if not callable(thing) or not isinstance(module, str) or not isinstance(path, str):
        return False
    resolved: Any = sys.modules.get(module)
    for part in path.split("."):
        resolved = getattr(resolved, part, None)
    return resolved is thing and _is_library(module)


def _referenced_values(function: Any) -> dict[str, Any]:
    """What a function is bound to, holds and has by default, by what follows its path."""
    references = {" of": function.__self__} if inspect.ismethod(function) else {}
    for i, cell in enumerate(function.__closure__ or ()):
        try:
            references[f" holds [{i}]"] = cell.cell_contents
        except ValueError:
            # Empty until the name that it stands for has a value.
            references[f" holds [{i}]"] = None
    references |= {f" by default [{i}]": x for i, x in enumerate(function.__defaults__ or ())}
    return references | {f" by default {n}": x for n, x in (function.__kwdefaults__ or {}).items()}


def _code_text(code: CodeType) -> str:
    """What a code does, without where it was written; of the functions in it, too."""
    constants = []
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            constants.append(_code_text(constant))
        elif isinstance(constant, frozenset):
            constants.append(repr(sorted(map(repr, constant))))
        else:
            constants.append(repr(constant))
    return repr((code.co_code, constants, code.co_names, code.co_varnames))


def _global_names(code: CodeType) -> set[str]:
    """The names by which a code, and the functions in it, reach globals."""
    steps = dis.get_instructions(code)
    names = {step.argval for step in steps if step.opname.startswith("LOAD_GLOBAL")}
    return names.union(*(_global_names(c) for c in code.co_consts if isinstance(c, CodeType)))


def _used_names(code: CodeType) -> set[str]:
    """The names that a code, and the functions in it, use of globals, attributes and modules."""
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*map(_used_names, inner))


@functools.cache
def _is_library(module: str) -> bool:
    """Whether a module is jaxclear's, Python's, or of an installed library."""
    top = module.partition(".")[0]
    if top in ("jaxclear", "builtins", "__main__"):
        return top != "__main__"
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return False
    if spec is None or spec.origin is None:
        return False
    places = Path(spec.origin).parents
    return spec.origin in ("built-in", "frozen") or any(place in places for place in LIBRARIES)


def _module_name(module: str) -> str:
    """The name of a user's module, without its packages; of a script, that which it has where it is
    imported."""
    main = sys.modules.get(module)
    if module == "__main__" and main is not None:
        spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
        module = spec.name if spec is not None else Path(file).stem if file else module
    return module.rpartition(".")[2]


def _array_text(values: np.ndarray) -> str:
    if values.ndim == 0:
        return repr(values.item())
    if values.dtype == object:
        return _shorten(ADDRESS.sub("", repr(values.tolist())))
    return f"an array {values.shape} {values.dtype} {_digest(np.ascontiguousarray(values))}"


def _shorten(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}... {_digest(text.encode())}"


def _digest(content: Any) -> str:
    return hashlib.sha256(content).hexdigest()[:DIGITS]
