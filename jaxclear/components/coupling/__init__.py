"""Couplings, one equation or force between the motions of joints or bodies (`base`)."""

from jaxclear.components.coupling.base import (
    AbstractBodyCoupling,
    AbstractCoordinateCoupling,
    AbstractCoupling,
    CoordinateTerm,
    Motor,
)
from jaxclear.components.coupling.cam import Cam
from jaxclear.components.coupling.coordinates import Differential, Latch, Ratio
from jaxclear.components.coupling.force import AbstractForceCoupling
from jaxclear.components.coupling.losses import Efficiency
from jaxclear.components.coupling.meshing import Belt, Gear, Rack, Screw
from jaxclear.components.coupling.one_way import OneWay
from jaxclear.components.coupling.rope import Capstan, Rope
from jaxclear.ground.argument_errors import nothing_else

__all__ = [
    "AbstractBodyCoupling",
    "AbstractCoordinateCoupling",
    "AbstractCoupling",
    "AbstractForceCoupling",
    "Belt",
    "Cam",
    "Capstan",
    "CoordinateTerm",
    "Differential",
    "Efficiency",
    "Gear",
    "Latch",
    "Motor",
    "OneWay",
    "Rack",
    "Ratio",
    "Rope",
    "Screw",
]
__getattr__, __dir__ = nothing_else("jaxclear.coupling", __all__)
