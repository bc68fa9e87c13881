"""What answers to a name that there is not: a class or function called with a wrong argument, a
module asked for what it does not offer.

Python's own errors name neither what there is nor what was probably meant. Nothing here costs a
call that is right.
"""

import functools
import importlib.util
import inspect
import re
from collections.abc import Callable
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import equinox as eqx

from jaxclear.ground.wording import as_typed, described, final_members, listed, meant, public_name

if TYPE_CHECKING:
    from equinox._module._module import _ModuleMeta as ModuleMeta
else:
    ModuleMeta = type(eqx.Module)

P, R = ParamSpec("P"), TypeVar("R")
PACKAGE_PATH = re.compile(r"\bjaxclear(\.\w+)+")
# An entry of `Args:`: names, and the description up to the unit, the range or the default.
ARGUMENT = re.compile(
    r"^ {4}((?:\w+, )*\w+): (.*?)(?: \[|, [<>]=? |, a count|; |\.(?:\s|\Z))",
    re.MULTILINE | re.DOTALL,
)
KEYWORDS = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
ORDERED = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


class PublicMeta(ModuleMeta):
    """Of classes of which `help` shows what users call, by the names that they type."""

    def __dir__(cls) -> list[str]:
        return [name for name in ModuleMeta.__dir__(cls) if not name.startswith("__")]

    @property
    def __signature__(cls) -> inspect.Signature:
        return _with_offered_types(ModuleMeta.__signature__.fget(cls))  # type: ignore[attr-defined]


class AnsweringMeta(PublicMeta):
    """Of classes that refuse wrong arguments with a sentence."""

    def __new__(mcs, name: str, bases: tuple, namespace: dict, **kwargs: Any):
        check = namespace.get("__check_init__")
        if check is not None and any(isinstance(base, AnsweringMeta) for base in bases):
            namespace = namespace | {"__check_init__": _check_after_fields(check)}
        kind = ModuleMeta.__new__(mcs, name, bases, namespace, **kwargs)
        _describe_fields(kind)
        return kind

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        if cls.__name__.startswith("Abstract"):
            members = [public_name(kind) for kind in final_members(cls)[:1]]
            raise TypeError(
                f"{public_name(cls)} is what a family has in common and cannot be built; it needs "
                f"a class of its own{''.join(f', such as {one}' for one in members)}."
            )
        try:
            return ModuleMeta.__call__(cls, *args, **kwargs)
        except TypeError:
            sentence = _describe_incomplete(cls) or _describe_misfit(cls, args, kwargs)
            if sentence:
                raise TypeError(sentence) from None
            raise


def _describe_incomplete(cls: Any) -> str:
    """What a class of a user leaves undefined of the family that it derives from; "" where nothing
    is."""
    kinds = ("__abstractmethods__", "__abstractvars__", "__abstractclassvars__")
    missing = {name for kind in kinds for name in getattr(cls, kind, ())}
    if not missing:
        return ""
    base = next(kind for kind in cls.__mro__[1:] if kind.__name__.startswith("Abstract"))
    return (
        f"{cls.__name__} leaves {listed(sorted(missing))} of {public_name(base)} undefined: define "
        f"them, or derive it from a base that does (help({public_name(base)}))."
    )


def _describe_fields(kind: Any) -> None:
    """Takes the meaning of a class's numbers from `Args:` of its docstring, up to the unit."""
    section = inspect.cleandoc(vars(kind).get("__doc__") or "").partition("\n\nArgs:\n")[2]
    for names, meaning in ARGUMENT.findall(section.partition("\n\n")[0]):
        for name in names.split(", "):
            field = kind.__dataclass_fields__.get(name)
            if field is not None and field.metadata.get("meaning") == "":
                words = {"meaning": " ".join(meaning.split())}
                field.metadata = MappingProxyType({**field.metadata, **words})


def _check_after_fields(class_check: Callable[[Any], None]) -> Callable[[Any], None]:
    """A class's own check, which may take for granted that every field holds what it may."""

    @functools.wraps(class_check)
    def check(self: Any) -> None:
        # Of the class: binding a method to a module costs more than the check.
        type(self)._check_fields(self)
        class_check(self)

    return check


