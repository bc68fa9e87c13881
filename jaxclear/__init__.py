"""jaxclear: differentiable simulation of mechanisms whose joints have clearance, contact, friction
and wear.

Importing it sets two things for the process: JAX's `jax_enable_x64`, and one compiler option in the
environment's XLA_FLAGS, unless those say otherwise. It starts no device and leaves logging alone.
"""

import gc
import os
import sys
from types import ModuleType

import jax

# The rest is many objects that stay: Python's collector need not look at all of JAX's again and
# again meanwhile, which took a tenth of the import. Where someone else has set some aside they are
# left alone.
_SETS_ASIDE = gc.get_freeze_count() == 0
if _SETS_ASIDE:
    gc.freeze()

# An option of XLA's CPU compiler, read when JAX first computes: loops over a state of up to 100 MB
# (instead of 1 kB) become one kernel, where otherwise every operation of the body is dispatched by
# itself. Steps of the four-bar that XLA ran were at least 7 times faster by it. Other
# xla_backend_extra_options, set by a user, are left alone; JAXCLEAR_PLAIN_XLA=1 switches it off.
# (Its neighbour xla_cpu_use_multi_output_fusion is faster still, but aborts the process on some
# differentiated programs of jaxlib 0.10.2 and never ends compiling others.)
_COMPILER_OPTION = "xla_cpu_small_while_loop_byte_threshold=100000000"
_FLAGS = os.environ.get("XLA_FLAGS", "").strip()
# A value that does not begin with a dash is the name of a file of flags.
_OPEN = _FLAGS == "" or (_FLAGS.startswith("-") and "xla_backend_extra_options" not in _FLAGS)
if _OPEN and os.environ.get("JAXCLEAR_PLAIN_XLA", "0") in ("", "0"):
    os.environ["XLA_FLAGS"] = f"{_FLAGS} --xla_backend_extra_options={_COMPILER_OPTION}".strip()

# The one place where float64 is switched on: gaps of 1e-5 m beside coordinates of 1 m have no
# meaning in float32.
jax.config.update("jax_enable_x64", True)

from jaxclear import complementarity, mesh
from jaxclear import formulations as formulation
from jaxclear import integrators as integrator
from jaxclear.components import clearance, coupling, drive, joint, load
from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.function_of_time import AbstractFunctionOfTime, TimeTable
from jaxclear.components.wear_map import AbstractWearMap, Wearing
from jaxclear.files.model_import import ImportedSoft, NotImported, read_mjcf, read_shapes, read_urdf
from jaxclear.files.scene import Scene, read_scene, scene_schema, write_scene
from jaxclear.ground import numerics, pose
from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.datasets import installed
from jaxclear.ground.outcome import why_unknown
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity, vector
from jaxclear.laws import contact, flank, friction, material, stiffness, wear
from jaxclear.laws.material import Material
from jaxclear.multibody.assemblies import assemblies
from jaxclear.multibody.assembly import assemble
from jaxclear.multibody.heated import heated
from jaxclear.multibody.loops import Baumgarte, Projection
from jaxclear.multibody.magnitudes import UnusualMagnitude
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.native.as_written import remember
from jaxclear.results import response, signal
from jaxclear.results.pointing_error import pointing_error
from jaxclear.results.state_history import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.saving import Saving
from jaxclear.simulation.simulate import SimulationError, simulate
from jaxclear.statics.position_path import positions
from jaxclear.statics.seated import seated
from jaxclear.studies import distribution, limit_state, sensor
from jaxclear.studies.advice import PilotSettings, advise
from jaxclear.studies.base import AbstractProblem, AbstractVariable
from jaxclear.studies.campaign.campaign import campaign, open_campaign
from jaxclear.studies.design import catalogue, cost, limit
from jaxclear.studies.design.design import design, design_front
from jaxclear.studies.design.search import DesignSettings
from jaxclear.studies.fidelity.multi_fidelity import multi_fidelity
from jaxclear.studies.function_problem import Dimension, FunctionProblem
from jaxclear.studies.identification.identify import identify
from jaxclear.studies.identification.measurement import Measurement
from jaxclear.studies.identification.remaining_life import remaining_life
from jaxclear.studies.life.derivative import wear_life_derivatives
from jaxclear.studies.life.life_problem import AbstractLifeResponse, LifeEnd, LifeProblem, LifeUntil
from jaxclear.studies.life.settled import settled
from jaxclear.studies.life.wear_life import wear_life, wear_lives
from jaxclear.studies.monte_carlo import monte_carlo
from jaxclear.studies.position_problem import PositionProblem
from jaxclear.studies.problem import Problem
from jaxclear.studies.reliability.reliability import reliability
from jaxclear.studies.screening import screening
from jaxclear.studies.sensitivity.sensitivity import sensitivity
from jaxclear.studies.statistics.shapley import shapley_effects
from jaxclear.studies.statistics.sobol_indices import sobol_indices
from jaxclear.studies.surface.correction import corrected
from jaxclear.studies.surface.surface import surface
from jaxclear.studies.sweep import sweep
from jaxclear.studies.variable import (
    AbstractMechanismVariable,
    Condition,
    Heating,
    Variable,
)
from jaxclear.studies.worst_case import worst_case

