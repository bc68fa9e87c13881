"""Tolerances as a drawing states them, `jaxclear.tolerance`: fits, how parts scatter, and zones of
places and directions. `jaxclear.Drawing` puts them on a mechanism.
"""

from jaxclear.ground.argument_errors import imported_names, nothing_else
from jaxclear.studies.tolerance.fit import AbstractTolerance as AbstractTolerance
from jaxclear.studies.tolerance.fit import Capability as Capability
from jaxclear.studies.tolerance.fit import Fit as Fit
from jaxclear.studies.tolerance.zones import AbstractZone as AbstractZone
from jaxclear.studies.tolerance.zones import Angularity as Angularity
from jaxclear.studies.tolerance.zones import Coaxiality as Coaxiality
from jaxclear.studies.tolerance.zones import Parallelism as Parallelism
from jaxclear.studies.tolerance.zones import Perpendicularity as Perpendicularity
from jaxclear.studies.tolerance.zones import Position as Position
from jaxclear.studies.tolerance.zones import Size as Size

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.tolerance", __all__)