def answering(function: Callable[P, R]) -> Callable[P, R]:
    """The function, which answers wrong arguments with a sentence."""

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except TypeError:
            sentence = _describe_misfit(function, args, kwargs)
            if sentence:
                raise TypeError(sentence) from None
            raise

    signature = _with_offered_types(inspect.signature(function))
    called.__signature__ = signature  # type: ignore[attr-defined]
    return called


def _with_offered_types(signature: inspect.Signature) -> inspect.Signature:
    """A signature whose types have the names that users type."""
    declared = signature.parameters.values()
    parameters = [p.replace(annotation=_with_public_name(p.annotation)) for p in declared]
    returned = _with_public_name(signature.return_annotation)
    return signature.replace(parameters=parameters, return_annotation=returned)


class _Offered:
    """A type that `help` tells by the names that users type."""

    def __init__(self, kind: Any):
        self.kind = kind

    def __repr__(self) -> str:
        annotation = inspect.formatannotation(self.kind)
        return PACKAGE_PATH.sub(lambda match: as_typed(match[0]), annotation)


def _with_public_name(kind: Any) -> Any:
    return _Offered(kind) if PACKAGE_PATH.search(inspect.formatannotation(kind)) else kind


def refuse_misfit(called: Callable, args: tuple, kwargs: dict) -> None:
    """Raises `TypeError` with a sentence where arguments do not fit a function or class.

    Args:
        called: function or class.
        args: arguments by position.
        kwargs: arguments by name.
    """
    sentence = _describe_misfit(called, args, kwargs)
    if sentence:
        raise TypeError(sentence)


def _describe_misfit(called: Callable, args: tuple, kwargs: dict) -> str:
    """Why these arguments do not fit a function's signature; "" where they do."""
    signature = inspect.signature(called)
    try:
        signature.bind(*args, **kwargs)
    except TypeError:
        pass
    else:
        return ""
    name, parameters = public_name(called), signature.parameters
    names = [p.name for p in parameters.values() if p.kind in KEYWORDS]
    takes = f"{name} takes {listed(names)}" if names else f"{name} takes no arguments"
    for keyword in kwargs:
        if keyword not in names:
            return f'{name} has no argument "{keyword}"; {takes}.{meant(keyword, names)}'
    ordered = [p.name for p in parameters.values() if p.kind in ORDERED]
    if len(args) > len(ordered):
        surplus = described(args[len(ordered)])
        available = [one for one in names if one not in {*ordered, *kwargs}]
        if not available:
            return f"{name} is given {surplus} too; {takes} and nothing else."
        return f"{name} is given {surplus} without a name; give it as one of {listed(available)}."
    twice = set(ordered[: len(args)]) & set(kwargs)
    if twice:
        return f"{name} is given {listed(sorted(twice))} twice, by place and by name; give it once."
    needed = [p.name for p in parameters.values() if p.default is p.empty and p.kind in KEYWORDS]
    missing = [one for one in needed if one not in {*ordered[: len(args)], *kwargs}]
    return f"{name} needs {listed(missing)}; {takes}."


def imported_names(namespace: dict[str, Any], *further: str) -> list[str]:
    """What a package offers: the classes and functions of jaxclear that its `__init__` imports, and
    `further` names."""
    return sorted(
        name
        for name, value in namespace.items()
        if (
            getattr(value, "__module__", "").startswith("jaxclear.")
            and value not in (imported_names, nothing_else)
        )
        or name in further
    )


def defined_names(namespace: dict[str, Any], *further: str) -> list[str]:
    """What a module offers: the public classes and functions that it defines, and `further`."""
    here = namespace["__name__"]
    names = (n for n, value in namespace.items() if getattr(value, "__module__", "") == here)
    return sorted({*(name for name in names if not name.startswith("_")), *further})


def nothing_else(
    module: str, offered: list[str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a module: for any name beyond those offered, a sentence;
    what completes a name that is being typed shows these alone."""

    def refuse(name: str) -> Any:
        path = f"{module} has no {name!r}"
        if name.startswith("__"):
            raise AttributeError(f"{path}.")
        if importlib.util.find_spec(f"{module.partition('.')[0]}.{name}") is not None:
            raise AttributeError(f"{path} yet: write `from {module} import {name}` first.")
        members = [one for one in offered if not one.startswith("Abstract")]
        raise AttributeError(f"{path}; it offers {', '.join(members)}.{meant(name, offered)}")

    def list_names() -> list[str]:
        return sorted(offered)

    return refuse, list_names
