"""One curve of a work-precision diagram: what the settings of one method cost and answer."""

from typing import NamedTuple

from jaxclear.studies.advice.pilot import Trial

# Curves beside those of the candidates: what is taken for the truth, and what the user had.
REFERENCE, PRESENT = "reference", "the problem's own"


class Curve(NamedTuple):
    """The trials of one method, coarse to fine, and why there are no finer ones."""

    trials: tuple[Trial, ...]
    stopped: str


class Choice(NamedTuple):
    """A trial by the name of its curve and its place on it."""

    method: str
    place: int
