"""How a dimension varies about its nominal value, `jaxclear.distribution`.

A distribution is told by its `quantile`: a share u in (0, 1) gives the deviation from nominal, so
any sampling of the unit cube serves every distribution. Those of closed form are in `closed_forms`
and `discrete`; `tabulated` has all of scipy's and those of samples. A new one
is a subclass of `AbstractDistribution` with `quantile` and `deviation`.
"""

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.studies.distribution.base import AbstractDistribution
from jaxclear.studies.distribution.closed_forms import (
    Lognormal,
    Normal,
    Triangular,
    TruncatedNormal,
    Uniform,
)
from jaxclear.studies.distribution.discrete import Discrete
from jaxclear.studies.distribution.tabulated import Empirical, FromScipy

__all__ = [
    "AbstractDistribution",
    "Discrete",
    "Empirical",
    "FromScipy",
    "Lognormal",
    "Normal",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
]
__getattr__, __dir__ = nothing_else("jaxclear.distribution", __all__)
