"""Whether this package still is as its files say: programs are found on disk by the names of its
functions, which tell all only then.

A process may have put a function of its own, or another number, in the place of one of the
package's; and files may have been edited since they were read.
"""

import sys
from collections.abc import Iterator
from operator import is_not
from typing import Any

PACKAGE = __name__.partition(".")[0]
# What has been the same since then [s since 1970] is what was read, or will be: the package's files
# are read later. Clocks of file systems tick, some every 10 ms.
UNCHANGED_SINCE = vars(sys.modules[PACKAGE])["_READ_AFTER"] - 0.1


# By module or class its names, and the things that they stood for when it was first seen: kept, so
# that nothing else comes to stand at their places in memory.
_CONTENTS: dict[Any, tuple[Any, list[Any]]] = {}


def remember() -> None:
    """What there is of this package by now counts as what its files say."""
    for space in _modules_and_classes():
        if space not in _CONTENTS:
            _CONTENTS[space] = vars(space), list(vars(space).values())


def is_unmodified() -> bool:
    """Whether all that is remembered is still the same."""
    remember()
    return not any(_is_changed(space, *recorded) for space, recorded in _CONTENTS.items())


def _modules_and_classes() -> Iterator[Any]:
    """Modules of this package and their classes."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == PACKAGE and module is not None:
            yield module
            members = list(vars(module).values())
            yield from (one for one in members if isinstance(one, type) and one.__module__ == name)


def _is_changed(space: Any, names: Any, things: list[Any]) -> bool:
    now = list(names.values())
    if len(now) < len(things) or any(map(is_not, now, things)):
        return True
    # What comes later stands at the end: a module's parts, and nothing of a class but Python's own.
    added = list(names)[len(things) :] if isinstance(space, type) else []
    return any(not name.startswith("__") or callable(names[name]) for name in added)
