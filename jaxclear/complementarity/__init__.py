"""Complementarity problems and their solvers: `jaxclear.complementarity`.

A problem is posed and handed to a solver's `solve`, which returns a `Solution` that says how it
ended. `FrictionContact` (a step through rigid contact) is solved by `ProjectedGaussSeidel`,
`JointFriction` (a step of joints that always touch) by `BoxedGaussSeidel`. `InteriorPoint` relaxes
linear problems to z w = kappa and so has smooth derivatives.
"""

from jaxclear.complementarity.friction_contact import FrictionContact as FrictionContact
from jaxclear.complementarity.interior_point import InteriorPoint as InteriorPoint
from jaxclear.complementarity.joint_friction import BoxedGaussSeidel as BoxedGaussSeidel
from jaxclear.complementarity.joint_friction import JointFriction as JointFriction
from jaxclear.complementarity.problem import LCP as LCP
from jaxclear.complementarity.problem import AbstractLinearProblem as AbstractLinearProblem
from jaxclear.complementarity.problem import AbstractProblem as AbstractProblem
from jaxclear.complementarity.problem import AbstractSolver as AbstractSolver
from jaxclear.complementarity.problem import HorizontalLCP as HorizontalLCP
from jaxclear.complementarity.problem import Outcome as Outcome
from jaxclear.complementarity.problem import Solution as Solution
from jaxclear.complementarity.problem import natural_residual as natural_residual
from jaxclear.complementarity.projected_gauss_seidel import Iterate as Iterate
from jaxclear.complementarity.projected_gauss_seidel import (
    ProjectedGaussSeidel as ProjectedGaussSeidel,
)
from jaxclear.ground.argument_errors import imported_names, nothing_else

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.complementarity", __all__)
