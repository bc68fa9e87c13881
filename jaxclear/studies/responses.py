"""Which responses are wanted of a mechanism, by name, and what they may answer."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.errors.verification import thinned
from jaxclear.ground.arguments import expect
from jaxclear.ground.quantity import is_one_number
from jaxclear.ground.warning import asked, shape_of
from jaxclear.ground.wording import described

__all__ = ["Thinned", "answer", "by_name", "check_answers", "check_responses"]


class Thinned(eqx.Module):
    """A response of a run whose saving intervals were cut into `parts`: it sees the run at the ends
    of whole ones."""

    function: Callable
    parts: int = eqx.field(static=True)

    def __call__(self, run: Any) -> Any:
        """The response of such a run."""
        return self.function(thinned(run, self.parts))


def by_name(what: str, given: Any) -> dict[str, Any]:
    """What varies or is wanted, by name; a response alone is called "response"."""
    if what == "response" and not isinstance(given, Mapping):
        return {what: given}
    expect(given, Mapping, f"{what} of a Problem", "a dictionary from names")
    if what == "response" and not given:
        raise ValueError("response of a Problem is empty; it must hold at least one.")
    for name in given:
        expect(name, str, f"a name in {what} of a Problem", "a text")
    return dict(given)


def answer(name: str, response: Callable, run: Any) -> Array:
    """A response of a run (of positions, a life) as one number. Raises `ValueError` with a sentence
    that names it where it fails, leaves JAX, or gives something else."""
    value = asked(f'response "{name}"', response, run)
    if not is_one_number(value):
        hint = " It returns nothing: is a `return` missing?" if value is None else ""
        raise ValueError(
            f'response "{name}" gives {described(value)} for a run; it must be one number, such as '
            f"a mean or the largest.{hint}"
        )
    return jnp.asarray(value, float)


def check_answers(response: dict[str, Callable], seen: Callable[[], Any]) -> None:
    """Raises `ValueError` with a sentence where a response does not give one number; `seen` makes
    what it is asked of. Nothing is compiled."""
    for name, own in response.items():
        shape_of(lambda name=name, own=own: answer(name, own, seen()))


def check_responses(response: dict[str, Any], variables: dict[str, Any], of: str) -> None:
    """Responses are functions `of` something, and share no name with a variable."""
    for name, wanted in response.items():
        if not callable(wanted) or isinstance(wanted, type):
            hint = f": build one, {wanted.__name__}(...)" if isinstance(wanted, type) else ""
            raise ValueError(
                f'response "{name}" is {described(wanted)}; it must be a function of {of}, such as '
                f"one of jaxclear.response{hint}."
            )
        if name in variables:
            raise ValueError(
                f'"{name}" names a variable and a response; give them different names.'
            )
