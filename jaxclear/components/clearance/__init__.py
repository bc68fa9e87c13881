"""Joints with clearance, one file each: where the parts touch, and what they become in each
formulation.

A joint of one's own derives from `AbstractClearance`; with a permanent form of its own also from
`AbstractPermanentJoint`.
"""

from jaxclear.components.clearance.backlash import Backlash
from jaxclear.components.clearance.ball import BallSocket, PermanentSpherical
from jaxclear.components.clearance.base import (
    SITUATIONS,
    AbstractClearance,
    AbstractPermanentJoint,
    ContactCandidate,
    ContactLaws,
    situation,
)
from jaxclear.components.clearance.guide import PermanentPrismatic, SliderGuide
from jaxclear.components.clearance.journal import Flange, JournalBearing, PlanarJournalBearing
from jaxclear.components.clearance.journal_base import (
    AbstractJournalBearing,
    Lobes,
    PermanentRevolute,
)
from jaxclear.components.joint.base import CarriedContact, CarryingEnd, carried_load
from jaxclear.ground.argument_errors import nothing_else

__all__ = [
    "SITUATIONS",
    "AbstractClearance",
    "AbstractJournalBearing",
    "AbstractPermanentJoint",
    "Backlash",
    "BallSocket",
    "CarriedContact",
    "CarryingEnd",
    "ContactCandidate",
    "ContactLaws",
    "Flange",
    "JournalBearing",
    "Lobes",
    "PermanentPrismatic",
    "PermanentRevolute",
    "PermanentSpherical",
    "PlanarJournalBearing",
    "SliderGuide",
    "carried_load",
    "situation",
]
__getattr__, __dir__ = nothing_else("jaxclear.clearance", __all__)
