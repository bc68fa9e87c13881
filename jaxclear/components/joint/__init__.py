"""Ideal joints, those that rub among them, and what a joint of one's own derives from."""

from jaxclear.components.joint.base import AbstractDrivenJoint as AbstractDrivenJoint
from jaxclear.components.joint.base import AbstractGroupJoint as AbstractGroupJoint
from jaxclear.components.joint.base import AbstractJoint as AbstractJoint
from jaxclear.components.joint.base import AbstractRubbingJoint as AbstractRubbingJoint
from jaxclear.components.joint.base import AbstractVectorJoint as AbstractVectorJoint
from jaxclear.components.joint.group import Free as Free
from jaxclear.components.joint.group import Planar as Planar
from jaxclear.components.joint.group import Spherical as Spherical
from jaxclear.components.joint.plain import AbstractRubbingBall as AbstractRubbingBall
from jaxclear.components.joint.plain import BallJoint as BallJoint
from jaxclear.components.joint.plain import PlainBearing as PlainBearing
from jaxclear.components.joint.plain import Slideway as Slideway
from jaxclear.components.joint.vector import Cylindrical as Cylindrical
from jaxclear.components.joint.vector import Fixed as Fixed
from jaxclear.components.joint.vector import Prismatic as Prismatic
from jaxclear.components.joint.vector import Revolute as Revolute
from jaxclear.components.joint.vector import Universal as Universal
from jaxclear.ground.argument_errors import imported_names, nothing_else

__all__ = imported_names(globals())
__getattr__, __dir__ = nothing_else("jaxclear.joint", __all__)
