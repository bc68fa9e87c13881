"""Laws of normal contact, `jaxclear.contact`: how hard, and how much is lost.

Most are an elastic force (`elastic`, `cylinder`) times a dissipation factor (`dissipation`); the
usual products have names of their own, any other is `ContactForce(force, factor)`. Additive laws
and rigid contact stand by themselves. A new law is a subclass of an abstract base.
"""

from jaxclear.ground.argument_errors import imported_names, nothing_else
from jaxclear.laws.contact import cylinder as cylinder
from jaxclear.laws.contact import dissipation as dissipation
from jaxclear.laws.contact import elastic as elastic
from jaxclear.laws.contact.base import AbstractContactLaw as AbstractContactLaw
from jaxclear.laws.contact.base import AbstractDissipation as AbstractDissipation
from jaxclear.laws.contact.base import AbstractElasticForce as AbstractElasticForce
from jaxclear.laws.contact.base import AbstractNormalLaw as AbstractNormalLaw
from jaxclear.laws.contact.composed import AdamsImpact as AdamsImpact
from jaxclear.laws.contact.composed import BaiZhao as BaiZhao
from jaxclear.laws.contact.composed import BallInSocket as BallInSocket
from jaxclear.laws.contact.composed import CarvalhoMartins as CarvalhoMartins
from jaxclear.laws.contact.composed import ContactForce as ContactForce
from jaxclear.laws.contact.composed import Flores as Flores
from jaxclear.laws.contact.composed import Goldsmith as Goldsmith
from jaxclear.laws.contact.composed import Gonthier as Gonthier
from jaxclear.laws.contact.composed import HerbertMcWhannell as HerbertMcWhannell
from jaxclear.laws.contact.composed import Hertz as Hertz
from jaxclear.laws.contact.composed import HuGuo as HuGuo
from jaxclear.laws.contact.composed import HuntCrossley as HuntCrossley
from jaxclear.laws.contact.composed import Johnson as Johnson
from jaxclear.laws.contact.composed import KelvinVoigt as KelvinVoigt
from jaxclear.laws.contact.composed import LankaraniNikravesh as LankaraniNikravesh
from jaxclear.laws.contact.composed import Linear as Linear
from jaxclear.laws.contact.composed import Liu as Liu
from jaxclear.laws.contact.composed import MarhefkaOrin as MarhefkaOrin
from jaxclear.laws.contact.composed import ModifiedFlores as ModifiedFlores
from jaxclear.laws.contact.composed import Radzimovsky as Radzimovsky
from jaxclear.laws.contact.composed import Rigid as Rigid
from jaxclear.laws.contact.composed import TwoSidedJohnson as TwoSidedJohnson
from jaxclear.laws.contact.composed import ZhiyingQishao as ZhiyingQishao
from jaxclear.laws.contact.dissipation import AbstractRestitutionFactor as AbstractRestitutionFactor
from jaxclear.laws.contact.rough import Rough as Rough

__all__ = imported_names(globals(), "cylinder", "dissipation", "elastic")
__getattr__, __dir__ = nothing_else("jaxclear.contact", __all__)
