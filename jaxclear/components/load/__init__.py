"""Loads, `jaxclear.load`: on bodies, and on the coordinates of joints."""

from jaxclear.components.load.base import AbstractLoad
from jaxclear.components.load.body import (
    AbstractBodyLoad,
    Action,
    Effect,
    Force,
    Gravity,
    MarkerMotion,
    MotorTorque,
    Spring,
    Torque,
)
from jaxclear.components.load.coordinate import (
    AbstractCoordinateLoad,
    JointFriction,
    JointSpring,
    JointStop,
    JointTorque,
    RotorInertia,
)
from jaxclear.ground.answering import nothing_else

__all__ = [
    "AbstractBodyLoad",
    "AbstractCoordinateLoad",
    "AbstractLoad",
    "Action",
    "Effect",
    "Force",
    "Gravity",
    "JointFriction",
    "JointSpring",
    "JointStop",
    "JointTorque",
    "MarkerMotion",
    "MotorTorque",
    "RotorInertia",
    "Spring",
    "Torque",
]
__getattr__, __dir__ = nothing_else("jaxclear.load", __all__)
