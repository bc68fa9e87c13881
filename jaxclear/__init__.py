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
from jaxclear.time import integrator  # noqa: E402
from jaxclear.time.simulate import SimulationError, simulate  # noqa: E402
from jaxclear.time.trajectory import Trajectory  # noqa: E402

__all__ = [
    "Baumgarte",
    "Body",
    "Connection",
    "Marker",
    "Material",
    "Mechanism",
    "SimulationError",
    "Trajectory",
    "Wearing",
    "assemble",
    "clearance",
    "contact",
    "drive",
    "friction",
    "integrator",
    "joint",
    "load",
    "material",
    "simulate",
    "wear",
]
