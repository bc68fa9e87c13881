"""How a refusal is worded: what was given, what there is instead, and which name was probably
meant.
"""

import difflib
import functools
import sys
from collections.abc import Iterable
from types import ModuleType
from typing import Any

# Longest text of a value in a sentence, and the most names that one lists.
LONGEST, MOST_NAMES = 60, 16
# Share of letters in common from which on a name counts as a slip of the pen (difflib's own).
LEAST_SIMILARITY = 0.6


def described(value: Any) -> str:
    """What was given, in a few words: a number as it is, of anything large its kind."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, float):
        # NumPy's are floats that would tell their type.
        text = repr(float(value))
    elif value is None or isinstance(value, (str, bytes, bool, int, complex)):
        text = repr(value)
    elif isinstance(value, (list, tuple, dict, set)):
        kind = type(value).__name__
        text = ", ".join(map(described, value))
        text = f"({text})" if isinstance(value, tuple) else f"[{text}]"
        if not value:
            return f"an empty {kind}"
        if isinstance(value, (dict, set)) or len(text) > LONGEST:
            return f"a {kind} of {len(value)}"
    elif isinstance(getattr(value, "shape", None), tuple):
        if value.shape:
            return f"an array of shape {value.shape}"
        text = str(value)
    elif callable(value) and getattr(value, "__name__", None):
        return f"the function {value.__name__}"
    else:
        kind = type(value).__name__
        return f"{'an' if kind[0] in 'AEIOU' else 'a'} {kind}"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def listed(names: Iterable[Any]) -> str:
    """Names in a row, in quotes; the first of many."""
    names = list(names)
    text = ", ".join(f'"{name}"' for name in names[:MOST_NAMES])
    return f"{text} and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else text


def nearest_name(name: Any, names: Iterable[Any]) -> str:
    """The known name that is most like another, whatever its capitals; "" where none is."""
    by_small = {str(one).lower(): str(one) for one in names}
    matches = difflib.get_close_matches(str(name).lower(), by_small, 1, LEAST_SIMILARITY)
    return by_small[matches[0]] if matches else ""


def meant(name: Any, names: Iterable[Any]) -> str:
    """A question, to be put behind a sentence, for the known name that is most like another; ""
    where none is."""
    close = nearest_name(name, names)
    return f' Did you mean "{close}"?' if close else ""


def unknown(what: str, name: Any, names: Iterable[Any], where: str = "") -> str:
    """A sentence for a name that does not exist, with those that do and the nearest.

    Args:
        what: kind of thing that is named, such as "joint".
        name: as given.
        names: that exist.
        where: follows the name, such as " in this mechanism".
    """
    names = list(names)
    if not isinstance(name, str):
        named = f"one of {listed(names)}" if names else "but there is none"
        return f"{what} is {described(name)}; it must be a name (text), {named}."
    if not names:
        return f'no {what} "{name}"{where}; there is none.'
    verb = "is" if len(names) == 1 else "are"
    return f'no {what} "{name}"{where}; there {verb} {listed(names)}.{meant(name, names)}'


def public_name(kind: Any) -> str:
    """What a user types behind `jaxclear.` for a class or function, such as `contact.Hertz`; its
    own name where it is not of this package.
    """
    return _find_path_in_package(kind) or kind.__qualname__


@functools.cache
def is_offered(kind: Any) -> bool:
    """Whether users can type the path to one of the package's classes."""
    return bool(_find_path_in_package(kind))


def as_typed(path: str) -> str:
    """The dotted path of one of the package's classes as users type it; its name where they are
    offered none."""
    module, _, name = path.rpartition(".")
    offered = _find_path_in_package(getattr(sys.modules.get(module), name, path))
    return f"jaxclear.{offered}" if offered else name


def final_members(family: type) -> list[type]:
    """Final classes of a family, in the order in which they were defined."""
    members: list[type] = []
    remaining: list[type] = list(family.__subclasses__())
    while remaining:
        kind = remaining.pop(0)
        remaining += kind.__subclasses__()
        members += [] if kind.__name__.startswith("Abstract") else [kind]
    return members


def offered_like(name: str, path: str) -> str:
    """What a user types for the thing most like `name` in the module of a public path."""
    place: Any = sys.modules[__name__.partition(".")[0]]
    for part in path.split(".")[:-1]:
        place = getattr(place, part)
    match = nearest_name(name, [n for n in place.__all__ if not n.startswith("Abstract")])
    return f"{place.__name__.partition('.')[0]}.{path.rpartition('.')[0]}.{match}" if match else ""


def _find_path_in_package(kind: Any) -> str:
    """The path to a thing by the names that the package offers; "" where there is none. What it
    loads when it is first asked for is asked only for things that came later than itself."""
    package = sys.modules[__name__.partition(".")[0]]
    loaded = vars(package).get("LOADED", ())
    later = bool(loaded) and getattr(kind, "__module__", "") not in loaded
    return _offered(package, kind) or (_offered(package, kind, asking=True) if later else "")


def _offered(place: ModuleType, kind: Any, asking: bool = False) -> str:
    """The path to a thing by the names that modules offer; "" where there is none. `asking`: those
    too that a module only loads when it is asked."""
    for name in getattr(place, "__all__", ()):
        thing = getattr(place, name, None) if asking else vars(place).get(name)
        if thing is kind:
            return name
        inner = _offered(thing, kind) if isinstance(thing, ModuleType) else ""
        if inner:
            return f"{name}.{inner}"
    return ""


def unit_of_rate(above: str, below: str) -> str:
    """Unit of a derivative: "N/m", "(N m)/rad", "1/s"."""
    over, under = (f"({unit})" if set(unit) & set(" /") else unit for unit in (above, below))
    return over if under == "1" else f"{over}/{under}"
