"""Sideways: what a friction law must say of itself so that every formulation can use it; and
Coulomb's law as an inclusion, with no function of the speed.

Friction acts along the sliding directions of one contact point, against the sliding velocity and in
proportion to the normal force [N]. Rigid and permanent contact ask any law for Coulomb's law with
its coefficients; compliant contact asks for forces, which all but set-valued laws have. Slip laws
creep under a steady side load at rest; a bristle or set-valued law sticks.
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar, concrete, quantity
from jaxclear.ground.wording import public_name
from jaxclear.laws.law import AbstractLaw

# Soft rubber on a clean dry road reaches about 4: Persson 2000, Sliding Friction, 2nd ed.,
# doi:10.1007/978-3-662-04283-0.
USUAL_FRICTION = (0.0, 5.0, "is it in per cent?")


def mu_static_field() -> Any:
    """Field of a static friction coefficient [1]."""
    return quantity(0.15, "1", at_least=0, usual=USUAL_FRICTION)


def mu_kinetic_field() -> Any:
    """Field of a kinetic friction coefficient [1]."""
    return quantity(0.1, "1", at_least=0, usual=USUAL_FRICTION)


def check_static(law: Any) -> None:
    """Raises `ValueError` where static friction is below kinetic friction; numbers that are being
    traced pass."""
    kinetic, static = concrete(law.mu_kinetic), concrete(law.mu_static)
    if kinetic is not None and static is not None and static < kinetic:
        raise ValueError(
            f"{public_name(type(law))} has mu_static {static:g} below mu_kinetic {kinetic:g}; at "
            "rest it must be at least that of sliding: give both."
        )


class AbstractFrictionLaw(AbstractLaw):
    """Friction of one contact point. Opposes sliding, never gives energy, in proportion to the
    normal force.

    A law of your own that is a function of the sliding speed derives from
    `jaxclear.friction.AbstractSlipFriction` and defines `coefficient`.
    """

    set_valued: eqx.AbstractClassVar[bool]
    """True: at rest any force up to a bound, so there is no force as a function of the motion."""

    bristles: eqx.AbstractClassVar[int]
    """How many deflections are remembered for each sliding direction: 0, or 1 for bristles."""

    @abstractmethod
    def coulomb(self) -> "AbstractSetValuedFriction | None":
        """The set-valued law that this one stands for, viscous parts left out; None where it is not
        known. Raises `ValueError` where static friction is below kinetic friction."""


class AbstractSetValuedFriction(AbstractFrictionLaw):
    """Friction that at rest is any force up to a bound: for rigid and permanent contact only."""

    mu_kinetic: eqx.AbstractVar[Scalar]
    mu_static: eqx.AbstractVar[Scalar | None]

    @abstractmethod
    def bound(self, slip_speed: Scalar) -> Scalar:
        """Largest friction force over normal force.

        Args:
            slip_speed: sliding speed at the beginning of the step [m/s], >= 0.

        Returns:
            the coefficient [1], >= 0.
        """


class Unhindered(NamedTuple):
    """The sliding `speed` [m/s] that a contact would have without its own friction, and what a unit
    of friction takes away of it (`yielding` [m/(N s)])."""

    speed: Scalar
    yielding: Scalar


class AbstractForceFriction(AbstractFrictionLaw):
    """Friction that is a force given by the motion.

    Forces act along the sliding directions of a point, one or two of them. Components that are
    known to be zero before tracing are structural zeros and stay so.
    """

    def coulomb(self):
        """Coulomb's law with its `mu_kinetic` and, where it has one, its `mu_static`; to be
        overridden by laws that call these otherwise."""
        kinetic = getattr(self, "mu_kinetic", None)
        static = getattr(self, "mu_static", None)
        return None if kinetic is None else Coulomb(mu_kinetic=kinetic, mu_static=static)

    @abstractmethod
    def tractions(
        self, normal_force: Scalar, bristles: tuple, slip: tuple, slip_speed: Scalar
    ) -> tuple[tuple[Any, ...], tuple[Scalar, ...]]:
        """Friction forces and rates of the bristles at an instant.

        Args:
            normal_force: load [N], >= 0.
            bristles: deflections [m], a tuple with one entry a sliding direction; () without
                bristles.
            slip: components of the sliding velocity [m/s], a tuple with one entry a sliding
                direction.
            slip_speed: norm of `slip` [m/s], rounded above 0.

        Returns:
            forces [N] along each sliding direction, and rates [m/s] of the deflections (() without
            any).
        """

    @abstractmethod
    def steady_coefficient(self, slip_speed: Scalar) -> Scalar:
        """Traction over normal force after long sliding at a constant speed.

        Args:
            slip_speed: sliding speed [m/s], > 0.

        Returns:
            the coefficient [1], >= 0.
        """

    @abstractmethod
    def largest_slope(self, step: Scalar) -> Scalar:
        """Largest increase of the coefficient with the slip, which bounds how hard friction can
        brake.

        Args:
            step: length of a step [s] over which the slope is taken where the law has bristles.

        Returns:
            the slope [s/m].
        """

    @abstractmethod
    def acting_share(self, normal_force: Scalar, traction: Scalar, slip_speed: Scalar) -> Scalar:
        """Share of a step in which the contact has rubbed.

        Args:
            normal_force: load [N], >= 0.
            traction: mean friction force over the step [N], >= 0.
            slip_speed: mean sliding speed over the step [m/s].

        Returns:
            the share [1].
        """

    @abstractmethod
    def linearised(
        self,
        normal_force: Scalar,
        bristles: tuple,
        slip: tuple,
        slip_speed: Scalar,
        unhindered: Unhindered,
        step: Scalar,
        bias: Scalar,
    ) -> tuple[list[Any], list[Scalar]]:
        """Mean forces over a step and their damping: a linear law, whose repeated solution ends
        where friction and inertia agree.

        Args:
            normal_force: load [N], >= 0.
            bristles: deflections at the beginning of the step [m], one entry a sliding direction;
                () without bristles.
            slip: components of the sliding velocity [m/s], one entry a sliding direction.
            slip_speed: norm of `slip` [m/s], rounded above 0.
            unhindered: slip without friction and what friction takes away of it, an `Unhindered`.
            step: length of the step [s].
            bias: 0 for the mean over the step, 1 for its end [1]; between them, a weighted mean.

        Returns:
            forces [N] along each sliding direction, and the damping [N s/m], >= 0, with which each
            falls as its component of the slip grows.
        """

    @abstractmethod
    def bristles_after(
        self,
        normal_force: Scalar,
        bristles: tuple,
        slip: tuple,
        slip_speed: Scalar,
        step: Scalar,
        bias: Scalar,
    ) -> tuple[Scalar, ...]:
        """Deflections at the end of a step; those of an open contact straighten.

        Args:
            normal_force: load [N], >= 0.
            bristles: deflections at the beginning of the step [m], one entry a sliding direction.
            slip: components of the sliding velocity [m/s], one entry a sliding direction.
            slip_speed: norm of `slip` [m/s], rounded above 0.
            step: length of the step [s].
            bias: as in `linearised` [1].

        Returns:
            deflections [m], one entry a sliding direction; () without bristles.
        """


# Sliding slower than this [m/s] is rounding of a contact that sticks.
STICKING_SPEED = 1e-10


class Coulomb(AbstractSetValuedFriction):
    r""":math:`|F_t| \le \mu_s F_n` at rest, :math:`F_t = -\mu_d F_n v/|v|` sliding: true sticking,
    no function of the speed.

    Where the formulation needs a function take CoulombTanh (cheap, creeps) or Dahl (sticks).

    Args:
        mu_kinetic: kinetic friction coefficient mu_d [1], >= 0.
        mu_static: static friction coefficient mu_s [1], >= 0; None: as the kinetic one.

    Raises:
        ValueError: if mu_static is below mu_kinetic.

    Source: Coulomb 1785, Théorie des machines simples; as a complementarity problem Pfeiffer &
    Glocker 1996, Multibody Dynamics with Unilateral Contacts, doi:10.1002/9783527618385.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    mu_static: Scalar | None = quantity(None, "1", at_least=0)
    set_valued: ClassVar[bool] = True
    bristles: ClassVar[int] = 0

    def __check_init__(self):
        check_static(self)

    def coulomb(self) -> "Coulomb":
        return self

    def bound(self, slip_speed: Scalar) -> Scalar:
        if self.mu_static is None:
            return self.mu_kinetic
        return jnp.where(slip_speed < STICKING_SPEED, self.mu_static, self.mu_kinetic)
