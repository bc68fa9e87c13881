"""What rigid contact takes from laws that are functions: their restitution, their coefficients of
friction.
"""

import dataclasses

import numpy as np
import pytest

from jaxclear.laws import conformal, contact, friction  # noqa: F401 (conformal: its laws join the family)
from jaxclear.laws.restitution import restitution
from tests.laws.law_family import members

FRICTION = [
    law
    for base in (friction.AbstractSlipFriction, friction.AbstractBristleFriction)
    for law in members(base)
] + members(friction.AbstractSetValuedFriction)
CONTACT = members(contact.AbstractContactLaw)


def fields(law):
    return {field.name for field in dataclasses.fields(law)}


@pytest.mark.parametrize("kind", FRICTION, ids=lambda kind: kind.__name__)
def test_every_friction_law_of_the_package_gives_its_coefficients(kind):
    static = {"mu_static": 0.4} if "mu_static" in fields(kind) else {}
    found = kind(mu_kinetic=0.2, **static).coulomb()
    assert float(found.mu_kinetic) == 0.2
    assert float(found.bound(1.0)) == 0.2
    assert float(found.bound(0.0)) == (0.4 if static else 0.2)


@pytest.mark.parametrize("kind", CONTACT, ids=lambda kind: kind.__name__)
def test_every_contact_law_with_a_restitution_gives_it(kind):
    if "restitution" in fields(kind):
        np.testing.assert_allclose(restitution(kind(restitution=0.7)), 0.7)
    else:
        assert restitution(kind()) == (1.0 if kind is contact.Hertz else None)


def test_rigid_contact_stores_nothing():
    assert (
        contact.Rigid(restitution=0.5).elastic_force(1e-3) == 0
        and float(restitution(contact.Rigid(restitution=0.5))) == 0.5
    )


def test_a_restitution_above_one_is_refused():
    with pytest.raises(ValueError, match=r"contact.Rigid has restitution = 1.5; .* at most 1"):
        contact.Rigid(restitution=1.5)
