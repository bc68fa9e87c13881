"""Figures of runs and studies: `jaxclear.plot`. Every function returns a matplotlib figure and
neither shows nor saves it.
"""

from jaxclear.ground.answering import nothing_else
from jaxclear.plot.design import design, design_front
from jaxclear.plot.life import wear_life
from jaxclear.plot.modes import modes
from jaxclear.plot.motion import angular_velocity, displacement, end_centres, journal_ends
from jaxclear.plot.pointing import pointing_budget
from jaxclear.plot.studies import monte_carlo, sensitivity, work_precision
from jaxclear.plot.wear import wear_surface, wear_unrolled

__all__ = [
    "angular_velocity",
    "design",
    "design_front",
    "displacement",
    "end_centres",
    "journal_ends",
    "modes",
    "monte_carlo",
    "pointing_budget",
    "sensitivity",
    "wear_life",
    "wear_surface",
    "wear_unrolled",
    "work_precision",
]
__getattr__ = nothing_else("jaxclear.plot", __all__)
