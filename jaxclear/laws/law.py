"""What all laws share: numbers with units and ranges, given by name.

Two laws of one family may list their numbers in different order (friction.Coulomb, ThreeZone), so a
number without a name is refused. Laws, materials and fits may be given by position.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxclear.ground.quantity import AbstractQuantified, concrete
from jaxclear.ground.wording import described, public_name

NUMBERS = (int, float, np.number, np.ndarray, jax.Array)


class AbstractLaw(AbstractQuantified):
    """A law of one contact point, or a part of one."""

    def __new__(cls, *slots: Any, **numbers: Any):
        for slot, name in zip(slots, cls.__dataclass_fields__, strict=False):
            if isinstance(slot, NUMBERS):
                raise ValueError(
                    f"{public_name(cls)} takes its numbers by name: "
                    f"{cls.__name__}({name}={described(slot)})."
                )
        return eqx.Module.__new__(cls)


def check_increasing(law: AbstractLaw, smaller: str, larger: str) -> None:
    """Raises `ValueError` unless one number of a law is below another.

    Fits and numbers that are being traced pass.

    Args:
        law: with both numbers.
        smaller, larger: names of its fields.
    """
    low, high = getattr(law, smaller), getattr(law, larger)
    if isinstance(low, eqx.Module) or isinstance(high, eqx.Module):
        return
    low, high = concrete(low), concrete(high)
    if low is not None and high is not None and low >= high:
        unit = law.__dataclass_fields__[smaller].metadata["unit"]
        raise ValueError(
            f"{public_name(type(law))} has {smaller} = {low:g} {unit} and {larger} = {high:g} "
            f"{unit}; the first must be below the second."
        )
