"""What varies about a mechanism and is no number of it, such as a temperature."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax

from jaxclear.ground.arguments import check_number, expect
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.ground.wording import described
from jaxclear.multibody.heated import heated
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.studies.base import one_distribution
from jaxclear.studies.distribution import AbstractDistribution
from jaxclear.studies.variable import AbstractMechanismVariable

__all__ = ["Condition", "Heating"]


@dataclasses.dataclass(frozen=True)
class Heating:
    """What a temperature does, for a `Condition` to act by: `heated(mechanism, rise, expansion)`
    for a `rise` [K] above the drawing's. `expansion`: coefficient of linear expansion [1/K], one
    for all, or by body. It is data: a scene file holds it, and no function of one's own.
    """

    expansion: float | tuple[tuple[str, float], ...]

    def __init__(self, expansion: float | Mapping[str, float]):
        if isinstance(expansion, Mapping):
            if not expansion:
                raise ValueError(
                    "expansion of a Heating is empty; it must hold the coefficient [1/K] of one "
                    "body at least, or be one number for all."
                )
            for name, value in expansion.items():
                check_number(f'expansion of body "{name}" in a Heating', value, "1/K")
            own: Any = tuple((str(name), float(value)) for name, value in expansion.items())
        else:
            check_number("expansion of a Heating", expansion, "1/K")
            own = float(expansion)
        object.__setattr__(self, "expansion", own)

    def __call__(self, mechanism: Mechanism, rise: Any) -> Mechanism:
        """The mechanism at this rise [K]."""
        own = self.expansion
        return heated(mechanism, rise, dict(own) if isinstance(own, tuple) else own)


class Condition(AbstractMechanismVariable):
    """What varies and is no number of the mechanism itself, such as a temperature:
    `acts(mechanism, value)` returns the mechanism as it is under the condition, all other variables
    set before. `Heating` is such a function for temperatures.

    `nominal` and `unit` are the condition's own; `acts(mechanism, nominal)` is the mechanism as it
    is studied at nominal. `distribution` or `tolerance` as of a `Variable`.
    """

    nominal: Scalar = quantity(unit="(its unit)", meaning="nominal value")
    distribution: AbstractDistribution
    acts: Callable[[Mechanism, Any], Mechanism] = eqx.field(static=True)
    unit: str = eqx.field(static=True)

    def __init__(
        self,
        acts: Callable[[Mechanism, Any], Mechanism],
        nominal: Any,
        distribution: AbstractDistribution | None = None,
        *,
        tolerance: float | None = None,
        unit: str = "K",
    ):
        if not callable(acts):
            raise ValueError(
                f"acts of a Condition is {described(acts)}; it must be a function of a mechanism "
                "and the condition's value that returns a mechanism."
            )
        if tolerance is not None:
            check_number("tolerance of a Condition", tolerance, above=0)
        expect(unit, str, "unit of a Condition", 'a text, such as "K"')
        self.acts, self.nominal, self.unit = acts, nominal, unit
        self.distribution = one_distribution("Condition", distribution, tolerance)

    def leaves(self, mechanism):
        return []

    def nominal_in(self, mechanism):
        return self.nominal

    def unit_in(self, mechanism):
        return self.unit

    def put(self, mechanism, value):
        return mechanism

    def followed(self, mechanism, value):
        return self.acts(mechanism, value)

    def check(self, name, mechanism):
        found = self.acts(mechanism, self.nominal)
        expect(found, Mechanism, f'what condition "{name}" makes of the mechanism', "a mechanism")
        if jax.tree.structure(found) != jax.tree.structure(mechanism):
            raise ValueError(
                f'condition "{name}" makes another mechanism (other parts, not other numbers); '
                "change numbers only, as with equinox.tree_at."
            )

    def told(self, name, mechanism):
        return {f'what "{name}" does': self.acts, f'nominal of "{name}"': self.nominal}
