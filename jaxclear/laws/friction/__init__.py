"""Friction laws, `jaxclear.friction`: how much a contact point resists sliding.

Slip laws are functions of the sliding speed, bristle laws remember a deflection, Coulomb's law is
set-valued. A new law is a subclass of one of the abstract bases and serves every formulation.
"""

from jaxclear.ground.argument_errors import imported_names, nothing_else
from jaxclear.laws.friction.base import AbstractForceFriction as AbstractForceFriction
from jaxclear.laws.friction.base import AbstractFrictionLaw as AbstractFrictionLaw
from jaxclear.laws.friction.base import AbstractSetValuedFriction as AbstractSetValuedFriction
from jaxclear.laws.friction.base import Coulomb as Coulomb
from jaxclear.laws.friction.bristle import AbstractBristleFriction as AbstractBristleFriction
from jaxclear.laws.friction.bristle import Dahl as Dahl
from jaxclear.laws.friction.bristle import LuGre as LuGre
from jaxclear.laws.friction.slip import AbstractSlipFriction as AbstractSlipFriction
from jaxclear.laws.friction.slip import AdamsStep as AdamsStep
from jaxclear.laws.friction.slip import Ambrosio as Ambrosio
from jaxclear.laws.friction.slip import BengisuAkay as BengisuAkay
from jaxclear.laws.friction.slip import CoulombTanh as CoulombTanh
from jaxclear.laws.friction.slip import Stribeck as Stribeck
from jaxclear.laws.friction.slip import ThreeZone as ThreeZone
from jaxclear.laws.friction.slip import Threlfall as Threlfall

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.friction", __all__)
