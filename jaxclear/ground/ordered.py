"""Dictionaries that are nodes of a pytree in the order of their names: JAX sorts the keys of others
where it takes a tree apart, and lists that follow that order, such as what a state holds of each
joint, would be those of others."""

from collections.abc import Iterable
from typing import Any

import jax


class Ordered(dict):
    """A dictionary that is a node of a pytree in the order of its names, as its subclasses are."""

    def __init_subclass__(cls, **kwargs: Any):
        _register_pytree(cls)


def _register_pytree(kind: type[Ordered]) -> None:
    def unflatten(names: tuple[str, ...], parts: Iterable[Any]) -> Ordered:
        return kind(zip(names, parts, strict=True))

    def flatten(parts: Ordered) -> tuple[list[Any], tuple[str, ...]]:
        return list(dict.values(parts)), tuple(parts)

    def flatten_with_names(parts: Ordered) -> tuple[list[tuple[Any, Any]], tuple[str, ...]]:
        return [(jax.tree_util.DictKey(name), x) for name, x in dict.items(parts)], tuple(parts)

    jax.tree_util.register_pytree_with_keys(kind, flatten_with_names, unflatten, flatten)


_register_pytree(Ordered)
