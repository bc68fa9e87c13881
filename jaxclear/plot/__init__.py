"""Figures of runs and studies: `jaxclear.plot`. Every function returns a matplotlib figure and
neither shows nor saves it; given axes as `ax`, it draws in them and returns them. `animate` makes
a page of a run that moves.
"""

from jaxclear.ground.argument_errors import imported_names, nothing_else
from jaxclear.plot.animation import animate as animate
from jaxclear.plot.drawing import drawing as drawing
from jaxclear.plot.identification import identification as identification
from jaxclear.plot.identification import remaining_life as remaining_life
from jaxclear.plot.life import design as design
from jaxclear.plot.life import largest as largest
from jaxclear.plot.life import pareto_front as pareto_front
from jaxclear.plot.life import steady_cycle as steady_cycle
from jaxclear.plot.life import wear_life as wear_life
from jaxclear.plot.life import wear_life_sample as wear_life_sample
from jaxclear.plot.motion import angular_velocity as angular_velocity
from jaxclear.plot.motion import displacement as displacement
from jaxclear.plot.motion import end_centres as end_centres
from jaxclear.plot.motion import hysteresis as hysteresis
from jaxclear.plot.motion import journal_ends as journal_ends
from jaxclear.plot.motion import journal_orbit as journal_orbit
from jaxclear.plot.motion import modes as modes
from jaxclear.plot.motion import path as path
from jaxclear.plot.motion import pointing_budget as pointing_budget
from jaxclear.plot.overview import overview as overview
from jaxclear.plot.overview import positions as positions
from jaxclear.plot.overview import result as result
from jaxclear.plot.signal import bifurcation as bifurcation
from jaxclear.plot.signal import phase_portrait as phase_portrait
from jaxclear.plot.signal import poincare_section as poincare_section
from jaxclear.plot.signal import spectrum as spectrum
from jaxclear.plot.studies import corrected_statistics as corrected_statistics
from jaxclear.plot.studies import error_budget as error_budget
from jaxclear.plot.studies import monte_carlo as monte_carlo
from jaxclear.plot.studies import multi_fidelity as multi_fidelity
from jaxclear.plot.studies import reliability as reliability
from jaxclear.plot.studies import screening as screening
from jaxclear.plot.studies import sensitivity as sensitivity
from jaxclear.plot.studies import shapley_effects as shapley_effects
from jaxclear.plot.studies import sobol_indices as sobol_indices
from jaxclear.plot.studies import surface as surface
from jaxclear.plot.studies import sweep as sweep
from jaxclear.plot.studies import work_precision as work_precision
from jaxclear.plot.studies import worst_case as worst_case
from jaxclear.plot.wear import wear_surface as wear_surface
from jaxclear.plot.wear import wear_unrolled as wear_unrolled

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.plot", __all__)
