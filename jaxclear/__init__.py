"""jaxclear: differentiable simulation of mechanisms whose joints have clearance, contact, friction and wear."""

import jax

# The one place where float64 is switched on: gaps of 1e-5 m beside coordinates of 1 m have no meaning in float32.
jax.config.update("jax_enable_x64", True)

from jaxclear.components import clearance, drive, joint, load  # noqa: E402
from jaxclear.components.body import Body, Connection, Marker  # noqa: E402
from jaxclear.components.wear_map import Wearing  # noqa: E402
from jaxclear.laws import contact, friction, material, wear  # noqa: E402
from jaxclear.laws.material import Material  # noqa: E402
from jaxclear.scene.initial import assemble  # noqa: E402
from jaxclear.scene.loops import Baumgarte  # noqa: E402
from jaxclear.scene.mechanism import Mechanism  # noqa: E402
from jaxclear.studies import distribution  # noqa: E402
from jaxclear.studies.problem import Problem, Variable  # noqa: E402
from jaxclear.studies.sensitivity import sensitivity  # noqa: E402
from jaxclear.studies.tolerance import monte_carlo  # noqa: E402
from jaxclear.time import integrator, response  # noqa: E402
from jaxclear.time.simulate import SimulationError, simulate  # noqa: E402
from jaxclear.time.trajectory import Trajectory  # noqa: E402

from jaxclear import scenes  # noqa: E402  isort: skip

__all__ = [
    "Baumgarte",
    "Body",
    "Connection",
    "Marker",
    "Material",
    "Mechanism",
    "Problem",
    "SimulationError",
    "Trajectory",
    "Variable",
    "Wearing",
    "assemble",
    "clearance",
    "contact",
    "distribution",
    "drive",
    "friction",
    "integrator",
    "joint",
    "load",
    "material",
    "monte_carlo",
    "response",
    "scenes",
    "sensitivity",
    "simulate",
    "wear",
]
