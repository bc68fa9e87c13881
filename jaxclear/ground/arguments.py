"""What a function is given, checked by name before anything runs: a flag, a count, a number, a word
of a few, a thing of a kind. What is being traced was checked before.

Each raises `ValueError` with a sentence that says what was given and what would be right.
"""

import inspect
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np

from jaxclear.ground.quantity import as_number, finite_and_within, range_in_words
from jaxclear.ground.wording import described, listed, unknown


def expect(thing: Any, kind: Any, what: str, required: str) -> None:
    """Raises `ValueError` unless a thing is of a kind.

    Args:
        thing: to be checked.
        kind: class, or tuple of classes.
        what: begins the message: whose argument it is.
        required: ends the message: what it must be.
    """
    if not isinstance(thing, kind):
        built = isinstance(thing, type) and isinstance(kind, type) and issubclass(thing, kind)
        hint = f": build one, {thing.__name__}(...)" if built else ""
        hint = f": call it, {thing.__name__}(...)" if inspect.isfunction(thing) else hint
        raise ValueError(f"{what} is {described(thing)}; it must be {required}{hint}.")


def check_flags(owner: str, **flags: Any) -> None:
    """Arguments of a function that are True or False."""
    for name, value in flags.items():
        if not isinstance(value, (bool, np.bool_)):
            raise ValueError(f"{name} of {owner} is {described(value)}; it must be True or False.")


def check_count(what: str, value: Any, at_least: int = 1) -> None:
    """Raises `ValueError` unless a value is a whole number in range.

    Args:
        what: begins the message: which number it is.
        value: to be checked; True and False are no numbers.
        at_least: smallest allowed number.
    """
    is_integer = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not is_integer or value < at_least:
        raise ValueError(
            f"{what} is {described(value)}; it must be a whole number, at least {at_least}."
        )


def check_number(what: str, value: Any, unit: str = "", **bounds: float) -> None:
    """Raises `ValueError` unless a value is one finite number within bounds; traced ones pass.

    Args:
        what: begins the message: which number it is.
        value: to be checked.
        unit: in the message.
        bounds: above, at_least, below, at_most, as of `quantity`.
    """
    unit = f" [{unit}]" if unit else ""
    limits = range_in_words(bounds)
    required = f"one finite number{unit}{', ' if limits else ''}{limits}"
    if isinstance(value, float) and finite_and_within(value, bounds):
        return
    try:
        number = as_number(value)
    except ValueError:
        number = None
    if isinstance(number, jax.core.Tracer):
        return
    if not isinstance(number, jax.Array) or not finite_and_within(float(number), bounds):
        raise ValueError(f"{what} is {described(value)}; it must be {required}.")


def check_name(what: str, name: Any, names: Iterable[str], where: str = "") -> None:
    """Raises `ValueError` unless a name is one of those that exist.

    Args:
        what: kind of thing that is named, such as "joint".
        name: to be checked.
        names: that exist.
        where: follows the name in the message, such as " in this mechanism".
    """
    names = list(names)
    if not isinstance(name, str) or name not in names:
        raise ValueError(unknown(what, name, names, where))


def check_methods(owner: str, methods: Any, names: Iterable[str]) -> None:
    """Raises `ValueError` unless some of a study's methods are given, at least one.

    Args:
        owner: name of the study in the message.
        methods: tuple or list of names.
        names: methods that the study has.
    """
    names = list(names)
    expect(methods, (tuple, list), f"methods of {owner}", f"some of {listed(names)}")
    if not methods:
        raise ValueError(f"methods of {owner} is empty; it must hold some of {listed(names)}.")
    for method in methods:
        check_name("method", method, names, f" of {owner}")
