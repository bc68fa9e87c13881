"""A wear law of a stranger; with a contact and a friction law of strangers it runs in a bearing."""

import numpy as np

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.extension.test_contact_law import Cushion
from tests.extension.test_friction_law import Saturating
from tests.laws.contracts import wear_contract


class Erosion(jc.wear.AbstractWearLaw):
    """dV/dt = k F v^1, half of what Archard gives."""

    wear_coefficient: Scalar = quantity(1e-15, "m^2/N", "worn volume per load and distance")

    def volume_rate(self, normal_force, slip_speed, traction):
        return 0.5 * self.wear_coefficient * normal_force * slip_speed


def test_law_passes_its_contract():
    wear_contract(Erosion())


def test_outsiders_run_in_a_bearing():
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.ContactForce(Cushion(stiffness=1e7)),
        Saturating(),
        bearing_wear=jc.Wearing(Erosion(), cells=(12, 1)),
    )
    ring = jc.Mechanism(
        {"ring": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(joint, "ground", "ring")},
        {"g": jc.load.Gravity()},
        speeds={"ring": (0, 0, 50.0)},
    )
    end = jc.simulate(ring, 0.2, save=21, balance=True)
    contact, balance = end.contact("B"), end.energy_balance()
    assert contact.normal_force.max() > 0
    assert balance.friction_loss[-1] > 0 and end.worn_volume("B", "bearing")[-1] > 0
    # the integrator's tolerance of 1e-7 a step, over a few hundred steps
    np.testing.assert_allclose(balance.error, 0, atol=1e-5 * float(balance.kinetic[0]))
