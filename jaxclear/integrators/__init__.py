"""The ladder of integrators, from cheap to exact: `jaxclear.integrator`. Each states what it
trades.

`Adaptive` (any diffrax solver under error control) is the reference; `FixedStep` (explicit) does
the same work for every sample, so it wins in batches; `ImplicitStep` takes long steps through stiff
contacts. `MuntheKaas` is a solver for `Adaptive` that keeps rotations on their group. A class of
your own derives from `AbstractIntegrator`.
"""

from jaxclear.ground.argument_errors import imported_names, nothing_else
from jaxclear.integrators.adaptive import Adaptive as Adaptive
from jaxclear.integrators.base import AbstractIntegrator as AbstractIntegrator
from jaxclear.integrators.base import Advance as Advance
from jaxclear.integrators.base import Interval as Interval
from jaxclear.integrators.checks import Outcome as Outcome
from jaxclear.integrators.fixed_step import FixedStep as FixedStep
from jaxclear.integrators.implicit_step import ImplicitStep as ImplicitStep
from jaxclear.integrators.moreau_jean import MoreauJean as MoreauJean
from jaxclear.integrators.munthe_kaas import AbstractGroup as AbstractGroup
from jaxclear.integrators.munthe_kaas import GroupTerm as GroupTerm
from jaxclear.integrators.munthe_kaas import MuntheKaas as MuntheKaas
from jaxclear.integrators.non_colliding import NonColliding as NonColliding

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.integrator", __all__)
