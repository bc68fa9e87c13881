"""Responses that are wanted of a mechanism, by name, and what they may answer."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.errors.verification import thin_run
from jaxclear.ground.arguments import expect
from jaxclear.ground.quantity import inside, is_one_number, numbers
from jaxclear.ground.warning import call_user, shape_of
from jaxclear.ground.wording import described
from jaxclear.multibody.mechanism import Mechanism, check_mechanism
from jaxclear.results.response import AbstractSignal
from jaxclear.studies.experiment import check_names_differ
from jaxclear.studies.variable import check_variables


def answers(response: dict[str, Callable], subject: Any) -> dict[str, Array]:
    """The responses of what a mechanism does, by name."""
    return {name: answer(name, function, subject) for name, function in response.items()}


def checked_question(
    mechanism: Mechanism, response: Any, variables: Any, owner: str, of: str
) -> tuple[dict[str, Callable], dict[str, Any]]:
    """Responses and variables of a mechanism, by name.

    Args:
        mechanism: to be varied.
        response, variables: by name, as given.
        owner: class in messages.
        of: what responses are functions of, in messages.

    Raises:
        ValueError: something is not what it must be.
    """
    check_mechanism(mechanism, f"the mechanism of a {owner}")
    responses, varied = by_name("response", response), by_name("variables", variables)
    check_responses(responses, varied, of)
    check_variables(varied, mechanism)
    return responses, varied


def in_range(*parts: Any) -> Array:
    """Whether all numbers of parts, as of a mechanism, are within their ranges."""
    is_inside = [inside(leaf, metadata) for part in parts for _, leaf, metadata in numbers(part)]
    # Tables, as of a function of time, are arrays.
    return jnp.all(jnp.stack([one if jnp.ndim(one) == 0 else jnp.all(one) for one in is_inside]))


class Thinned(eqx.Module):
    """A response of a run whose saving intervals were cut into `parts`: it sees the run at the ends
    of whole ones."""

    function: Callable
    parts: int = eqx.field(static=True)

    def __call__(self, run: Any) -> Any:
        """The response of such a run."""
        return self.function(thin_run(run, self.parts))


def by_name(what: str, mapping: Any) -> dict[str, Any]:
    """What varies or is wanted, by name; a response alone is called "response"."""
    if what == "response" and not isinstance(mapping, Mapping):
        return {what: mapping}
    expect(mapping, Mapping, f"{what} of a Problem", "a dictionary from names")
    if what == "response" and not mapping:
        raise ValueError("response of a Problem is empty; it must hold at least one.")
    for name in mapping:
        expect(name, str, f"a name in {what} of a Problem", "a text")
    return dict(mapping)


def answer(name: str, response: Callable, run: Any) -> Array:
    """A response of a run (or of positions, a life) as one number; of a sensor a series.

    Args:
        name: in messages.
        response: function of the run.
        run: its argument.

    Raises:
        ValueError: it fails, leaves JAX, or gives something else.
    """
    value = call_user(f'response "{name}"', response, run)
    if not is_one_number(value) and not isinstance(response, AbstractSignal):
        hint = " It returns nothing: is a `return` missing?" if value is None else ""
        raise ValueError(
            f'response "{name}" gives {described(value)} for a run; it must be one number, such as '
            f"a mean or the largest.{hint}"
        )
    return jnp.asarray(value, float)


def check_answers(response: dict[str, Callable], make_subject: Callable[[], Any]) -> None:
    """Raises `ValueError` with a sentence where a response does not give one number; `make_subject`
    makes what it is asked of. Nothing is compiled."""
    for name, function in response.items():
        if isinstance(function, AbstractSignal):
            raise ValueError(
                f'response "{name}" is a sensor, whose signal is no number: give a function of it, '
                "such as lambda run: jax.numpy.max(sensor(run)); jaxclear.identify takes the "
                "sensors of its record by itself."
            )
        shape_of(lambda name=name, function=function: answer(name, function, make_subject()))


def check_responses(response: dict[str, Any], variables: dict[str, Any], of: str) -> None:
    """Raises `ValueError` unless responses are functions that share no name with a variable.

    Args:
        response: by name.
        variables: by name.
        of: what responses are functions of, in messages.
    """
    for name, value in response.items():
        if not callable(value) or isinstance(value, type):
            hint = f": build one, {value.__name__}(...)" if isinstance(value, type) else ""
            raise ValueError(
                f'response "{name}" is {described(value)}; it must be a function of {of}, such as '
                f"one of jaxclear.response{hint}."
            )
    check_names_differ(response, variables)
