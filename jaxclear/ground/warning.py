"""Warnings stand at the user's line: that which built or called something, however deep in the
package its cause is found.
"""

import sys
import warnings

__all__ = ["warn"]

# Packages whose frames lie between a user's line and the cause of a warning.
BETWEEN = ("jaxclear", "equinox", "jax", "jaxtyping", "contextlib", "functools")


def warn(sentence: str, kind: type[Warning] = UserWarning) -> None:
    """A warning at the nearest line outside the package."""
    level, frame = 1, sys._getframe(0)
    while frame.f_back is not None and _is_between(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, kind, stacklevel=level)


def _is_between(module: str) -> bool:
    return module.partition(".")[0] in BETWEEN
