"""Complementarity problems and their solvers: `jaxclear.complementarity`.

A problem is posed and handed to a solver's `solve`, which returns a `Solution` that says how it
ended. `FrictionContact` (a step through rigid contact) is solved by `ProjectedGaussSeidel`,
`JointFriction` (a step of joints that always touch) by `BoxedGaussSeidel`. `InteriorPoint` relaxes
linear problems to z w = kappa and so has smooth derivatives.
"""

from jaxclear.complementarity.friction_contact import FrictionContact
from jaxclear.complementarity.interior_point import InteriorPoint
from jaxclear.complementarity.joint_friction import BoxedGaussSeidel, JointFriction
from jaxclear.complementarity.problem import (
    LCP,
    AbstractLinearProblem,
    AbstractProblem,
    AbstractSolver,
    HorizontalLCP,
    Outcome,
    Solution,
    natural_residual,
)
from jaxclear.complementarity.projected_gauss_seidel import Iterate, ProjectedGaussSeidel
from jaxclear.ground.argument_errors import nothing_else

__all__ = [
    "LCP",
    "AbstractLinearProblem",
    "AbstractProblem",
    "AbstractSolver",
    "BoxedGaussSeidel",
    "FrictionContact",
    "HorizontalLCP",
    "InteriorPoint",
    "Iterate",
    "JointFriction",
    "Outcome",
    "ProjectedGaussSeidel",
    "Solution",
    "natural_residual",
]
__getattr__, __dir__ = nothing_else("jaxclear.complementarity", __all__)
