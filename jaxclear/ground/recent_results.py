"""What was found lately, by what was asked: a loop that calls `simulate` asks the same again and
again."""

import functools
import threading
from typing import Any, Generic, TypeVar

import jax
import numpy as np

Value = TypeVar("Value")
# Numbers of Python and NumPy, beside JAX's: what is told apart by type, shape and bytes.
NUMBERS = (bool, int, float, complex, np.generic, np.ndarray)


class Key:
    """What is asked: trees are alike whose structure is the same and whose numbers are,
    bit for bit. Their functions are those of Python's, by identity."""

    def __init__(self, *arguments: Any):
        self.arguments = arguments
        self.leaves: list[Any]
        self.structure: Any
        self.leaves, self.structure = jax.tree.flatten(arguments)

    @functools.cached_property
    def key(self) -> tuple:
        """All of it; of numbers that are being traced there is none."""
        return (self.structure, *map(_hashable_leaf, self.leaves))

    @functools.cached_property
    def hash(self) -> int:
        """Looked up several times in each call."""
        return hash(self.key)

    def __hash__(self) -> int:
        return self.hash

    def __eq__(self, other: Any) -> bool:
        return self.key == other.key


def _hashable_leaf(leaf: Any) -> Any:
    if not isinstance(leaf, NUMBERS) and not isinstance(leaf, jax.Array):
        return leaf
    array = np.asarray(leaf)
    return array.dtype.char, array.shape, array.tobytes()


class Latest(Generic[Value]):
    """The answers to the questions that were asked last, as long as their sizes sum up to `most`:
    by default so many. The very last one stays however large it is; several threads may ask."""

    def __init__(self, most: float):
        self.most, self.looking = most, threading.Lock()
        self.entries: dict[Any, tuple[Value, float]] = {}

    def get(self, key: Any) -> Value | None:
        with self.looking:
            # One comparison of keys, which are large.
            entry = self.entries.pop(key, None)
            if entry is None:
                return None
            self.entries[key] = entry
            return entry[0]

    def keep(self, key: Any, value: Value, size: float = 1.0) -> None:
        with self.looking:
            self.entries[key] = value, size
            while len(self.entries) > 1 and sum(s for _, s in self.entries.values()) > self.most:
                del self.entries[next(iter(self.entries))]
