"""Friction that truly sticks: Coulomb's law as an inclusion, with no function of the speed."""

from typing import ClassVar

import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.friction.base import AbstractSetValuedFriction, check_static, mu_kinetic_field

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
