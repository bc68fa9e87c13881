"""What a response is: a number drawn from a run, with its unit and what of the run it needs to be
right.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx

from jaxclear.ground.quantity import AbstractQuantified, Scalar
from jaxclear.results.trajectory import Trajectory

__all__ = ["REACHES", "AbstractResponse", "concerned", "needs_of", "unit_of"]

# What is off in a run where one part of it is: forces follow the motion, wear follows forces.
REACHES = {
    "motion": ("motion", "forces", "peak forces", "wear", "worn depth", "places in gaps"),
    "places": ("motion", "places in gaps"),
    "forces": ("forces", "peak forces", "wear", "worn depth"),
    "peak forces": ("peak forces",),
    "swinging forces": ("peak forces", "wear", "worn depth"),
    "wear": ("wear", "worn depth"),
    "worn depth": ("worn depth",),
    "places in gaps": ("places in gaps", "wear", "worn depth"),
}


class AbstractResponse(AbstractQuantified):
    """A number drawn from a run; `unit` is that of the number."""

    unit: eqx.AbstractVar[str]

    def unit_in(self, mechanism: Any) -> str:
        """The unit, of a number drawn from runs of this mechanism."""
        return self.unit

    def drawn_from(self) -> str:
        """What of a run it needs to be right: its "motion", "forces", "peak forces", "wear",
        "worn depth", "places in gaps" (at an instant) or "anything". A warning that concerns
        something else does not concern it."""
        return "anything"

    @abstractmethod
    def __call__(self, run: Trajectory) -> Scalar:
        """The response of a run."""


def needs_of(response: Any) -> str:
    """What of a run a response needs to be right, as `drawn_from` says; a plain function may need
    "anything"."""
    return response.drawn_from() if isinstance(response, AbstractResponse) else "anything"


def concerned(response: Any, concerns: str) -> bool:
    """Whether a warning that `concerns` a part of a run concerns a response; any does that of a
    plain function."""
    needs = needs_of(response)
    return needs == "anything" or needs in REACHES.get(concerns, (needs,))


def unit_of(response: Any, mechanism: Any) -> str:
    """Unit of a response of a mechanism; "1" for a plain function."""
    return response.unit_in(mechanism) if isinstance(response, AbstractResponse) else "1"
