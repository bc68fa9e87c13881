r"""Along the normal: what a law of contact must say of itself so that every formulation can use it,
and how deep a force presses by its elastic part.

Indentation :math:`\delta` [m] is positive in contact, rate :math:`\dot\delta` [m/s] positive while
closing, impact_speed :math:`\dot\delta^{(-)}` [m/s] the closing speed at first touch, force [N]
never negative.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.law import AbstractLaw


def stiffness_field() -> Any:
    """Field of a stiffness [N/m^exponent]."""
    return quantity(1e10, "N/m^exponent", above=0)


def exponent_field() -> Any:
    """Field of an exponent [1]."""
    return quantity(None, "1", above=1)


class AbstractNormalLaw(AbstractLaw):
    """What happens along the normal of one contact point.

    A law of your own is a `jaxclear.contact.ContactForce` of an elastic force
    (`AbstractElasticForce`) and a factor (`AbstractDissipation`), or derives from
    `AbstractContactLaw`.
    """

    compliant: eqx.AbstractClassVar[bool]
    """True: the force is a function of the indentation. False: bodies do not overlap."""

    @property
    @abstractmethod
    def restitution(self) -> Scalar | None:
        """Coefficient of restitution [1] that the law is built around, which rigid contact takes
        from it: 1 without loss, None where it depends on mass and speed."""

    @property
    @abstractmethod
    def remembers_impact_speed(self) -> bool:
        """Whether the engine must supply the speed of first touch: one entry of the state."""

    @property
    def lossless(self) -> bool:
        """Whether the force never depends on the rate, so that nothing is damped; False unless
        overridden."""
        return False

    @property
    def reach(self) -> Scalar | None:
        """How far before the parts touch it begins to press [m], from where the indentation
        counts; None unless overridden: at touch."""
        return None

    @property
    def least_film(self) -> Scalar | None:
        """Film thickness below which no film is taken [m]; None unless overridden: the film's law
        says it alone."""
        return None

    @abstractmethod
    def elastic_force(self, indentation: Scalar) -> Scalar:
        """Conservative part of the force; its integral over the indentation is the stored energy.

        Args:
            indentation: indentation [m], positive in contact.

        Returns:
            the force [N].
        """


class AbstractContactLaw(AbstractNormalLaw):
    """Normal force of one contact point. Zero while open, continuous at touch, never pulling,
    dissipating or elastic.
    """

    compliant = True

    @abstractmethod
    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Scalar) -> Scalar:
        """Force at an instant; 0 while open.

        Args:
            indentation: indentation [m], positive in contact.
            rate: its rate [m/s], positive while closing.
            impact_speed: closing speed at first touch [m/s]; ignored by laws that do not remember
                it.

        Returns:
            the force [N], >= 0.
        """


class AbstractElasticForce(AbstractLaw):
    """The force that a contact would have at rest: one part of `ContactForce`."""

    @abstractmethod
    def force(self, indentation: Scalar) -> Scalar:
        """Force of an indentation, differentiable in it.

        Args:
            indentation: indentation [m], positive in contact.

        Returns:
            the force [N]: 0 for an indentation up to 0, growing beyond.
        """


class AbstractDissipation(AbstractLaw):
    r"""The loss of a contact, as damping in proportion to the elastic force: the other part of
    `ContactForce`. With :math:`d = \lambda\dot\delta^{(-)}` a mass that strikes at
    :math:`\dot\delta^{(-)}` leaves at e times that speed, :math:`1 + d = (1 - d e)\,e^{d(1 + e)}`,
    whatever the elastic force.
    """

    remembers_impact_speed: eqx.AbstractClassVar[bool]
    """True: the damping depends on the speed of first touch."""

    @property
    @abstractmethod
    def restitution(self) -> Scalar | None:
        """Coefficient of restitution that is prescribed; None where it depends on the speed."""

    @abstractmethod
    def relative_damping(self, rate: Scalar, impact_speed: Scalar) -> Scalar:
        r"""Damping force over elastic force, :math:`\lambda\dot\delta`.

        Args:
            rate: rate of the indentation [m/s], positive while closing.
            impact_speed: closing speed at first touch [m/s], > 0.

        Returns:
            the ratio [1], of the sign of `rate`.
        """


# Where the search begins [m], and turns of it: each takes the law for a power of the indentation,
# which Hertz's is.
FIRST, TURNS = 1e-5, 4
# Indentations that tell the power differ by this share.
RELATIVE_STEP = 1e-3
# What presses by next to nothing presses so deep [m]: at 0 a root has no slope.
SHALLOWEST = 1e-10


def indentation_under(law: AbstractNormalLaw, force: Scalar) -> Scalar:
    """Indentation [m] at which the elastic part of a law carries a force [N, at least 0]; 0 where
    bodies do not overlap."""
    if not law.compliant:
        return jnp.zeros(())
    target = force + law.elastic_force(jnp.asarray(SHALLOWEST))
    depth = jnp.asarray(FIRST)
    for _ in range(TURNS):
        here, beyond = law.elastic_force(depth), law.elastic_force((1 + RELATIVE_STEP) * depth)
        power = jnp.log(beyond / here) / jnp.log1p(RELATIVE_STEP)
        depth = depth * (target / here) ** (1 / power)
    return depth
