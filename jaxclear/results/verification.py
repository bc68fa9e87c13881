"""How far the numbers of a run are off: what a run holds of it, and what it answers. Which runs
tell it, and by which standard answers, is the room `errors`.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxclear.ground.printing import AbstractShown, in_few, with_error, with_text_repr
from jaxclear.ground.quantity import is_traced
from jaxclear.ground.table import as_table
from jaxclear.ground.wording import described

# Of the tables of standard answers.
TABLE_COLUMNS = ["quantity", "value", "error", "unit", "relative error", "tolerance"]


@with_text_repr
class Estimate(AbstractShown):
    """A number computed from a run, with its numerical error.

    Args:
        value: the number, or an array or collection of numbers.
        error: its numerical error in the same unit, of the same form; nan where it is not known.
        why: what the error comes from, or why it is not known.
        unit: unit of both; "" where none is given.
    """

    value: Any
    error: Any
    why: str = eqx.field(static=True, default="")
    unit: str = eqx.field(static=True, default="")

    def of(self, response: Any, mechanism: Any) -> "Estimate":
        """The same estimate with the unit of a response.

        Args:
            response: an `AbstractResponse`, or a plain function, which has no unit.
            mechanism: the `Mechanism` of the run.

        Returns:
            The estimate.
        """
        unit_in = getattr(response, "unit_in", None)
        return self if unit_in is None else replace(self, unit=unit_in(mechanism))

    def _summary(self):
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        values, errors = jax.tree.leaves(self.value), jax.tree.leaves(self.error)
        if is_traced((values, errors)):
            return "a traced number"
        most = max((float(np.max(each, initial=0.0)) for each in errors), default=math.nan)
        if len(values) == 1 and np.ndim(values[0]) == 0 and not isinstance(values[0], str):
            value = float(values[0])
            if math.isfinite(most):
                return f"{with_error(value, most)}{unit}"
            return f"{in_few(value, 6)}{unit} ({self.why})"
        count = sum(np.size(each) for each in values)
        text = f"each ± {most:.2g}{unit} at the most" if math.isfinite(most) else self.why
        return f"{count} numbers ({text})"


def checked(response: Any) -> Any:
    """What is to be estimated. Raises `ValueError` where it is no function."""
    if callable(response):
        return response
    raise ValueError(
        f"{described(response)} was given to be estimated; it must be a response, such as "
        'jaxclear.response.MeanContactForce("B"), or a function of a run.'
    )


class AbstractVerification(AbstractShown):
    """The numerical errors of a run."""

    @property
    @abstractmethod
    def warnings(self) -> tuple[str, ...]:
        """A sentence for answers whose error exceeds the tolerance of the integrator."""

    @property
    @abstractmethod
    def notes(self) -> tuple[str, ...]:
        """Sentences about numbers that are right, or that the run does not claim."""

    @property
    @abstractmethod
    def beyond(self) -> frozenset[str]:
        """The fields of `Promise` that some answer exceeds."""

    @abstractmethod
    def estimate(self, run: Any, response: Callable[[Any], Any]) -> Estimate:
        """The value of a response of this run, and its error.

        Args:
            run: the `Trajectory`.
            response: a function of a run that returns numbers.

        Returns:
            The `Estimate`.
        """

    @abstractmethod
    def table(self) -> Any:
        """A table of the standard answers.

        Returns:
            A pandas table: quantity, value, error, unit, relative error [1], and the tolerance of
            the relative error [1].
        """

    @abstractmethod
    def attributes(self) -> dict[str, str]:
        """Texts that are stored with saved data.

        Returns:
            Texts by name.
        """


class Unverified(AbstractVerification):
    """A run without companion runs, whose numerical error is not known.

    Args:
        why: the reason, as part of a sentence.
        warns: whether the first line of the run says so.
    """

    why: str = eqx.field(static=True, default="it has no replicas")
    warns: bool = eqx.field(static=True, default=False)

    def _summary(self):
        return f"Not verified: {self.why}."

    @property
    def warnings(self):
        return (f"Not verified: {self.why}.",) if self.warns else ()

    @property
    def notes(self):
        return ()

    @property
    def beyond(self):
        return frozenset()

    def estimate(self, run, response):
        return Estimate(response(run), math.nan, f"not verified: {self.why}")

    def table(self):
        return as_table(columns=TABLE_COLUMNS)

    def attributes(self):
        return {"verification": str(self)}
