"""Ideal joints, those that rub among them, and what a joint of one's own derives from."""

from jaxclear.components.joint.base import (
    AbstractDrivenJoint,
    AbstractGroupJoint,
    AbstractJoint,
    AbstractRubbingJoint,
    AbstractVectorJoint,
)
from jaxclear.components.joint.group import Free, Planar, Spherical
from jaxclear.components.joint.plain import AbstractRubbingBall, BallJoint, PlainBearing, Slideway
from jaxclear.components.joint.vector import Cylindrical, Fixed, Prismatic, Revolute, Universal
from jaxclear.ground.argument_errors import nothing_else

__all__ = [
    "AbstractDrivenJoint",
    "AbstractGroupJoint",
    "AbstractJoint",
    "AbstractRubbingBall",
    "AbstractRubbingJoint",
    "AbstractVectorJoint",
    "BallJoint",
    "Cylindrical",
    "Fixed",
    "Free",
    "PlainBearing",
    "Planar",
    "Prismatic",
    "Revolute",
    "Slideway",
    "Spherical",
    "Universal",
]
__getattr__, __dir__ = nothing_else("jaxclear.joint", __all__)
