"""What a load or a drive asks of a function of time: it takes a time [s], traced by JAX, and
returns so many numbers. Looked at once, when the load or drive is built.
"""

import math
from abc import abstractmethod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.given_functions import asked, shape_of
from jaxclear.ground.quantity import AbstractQuantified, Scalar, as_number, as_vector
from jaxclear.ground.wording import described, public_name

__all__ = [
    "AbstractFunctionOfTime",
    "check_function_of_time",
    "number_or_function",
    "one_or_more_or_function",
    "value_at",
    "vector_or_function",
]


class AbstractFunctionOfTime(AbstractQuantified):
    """A function of time [s] that is told by its numbers, so that a file can hold it."""

    @abstractmethod
    def __call__(self, time: Scalar) -> Any:
        """Its value, or several, at a time [s]."""

    def integral(self, time: Scalar) -> Any:
        """Its integral from 0 to a time [s]; None where it knows none, as unless overridden."""
        return None

    def check_motion(self) -> None:
        """Raises `ValueError` with a sentence where it is no position of a drive because its speed
        jumps; nothing is refused unless overridden."""


def check_function_of_time(part: Any, field: str, counts: tuple[int, ...] = (1,)) -> None:
    """Raises `ValueError` for a function in a field of a part that fails at a time, or returns
    other than as many numbers as one of `counts`; what is no function passes.
    """
    function = getattr(part, field)
    if not callable(function):
        return
    number = " or ".join(map(str, counts))
    wanted = f"must take a time [s] and return {number} number{'s' if counts != (1,) else ''}"
    owner = f"{public_name(type(part))} has {field} = {described(function)}"
    answers = lambda at: jax.tree.map(jnp.asarray, function(at))
    found = shape_of(
        lambda at: asked(f"{owner}, which", answers, at, wanted=f"It {wanted}."),
        jax.ShapeDtypeStruct((), jnp.float64),
    )
    shapes = [leaf.shape for leaf in jax.tree.leaves(found)]
    plain = all(shape == () for shape in shapes) or (len(shapes) == 1 and len(shapes[0]) == 1)
    alone = counts == (1,) and shapes != [()]
    if not plain or alone or sum(map(math.prod, shapes)) not in counts:
        returned = f"{len(shapes)} numbers" if plain and len(shapes) > 1 else str(shapes)
        raise ValueError(f"{owner}, which returns {returned}; it {wanted}.")


def vector_or_function(value: Any) -> Any:
    """Several numbers, or the function that gives them."""
    return value if callable(value) else as_vector(value)


def one_or_more_or_function(value: Any) -> Any:
    """One number or several, or the function that gives them."""
    one = np.ndim(value) == 0 and not isinstance(value, (str, dict)) and value is not None
    return value if callable(value) else as_vector((value,) if one else value)


def number_or_function(value: Any) -> Any:
    """One number, or the function that gives it."""
    return value if callable(value) else as_number(value)


def value_at(value: Any, time: Any) -> Any:
    """A number, or what its function gives at a time [s]."""
    return value(time) if callable(value) else value
