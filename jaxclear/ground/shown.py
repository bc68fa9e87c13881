"""What `print`, and a notebook at the end of a cell, show of an answer: its words and its numbers,
not the arrays it is made of.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx


class AbstractShown(eqx.Module):
    """What is shown in words."""

    @abstractmethod
    def __str__(self) -> str:
        """The words."""

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """IPython's way to ask for them."""
        printer.text(str(self))


def in_rows(table: Any) -> str:
    """All of a pandas table as text, numbers to five digits."""
    return table.to_string(float_format="{:.5g}".format)
