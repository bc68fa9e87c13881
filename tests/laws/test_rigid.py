"""What rigid contact takes from laws that are functions: their coefficients of friction."""

import dataclasses

import pytest

from jaxclear.laws import contact, friction
from tests.laws.law_family import members

FRICTION = [
    law
    for base in (friction.AbstractSlipFriction, friction.AbstractBristleFriction)
    for law in members(base)
] + members(friction.AbstractSetValuedFriction)


def fields(law):
    return {field.name for field in dataclasses.fields(law)}


@pytest.mark.parametrize("kind", FRICTION, ids=lambda kind: kind.__name__)
def test_every_friction_law_of_the_package_gives_its_coefficients(kind):
    static = {"mu_static": 0.4} if "mu_static" in fields(kind) else {}
    found = kind(mu_kinetic=0.2, **static).coulomb()
    assert float(found.mu_kinetic) == 0.2
    assert float(found.bound(1.0)) == 0.2
    assert float(found.bound(0.0)) == (0.4 if static else 0.2)


def test_a_restitution_above_one_is_refused():
    with pytest.raises(ValueError, match=r"contact.Rigid has restitution = 1.5; .* at most 1"):
        contact.Rigid(restitution=1.5)
