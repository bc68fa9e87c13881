"""Every number of a mechanism, in the unit of the joint it is of: a coordinate is in rad or m as
its joint turns or slides.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from jaxclear.components.coupling import AbstractCoordinateCoupling
from jaxclear.ground.quantity import numbers
from jaxclear.multibody.topology import coordinate_joint

# What the meaning of a number says of its unit where the joint slides that it is of, or acts on.
SLIDING = re.compile(r"\(([^()]+) for a sliding joint\)")


def own_numbers(mechanism: Any) -> Iterator[tuple[str, Any, Mapping[str, Any], str]]:
    """(name, value, metadata of its field, unit) of every number of a mechanism but those of its
    start, in definition order."""
    for part in ("bodies", "connections", "loads", "couplings"):
        for name, own in getattr(mechanism, part).items():
            along = slides(mechanism, name if part == "connections" else acted_on(own))
            for path, leaf, metadata in numbers(own, f'{part}["{name}"]'):
                yield path, leaf, metadata, unit_along(metadata, along)
    for path, leaf, metadata in numbers(mechanism.stabilisation, "stabilisation"):
        yield path, leaf, metadata, unit_along(metadata, False)


def coordinate_units(mechanism: Any, name: str) -> tuple[str, ...]:
    """Units of the coordinates in which a joint or body is spoken of; none where there are none."""
    try:
        return coordinate_joint(name, mechanism.bodies, mechanism.connections).units
    except (KeyError, ValueError):
        return ()


def acted_on(load: Any) -> str:
    """The joint on whose coordinate a load acts; "" for none."""
    return getattr(load, "connection", "")


def turns(mechanism: Any, coupling: Any) -> bool:
    """Whether what a coupling transmits is a torque: its first coordinate turns."""
    if not isinstance(coupling, AbstractCoordinateCoupling):
        return False
    return not slides(mechanism, coupling.joints()[0])


def slides(mechanism: Any, name: str) -> bool:
    """Whether a joint has the one coordinate along which it slides."""
    return coordinate_units(mechanism, name) == ("m",)


def unit_along(metadata: Mapping[str, Any], along: bool) -> str:
    """The unit of a number by its field; `along`: whether it is of a coordinate that slides."""
    found = SLIDING.search(metadata.get("meaning", "")) if along else None
    return metadata.get("unit", "1") if found is None else found[1]