from jaxclear import scenes  # isort: skip

__version__ = installed("jaxclear")

# The name under which the laws of cylinders used to stand.
conformal = contact

__all__ = [
    "AbstractFunctionOfTime",
    "AbstractLifeResponse",
    "AbstractMechanismVariable",
    "AbstractProblem",
    "AbstractQuantified",
    "AbstractVariable",
    "AbstractWearMap",
    "Baumgarte",
    "Body",
    "Condition",
    "Connection",
    "DesignSettings",
    "Dimension",
    "FunctionProblem",
    "Heating",
    "ImportedSoft",
    "LifeEnd",
    "LifeProblem",
    "LifeUntil",
    "Marker",
    "Material",
    "Measurement",
    "Mechanism",
    "NotImported",
    "PilotSettings",
    "PositionProblem",
    "Problem",
    "Projection",
    "Saving",
    "Scalar",
    "Scene",
    "SimulationError",
    "State",
    "TimeTable",
    "Trajectory",
    "UnusualMagnitude",
    "Variable",
    "Wearing",
    "advise",
    "assemble",
    "assemblies",
    "campaign",
    "catalogue",
    "clearance",
    "complementarity",
    "contact",
    "corrected",
    "cost",
    "coupling",
    "design",
    "design_front",
    "distribution",
    "drive",
    "flank",
    "formulation",
    "friction",
    "heated",
    "identify",
    "integrator",
    "joint",
    "limit",
    "limit_state",
    "load",
    "material",
    "mesh",
    "monte_carlo",
    "multi_fidelity",
    "numerics",
    "open_campaign",
    "pointing_error",
    "pose",
    "positions",
    "quantity",
    "read_mjcf",
    "read_scene",
    "read_shapes",
    "read_urdf",
    "reliability",
    "remaining_life",
    "response",
    "scene_schema",
    "scenes",
    "screening",
    "seated",
    "sensitivity",
    "sensor",
    "settled",
    "shapley_effects",
    "signal",
    "simulate",
    "sobol_indices",
    "stiffness",
    "surface",
    "sweep",
    "vector",
    "wear",
    "wear_life",
    "wear_life_derivatives",
    "wear_lives",
    "why_unknown",
    "worst_case",
    "write_scene",
]
__getattr__, __dir__ = nothing_else("jaxclear", __all__)
# `from jaxclear.joint import Revolute` works as `jaxclear.joint.Revolute` does.
_named = [(f"jaxclear.{name}", globals()[name]) for name in (*__all__, "conformal")]
for _path, _place in _named:
    if isinstance(_place, ModuleType):
        sys.modules.setdefault(_path, _place)
        _named += [(f"{_path}.{name}", getattr(_place, name)) for name in _place.__all__]
remember()
if _SETS_ASIDE:
    gc.unfreeze()
