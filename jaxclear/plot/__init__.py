"""Figures of runs and studies: `jaxclear.plot`. Every function returns a matplotlib figure and
neither shows nor saves it; given axes as `ax`, it draws in them and returns them. `animate` makes
a page of a run that moves.
"""

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.plot.animation import animate
from jaxclear.plot.identification import identification, remaining_life
from jaxclear.plot.life import design, design_front, settled, wear_life, wear_lives
from jaxclear.plot.motion import (
    angular_velocity,
    displacement,
    end_centres,
    hysteresis,
    journal_ends,
    journal_orbit,
    modes,
    pointing_budget,
)
from jaxclear.plot.overview import overview, positions, result
from jaxclear.plot.signal import bifurcation, phase_portrait, poincare_section, spectrum
from jaxclear.plot.studies import (
    corrected,
    error_budget,
    monte_carlo,
    multi_fidelity,
    reliability,
    screening,
    sensitivity,
    shapley_effects,
    sobol_indices,
    surface,
    sweep,
    work_precision,
    worst_case,
)
from jaxclear.plot.wear import wear_surface, wear_unrolled

__all__ = [
    "angular_velocity",
    "animate",
    "bifurcation",
    "corrected",
    "design",
    "design_front",
    "displacement",
    "end_centres",
    "error_budget",
    "hysteresis",
    "identification",
    "journal_ends",
    "journal_orbit",
    "modes",
    "monte_carlo",
    "multi_fidelity",
    "overview",
    "phase_portrait",
    "poincare_section",
    "pointing_budget",
    "positions",
    "reliability",
    "remaining_life",
    "result",
    "screening",
    "sensitivity",
    "settled",
    "shapley_effects",
    "sobol_indices",
    "spectrum",
    "surface",
    "sweep",
    "wear_life",
    "wear_lives",
    "wear_surface",
    "wear_unrolled",
    "work_precision",
    "worst_case",
]
__getattr__, __dir__ = nothing_else("jaxclear.plot", __all__)
