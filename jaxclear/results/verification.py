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

from jaxclear.ground.printing import AbstractShown, in_few, shown_in_words, with_error
from jaxclear.ground.quantity import is_traced
from jaxclear.ground.table import as_table
from jaxclear.ground.wording import described


@shown_in_words
class Estimate(AbstractShown):
    """What was drawn from a run: its `value`, its numerical `error` (nan: not known) in the same
    `unit` ("": not told), and, in `why`, what the error comes from or why it is not known. Of
    arrays and of collections of numbers the error has their form."""

    value: Any
    error: Any
    why: str = eqx.field(static=True, default="")
    unit: str = eqx.field(static=True, default="")

    def of(self, response: Any, mechanism: Any) -> "Estimate":
        """The same with the unit of a response of this mechanism; a plain function has none."""
        unit_in = getattr(response, "unit_in", None)
        return self if unit_in is None else replace(self, unit=unit_in(mechanism))

    def _shown(self):
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
        told = f"each ± {most:.2g}{unit} at the most" if math.isfinite(most) else self.why
        return f"{count} numbers ({told})"


def checked(response: Any) -> Any:
    """What is to be estimated. Raises `ValueError` where it is no function."""
    if callable(response):
        return response
    raise ValueError(
        f"{described(response)} was given to be estimated; it must be a response, such as "
        'jaxclear.response.MeanContactForce("B"), or a function of a run.'
    )


class AbstractVerification(AbstractShown):
    """What is known of a run's numerical errors."""

    @property
    @abstractmethod
    def warnings(self) -> tuple[str, ...]:
        """A sentence for answers beyond what the integrator promises."""

    @property
    @abstractmethod
    def beyond(self) -> frozenset[str]:
        """The parts of the promise (`Promise`'s fields) beyond which some answer is."""

    @abstractmethod
    def estimate(self, run: Any, response: Callable[[Any], Any]) -> Estimate:
        """The value of a response of this run, and its error."""

    @abstractmethod
    def table(self) -> Any:
        """A pandas table of the standard answers: value, error, unit, the error as a share and what
        is promised of it."""

    @abstractmethod
    def attributes(self) -> dict[str, str]:
        """What goes as text with saved data."""


class Unverified(AbstractVerification):
    """Of a run without replicas: nobody has looked, and `why`."""

    why: str = eqx.field(static=True, default="it has no replicas")

    def _shown(self):
        return f"Not verified: {self.why}."

    @property
    def warnings(self):
        return ()

    @property
    def beyond(self):
        return frozenset()

    def estimate(self, run, response):
        return Estimate(response(run), math.nan, f"not verified: {self.why}")

    def table(self):
        return as_table(columns=["answer", "value", "error", "unit", "share", "promised"])

    def attributes(self):
        return {"verification": str(self)}
