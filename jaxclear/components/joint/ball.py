r"""Balls that rub: they move as `Spherical`, and friction is a torque across what they carry.

With m the friction's torque over the ball's radius, :math:`|m| \le \sin(\arctan\mu)\,|R|`, across
the reaction R and against the angular velocity. Spin about the reaction meets none.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.area_map import AreaMap
from jaxclear.components.joint.base import AbstractGroupJoint
from jaxclear.components.joint.group import Spherical
from jaxclear.components.joint.rubbing import AbstractRubbingJoint, ball_end, check_radius_as_made
from jaxclear.components.wear_map import Wearing
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.friction import AbstractFrictionLaw


class AbstractRubbingBall(AbstractRubbingJoint, AbstractGroupJoint):
    """A ball in a socket that touches all the time."""

    @property
    @abstractmethod
    def play(self) -> Any:
        """Radial clearance [m]; 0 for an ideal joint."""

    @property
    def components(self):
        return 3

    def friction_wrench(self, friction):
        return sp.ZERO, sp.scale(self.arm, friction)

    def carrying_ends(self, force, torque, ratio):
        return (ball_end(force, ratio, self.arm, self.play),)

    def friction_ratio(self, mu):
        return mu / safe_sqrt(1 + mu * mu)

    def motion(self, q):
        return Spherical().motion(q)

    def columns(self, q):
        return Spherical().columns(q)

    def rate(self, q, v):
        return Spherical().rate(q, v)

    def bias(self, q, v):
        return None

    def moved(self, q, increment):
        return Spherical().moved(q, increment)

    def retracted(self, q, increment):
        return Spherical().retracted(q, increment)

    def bracket(self, a, b):
        return Spherical().bracket(a, b)

    def coordinates_at(self, pose):
        return Spherical().coordinates_at(pose)

    def speeds_at(self, pose, velocity, spin):
        return Spherical().speeds_at(pose, velocity, spin)

    def start(self, given):
        return Spherical().start(given)


class BallJoint(AbstractRubbingBall):
    """Turns about a point as `Spherical` does, and rubs by its reaction. `wear`: one depth, worn
    volume over the ball's cross-section, how far it has sunk; the motion does not feel it.
    Set-valued friction sticks, for `NonColliding` and `MoreauJean`; laws that are functions of the
    sliding speed serve `Adaptive`, `FixedStep` and `ImplicitStep` too."""

    home: ClassVar = Spherical.home
    units: ClassVar = Spherical.units
    rows: ClassVar = Spherical.rows
    reversal: ClassVar = Spherical.reversal
    gap_axes: ClassVar = ()
    play: ClassVar = 0
    friction: AbstractFrictionLaw | None = None
    radius: Scalar = quantity(10e-3, "m", "radius of the ball", above=0, kw_only=True)
    wear: Wearing | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        check_radius_as_made(self)

    @property
    def arm(self):
        return self.radius

    def maps(self):
        if self.wear is None:
            return {}
        return {"socket": (AreaMap(jnp.pi * self.radius * self.radius), self.wear)}

    def wearing_contacts(self):
        return (0,)

    def wear_place(self, surface, offset, axes, contact, indentation):
        return (0.0,)
