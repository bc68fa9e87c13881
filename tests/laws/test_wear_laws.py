"""Every wear law keeps the contract; Archard and Fouvry agree where they must."""

import numpy as np
import pytest

from jaxclear.laws import wear
from tests.laws.contracts import WEAR_CHECKS
from tests.laws.law_family import family

LAWS = family(wear.AbstractWearLaw)


@pytest.mark.parametrize("check", WEAR_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("law", [law for _, law in LAWS], ids=[name for name, _ in LAWS])
def test_wear_law_keeps_the_contract(law, check):
    check(law)


def test_archard_wears_in_proportion_to_load_and_distance():
    """1e-5 * 1000 N * 2 m / 2 GPa = 1e-11 m^3, by hand."""
    np.testing.assert_allclose(
        wear.Archard(wear_coefficient=1e-5, hardness=2e9).volume_rate(1000.0, 2.0, 0.0),
        1e-11,
        rtol=1e-15,
    )


def test_fouvry_is_archard_at_constant_friction():
    mu, load, speed = 0.1, 300.0, 0.2
    archard = wear.Archard(wear_coefficient=1e-5, hardness=2e9)
    fouvry = wear.Fouvry(energy_wear_coefficient=1e-5 / (2e9 * mu))
    np.testing.assert_allclose(
        fouvry.volume_rate(load, speed, mu * load),
        archard.volume_rate(load, speed, mu * load),
        rtol=1e-14,
    )
