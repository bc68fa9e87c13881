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
    flat, unpacked = ravel_pytree(jax.lax.stop_gradient(numbers))
    count = len(flat)
    rest = max(LONG - count, 0)
    read = lambda array: [jax.lax.dynamic_slice(array, (k,), (1,))[0] for k in range(count)]
    return jnp.pad(flat, (0, rest)), lambda array: unpacked(jnp.stack(read(array)))


def where_shadows_go_on(follows: Any, shadow: Array, unpacked: Callable, now: tuple) -> tuple:
    """(state, warm start, outcome) with which a turn begins: those of `now`, or from memory where
    it `follows` another as a shadow."""
    # A loop of one turn or none is a branch.
    read = lambda of: (jnp.zeros((), bool), *unpacked(shadow))
    return while_loop(lambda of: of[0], read, (follows, *now))[1:]


def kept_of_shadows(followed: Any, shadow: Array, end: tuple) -> Array:
    """Memory with the `end` of a turn, where a shadow goes on from it: it is `followed`."""
    flat = ravel_pytree(jax.lax.stop_gradient(end))[0]
    write = lambda of: (jnp.zeros((), bool), jax.lax.dynamic_update_slice(of[1], flat, (0,)))
    return while_loop(lambda of: of[0], write, (followed, shadow), (False, True))[1]
