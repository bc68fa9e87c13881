"""jaxclear: differentiable simulation of mechanisms whose joints have clearance, contact, friction
and wear.
"""

import os

import jax

# An option of XLA's CPU compiler, read when JAX first computes: loops over a state of up to 100 MB
# (instead of 1 kB) become one kernel, where otherwise every operation of the body is dispatched by
# itself. Steps of the four-bar are at least 7 times faster (benchmarks/claims/loops.py). A user's own
# xla_backend_extra_options are left alone; JAXCLEAR_PLAIN_XLA=1 switches it off. (Its neighbour
# xla_cpu_use_multi_output_fusion is faster still, but aborts the process on some differentiated
# programs of jaxlib 0.10.2 and never ends compiling others.)
_COMPILER_OPTION = "xla_cpu_small_while_loop_byte_threshold=100000000"
_FLAGS = os.environ.get("XLA_FLAGS", "").strip()
# A value that does not begin with a dash is the name of a file of flags.
_OPEN = _FLAGS == "" or (_FLAGS.startswith("-") and "xla_backend_extra_options" not in _FLAGS)
if _OPEN and os.environ.get("JAXCLEAR_PLAIN_XLA", "0") in ("", "0"):
    os.environ["XLA_FLAGS"] = f"{_FLAGS} --xla_backend_extra_options={_COMPILER_OPTION}".strip()

# The one place where float64 is switched on: gaps of 1e-5 m beside coordinates of 1 m have no
# meaning in float32.
jax.config.update("jax_enable_x64", True)

from jaxclear import complementarity  # noqa: E402
from jaxclear import integrators as integrator  # noqa: E402
from jaxclear.components import clearance, drive, joint, load  # noqa: E402
from jaxclear.components.body import Body, Connection, Marker  # noqa: E402
from jaxclear.components.wear_map import AbstractWearMap, Wearing  # noqa: E402
from jaxclear.ground import numerics, pose  # noqa: E402
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity, vector  # noqa: E402
from jaxclear.laws import conformal, contact, friction, material, stiffness, wear  # noqa: E402
from jaxclear.laws.material import Material  # noqa: E402
from jaxclear.multibody.assembly import assemble  # noqa: E402
from jaxclear.multibody.loops import Baumgarte, Projection  # noqa: E402
from jaxclear.multibody.mechanism import Mechanism  # noqa: E402
from jaxclear.results import response  # noqa: E402
from jaxclear.results.pointing_error import pointing_error  # noqa: E402
from jaxclear.results.trajectory import Trajectory  # noqa: E402
from jaxclear.simulation.simulate import SimulationError, simulate  # noqa: E402
from jaxclear.studies import distribution  # noqa: E402
from jaxclear.studies.advice.choice import advise  # noqa: E402
from jaxclear.studies.advice.pilot import PilotSettings  # noqa: E402
from jaxclear.studies.monte_carlo import monte_carlo  # noqa: E402
from jaxclear.studies.problem import Problem, Variable  # noqa: E402
from jaxclear.studies.sensitivity.sensitivity import sensitivity  # noqa: E402

from jaxclear import scenes  # noqa: E402  isort: skip

__all__ = [
    "AbstractQuantified",
    "AbstractWearMap",
    "Baumgarte",
    "Body",
    "Connection",
    "Marker",
    "Material",
    "Mechanism",
    "PilotSettings",
    "Problem",
    "Projection",
    "Scalar",
    "SimulationError",
    "Trajectory",
    "Variable",
    "Wearing",
    "advise",
    "assemble",
    "clearance",
    "complementarity",
    "conformal",
    "contact",
    "distribution",
    "drive",
    "friction",
    "integrator",
    "joint",
    "load",
    "material",
    "monte_carlo",
    "numerics",
    "pointing_error",
    "pose",
    "quantity",
    "response",
    "scenes",
    "sensitivity",
    "simulate",
    "stiffness",
    "vector",
    "wear",
]
