"""How a dimension varies about its nominal value, `jaxclear.distribution`.

A distribution is told by its `quantile`: a share u in (0, 1) gives the deviation from nominal, so
any sampling of the unit cube serves every distribution. Those of closed form are in `closed_forms`
and `discrete`; `tabulated` has all of scipy's and those of samples. A new one
is a subclass of `AbstractDistribution` with `quantile` and `deviation`. `joint` has distributions
of several numbers that vary together, under one name.
"""

from jaxclear.ground.argument_errors import imported_names, nothing_else
from jaxclear.studies.distribution.base import AbstractDistribution as AbstractDistribution
from jaxclear.studies.distribution.closed_forms import Lognormal as Lognormal
from jaxclear.studies.distribution.closed_forms import Normal as Normal
from jaxclear.studies.distribution.closed_forms import Triangular as Triangular
from jaxclear.studies.distribution.closed_forms import TruncatedNormal as TruncatedNormal
from jaxclear.studies.distribution.closed_forms import Uniform as Uniform
from jaxclear.studies.distribution.discrete import Discrete as Discrete
from jaxclear.studies.distribution.joint import (
    AbstractJointDistribution as AbstractJointDistribution,
)
from jaxclear.studies.distribution.joint import Ball as Ball
from jaxclear.studies.distribution.joint import BallMarginal as BallMarginal
from jaxclear.studies.distribution.joint import Independent as Independent
from jaxclear.studies.distribution.tabulated import Empirical as Empirical
from jaxclear.studies.distribution.tabulated import FromScipy as FromScipy

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.distribution", __all__)
