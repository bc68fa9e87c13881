"""How contact enters the equations of motion: `jaxclear.formulation`.

`CompliantContact` (forces follow from the state), `RigidContact` (percussions of bodies that do not
overlap), `PermanentContact` (joints that always touch). An integrator holds one. One of your own
derives from `AbstractFormulation` and needs an integrator that steps with it; what the steps here
are made of serves it too: a model, the middle of a step, contact rows, Delassus' operator, reports.
"""

from jaxclear.formulations.base import (
    AbstractFormulation,
    ContactReport,
    clearance_contact,
    model_of,
)
from jaxclear.formulations.closing import closed
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.contact_rows import (
    TimeStep,
    indentations,
    middle_of_step,
    reports_of_means,
)
from jaxclear.formulations.delassus import DelassusOperator, delassus_operator
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent import PermanentContact
from jaxclear.formulations.rigid import RigidContact
from jaxclear.ground.argument_errors import nothing_else
from jaxclear.multibody.kinematics import along

__all__ = [
    "AbstractFormulation",
    "CompliantContact",
    "ContactReport",
    "DelassusOperator",
    "Instant",
    "Model",
    "PermanentContact",
    "RigidContact",
    "TimeStep",
    "along",
    "clearance_contact",
    "closed",
    "delassus_operator",
    "indentations",
    "middle_of_step",
    "model_of",
    "reports_of_means",
]
__getattr__, __dir__ = nothing_else("jaxclear.formulation", __all__)
