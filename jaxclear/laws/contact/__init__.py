"""Laws of normal contact, `jaxclear.contact`: how hard, and how much is lost.

Most are an elastic force (`elastic`, `cylinder`) times a dissipation factor (`dissipation`); the
usual products have names of their own, any other is `ContactForce(force, factor)`. Additive laws
and rigid contact stand by themselves. A new law is a subclass of an abstract base.
"""

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.laws.contact import cylinder, dissipation, elastic
from jaxclear.laws.contact.base import (
    AbstractContactLaw,
    AbstractDissipation,
    AbstractElasticForce,
    AbstractNormalLaw,
)
from jaxclear.laws.contact.composed import (
    AdamsImpact,
    BaiZhao,
    BallInSocket,
    CarvalhoMartins,
    ContactForce,
    Flores,
    Goldsmith,
    Gonthier,
    HerbertMcWhannell,
    Hertz,
    HuGuo,
    HuntCrossley,
    Johnson,
    KelvinVoigt,
    LankaraniNikravesh,
    Linear,
    Liu,
    MarhefkaOrin,
    ModifiedFlores,
    Radzimovsky,
    Rigid,
    TwoSidedJohnson,
    ZhiyingQishao,
)
from jaxclear.laws.contact.dissipation import AbstractRestitutionFactor

__all__ = [
    "AbstractContactLaw",
    "AbstractDissipation",
    "AbstractElasticForce",
    "AbstractNormalLaw",
    "AbstractRestitutionFactor",
    "AdamsImpact",
    "BaiZhao",
    "BallInSocket",
    "CarvalhoMartins",
    "ContactForce",
    "Flores",
    "Goldsmith",
    "Gonthier",
    "HerbertMcWhannell",
    "Hertz",
    "HuGuo",
    "HuntCrossley",
    "Johnson",
    "KelvinVoigt",
    "LankaraniNikravesh",
    "Linear",
    "Liu",
    "MarhefkaOrin",
    "ModifiedFlores",
    "Radzimovsky",
    "Rigid",
    "TwoSidedJohnson",
    "ZhiyingQishao",
    "cylinder",
    "dissipation",
    "elastic",
]
__getattr__, __dir__ = nothing_else("jaxclear.contact", __all__)
