"""Contact laws of a stranger: an elastic force, a dissipation factor, and a law of another form."""

from typing import ClassVar

import pytest

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.extension.test_friction_law import Saturating
from tests.laws.contracts import contact_contract


class Cushion(jc.contact.AbstractElasticForce):
    """F = K delta + K delta^2 / d: a linear spring that stiffens over the depth d."""

    stiffness: Scalar = quantity(1e6, "N/m", "stiffness at touch")
    depth: Scalar = quantity(1e-3, "m", "depth over which the stiffness trebles")

    def force(self, indentation):
        depth = jc.numerics.positive_part(indentation)
        return self.stiffness * depth * (1 + depth / self.depth)


class Firm(jc.contact.AbstractRestitutionFactor):
    """d = 1.51 (1 - e), near Hunt and Crossley's."""

    restitution: Scalar = quantity(0.9, "1", "coefficient of restitution", above=0, at_most=1)

    def factor(self):
        return 1.51 * (1 - self.restitution)


class Leaking(jc.contact.AbstractContactLaw):
    """A spring with a damper that grows with the indentation: a law that is no product."""

    stiffness: Scalar = quantity(1e7, "N/m", "stiffness")
    damping: Scalar = quantity(1e6, "N s/m^2", "damping per indentation")
    restitution: ClassVar[None] = None
    remembers_impact_speed: ClassVar[bool] = False

    def normal_force(self, indentation, rate, impact_speed):
        damper = self.damping * jc.numerics.positive_part(indentation) * rate
        return jc.numerics.positive_part(self.elastic_force(indentation) + damper)

    def elastic_force(self, indentation):
        return self.stiffness * jc.numerics.positive_part(indentation)


LAWS = {
    "elastic force": jc.contact.ContactForce(Cushion()),
    "dissipation factor": jc.contact.ContactForce(Cushion(), Firm()),
    "additive": Leaking(),
}


@pytest.mark.parametrize("name", LAWS)
def test_law_passes_its_contract(name):
    contact_contract(LAWS[name])


STEPS = jc.integrator.ImplicitStep, jc.integrator.MoreauJean, jc.integrator.NonColliding


@pytest.mark.parametrize("steps", STEPS)
def test_laws_from_outside_serve_every_formulation(steps):
    law = jc.contact.ContactForce(Cushion(stiffness=1e7), Firm(restitution=0.8))
    joint = jc.clearance.PlanarJournalBearing(law, Saturating(), clearance=1e-4)
    pendulum = jc.Mechanism(
        {"arm": jc.Body(1.0, 1e-3, com=(0.1, 0.0))},
        {"B": jc.Connection(joint, "ground", "arm")},
        {"g": jc.load.Gravity()},
    )
    run = jc.simulate(pendulum, 2e-2, save=5, integrator=steps(1e-4), balance=True)
    assert run.succeeded and run.energy_balance().friction_loss[-1] > 0
