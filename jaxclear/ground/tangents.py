"""Derivatives forwards where of some numbers it is known that they do not move, so that a program
need not go through zeros."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero


def pushed(function: Callable, numbers: Sequence[Any], tangents: Sequence[Any]) -> tuple[Any, Any]:
    """As `jax.jvp(function, numbers, tangents)`, where some of the tangents are `SymbolicZero`."""
    leaves, structure = jax.tree.flatten(tuple(numbers))
    ways = jax.tree.leaves(tuple(tangents))
    moving = [i for i, way in enumerate(ways) if not isinstance(way, SymbolicZero)]

    def of_moving(*some):
        given = list(leaves)
        for i, number in zip(moving, some, strict=True):
            given[i] = number
        return function(*jax.tree.unflatten(structure, given))

    if not moving:
        out = of_moving()
        return out, jax.tree.map(jnp.zeros_like, out)
    return jax.jvp(of_moving, [leaves[i] for i in moving], [ways[i] for i in moving])


def moved(tangent: Any) -> Any:
    """A tangent as an array."""
    zero = isinstance(tangent, SymbolicZero)
    return jnp.zeros(tangent.shape, tangent.dtype) if zero else tangent


def derived_once(sentence: str, numbers: Any) -> Any:
    """The numbers as they are, with their derivative; a second one raises `ValueError` with the
    sentence."""

    @jax.custom_jvp
    def once(numbers):
        return numbers

    @jax.custom_jvp
    def never(numbers):
        return numbers

    def refuse(given, tangents):
        if any(not isinstance(each, SymbolicZero) for each in jax.tree.leaves(tangents)):
            raise ValueError(sentence)
        return given[0], jax.tree.map(moved, tangents[0])

    once.defjvp(lambda given, tangents: (given[0], never(tangents[0])))
    never.defjvp(refuse, symbolic_zeros=True)
    return once(numbers)
