"""What `print`, and a notebook at the end of a cell, show of an answer: its words and its numbers,
not the arrays it is made of. What is shown is read-only: it stays as it was built and checked.
"""

import dataclasses
import inspect
import math
from abc import abstractmethod
from typing import Any, NoReturn

import equinox as eqx

from jaxclear.ground.wording import public_name, unknown

# Of a float64; and of a number that a user gave, without the rounding of a sum.
MOST_DIGITS, GIVEN_DIGITS = 15, 10


class AbstractShown(eqx.Module):
    """What is shown in words."""

    @abstractmethod
    def __str__(self) -> str:
        """The words."""

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """IPython's way to ask for them."""
        printer.text(str(self))

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            eqx.Module.__setattr__(self, name, value)
        except dataclasses.FrozenInstanceError:
            raise dataclasses.FrozenInstanceError(_read_only(type(self), name)) from None

    def __delattr__(self, name: str) -> NoReturn:
        raise dataclasses.FrozenInstanceError(_read_only(type(self), name))


def _read_only(kind: type, name: str) -> str:
    """Why a field cannot be set, and what to do in its place."""
    fields, owner = [field.name for field in dataclasses.fields(kind)], public_name(kind)
    if name not in fields:
        return unknown("field", name, fields, f" in {owner}")
    # A class with an `__init__` of its own may take other arguments than it has fields.
    plain = list(inspect.signature(kind).parameters) == fields
    way = f", dataclasses.replace(it, {name}=...)" if plain else ""
    return (
        f"{owner} is read-only: {name} stays as it was built and checked. Build another{way}; "
        "mechanism.with_body, with_joint, with_load and with_coupling put it in. To change a "
        "number alone write equinox.tree_at(lambda mechanism: ..., mechanism, number)."
    )


def in_rows(table: Any) -> str:
    """All of a pandas table as text, numbers to seven digits: micrometres beside a metre."""
    return table.to_string(float_format="{:.7g}".format)


def left_out(failed: int, samples: str) -> list[str]:
    """A sentence for samples that failed; none where none did."""
    return [f"{failed} {samples} failed and are left out."] if failed else []


def as_written(number: Any) -> str:
    """A number that a user gave, such as a limit, with all that anybody writes of it."""
    return f"{float(number):.{GIVEN_DIGITS}g}"


def in_digits(value: float, error: float, least: int = 5) -> str:
    """A number with so many digits that two of its error are among them, and at least so many."""
    if not (math.isfinite(value) and math.isfinite(error) and value and error):
        return f"{value:.{least}g}"
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(abs(error))) + 2
    return f"{value:.{min(max(digits, least), MOST_DIGITS)}g}"
