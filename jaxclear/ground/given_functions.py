"""What functions answer that a user has given: a response, a place, a load, a drive. One that
leaves JAX or fails is refused in a sentence that names what it is of, and the line.
"""

from collections.abc import Callable
from typing import Any

import jax

from jaxclear.ground.warning import users_line

__all__ = ["asked", "shape_of"]

# What JAX raises where Python, or NumPy, wants the value of what is being traced.
UNTRACEABLE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)
IN_JAX = (
    "Leave float() and int() out; write jax.numpy.sqrt for math.sqrt or numpy.sqrt (and so on), "
    "jax.numpy.where for `if`, and jax.lax.while_loop for `while`."
)


def asked(what: str, function: Callable, *given: Any, wanted: str = "") -> Any:
    """What a function answers. Raises `ValueError`, with a sentence that begins with `what`, where
    it leaves JAX or fails; `wanted`: what is asked of it, a sentence."""
    try:
        return function(*given)
    except UNTRACEABLE as error:
        raise ValueError(
            f"{what} leaves JAX {users_line(error)}: it is compiled before any number is known. "
            f"{IN_JAX}"
        ) from error
    except Exception as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        failed = f"{what} fails {users_line(error)}".rstrip()
        said = f"{kind}{error}".partition("\n")[0]
        told = f"{said.rstrip('.')}. {wanted}" if wanted else said
        raise ValueError(f"{failed}: {told}") from error


def shape_of(function: Callable, *given: Any) -> Any:
    """The shapes of what a function answers; nothing is computed. Errors come as they are raised,
    without what JAX adds to those that pass it."""
    try:
        return jax.eval_shape(function, *given)
    except ValueError as error:
        raise ValueError(*error.args) from error.__cause__
