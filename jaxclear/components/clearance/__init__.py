"""Joints with clearance, one file each: where the parts touch, and what they become in each
formulation.

A joint of one's own derives from `AbstractClearance`; with a permanent form of its own also from
`AbstractPermanentJoint`.
"""

from jaxclear.components.clearance.backlash import Backlash as Backlash
from jaxclear.components.clearance.ball import BallSocket as BallSocket
from jaxclear.components.clearance.ball import PermanentSpherical as PermanentSpherical
from jaxclear.components.clearance.base import SITUATIONS as SITUATIONS
from jaxclear.components.clearance.base import AbstractClearance as AbstractClearance
from jaxclear.components.clearance.base import AbstractPermanentJoint as AbstractPermanentJoint
from jaxclear.components.clearance.base import ContactCandidate as ContactCandidate
from jaxclear.components.clearance.base import ContactLaws as ContactLaws
from jaxclear.components.clearance.base import situation as situation
from jaxclear.components.clearance.guide import PermanentPrismatic as PermanentPrismatic
from jaxclear.components.clearance.guide import SliderGuide as SliderGuide
from jaxclear.components.clearance.journal import Flange as Flange
from jaxclear.components.clearance.journal import JournalBearing as JournalBearing
from jaxclear.components.clearance.journal import PlanarJournalBearing as PlanarJournalBearing
from jaxclear.components.clearance.journal_base import (
    AbstractJournalBearing as AbstractJournalBearing,
)
from jaxclear.components.clearance.journal_base import Lobes as Lobes
from jaxclear.components.clearance.journal_base import PermanentRevolute as PermanentRevolute
from jaxclear.components.joint.base import CarriedContact as CarriedContact
from jaxclear.components.joint.base import CarryingEnd as CarryingEnd
from jaxclear.components.joint.base import carried_load as carried_load
from jaxclear.ground.argument_errors import imported_names, nothing_else

__all__ = imported_names(globals(), "SITUATIONS")
__getattr__, __dir__ = nothing_else("jaxclear.clearance", __all__)
