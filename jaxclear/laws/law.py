"""What all laws share: numbers with units and ranges, given by name.

Two laws of one family may list their numbers in different order (friction.Coulomb, ThreeZone), so a
number without a name is refused. Laws, materials and fits may be given by position.
"""

from typing import Any

import equinox as eqx

from jaxclear.ground.quantity import AbstractQuantified, public_name


class AbstractLaw(AbstractQuantified):
    """A law of one contact point, or a part of one."""

    def __new__(cls, *slots: Any, **numbers: Any):
        for slot, name in zip(slots, cls.__dataclass_fields__, strict=False):
            if not (slot is None or isinstance(slot, eqx.Module)):
                raise ValueError(
                    f"{public_name(cls)} takes its numbers by name: {cls.__name__}({name}={slot})."
                )
        return eqx.Module.__new__(cls)
