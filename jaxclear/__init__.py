"""jaxclear: differentiable simulation of mechanisms whose joints have clearance, contact, friction
and wear.

Importing it sets two things for the process: JAX's `jax_enable_x64`, and one compiler option in the
environment's XLA_FLAGS, unless those say otherwise. It starts no device and leaves logging alone.
"""

import gc
import importlib
import os
import sys
import time
from types import ModuleType
from typing import TYPE_CHECKING, Any

import jax

# The rest of the package is read after this [s since 1970].
_READ_AFTER = time.time()
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

# The rest is many objects that stay: Python's collector looks at them again and again meanwhile,
# which took a tenth of the import.
_COLLECTS = gc.isenabled()
gc.disable()
try:
    from jaxclear import complementarity
    from jaxclear import formulations as formulation
    from jaxclear import integrators as integrator
    from jaxclear.components import clearance, coupling, drive, joint, load
    from jaxclear.components.beam import Beam
    from jaxclear.components.body import Body, Connection, Marker
    from jaxclear.components.function_of_time import AbstractFunctionOfTime, TimeTable
    from jaxclear.components.wear_map import AbstractWearMap, Wearing
    from jaxclear.ground import numerics, pose
    from jaxclear.ground.argument_errors import nothing_else
    from jaxclear.ground.datasets import installed
    from jaxclear.ground.outcome import explain_nan
    from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity, vector
    from jaxclear.laws import contact, film, flank, friction, material, section, stiffness, wear
    from jaxclear.laws.material import Material
    from jaxclear.multibody.assemblies import assemblies
    from jaxclear.multibody.assembly import assemble
    from jaxclear.multibody.loops import Baumgarte, Projection
    from jaxclear.multibody.magnitudes import UnusualMagnitude
    from jaxclear.multibody.mechanism import Mechanism
    from jaxclear.multibody.thermal_expansion import apply_thermal_expansion
    from jaxclear.native.source_check import remember
    from jaxclear.results import response, signal
    from jaxclear.results.pointing_error import pointing_error
    from jaxclear.results.state_history import State
    from jaxclear.results.trajectory import Trajectory
    from jaxclear.simulation.saving import Saving
    from jaxclear.simulation.simulate import SimulationError, simulate

    from jaxclear import scenes  # isort: skip
finally:
    # By this all that there is counts as old, unless someone else has set things aside.
    if _COLLECTS and gc.get_freeze_count() == 0:
        gc.freeze()
        gc.unfreeze()
    if _COLLECTS:
        gc.enable()

if TYPE_CHECKING:
    from jaxclear.lazy_names import *
    from jaxclear.plot.live import view

__version__ = installed("jaxclear")

__all__ = [
    "AbstractExperiment",
    "AbstractFunctionOfTime",
    "AbstractMechanismVariable",
    "AbstractQuantified",
    "AbstractVariable",
    "AbstractWearMap",
    "Baumgarte",
    "Beam",
    "Body",
    "Condition",
    "Connection",
    "DesignSettings",
    "Dimension",
    "Drawing",
    "FunctionProblem",
    "Heating",
    "ImportedSoft",
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
    "apply_thermal_expansion",
    "assemble",
    "assemblies",
    "campaign",
    "catalogue",
    "clearance",
    "complementarity",
    "contact",
    "corrected_statistics",
    "cost",
    "coupling",
    "design",
    "distribution",
    "drive",
    "explain_nan",
    "export_fmu",
    "film",
    "fit",
    "flank",
    "formulation",
    "friction",
    "identify",
    "integrator",
    "joint",
    "largest",
    "limit",
    "limit_state",
    "load",
    "material",
    "mesh",
    "monte_carlo",
    "multi_fidelity",
    "numerics",
    "open_campaign",
    "pareto_front",
    "pointing_error",
    "pose",
    "positions",
    "process",
    "quantity",
    "read_mjcf",
    "read_scene",
    "read_shapes",
    "read_urdf",
    "reliability",
    "remaining_life",
    "response",
    "resting_state",
    "scene_schema",
    "scenes",
    "screening",
    "section",
    "sensitivity",
    "sensor",
    "shapley_effects",
    "signal",
    "simulate",
    "sobol_indices",
    "steady_cycle",
    "stiffness",
    "surface",
    "sweep",
    "tolerance",
    "vector",
    "view",
    "wear",
    "wear_life",
    "wear_life_derivatives",
    "wear_life_sample",
    "worst_case",
    "write_scene",
]
_refused, __dir__ = nothing_else("jaxclear", __all__)
# What `lazy_names` offers; of it, what is a module.
_LATER = set(__all__) - set(globals())
_MODULES_LATER = (
    "catalogue",
    "cost",
    "distribution",
    "limit",
    "limit_state",
    "sensor",
    "tolerance",
)


class _Later(ModuleType):
    """A module that is loaded once a name of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") and name != "__all__":
            raise AttributeError(name)
        return getattr(getattr(sys.modules[__name__], self.__name__.rpartition(".")[2]), name)


if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        if name not in _LATER:
            return _refused(name)
        if name == "view":  # which loads matplotlib, as no other name does
            return importlib.import_module("jaxclear.plot.live").view
        later = importlib.import_module("jaxclear.lazy_names")
        globals().update((one, getattr(later, one)) for one in _LATER - {"view"})
        _LATER.intersection_update({"view"})
        _named(*_MODULES_LATER)
        remember()
        return globals()[name]


def _named(*names: str) -> None:
    """`from jaxclear.joint import Revolute` works as `jaxclear.joint.Revolute` does."""
    rest = [(f"{__name__}.{name}", globals()[name]) for name in names]
    for path, place in rest:
        if isinstance(place, ModuleType):
            if isinstance(sys.modules.get(path), _Later):
                del sys.modules[path]
            sys.modules.setdefault(path, place)
            rest += [(f"{path}.{name}", getattr(place, name)) for name in place.__all__]


_named(*(name for name in __all__ if name not in _LATER))
sys.modules |= {f"{__name__}.{name}": _Later(f"{__name__}.{name}") for name in _MODULES_LATER}
# What the package is made of before more of it is asked for.
LOADED = frozenset(name for name in sys.modules if name.partition(".")[0] == __name__)
remember()
