"""How a state is carried from one saving time to the next: what every integrator is asked, and how
it answers.

An integrator sees a `Field` (the state's rate and views of its contacts) and an interval. Outcomes
are numbers while the program runs and sentences when a user reads them.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx

from jaxclear.formulations.base import Field
from jaxclear.ground.quantity import AbstractQuantified, Scalar

# Forces that follow from the state; percussions of rigid contacts; reactions of joints that are
# always in contact.
FORMULATIONS = COMPLIANT, RIGID, PERMANENT = ("compliant", "rigid", "permanent")


class Advance(NamedTuple):
    """Outcome of one interval: state at its end, steps accepted and rejected, what helps the next
    interval to start, `Outcome`."""

    state: Any
    accepted: Any
    rejected: Any
    warm_start: Any
    outcome: Any


class AbstractIntegrator(AbstractQuantified):
    """Carries a state over an interval. `pathwise` tells whether forward-mode derivatives through
    its steps are those of the discrete run, `formulation` what contact is to it: one of
    `FORMULATIONS`."""

    pathwise: eqx.AbstractClassVar[bool]
    formulation: eqx.AbstractClassVar[str]

    @abstractmethod
    def first_warm_start(self, field: Field, start: Scalar, state: Any) -> Any:
        """What the first interval is handed in place of the hint of an interval before."""

    @abstractmethod
    def advance(
        self,
        field: Field,
        start: Scalar,
        stop: Scalar,
        state: Any,
        warm_start: Any,
        weights: Any,
        running: Any,
    ) -> Advance:
        """From `start` to `stop` [s]; `hint` is what the last interval left to this one. `weights`
        (n,) scale each entry's error for the error control; 0 where an entry only follows the
        others. Where `running` is False the run has ended before and the outcome will be ignored:
        an integrator may then save the work."""

    @abstractmethod
    def relaxing_step(self, interval: Scalar | None) -> Scalar | None:
        """The step [s] over which an impact speed relaxes by an explicit formula, in a saving
        interval of this length (None: not known). None where steps of any length are stable, or not
        known."""


def check_count(value: int | None, what: str) -> None:
    """Raises `ValueError` for a static count that is no positive whole number; None passes."""
    if value is not None and (
        isinstance(value, bool) or not (isinstance(value, int) and value > 0)
    ):
        raise ValueError(f"{what} is {value!r}; it must be a positive whole number.")
