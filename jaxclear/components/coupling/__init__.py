"""Couplings, one equation or force between the motions of joints or bodies (`base`)."""

from jaxclear.components.coupling.base import AbstractBodyCoupling as AbstractBodyCoupling
from jaxclear.components.coupling.base import (
    AbstractCoordinateCoupling as AbstractCoordinateCoupling,
)
from jaxclear.components.coupling.base import AbstractCoupling as AbstractCoupling
from jaxclear.components.coupling.base import CoordinateTerm as CoordinateTerm
from jaxclear.components.coupling.base import Motor as Motor
from jaxclear.components.coupling.cam import Cam as Cam
from jaxclear.components.coupling.coordinates import Differential as Differential
from jaxclear.components.coupling.coordinates import Latch as Latch
from jaxclear.components.coupling.coordinates import Ratio as Ratio
from jaxclear.components.coupling.force import AbstractForceCoupling as AbstractForceCoupling
from jaxclear.components.coupling.losses import Efficiency as Efficiency
from jaxclear.components.coupling.meshing import Belt as Belt
from jaxclear.components.coupling.meshing import Gear as Gear
from jaxclear.components.coupling.meshing import Rack as Rack
from jaxclear.components.coupling.meshing import Screw as Screw
from jaxclear.components.coupling.one_way import OneWay as OneWay
from jaxclear.components.coupling.rope import Capstan as Capstan
from jaxclear.components.coupling.rope import Rope as Rope
from jaxclear.ground.argument_errors import imported_names, nothing_else

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.coupling", __all__)
