"""A friction law of a stranger, as smooth friction and as the set-valued law that it tends to."""

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.laws.contracts import friction_contract


class Saturating(jc.friction.AbstractSlipFriction):
    """mu v / (v + v_0) made smooth by a tanh at rest."""

    mu_kinetic: Scalar = quantity(0.2, "1", "coefficient at high speed")
    transition_speed: Scalar = quantity(1e-3, "m/s", "speed of half the friction")

    def coulomb(self):
        return jc.friction.Coulomb(mu_kinetic=self.mu_kinetic)

    def coefficient(self, slip_speed):
        return self.mu_kinetic * jc.numerics.smooth_sign(slip_speed, self.transition_speed)


def test_law_passes_its_contract():
    friction_contract(Saturating())
