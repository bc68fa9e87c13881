"""Friction laws, `jaxclear.friction`: how much a contact point resists sliding.

Slip laws are functions of the sliding speed, bristle laws remember a deflection, Coulomb's law is
set-valued. A new law is a subclass of one of the abstract bases and serves every formulation.
"""

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.laws.friction.base import (
    AbstractForceFriction,
    AbstractFrictionLaw,
    AbstractSetValuedFriction,
    Coulomb,
)
from jaxclear.laws.friction.bristle import AbstractBristleFriction, Dahl, LuGre
from jaxclear.laws.friction.slip import (
    AbstractSlipFriction,
    AdamsStep,
    Ambrosio,
    BengisuAkay,
    CoulombTanh,
    Stribeck,
    ThreeZone,
    Threlfall,
)

__all__ = [
    "AbstractBristleFriction",
    "AbstractForceFriction",
    "AbstractFrictionLaw",
    "AbstractSetValuedFriction",
    "AbstractSlipFriction",
    "AdamsStep",
    "Ambrosio",
    "BengisuAkay",
    "Coulomb",
    "CoulombTanh",
    "Dahl",
    "LuGre",
    "Stribeck",
    "ThreeZone",
    "Threlfall",
]
__getattr__, __dir__ = nothing_else("jaxclear.friction", __all__)
