r"""Ideal joints whose parts rub and wear by what they carry: the plain bearing and the slideway.

They move as `Revolute` and `Prismatic` do; friction and wear follow the joint's own reaction within
the step, so that friction in one joint loads the others. Prefer a joint with clearance
(`jaxclear.clearance`) where the play matters.

Balls that rub: they move as `Spherical`, and friction is a torque across what they carry.

With m the friction's torque over the ball's radius, :math:`|m| \le \sin(\arctan\mu)\,|R|`, across
the reaction R and against the angular velocity. Spin about the reaction meets none.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.drive import AbstractDrive
from jaxclear.components.joint.base import (
    AbstractDrivenJoint,
    AbstractGroupJoint,
    AbstractLikeIdeal,
    AbstractRubbingJoint,
    CarriedContact,
    CarryingEnd,
    ball_end,
    check_radius_as_made,
    pressed_end,
    shared_by_ends,
)
from jaxclear.components.joint.group import Spherical
from jaxclear.components.joint.vector import Prismatic, Revolute
from jaxclear.components.wear_map import AreaMap, Wearing
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.friction import AbstractFrictionLaw


class PlainBearing(AbstractRubbingJoint, AbstractLikeIdeal, AbstractDrivenJoint):
    r"""A plain bearing: turns about z as `Revolute` does, and rubs with a friction torque of radius
    times friction.

    A reaction R across the axis rubs with :math:`\sin(\arctan\mu)\,|R|` (the friction circle).
    Force along the axis rubs without a torque. Set-valued friction sticks, for `NonColliding` and
    `MoreauJean`; laws that are functions of the sliding speed serve `Adaptive`, `FixedStep` and
    `ImplicitStep` too.

    Args:
        friction: friction law, one of `jaxclear.friction`; none by default.
        radius: radius of the pin [m], > 0.
        length: length of the bearing [m], > 0: the moment across the axis loads its two ends as
            forces; None: this moment is not counted.
        load: normal force that rubs whatever the reaction (a seal, a clamped bush) [N], >= 0;
            friction is then :math:`\mu` times this. None: the reaction rubs.
        wear: wear of the pair, a `Wearing`: one depth, worn volume over 2 radius length, how far
            the pin has sunk; the motion does not feel it. None by default.
        drive: prescribed motion of the coordinate, one of `jaxclear.drive`; none by default.

    Raises:
        ValueError: for wear without a length, or with `worn_radius`.
    """

    ideal: ClassVar = Revolute()
    home: ClassVar = Revolute.home
    units: ClassVar = Revolute.units
    rows: ClassVar = Revolute.rows
    reversal: ClassVar = Revolute.reversal
    gap_axes: ClassVar = ()
    friction: AbstractFrictionLaw | None = None
    radius: Scalar = quantity(10e-3, "m", above=0, kw_only=True)
    length: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    load: Scalar | None = quantity(None, "N", at_least=0, kw_only=True)
    wear: Wearing | None = eqx.field(default=None, kw_only=True)
    drive: AbstractDrive | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        _check_area(self, length=self.length)

    @property
    def follows_reaction(self):
        return self.load is None

    @property
    def arm(self):
        return self.radius

    def friction_wrench(self, friction):
        return sp.ZERO, (0, 0, sp.mul(self.radius, friction))

    def carrying_ends(self, force, torque, ratio):
        if self.load is not None:
            return (_clamped_end(self.load, ratio, (self.radius, 0, 0)),)
        ends: tuple = (((force[0], force[1], 0), 0),)
        if self.length is not None:
            ends = shared_by_ends(force, torque, self.length)
        return tuple(
            pressed_end(k, f, height, ratio, self.radius, 0) for k, (f, height) in enumerate(ends)
        )

    def friction_ratio(self, mu):
        return mu if self.load is not None else mu / safe_sqrt(1 + mu * mu)

    def maps(self):
        if self.wear is None:
            return {}
        return {"bearing": (AreaMap(2 * self.radius * self.length), self.wear)}

    def wearing_contacts(self):
        return (0,) if self.load is not None or self.length is None else (0, 1)

    def wear_place(self, surface, offset, axes, contact, indentation):
        return (0.0,)


class Slideway(AbstractRubbingJoint, AbstractLikeIdeal, AbstractDrivenJoint):
    r"""A slideway: slides along z as `Prismatic` does, and rubs with :math:`\mu` times what it
    carries across.

    Set-valued friction sticks, for `NonColliding` and `MoreauJean`; laws that are functions of the
    sliding speed serve `Adaptive`, `FixedStep` and `ImplicitStep` too.

    Args:
        friction: friction law, one of `jaxclear.friction`; none by default.
        length: length of the slider [m], > 0: the moment across the axis loads its two ends as
            forces; None: this moment is not counted.
        width: width of the slider [m], > 0: the moment about the axis loads its two sides; None:
            this moment is not counted.
        load: normal force that rubs whatever the reaction (a wiper, a clamp) [N], >= 0; None: the
            reaction rubs.
        wear: wear of the pair, a `Wearing`: one depth, worn volume over width times length; the
            motion does not feel it. None by default.
        drive: prescribed motion of the coordinate, one of `jaxclear.drive`; none by default.

    Raises:
        ValueError: for wear without length and width, or with `worn_radius`.
    """

    ideal: ClassVar = Prismatic()
    home: ClassVar = Prismatic.home
    units: ClassVar = Prismatic.units
    rows: ClassVar = Prismatic.rows
    reversal: ClassVar = Prismatic.reversal
    gap_axes: ClassVar = ()
    arm: ClassVar = 1
    friction: AbstractFrictionLaw | None = None
    length: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    width: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    load: Scalar | None = quantity(None, "N", at_least=0, kw_only=True)
    wear: Wearing | None = eqx.field(default=None, kw_only=True)
    drive: AbstractDrive | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        _check_area(self, length=self.length, width=self.width)

    @property
    def follows_reaction(self):
        return self.load is None

    def friction_wrench(self, friction):
        return (0, 0, friction), sp.ZERO

    def carrying_ends(self, force, torque, ratio):
        if self.load is not None:
            return (_clamped_end(self.load, ratio, sp.ZERO),)
        ends: list = [((force[0], force[1], 0), 0)]
        if self.length is not None:
            ends = list(shared_by_ends(force, torque, self.length))
        if self.width is not None:
            side = (sp.mul(1 / self.width, torque[2]), 0, 0)
            ends += [(side, 0), (tuple(sp.neg(x) for x in side), 0)]
        return tuple(
            _end(k, sp.norm(f), ratio, f, (0, 0, height)) for k, (f, height) in enumerate(ends)
        )

    def friction_ratio(self, mu):
        return mu

    def maps(self):
        if self.wear is None:
            return {}
        return {"guide": (AreaMap(self.width * self.length), self.wear)}

    def wearing_contacts(self):
        if self.load is not None:
            return (0,)
        return tuple(range((2 if self.length is not None else 1) + 2 * (self.width is not None)))

    def wear_place(self, surface, offset, axes, contact, indentation):
        return (0.0,)


def _clamped_end(load: Any, ratio: Any, place: sp.Vec) -> CarryingEnd:
    """What a given normal force [N] carries."""
    return _end(0, load, ratio, (load, 0, 0), place)


def _end(number: int, normal: Any, ratio: Any, force: sp.Vec, place: sp.Vec) -> CarryingEnd:
    """One contact that a normal force [N] presses."""
    contact = CarriedContact(number, normal, ratio * normal, place)
    return CarryingEnd(place[2], force, sp.ZERO, (contact,))


def _check_area(joint: Any, **sizes: Any) -> None:
    """Raises `ValueError` where a joint wears and its bearing area is not known, or asks for a
    radius that nothing reads."""
    check_radius_as_made(joint)
    missing = [name for name, size in sizes.items() if size is None]
    if joint.wear is not None and missing:
        raise ValueError(
            f"a {type(joint).__name__} with wear has no {' and no '.join(missing)}; the worn depth "
            "is the worn volume over the bearing area, so give it."
        )


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

    def start(self, values):
        return Spherical().start(values)


class BallJoint(AbstractRubbingBall):
    """A ball joint: turns about a point as `Spherical` does, and rubs by its reaction.

    Set-valued friction sticks, for `NonColliding` and `MoreauJean`; laws that are functions of the
    sliding speed serve `Adaptive`, `FixedStep` and `ImplicitStep` too.

    Args:
        friction: friction law, one of `jaxclear.friction`; none by default.
        radius: radius of the ball [m], > 0.
        wear: wear of the pair, a `Wearing`: one depth, worn volume over the ball's cross-section,
            how far it has sunk; the motion does not feel it. None by default.
    """

    home: ClassVar = Spherical.home
    units: ClassVar = Spherical.units
    rows: ClassVar = Spherical.rows
    reversal: ClassVar = Spherical.reversal
    gap_axes: ClassVar = ()
    play: ClassVar = 0
    friction: AbstractFrictionLaw | None = None
    radius: Scalar = quantity(10e-3, "m", above=0, kw_only=True)
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
