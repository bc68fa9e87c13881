"""Complementarity problems and their solvers: `jaxclear.complementarity`.

A problem is posed (LCP, MixedLCP, HorizontalLCP, FrictionContact) and handed to a solver's `solve`,
which returns a `Solution` that says how it ended. `Lemke` is exact for small problems;
`ProjectedGaussSeidel` knows spatial friction cones; `SemismoothNewton` is fast near a solution;
`InteriorPoint` relaxes to z w = kappa and so has smooth derivatives.
"""

from jaxclear.complementarity.friction_cone import FrictionContact, ProjectedGaussSeidel
from jaxclear.complementarity.interior_point import InteriorPoint
from jaxclear.complementarity.lemke import Lemke
from jaxclear.complementarity.problem import (
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
from jaxclear.complementarity.semismooth_newton import SemismoothNewton

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
