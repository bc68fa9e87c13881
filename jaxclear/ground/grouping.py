"""Like pieces are traced once and mapped over, however they are named.

Two calls are alike when the trees of their arguments have the same shape, static fields and
structural zeros. A group of alike calls becomes one `vmap`; small groups are unrolled, because a
few fused scalars are cheaper than a short axis.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

__all__ = ["SMALLEST_GROUP", "map_alike", "signature"]

# From this many alike pieces on, one mapped trace beats repeated ones in compile time.
SMALLEST_GROUP = 4


def signature(tree: Any) -> tuple:
    """Hashable description of a tree: structure, structural integers, functions, and shapes and
    types of arrays.
    """
    leaves, structure = jax.tree.flatten(tree)
    kinds = tuple(
        leaf if _is_structure(leaf) else (jnp.shape(leaf), str(jnp.result_type(leaf)))
        for leaf in leaves
    )
    return structure, kinds


def _is_structure(leaf: Any) -> bool:
    """What stands in a program as it is, and cannot vary within a group."""
    return isinstance(leaf, int) or callable(leaf)


def map_alike(function: Callable, calls: Sequence[tuple], smallest: int = SMALLEST_GROUP) -> list:
    """[function(*arguments) for arguments in calls], with alike calls mapped together.

    The function must be pure; its result may contain structural integers, which must not depend on
    array values.
    """
    groups: dict[tuple, list[int]] = {}
    for index, arguments in enumerate(calls):
        groups.setdefault(signature(arguments), []).append(index)
    results: list = [None] * len(calls)
    for members in groups.values():
        if len(members) < smallest:
            for index in members:
                results[index] = function(*calls[index])
        else:
            for index, result in zip(
                members, _mapped(function, [calls[index] for index in members]), strict=True
            ):
                results[index] = result
    return results


def _mapped(function, calls):
    leaves, structure = jax.tree.flatten(calls[0])
    varying = [position for position, leaf in enumerate(leaves) if not _is_structure(leaf)]
    all_leaves = [jax.tree.leaves(call) for call in calls]
    stacked = [jnp.stack([other[position] for other in all_leaves]) for position in varying]
    template: dict[str, Any] = {}

    def one(arrays):
        filled = list(leaves)
        for position, array in zip(varying, arrays, strict=True):
            filled[position] = array
        out_leaves, template["structure"] = jax.tree.flatten(
            function(*jax.tree.unflatten(structure, filled))
        )
        template["leaves"] = [leaf if isinstance(leaf, int) else None for leaf in out_leaves]
        return [leaf for leaf in out_leaves if not isinstance(leaf, int)]

    mapped = jax.vmap(one)(stacked)
    for index in range(len(calls)):
        arrays = iter([array[index] for array in mapped])
        filled = [next(arrays) if leaf is None else leaf for leaf in template["leaves"]]
        yield jax.tree.unflatten(template["structure"], filled)
