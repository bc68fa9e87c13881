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
    return quantity(0.15, "1", "static friction coefficient mu_s", at_least=0, usual=USUAL_FRICTION)


def mu_kinetic_field() -> Any:
    """Field of a kinetic friction coefficient [1]."""
    return quantity(0.1, "1", "kinetic friction coefficient mu_d", at_least=0, usual=USUAL_FRICTION)


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
        """Largest friction over normal force [1], for the sliding speed [m/s] with which an instant
        begins.
        """


class Unhindered(NamedTuple):
    """The sliding `speed` [m/s] that a contact would have without its own friction, and what a unit
    of friction takes away of it (`yielding` [m/(N s)])."""

    speed: Scalar
    yielding: Scalar


class AbstractForceFriction(AbstractFrictionLaw):
    """Friction that is a force given by the motion: forces along each sliding direction, for
    `slip`, the sliding velocity's components [m/s] (structural zeros kept), and its norm
    `slip_speed`, rounded above 0. `bristles`: deflections [m] of each direction, () without any.
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
        """Forces [N] along each sliding direction, and the rates [m/s] of the deflections."""

    @abstractmethod
    def steady_coefficient(self, slip_speed: Scalar) -> Scalar:
        """Traction over normal force [1], >= 0, after long sliding at a speed [m/s] > 0."""

    @abstractmethod
    def largest_slope(self, step: Scalar) -> Scalar:
        """Largest increase of the coefficient by the slip [s/m], taken over a step [s] where the
        law remembers: how hard friction can brake."""

    @abstractmethod
    def acting_share(self, normal_force: Scalar, traction: Scalar, slip_speed: Scalar) -> Scalar:
        """Share [1] of a step in which a contact of mean slip `slip_speed` [m/s] has rubbed, if the
        mean friction over the step was `traction` [N] >= 0."""

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
        """Mean forces [N] along each direction over a step of length `step` [s], and the damping
        [N s/m] >= 0 with which each falls as its component of the slip grows: linear laws whose
        repeated solution ends where friction and inertia agree. `bias`: 0 averages over the step,
        1 takes its end."""

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
        """Deflections [m] at the end of a step; those of an open contact straighten."""


# Sliding slower than this [m/s] is rounding of a contact that sticks.
STICKING_SPEED = 1e-10


class Coulomb(AbstractSetValuedFriction):
    r""":math:`|F_t| \le \mu_s F_n` at rest, :math:`F_t = -\mu_d F_n v/|v|` sliding: true sticking,
    no function of the speed.

    Where the formulation needs a function take CoulombTanh (cheap, creeps) or Dahl (sticks).

    Source: Coulomb 1785, Théorie des machines simples; as a complementarity problem Pfeiffer &
    Glocker 1996, Multibody Dynamics with Unilateral Contacts, doi:10.1002/9783527618385.
    """

    mu_kinetic: Scalar = mu_kinetic_field()
    mu_static: Scalar | None = quantity(
        None, "1", "static friction coefficient mu_s (None: as the kinetic one)", at_least=0
    )
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
