"""Derivatives forwards where of some numbers it is known that they do not move, so that a program
need not go through zeros."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero


def pushed(function: Callable, numbers: Sequence[Any], tangents: Sequence[Any]) -> tuple[Any, Any]:
    """As `jax.jvp(function, numbers, tangents)`, where some tangents are `SymbolicZero`.

    Args:
        function: of these numbers.
        numbers: pytrees at which it is differentiated.
        tangents: of the same structure; symbolic zeros are not propagated.
    """
    leaves, structure = jax.tree.flatten(tuple(numbers))
    moves = jax.tree.leaves(tuple(tangents))
    moving = [i for i, t in enumerate(moves) if not isinstance(t, SymbolicZero)]

    def of_moving(*some):
        arguments = list(leaves)
        for i, number in zip(moving, some, strict=True):
            arguments[i] = number
        return function(*jax.tree.unflatten(structure, arguments))

    if not moving:
        out = of_moving()
        return out, jax.tree.map(jnp.zeros_like, out)
    return jax.jvp(of_moving, [leaves[i] for i in moving], [moves[i] for i in moving])


def derived(function: Callable, tangent: Callable) -> Callable:
    """A function with another's derivative: `tangent(numbers, tangents)`, where tangents of what
    does not move are `SymbolicZero`."""
    with_rule = jax.custom_jvp(function)
    with_rule.defjvp(
        lambda numbers, tangents: (function(*numbers), tangent(numbers, tangents)),
        symbolic_zeros=True,
    )
    return with_rule


def moving_with(number: Any, numbers: Any) -> Any:
    """The numbers, which move with one of a program: by what numbers depend on loops know what
    moves, and of a derivative of one's own they see but the function."""
    return jax.tree.map(lambda each: jnp.where(jnp.isnan(number), number, each), numbers)


def zeros_with(number: Any, like: Any) -> Any:
    """Zeros that move with a number of a program (`moving_with`), as a compiler sees too: they cost
    nothing."""
    never = (number > 0) & (number < 0)
    return jax.tree.map(lambda x: jnp.broadcast_to(jnp.where(never, number, 0.0), x.shape), like)


def apply_if(condition: Any, function: Callable, value: Any) -> Any:
    """`function(value)` where a condition holds, otherwise `value`.

    It is a loop of no or one turn: kernels skip it, while of a choice they evaluate both sides.

    Args:
        condition: may be traced.
        function: keeps shapes and types of the value.
        value: pytree of arrays.
    """
    turn = lambda carry: (carry[0] + 1, function(carry[1]))
    first = jnp.zeros((), int), value
    return jax.lax.while_loop(lambda carry: carry[0] < condition.astype(int), turn, first)[1]


def moved(tangent: Any) -> Any:
    """A tangent as an array."""
    zero = isinstance(tangent, SymbolicZero)
    return jnp.zeros(tangent.shape, tangent.dtype) if zero else tangent


def allow_first_derivative(sentence: str, numbers: Any) -> Any:
    """The numbers as they are, with their derivative; a second one raises `ValueError` with the
    sentence. Each by itself: what nobody asks for is dropped."""

    @jax.custom_jvp
    def differentiate_first(number):
        return number

    @jax.custom_jvp
    def refuse_second(number):
        return number

    def refuse(primals, tangents):
        if not isinstance(tangents[0], SymbolicZero):
            raise ValueError(sentence)
        return primals[0], moved(tangents[0])

    differentiate_first.defjvp(lambda primals, tangents: (primals[0], refuse_second(tangents[0])))
    refuse_second.defjvp(refuse, symbolic_zeros=True)
    return jax.tree.map(differentiate_first, numbers)
