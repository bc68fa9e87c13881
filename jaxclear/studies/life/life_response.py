"""What is asked of a life by one number: after how many cycles a limit is reached, infinite where
it never is, or what a quantity has come to at its end.

A life knows its own error. With `sure` the answer is the end of its 95 % interval that is on the
safe side: what is left out is the rest beyond it, and what hangs on the saving times of a cycle
(`WearLife.by_saves`).
"""

from abc import abstractmethod

import equinox as eqx
import numpy as np

from jaxclear.ground.arguments import check_flags, check_known, expect
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.results.response import REACHES
from jaxclear.studies.life.result import CONFIDENCE, DEPTH, VOLUME, WearLife
from jaxclear.studies.problem import Problem

# From which part of a cycle what every life tells of is drawn.
DRAWN_FROM = {DEPTH: "worn depth", VOLUME: "wear"}
# The rate at which a life goes on is that over its last part, this share of it.
LAST = 0.1

__all__ = ["AbstractLifeResponse", "LifeEnd", "LifeUntil"]


class AbstractLifeResponse(AbstractQuantified):
    """One number of a life, of what is called `name` among all that it tells of ("depth", "volume",
    those of one surface, or a response)."""

    name: eqx.AbstractVar[str]

    @abstractmethod
    def __call__(self, life: WearLife) -> float:
        """The number; `nan` where the life does not tell it."""

    @abstractmethod
    def unit_among(self, units: dict[str, str]) -> str:
        """Its unit, from those of the quantities of a life."""

    @abstractmethod
    def decides_length(self) -> bool:
        """Whether it says by itself how long a life is to be."""

    def ahead(self, life: WearLife) -> float:
        """How many cycles more it takes, as the life goes on at its end; 0 where the life tells it
        already, infinite where it never will."""
        return 0.0

    def concerned(self, problem: Problem, concerns: str) -> bool:
        """Whether a warning that `concerns` a part of a cycle of the problem concerns it. A
        response of cycles hangs on how deep these wear, too."""
        reached = REACHES.get(concerns, (concerns,))
        if self.name in problem.response_names:
            return DRAWN_FROM[DEPTH] in reached or problem.concerned(self.name, concerns)
        return DRAWN_FROM[self.name.partition(" ")[0]] in reached

    def check(self, units: dict[str, str]) -> None:
        """Raises `ValueError` for a quantity that lives with these units do not tell of."""
        check_known("quantity", self.name, units, " in this life")


class LifeUntil(AbstractLifeResponse):
    """Cycles until a quantity first reaches a `limit`, in its unit, as `WearLife.until`; infinite
    where it does not in as long a life as is followed (`LifeProblem`). `sure`: less the error of
    the life, the lower end of its 95 % interval [cycles]."""

    name: str = eqx.field(static=True)
    limit: Scalar = quantity(unit="(in the quantity's unit)", meaning="what it reaches")
    sure: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        _check_quantity("LifeUntil", self.name, self.sure)

    def __call__(self, life):
        found = life.until(self.name, float(self.limit))
        if not np.isfinite(found.cycles):
            # Of a life that ended by a failed cycle nobody knows.
            return np.nan if life.ended else self._outlived(life)
        if not self.sure:
            return found.cycles
        return max(found.cycles - found.error, 0.0)

    def _outlived(self, life: WearLife) -> float:
        """Of a life in which the limit is not reached: infinite, unless it is to be sure and the
        error at the end may hide that it is."""
        now = life.at_end(self.name)
        off, limit = _error_at_end(life, self.name, now), float(self.limit)
        if not self.sure or abs(limit - now) > off:
            return np.inf
        nearer = life.until(self.name, limit - np.copysign(off, limit - now)).cycles
        return nearer if np.isfinite(nearer) else 0.0

    def unit_among(self, units):
        return "cycles"

    def decides_length(self):
        return True

    def ahead(self, life):
        if np.isfinite(life.until(self.name, float(self.limit)).cycles):
            return 0.0
        last = float(life.cycles[-1])
        before, now = life.over_life(self.name, [(1.0 - LAST) * last, last])
        more = (float(self.limit) - now) / (now - before) if now != before else np.inf
        return LAST * last * more if more > 0 else np.inf


class LifeEnd(AbstractLifeResponse):
    """A quantity at the end of the life, in its unit. `sure`: with the error of the life added, the
    upper end of its 95 % interval; of depths and volumes, whose errors a life tells."""

    name: str = eqx.field(static=True)
    sure: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        _check_quantity("LifeEnd", self.name, self.sure)
        if self.sure and self.name.partition(" ")[0] not in (DEPTH, VOLUME):
            raise ValueError(
                f'LifeEnd of "{self.name}" cannot be sure: at its end a life tells the errors '
                "of depths and volumes."
            )

    def __call__(self, life):
        if life.ended:
            return np.nan
        value = life.at_end(self.name)
        return value + _error_at_end(life, self.name, value) if self.sure else value

    def unit_among(self, units):
        return units[self.name]

    def decides_length(self):
        return False


def _error_at_end(life: WearLife, name: str, value: float) -> float:
    """Half of the 95 % interval of a quantity at the end of a life, in its unit."""
    if name in life.problem.response_names:
        return CONFIDENCE * float(life.stages[-1].settled.responses()[name][1])
    errors = life.errors_of_volume if name.startswith(VOLUME) else life.errors
    return abs(value) * float(errors[-1])


def _check_quantity(owner: str, quantity: str, sure: bool) -> None:
    expect(quantity, str, f"quantity of {owner}", 'a text, such as "depth"')
    check_flags(owner, sure=sure)
