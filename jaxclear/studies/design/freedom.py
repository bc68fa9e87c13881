"""What a design may choose: nominal values and tolerances, each within bounds or from a catalogue.

An optimiser sees numbers between 0 and 1: nominal values by proportion, tolerances by the logarithm
(costs are powers of them). A tolerance scales the variable's own distribution.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_known, check_number, expect
from jaxclear.ground.wording import described
from jaxclear.studies.design.catalogue import AbstractCatalogue

NOMINAL, TOLERANCE = "nominal", "tolerance"
# Shares of a normal distribution three standard deviations out, which stand for the tolerance of
# a distribution without ends.
THREE_DEVIATIONS = 0.9986501019683699
# So close to a number of a catalogue is that number.
ROUNDING = 1e-12


class Choice(NamedTuple):
    """A free number: of which variable (index), whether its nominal value or its tolerance, its
    range, and what there is to choose from, rising, with what that is called (none: anything
    within)."""

    kind: str
    variable: int
    low: float
    high: float
    offered: tuple[float, ...] = ()
    labels: tuple[str, ...] = ()


class Freedom(eqx.Module):
    """The free numbers of a design; `names` of the variables, `start` and `usual` their nominal
    values and tolerances where nothing is chosen."""

    choices: tuple[Choice, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    start: np.ndarray
    usual: np.ndarray

    @property
    def size(self) -> int:
        """How many free numbers there are."""
        return len(self.choices)

    def label(self, i: int) -> str:
        """A free number in words."""
        choice = self.choices[i]
        return f"{choice.kind} {self.names[choice.variable]}"

    def decoded(self, place: Float[Array, " size"]) -> tuple[Array, Array]:
        """(nominal values, tolerances) of all variables."""
        numbers = {NOMINAL: jnp.asarray(self.start), TOLERANCE: jnp.asarray(self.usual)}
        for i, choice in enumerate(self.choices):
            own = _between(choice, place[i])
            numbers[choice.kind] = numbers[choice.kind].at[choice.variable].set(own)
        return numbers[NOMINAL], numbers[TOLERANCE]

    def drawn(self, place: Float[Array, " size"]) -> tuple[np.ndarray, np.ndarray]:
        """(nominal values, tolerances) as they stand in a drawing: those that come from a catalogue
        to the last digit as it has them, which their places between 0 and 1 are not."""
        numbers = dict(zip((NOMINAL, TOLERANCE), map(np.array, self.decoded(place)), strict=True))
        for choice in self.choices:
            own = numbers[choice.kind]
            for number in choice.offered:
                if np.isclose(own[choice.variable], number, rtol=ROUNDING, atol=0.0):
                    own[choice.variable] = number
        return numbers[NOMINAL], numbers[TOLERANCE]

    def encoded(self, nominal: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
        """The numbers between 0 and 1 of a design, which is brought within its bounds."""
        values = {NOMINAL: nominal, TOLERANCE: tolerance}
        places = [_place(choice, values[choice.kind][choice.variable]) for choice in self.choices]
        return np.clip(np.array(places), 0.0, 1.0)

    def places(self, i: int) -> list[float]:
        """Places of everything that the catalogue of a free number has, rising."""
        choice = self.choices[i]
        return [float(_place(choice, number)) for number in choice.offered]


def _between(choice, place):
    if choice.kind == NOMINAL:
        return choice.low + place * (choice.high - choice.low)
    return choice.low * jnp.exp(place * np.log(choice.high / choice.low))


def _place(choice, number):
    if choice.kind == NOMINAL:
        return (number - choice.low) / (choice.high - choice.low)
    return np.log(number / choice.low) / np.log(choice.high / choice.low)


def usual_tolerance(distribution: Any) -> float:
    """Half of the range of a distribution; of one without ends, half of what lies between three
    standard deviations of a normal one."""
    ends = [float(distribution.quantile(jnp.asarray(share))) for share in (0.0, 1.0)]
    if not np.all(np.isfinite(ends)):
        shares = (1.0 - THREE_DEVIATIONS, THREE_DEVIATIONS)
        ends = [float(distribution.quantile(jnp.asarray(share))) for share in shares]
    return 0.5 * (ends[1] - ends[0])


def freedom_of(problem: Any, nominal: Mapping | None, tolerance: Mapping | None) -> Freedom:
    """What a user leaves open. Raises `ValueError` with a sentence for what cannot be."""
    names = problem.names
    choices = []
    for kind, given in ((NOMINAL, nominal), (TOLERANCE, tolerance)):
        expect(given or {}, Mapping, f"{kind} of design", "a dictionary from names of variables")
        for name, span in (given or {}).items():
            check_known("variable", name, names, " in this problem")
            choices.append(_choice(kind, name, names.index(name), span))
    if not choices:
        raise ValueError(
            "nothing is left open: give design a `tolerance` or a `nominal` with bounds, such as "
            f'tolerance={{"{names[0] if names else "name"}": (1e-6, 1e-4)}}.'
        )
    usual = [usual_tolerance(problem.variables[name].distribution) for name in names]
    return Freedom(tuple(choices), names, np.asarray(problem.nominal()), np.array(usual))


def _choice(kind, name, index, span):
    what = f'{kind} of "{name}"'
    if isinstance(span, AbstractCatalogue):
        numbers = span.numbers()
        if len(numbers) < 2 or (kind == TOLERANCE and numbers[0] <= 0):
            raise ValueError(f"the catalogue for {what} must hold two sizes or more, above 0.")
        labels = tuple(span.label(number) for number in numbers)
        return Choice(kind, index, numbers[0], numbers[-1], tuple(numbers), labels)
    if not isinstance(span, (tuple, list)) or len(span) != 2:
        raise ValueError(
            f"{what} is {described(span)}; it must be (smallest, largest) or a jaxclear.catalogue."
        )
    low, high = span
    check_number(f"smallest {what}", low, **({"above": 0} if kind == TOLERANCE else {}))
    check_number(f"largest {what}", high, above=float(low))
    return Choice(kind, index, float(low), float(high))
