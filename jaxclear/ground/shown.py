"""What `print`, and a notebook at the end of a cell, show of an answer: its words and its numbers,
not the arrays it is made of.
"""

import math
from abc import abstractmethod
from typing import Any

import equinox as eqx

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
