"""Complementarity problems and their solvers: `jaxclear.complementarity`.

A problem is posed (LCP, MixedLCP, HorizontalLCP, FrictionContact) and handed to a solver's `solve`, which returns a
`Solution` that says how it ended. `Lemke` is exact for small problems; `ProjectedGaussSeidel` knows spatial friction
cones; `SemismoothNewton` is fast near a solution; `InteriorPoint` relaxes to z w = kappa and so has smooth derivatives.
"""

from jaxclear.scene.complementarity_newton import SemismoothNewton
from jaxclear.scene.complementarity_problem import (
    LCP,
    LIMIT,
    NOT_FINITE,
    OUTCOMES,
    RAY,
    SOLVED,
    STALLED,
    AbstractProblem,
    AbstractSolver,
    HorizontalLCP,
    MixedLCP,
    Solution,
    natural_residual,
)
from jaxclear.scene.interior_point import InteriorPoint
from jaxclear.scene.pivoting import Lemke
from jaxclear.scene.projection import FrictionContact, ProjectedGaussSeidel

__all__ = [
    "LCP",
    "LIMIT",
    "NOT_FINITE",
    "OUTCOMES",
    "RAY",
    "SOLVED",
    "STALLED",
    "AbstractProblem",
    "AbstractSolver",
    "FrictionContact",
    "HorizontalLCP",
    "InteriorPoint",
    "Lemke",
    "MixedLCP",
    "ProjectedGaussSeidel",
    "SemismoothNewton",
    "Solution",
    "natural_residual",
]
