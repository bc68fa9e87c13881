"""Ideal joints, and what a joint of one's own derives from."""

from jaxclear.components.joint.base import (
    AbstractDrivenJoint,
    AbstractGroupJoint,
    AbstractJoint,
    AbstractVectorJoint,
)
from jaxclear.components.joint.group import Free, Planar, Spherical
from jaxclear.components.joint.vector import Cylindrical, Fixed, Prismatic, Revolute, Universal
from jaxclear.ground.answering import nothing_else
from jaxclear.ground.pose import FLIP

__all__ = [
    "FLIP",
    "AbstractDrivenJoint",
    "AbstractGroupJoint",
    "AbstractJoint",
    "AbstractVectorJoint",
    "Cylindrical",
    "Fixed",
    "Free",
    "Planar",
    "Prismatic",
    "Revolute",
    "Spherical",
    "Universal",
]
__getattr__ = nothing_else("jaxclear.joint", __all__)
