"""Figures of runs and studies: `jaxclear.plot`. Every function returns a matplotlib figure and
neither shows nor saves it; given axes as `ax`, it draws in them and returns them. `animate` makes
a page of a run that moves.
"""

from jaxclear.ground.answering import nothing_else
from jaxclear.plot.animation import animate
from jaxclear.plot.cycles import settled, wear_lives
from jaxclear.plot.design import design, design_front
from jaxclear.plot.joints import hysteresis, journal_orbit
from jaxclear.plot.life import wear_life
from jaxclear.plot.modes import modes
from jaxclear.plot.motion import angular_velocity, displacement, end_centres, journal_ends
from jaxclear.plot.overview import overview, positions, result
from jaxclear.plot.pointing import pointing_budget
from jaxclear.plot.portraits import bifurcation, phase_portrait, poincare_section
from jaxclear.plot.shares import (
    corrected,
    error_budget,
    multi_fidelity,
    reliability,
    shapley_effects,
    sobol_indices,
    surface,
    worst_case,
)
from jaxclear.plot.spectrum import spectrum
from jaxclear.plot.studies import monte_carlo, sensitivity, sweep, work_precision
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
    "result",
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
