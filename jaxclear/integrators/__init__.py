"""The ladder of integrators, from cheap to exact: `jaxclear.integrator`. Each states what it
trades.

`Adaptive` (any diffrax solver under error control) is the reference; `FixedStep` (explicit) does
the same work for every sample, so it wins in batches; `ImplicitStep` takes long steps through stiff
contacts. `MuntheKaas` is a solver for `Adaptive` that keeps rotations on their group. A class of
your own derives from `AbstractIntegrator`.
"""

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import AbstractIntegrator, Advance, Interval
from jaxclear.integrators.checks import Outcome
from jaxclear.integrators.fixed_step import FixedStep
from jaxclear.integrators.implicit_step import ImplicitStep
from jaxclear.integrators.moreau_jean import MoreauJean
from jaxclear.integrators.munthe_kaas import AbstractGroup, GroupTerm, MuntheKaas
from jaxclear.integrators.non_colliding import NonColliding

__all__ = [
    "AbstractGroup",
    "AbstractIntegrator",
    "Adaptive",
    "Advance",
    "FixedStep",
    "GroupTerm",
    "ImplicitStep",
    "Interval",
    "MoreauJean",
    "MuntheKaas",
    "NonColliding",
    "Outcome",
]
__getattr__, __dir__ = nothing_else("jaxclear.integrator", __all__)
