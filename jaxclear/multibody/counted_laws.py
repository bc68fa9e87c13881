"""Laws of contacts that are told whether they count as closed or as apart, whatever their
indentation: where a contact closes or parts, the equations of motion on one side of that instant
are those of the other side with another share of the contact, 1 or 0, and between them affine in
it (`integrators.saltation`).
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.ground.quantity import Scalar
from jaxclear.laws.contact.base import AbstractContactLaw
from jaxclear.laws.friction.base import AbstractForceFriction

# A force [N] beside which no other is anything, by which a contact that counts as closed presses.
LEAST_FORCE = 1e-30


def laws_as_counted(
    contact_laws: tuple[ContactLaws, ...], shares: tuple[Any, ...]
) -> tuple[ContactLaws, ...]:
    """The laws of all contacts of a joint, by the share of each that acts; None: as it is."""
    return tuple(
        laws if share is None else _as_counted(laws, share)
        for laws, share in zip(contact_laws, shares, strict=True)
    )


def _as_counted(laws: ContactLaws, share: Scalar) -> ContactLaws:
    friction = laws.friction
    own = _Force(laws.contact, share), None if friction is None else _Friction(friction, share)
    parts = lambda laws: (laws.contact, laws.friction)
    return eqx.tree_at(parts, laws, own, is_leaf=lambda part: part is None)


class _Force(eqx.Module):
    """A share of a contact's normal force."""

    law: AbstractContactLaw
    share: Scalar

    def normal_force(self, indentation: Scalar, rate: Scalar, impact_speed: Any) -> Scalar:
        return self.share * self.law.normal_force(indentation, rate, impact_speed)

    def elastic_force(self, indentation: Scalar) -> Scalar:
        return self.share * self.law.elastic_force(indentation)


class _Friction(eqx.Module):
    """Friction of a contact of which a share acts: bristles of the rest straighten."""

    law: AbstractForceFriction
    share: Scalar

    def tractions(self, normal_force: Scalar, bristles: tuple, slip: tuple, slip_speed: Scalar):
        pressed = jnp.where(normal_force > 0, normal_force, LEAST_FORCE + normal_force)
        tractions, closed = self.law.tractions(pressed, bristles, slip, slip_speed)
        _, apart = self.law.tractions(jnp.zeros_like(pressed), bristles, slip, slip_speed)
        rates = (a + self.share * (b - a) for a, b in zip(apart, closed, strict=True))
        return tractions, tuple(rates)
