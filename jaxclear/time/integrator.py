"""The ladder of integrators, from cheap to exact: `jaxclear.integrator`. Each states what it trades.

`Adaptive` (any diffrax solver under error control) is the reference; `FixedStep` (explicit) does the same work for every sample,
so it wins in batches; `ImplicitStep` takes long steps through stiff contacts. `MuntheKaas` is a solver for `Adaptive` that keeps
rotations on their group. A class of your own derives from `AbstractIntegrator`.
"""

from jaxclear.time.adaptive import Adaptive
from jaxclear.time.advance import (
    NOT_FINITE,
    OUTCOMES,
    REACHED,
    TOO_MANY,
    TOO_MANY_IMPACTS,
    TOO_SMALL,
    AbstractIntegrator,
    Advance,
)
from jaxclear.time.fixed_step import FixedStep
from jaxclear.time.implicit_step import ImplicitStep
from jaxclear.time.moreau_jean import MoreauJean
from jaxclear.time.munthe_kaas import AbstractGroup, GroupTerm, MuntheKaas
from jaxclear.time.non_colliding import NonColliding

__all__ = [
    "NOT_FINITE",
    "OUTCOMES",
    "REACHED",
    "TOO_MANY",
    "TOO_MANY_IMPACTS",
    "TOO_SMALL",
    "AbstractGroup",
    "AbstractIntegrator",
    "Adaptive",
    "Advance",
    "FixedStep",
    "GroupTerm",
    "ImplicitStep",
    "MoreauJean",
    "NonColliding",
    "MuntheKaas",
]
