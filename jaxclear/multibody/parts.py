"""Named parts of a built mechanism, read-only: the tree and all checks are of the time of building,
so what was put in later would be printed and not move.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

import jax

__all__ = ["Parts"]


class Parts(dict):
    """A dictionary of a built mechanism, in the order of its names, that cannot be changed in
    place. `|` and `copy` give a plain dictionary to build another mechanism from.

    A node of a pytree; unlike JAX's own for dictionaries it keeps its names in their order. Raises
    `TypeError` with a sentence where it is to be changed.
    """

    def _refused(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError(
            "a built Mechanism is read-only: what is changed in it now would not be checked, and "
            "its motion would not follow. Build another: mechanism.with_joint(name, joint), "
            "mechanism.with_body(name, body), mechanism.with_load(name, load), "
            "mechanism.with_coupling(name, coupling) (None takes a load or a coupling out), or "
            "jaxclear.Mechanism(mechanism.bodies, mechanism.connections, mechanism.loads, "
            "couplings=mechanism.couplings, **mechanism.given | {'start': ...})."
        )

    __setitem__ = __delitem__ = __ior__ = _refused
    update = setdefault = pop = popitem = clear = _refused

    def __or__(self, other: Any) -> Any:
        return dict(self) | dict(other) if isinstance(other, Mapping) else NotImplemented

    def __ror__(self, other: Any) -> Any:
        return dict(other) | dict(self) if isinstance(other, Mapping) else NotImplemented

    def copy(self) -> dict[str, Any]:
        return dict(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return Parts, (dict(self),)


def _unflattened(names: tuple[str, ...], parts: Iterable[Any]) -> Parts:
    return Parts(zip(names, parts, strict=True))


def _flattened(parts: Parts) -> tuple[list[Any], tuple[str, ...]]:
    return list(parts.values()), tuple(parts)


def _flattened_with_names(parts: Parts) -> tuple[list[tuple[Any, Any]], tuple[str, ...]]:
    return [(jax.tree_util.DictKey(name), part) for name, part in parts.items()], tuple(parts)


jax.tree_util.register_pytree_with_keys(Parts, _flattened_with_names, _unflattened, _flattened)
