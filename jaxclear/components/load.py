"""Loads, `jaxclear.load`: on bodies through markers (gravity, forces, torques, springs, dampers),
and on the single coordinate of a joint (springs and dampers, torques, stops, friction that is given
as a torque, the inertia of a motor behind its gear).

A load on bodies sees the motion of the markers it acts on (`MarkerMotion`, in the ground frame) and
returns forces and torques in the ground frame. Springs tell their stored energy, dampers their
dissipated power, so that the energy balance can be closed; every other force counts as input. Units
of loads on coordinates are those of a joint that turns; of one that slides N stands for N m and m
for rad.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxclear.components.body import Marker
from jaxclear.components.function_of_time import (
    check_function_of_time,
    number_or_function,
    one_or_more_or_function,
    value_at,
    vector_or_function,
)
from jaxclear.components.load_base import (
    AbstractCoordinateLoad,
    AbstractJointLoad,
    AbstractLoad,
    AbstractStateLoad,
    CoordinateEffect,
    JointEffect,
    JointMotion,
    LoadState,
    MotorEnd,
    Side,
)
from jaxclear.components.servo import Servo
from jaxclear.components.stops_and_friction import JointFriction, JointStop, Pressed
from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.pose import Pose
from jaxclear.ground.quantity import Scalar, concrete, quantity, vector

__all__ = [
    "AbstractBodyLoad",
    "AbstractCoordinateLoad",
    "AbstractJointLoad",
    "AbstractLoad",
    "AbstractStateLoad",
    "Action",
    "CoordinateEffect",
    "Effect",
    "Force",
    "Gravity",
    "JointEffect",
    "JointFriction",
    "JointMotion",
    "JointSpring",
    "JointStop",
    "JointTorque",
    "LoadState",
    "MarkerMotion",
    "MotorEnd",
    "MotorTorque",
    "Pressed",
    "RotorInertia",
    "Servo",
    "Side",
    "Spring",
    "Torque",
]


def check_acts(spring: Any) -> None:
    """Raises `ValueError` for a spring that is neither one nor a damper."""
    if spring.stiffness is None and spring.damping is None:
        name = type(spring).__name__
        raise ValueError(f"load.{name} needs stiffness or damping, or both; it has neither.")


class MarkerMotion(NamedTuple):
    """Motion of a marker, as a load sees it.

    Args:
        pose: pose in the ground frame.
        velocity: velocity of its origin [m/s], in ground axes.
        spin: angular velocity [rad/s], in ground axes.
    """

    pose: Pose
    velocity: sp.Vec
    spin: sp.Vec


class Action(NamedTuple):
    """Force through the origin of one of the load's markers and torque on its body, in ground axes.

    Args:
        marker: one of the markers of the load, a `Marker`.
        force: force [N], 3 components.
        torque: torque [N m], 3 components.
    """

    marker: Marker
    force: sp.Vec
    torque: sp.Vec

    def place_among(self, markers: tuple[Marker, ...], order: int) -> int:
        """Index of the marker on which the action acts: the same object, else an equal marker, else
        one on its body.

        Args:
            markers: markers of the load, a tuple of `Marker`.
            order: index of the action among the actions, which decides between several markers.

        Returns:
            the index into `markers`.

        Raises:
            ValueError: if no marker matches, or several do.
        """
        tests = (lambda a: a is self.marker, self._equals, self._shares_body)
        matches = ([i for i, a in enumerate(markers) if test(a)] for test in tests)
        places = next(filter(None, matches), [])
        if order not in places and len(places) != 1:
            on = f'a marker on "{self.marker.body}"'
            raise ValueError(
                f"an action on {on}, of which its markers() has "
                + ("several: hand over one of these." if places else "none.")
            )
        return order if order in places else places[0]

    def _equals(self, marker: Marker) -> bool:
        structure: Any
        leaves, structure = jax.tree.flatten(marker)
        others, other = jax.tree.flatten(self.marker)
        same = lambda x, y: x is y or concrete(x) == concrete(y) is not None
        return structure == other and all(map(same, leaves, others))

    def _shares_body(self, marker: Marker) -> bool:
        return marker.body == self.marker.body


class Effect(NamedTuple):
    """What a load on bodies does at one instant.

    Args:
        actions: forces and torques, a tuple of `Action`.
        stored: stored energy [J].
        dissipated: dissipated power [W].
        external: power that enters the mechanism [W].
    """

    actions: tuple[Action, ...]
    stored: Any
    dissipated: Any
    external: Any


class AbstractBodyLoad(AbstractLoad):
    """Acts on bodies through markers."""

    @abstractmethod
    def markers(self) -> tuple[Marker, ...]:
        """The markers it needs to see."""

    @abstractmethod
    def effect(self, time: Scalar, motions: tuple[MarkerMotion, ...]) -> Effect:
        """Forces and energies at an instant.

        Args:
            time: time [s].
            motions: motions of the load's markers in their order, a tuple of `MarkerMotion`.

        Returns:
            forces, energy and powers, an `Effect`.
        """


# A hundred times that of the Earth.
USUAL_GRAVITY = (-1e3, 1e3, "is it in mm/s^2? Accelerations are in m/s^2.")


class Gravity(AbstractLoad):
    """Uniform gravity on all bodies.

    Args:
        acceleration: acceleration of free fall [m/s^2], 2 or 3 numbers in the ground frame.
    """

    switches: ClassVar = False
    acceleration: tuple = vector((0.0, -9.81), "m/s^2", counts=(2, 3), usual=USUAL_GRAVITY)

    def springs_back(self):
        return False


class Force(AbstractBodyLoad):
    """A force at a marker.

    Args:
        marker: where it acts, a `Marker`.
        value: force [N], 2 or 3 numbers, or a function of time [s] that returns as many.
        follows: whether the axes are those of the marker, a flag; by default those of the ground.
    """

    switches: ClassVar = False
    marker: Marker
    value: tuple | Callable = vector(unit="N", counts=(2, 3), converter=vector_or_function)
    follows: bool = eqx.field(static=True, default=False)

    def springs_back(self):
        return False

    def __check_init__(self):
        check_function_of_time(self, "value", (2, 3))

    def markers(self):
        return (self.marker,)

    def effect(self, time, motions):
        force = sp.vec3(tuple(value_at(self.value, time)))
        if self.follows:
            force = sp.apply(motions[0].pose.rotation, force)
        return Effect(
            (Action(self.marker, force, sp.ZERO),), 0, 0, sp.dot(force, motions[0].velocity)
        )


class Torque(AbstractBodyLoad):
    """A torque on a body.

    Args:
        marker: marker on the body, a `Marker`.
        value: torque [N m], 1 number (about z) or 3, or a function of time [s] that returns as
            many.
        follows: whether the axes are those of the marker, a flag; by default those of the ground.
    """

    switches: ClassVar = False
    marker: Marker
    value: tuple | Callable = vector(unit="N m", counts=(1, 3), converter=one_or_more_or_function)
    follows: bool = eqx.field(static=True, default=False)

    def springs_back(self):
        return False

    def __check_init__(self):
        check_function_of_time(self, "value", (1, 3))

    def markers(self):
        return (self.marker,)

    def effect(self, time, motions):
        value = value_at(self.value, time)
        value = tuple(value) if isinstance(value, tuple) or np.ndim(value) else (value,)
        torque = (0, 0, *value) if len(value) == 1 else sp.vec3(value)
        if self.follows:
            torque = sp.apply(motions[0].pose.rotation, torque)
        return Effect(
            (Action(self.marker, sp.ZERO, torque),), 0, 0, sp.dot(torque, motions[0].spin)
        )


class MotorTorque(AbstractBodyLoad):
    """A torque between two bodies, about the z axis of one of them: a motor between bodies that no
    joint need join.

    Equal and opposite however the journal leans; for a joint prefer `JointTorque`, which takes its
    name.

    Args:
        bearing: marker on the body that takes the reaction, a `Marker`; the torque is about its z
            axis.
        journal: marker on the body that the torque turns, a `Marker`.
        value: torque [N m], a number or a function of time [s].
    """

    bearing: Marker
    journal: Marker
    value: Scalar | Callable = quantity(unit="N m", converter=number_or_function)

    def springs_back(self):
        return False

    def __check_init__(self):
        check_function_of_time(self, "value")

    def markers(self):
        return (self.bearing, self.journal)

    def effect(self, time, motions):
        torque = sp.scale(value_at(self.value, time), sp.apply(motions[0].pose.rotation, (0, 0, 1)))
        back = tuple(sp.neg(x) for x in torque)
        actions = (Action(self.bearing, sp.ZERO, back), Action(self.journal, sp.ZERO, torque))
        return Effect(actions, 0, 0, sp.dot(torque, sp.minus(motions[1].spin, motions[0].spin)))


class Spring(AbstractBodyLoad):
    """Spring and damper between two markers, along the line between them: F = k (l - l0) + d dl/dt,
    positive in tension.

    Args:
        start, end: the two ends, each a `Marker`.
        stiffness: stiffness [N/m], >= 0; none by default.
        free_length: length without force [m], >= 0.
        damping: viscous damping [N s/m], >= 0; none by default.

    Raises:
        ValueError: if neither stiffness nor damping is given.
    """

    switches: ClassVar = False
    start: Marker
    end: Marker
    stiffness: Scalar | None = quantity(None, "N/m", at_least=0)
    free_length: Scalar = quantity(0.0, "m", at_least=0)
    damping: Scalar | None = quantity(None, "N s/m", at_least=0)

    def springs_back(self):
        return self.stiffness is not None

    def __check_init__(self):
        check_acts(self)

    def markers(self):
        return (self.start, self.end)

    def effect(self, time, motions):
        line = sp.minus(motions[1].pose.translation, motions[0].pose.translation)
        length = safe_sqrt(sp.dot(line, line))
        direction = tuple(0 if sp.is_zero(x) else safe_divide(x, length) for x in line)
        rate = sp.dot(direction, sp.minus(motions[1].velocity, motions[0].velocity))
        stretch = length - self.free_length
        tension, stored, dissipated = 0, 0, 0
        if self.stiffness is not None:
            tension, stored = self.stiffness * stretch, 0.5 * self.stiffness * stretch * stretch
        if self.damping is not None:
            tension, dissipated = (
                sp.add(tension, sp.mul(self.damping, rate)),
                sp.mul(self.damping, sp.mul(rate, rate)),
            )
        pull = sp.scale(tension, direction)
        reaction = tuple(sp.neg(x) for x in pull)
        actions = (Action(self.start, pull, sp.ZERO), Action(self.end, reaction, sp.ZERO))
        return Effect(actions, stored, dissipated, 0)


class JointSpring(AbstractCoordinateLoad):
    """Spring and damper on the coordinate of a joint that turns or slides, ideal or with clearance.

    Angles count over whole turns, as `AbstractStateLoad` says.

    Args:
        connection: name of the joint.
        stiffness: stiffness [N m/rad; N/m for a sliding joint], >= 0; none by default.
        rest: coordinate without force [rad; m for a sliding joint].
        damping: viscous damping [N m s/rad; N s/m for a sliding joint], >= 0; none by default.

    Raises:
        ValueError: if neither stiffness nor damping is given.
    """

    switches: ClassVar = False
    connection: str = eqx.field(static=True)
    stiffness: Scalar | None = quantity(None, "N m/rad", sliding="N/m", at_least=0)
    rest: Scalar = quantity(0.0, "rad", sliding="m")
    damping: Scalar | None = quantity(None, "N m s/rad", sliding="N s/m", at_least=0)

    def __check_init__(self):
        check_acts(self)

    def force(self, time, position, speed):
        force, stored, dissipated = 0, 0, 0
        if self.stiffness is not None:
            stretch = position - self.rest
            force, stored = -self.stiffness * stretch, 0.5 * self.stiffness * stretch * stretch
        if self.damping is not None:
            force, dissipated = sp.sub(force, self.damping * speed), self.damping * speed * speed
        return force, stored, dissipated, 0

    def reads_position(self):
        return self.stiffness is not None


class JointTorque(AbstractCoordinateLoad):
    """A torque or force on the coordinate of a joint, ideal or with clearance, child against
    parent.

    Args:
        connection: name of the joint.
        value: torque [N m; N for a sliding joint], a number or a function of time [s].
    """

    switches: ClassVar = False
    connection: str = eqx.field(static=True)
    value: Scalar | Callable = quantity(unit="N m", sliding="N", converter=number_or_function)

    def __check_init__(self):
        check_function_of_time(self, "value")

    def force(self, time, position, speed):
        force = value_at(self.value, time)
        return force, 0, 0, force * speed

    def reads_position(self):
        return False

    def springs_back(self):
        return False


class RotorInertia(AbstractCoordinateLoad):
    """Inertia of what turns with the coordinate of a joint and with nothing else: a motor's rotor
    behind its gear, of inertia J and ratio i, adds i^2 J (MuJoCo's armature).

    It adds to the joint's own entry of the mass matrix and to the kinetic energy; the rotor's
    gyroscopic torques on the bodies, i J times their turning, are left out, as is its mass. The
    joint must be ideal, without a drive, and carried by the tree.

    Args:
        connection: name of the joint.
        reflected_inertia: inertia of the rotor times the square of the gear's ratio [kg m^2; kg for
            a sliding joint], >= 0.

    Source: Featherstone 2008, Rigid Body Dynamics Algorithms, chapter 9, "Gears",
    doi:10.1007/978-1-4899-7560-7.
    """

    switches: ClassVar = False
    connection: str = eqx.field(static=True)
    reflected_inertia: Scalar = quantity(unit="kg m^2", sliding="kg", at_least=0)

    def force(self, time, position, speed):
        return 0, 0, 0, 0

    def reads_position(self):
        return False

    def inertia_along(self):
        return self.reflected_inertia


__getattr__, __dir__ = nothing_else("jaxclear.load", __all__)
