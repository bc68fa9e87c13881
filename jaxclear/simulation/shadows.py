"""What a turn leaves to a shadow, a turn of a window, that goes on from it: kept in memory. Windows
are few, and what is carried along costs the steps of every turn its registers.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from jaxclear.native import while_loop

# Longer arrays stand in memory, where a loop's writer calls them long (`native.while_loop`).
LONG = 65


def in_memory(numbers: Any) -> tuple[Array, Callable]:
    """(these numbers as an array that stands in memory, how they are had from it)."""
    leaves, structure = jax.tree.flatten(jax.lax.stop_gradient(numbers))
    flat, begins = ravel_pytree(leaves)[0], _begins(leaves)

    def read(array, begin, leaf):
        entries = [jax.lax.dynamic_slice(array, (begin + k,), (1,))[0] for k in range(leaf.size)]
        found = jnp.stack(entries) if entries else jnp.zeros(0)
        return found.reshape(leaf.shape).astype(leaf.dtype)

    def unpacked(array):
        return structure.unflatten(
            read(array, *place) for place in zip(begins, leaves, strict=True)
        )

    return jnp.pad(flat.astype(float), (0, max(LONG - len(flat), 0))), unpacked


def where_shadows_go_on(follows: Any, shadow: Array, unpacked: Callable, now: tuple) -> tuple:
    """(state, warm start, outcome) with which a turn begins: those of `now`, or from memory where
    it `follows` another as a shadow."""
    # A loop of one turn or none is a branch.
    read = lambda of: (jnp.zeros((), bool), *unpacked(shadow))
    return while_loop(lambda of: of[0], read, (follows, *now))[1:]


def kept_of_shadows(followed: Any, shadow: Array, end: tuple) -> Array:
    """Memory with the `end` of a turn, where a shadow goes on from it: it is `followed`."""
    leaves = jax.tree.leaves(jax.lax.stop_gradient(end))

    def write(of):
        array = of[1]
        for begin, leaf in zip(_begins(leaves), leaves, strict=True):
            array = jax.lax.dynamic_update_slice(array, leaf.ravel().astype(float), (begin,))
        return jnp.zeros((), bool), array

    return while_loop(lambda of: of[0], write, (followed, shadow), (False, True))[1]


def _begins(leaves: list) -> list[int]:
    """Where the numbers of each leaf begin. Each is read and written by itself: all of them at
    once would be a long array, which a loop's writer has no registers for."""
    return [sum(leaf.size for leaf in leaves[:k]) for k in range(len(leaves))]
