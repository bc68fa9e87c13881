"""How contact enters the equations of motion: `jaxclear.formulation`.

`CompliantContact` (forces follow from the state), `RigidContact` (percussions of bodies that do not
overlap), `PermanentContact` (joints that always touch). An integrator holds one. One of your own
derives from `AbstractFormulation` and needs an integrator that steps with it; what the steps here
are made of serves it too: a model, the middle of a step, contact rows, Delassus' operator, reports.
"""

from jaxclear.formulations.base import AbstractFormulation as AbstractFormulation
from jaxclear.formulations.base import ContactReport as ContactReport
from jaxclear.formulations.base import clearance_contact as clearance_contact
from jaxclear.formulations.base import model_of as model_of
from jaxclear.formulations.compliant import CompliantContact as CompliantContact
from jaxclear.formulations.contact_rows import TimeStep as TimeStep
from jaxclear.formulations.contact_rows import indentations as indentations
from jaxclear.formulations.contact_rows import middle_of_step as middle_of_step
from jaxclear.formulations.contact_rows import reports_of_means as reports_of_means
from jaxclear.formulations.delassus import DelassusOperator as DelassusOperator
from jaxclear.formulations.delassus import delassus_operator as delassus_operator
from jaxclear.formulations.loop_closing import closed as closed
from jaxclear.formulations.model import Instant as Instant
from jaxclear.formulations.model import Model as Model
from jaxclear.formulations.permanent import PermanentContact as PermanentContact
from jaxclear.formulations.rigid import RigidContact as RigidContact
from jaxclear.ground.argument_errors import imported_names, nothing_else
from jaxclear.multibody.kinematics import along as along

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.formulation", __all__)
