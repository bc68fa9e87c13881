"""What is offered of studies, static positions, meshes and files: loaded when the first of these
names is asked for, as a run needs none. `jaxclear.__all__` lists them.
"""

from jaxclear import mesh
from jaxclear.files.model_import import ImportedSoft, NotImported, read_mjcf, read_shapes, read_urdf
from jaxclear.files.scene import Scene, read_scene, scene_schema, write_scene
from jaxclear.fmu.export import export_fmu
from jaxclear.statics.position_path import positions
from jaxclear.statics.resting_state import resting_state
from jaxclear.studies import distribution, limit_state, sensor, tolerance
from jaxclear.studies.advice import PilotSettings, advise
from jaxclear.studies.design import catalogue, cost, limit
from jaxclear.studies.design.design import design, pareto_front
from jaxclear.studies.design.largest import largest
from jaxclear.studies.design.search import DesignSettings
from jaxclear.studies.experiment import AbstractExperiment, AbstractVariable
from jaxclear.studies.fidelity.multi_fidelity import multi_fidelity
from jaxclear.studies.function_problem import Dimension, FunctionProblem
from jaxclear.studies.identification.identify import identify
from jaxclear.studies.identification.measurement import Measurement
from jaxclear.studies.identification.remaining_life import remaining_life
from jaxclear.studies.life.derivative import wear_life_derivatives
from jaxclear.studies.life.life_problem import LifeProblem, LifeUntil
from jaxclear.studies.life.steady_cycle import steady_cycle
from jaxclear.studies.life.wear_life import wear_life, wear_life_sample
from jaxclear.studies.monte_carlo import monte_carlo
from jaxclear.studies.position_problem import PositionProblem
from jaxclear.studies.problem import Problem
from jaxclear.studies.reliability.reliability import reliability
from jaxclear.studies.screening import screening
from jaxclear.studies.sensitivity.sensitivity import sensitivity
from jaxclear.studies.statistics.shapley import shapley_effects
from jaxclear.studies.statistics.sobol_indices import sobol_indices
from jaxclear.studies.store.campaign import campaign, open_campaign
from jaxclear.studies.surface.correction import corrected_statistics
from jaxclear.studies.surface.surface import surface
from jaxclear.studies.sweep import sweep
from jaxclear.studies.tolerance.drawing import Drawing
from jaxclear.studies.tolerance.fit import fit, process
from jaxclear.studies.variable import AbstractMechanismVariable, Condition, Heating, Variable
from jaxclear.studies.worst_case import worst_case
