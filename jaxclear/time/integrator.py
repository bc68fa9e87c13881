"""The ladder of integrators, from cheap to exact: `jaxclear.integrator`. Each states what it trades.

`Adaptive` (any diffrax solver under error control) is the reference; `FixedStep` (explicit) does the same work for every sample,
so it wins in batches; `ImplicitStep` takes long steps through stiff contacts. A class of your own derives from
`AbstractIntegrator`.
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

__all__ = [
    "NOT_FINITE",
    "OUTCOMES",
    "REACHED",
    "TOO_MANY",
    "TOO_MANY_IMPACTS",
    "TOO_SMALL",
    "AbstractIntegrator",
    "Adaptive",
    "Advance",
    "FixedStep",
    "ImplicitStep",
]
