"""How a contact rebounds: by its dissipation factor alone, as the closed relation says, and as well
as each docstring states.
"""

import warnings

import jax
import numpy as np
import pytest
from scipy.optimize import brentq

from jaxclear.laws import contact
from jaxclear.laws.contact import dissipation
from tests.laws.contracts import rebound
from tests.laws.law_family import family, members

FORCES = family(contact.AbstractElasticForce)


def returned(d):
    """e with 1 + d = (1 - d e) exp(d (1 + e)), in y = -ln(1 - d e), apart from the package."""

    def residual(y):
        return np.log1p(d) + y - d * (1 - np.expm1(-y) / d)

    return -np.expm1(-brentq(residual, 1e-6, d + 2 if d >= 1 else -np.log1p(-d), xtol=1e-14)) / d


@pytest.mark.parametrize("force", [law for _, law in FORCES], ids=[name for name, _ in FORCES])
def test_rebound_depends_on_the_factor_times_the_speed_alone(force):
    """F_el (1 + lambda rate) at two speeds with one product d = lambda v, integrated by scipy."""
    for d in (0.15, 1.5):
        for speed in (0.02, 0.5):
            law = contact.ContactForce(
                force, dissipation.MarhefkaOrin(loss_per_speed=d / speed * 2 / 3)
            )
            # an integration to 1e-8 a step, ended where the force vanishes
            np.testing.assert_allclose(rebound(law, speed), returned(d), atol=2e-6)


@pytest.mark.parametrize(
    ("factor", "at_09", "at_05"),
    [
        # what the docstrings state: by how much the rebound is too high at restitution 0.9 and 0.5
        (dissipation.HuntCrossley, 0.009, 0.163),
        (dissipation.LankaraniNikravesh, 0.013, 0.225),
        (dissipation.HerbertMcWhannell, 0.0009, 0.094),
        (dissipation.Flores, -0.006, -0.030),
        (dissipation.HuGuo, -0.0001, -0.012),
        (dissipation.ZhiyingQishao, -0.004, -0.017),
        (dissipation.CarvalhoMartins, 0.0, 0.0002),
        (dissipation.Gonthier, 0.0, 0.0),
    ],
)
def test_rebound_is_as_accurate_as_the_docstring_says(factor, at_09, at_05):
    for restitution, stated in ((0.9, at_09), (0.5, at_05)):
        error = returned(float(factor(restitution=restitution).factor())) - restitution
        # the last digit that is stated
        digits = len(f"{stated}".split(".")[1]) if stated else 5
        assert abs(error - stated) <= 0.51 * 10.0**-digits, (restitution, error)


@pytest.mark.parametrize(
    "factor", members(contact.AbstractRestitutionFactor), ids=lambda k: k.__name__
)
def test_every_factor_is_right_for_small_losses_and_a_free_mass_rebounds_by_it(factor):
    """Of first order but for Flores', whose 8/5 stands for 3/2; Lankarani-Nikravesh is the coarsest
    of second order. One weak rebound is integrated by scipy."""
    for restitution in np.linspace(0.1, 0.99, 30):
        found = returned(float(factor(restitution=restitution).factor()))
        loss = 1 - restitution
        first = 1 / 15 if factor is dissipation.Flores else 0.0
        assert abs(found - restitution) <= first * loss + 1.5 * loss**2, restitution
    weak = factor(restitution=0.1)
    found = rebound(contact.ContactForce(contact.elastic.Hertz(), weak), speed=0.3)
    np.testing.assert_allclose(found, returned(float(weak.factor())), atol=2e-6)


@pytest.mark.parametrize(
    ("factor", "worst", "least"),
    [
        (dissipation.Flores, 0.046, 0.02),
        (dissipation.HuGuo, 0.035, 0.02),
        (dissipation.CarvalhoMartins, 0.004, 0.3),
        (dissipation.Gonthier, 1e-8, 0.02),
    ],
)
def test_worst_rebound_is_as_the_docstring_says(factor, worst, least):
    for restitution in np.linspace(least, 0.99, 60):
        found = returned(float(factor(restitution=restitution).factor()))
        assert abs(found - restitution) <= worst, restitution


def test_the_table_of_accuracies_misses_no_factor():
    stated = test_rebound_is_as_accurate_as_the_docstring_says.pytestmark[0].args[1]
    assert {row[0] for row in stated} == set(members(contact.AbstractRestitutionFactor))


def test_published_factors_by_hand():
    """At restitution 1/2: 6 (1/2) / (0 + 3) = 1, 3/2 (1/2) / (1/2) = 3/2, 3/4 (3/4) exp(1), and
    8/5."""
    expected = {
        dissipation.HerbertMcWhannell: 1.0,
        dissipation.HuGuo: 1.5,
        dissipation.ZhiyingQishao: 9 / 16 * np.e,
        dissipation.Flores: 1.6,
    }
    for kind, value in expected.items():
        np.testing.assert_allclose(kind(restitution=0.5).factor(), value, rtol=1e-14)


def test_gonthier_solves_the_rebound_relation():
    """(1 + d) = (1 - d e) exp(d (1 + e)), solved independently for y = -ln(1 - d e) by scipy's
    brentq."""
    restitutions = np.array([0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.99985, 0.99995, 1.0])

    def solved(e):
        def residual(y):
            factor = -np.expm1(-y) / e
            return y - factor * (1 + e) + np.log1p(factor)

        bracket = e * (1 - e), (1 + e) / e + 1
        return -np.expm1(-brentq(residual, *bracket, xtol=1e-15, rtol=1e-14)) / e

    factor = lambda e: dissipation.Gonthier(restitution=e).factor()
    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(factor)))(restitutions)
    # the two roots cancel as e tends to 1: a part in 1e8 of a factor of 1e-4
    expected = [*map(solved, restitutions[:-1]), 0.0]
    np.testing.assert_allclose(found, expected, rtol=2e-8)
    assert np.all(np.isfinite(slopes))


def test_marhefka_orin_loses_restitution_in_proportion_to_speed():
    """e = 1 - a v + O((a v)^2)."""
    law = contact.MarhefkaOrin(loss_per_speed=0.1)
    assert abs(rebound(law, speed=0.5) - (1 - 0.05)) < 0.05**2


@pytest.mark.parametrize("kind", members(contact.AbstractDissipation), ids=lambda k: k.__name__)
def test_every_law_says_its_restitution(kind):
    force = contact.elastic.Hertz()
    if kind is dissipation.MarhefkaOrin:
        assert contact.ContactForce(force, kind()).restitution is None
    else:
        assert float(contact.ContactForce(force, kind(restitution=0.7)).restitution) == 0.7


def test_lossless_laws_have_restitution_one_and_additive_ones_none():
    assert contact.Hertz().restitution == 1 == contact.Johnson().restitution
    assert contact.KelvinVoigt().restitution is None is contact.AdamsImpact().restitution
    rigid = contact.Rigid(restitution=0.5)
    assert rigid.elastic_force(1e-3) == 0 and float(rigid.restitution) == 0.5


@pytest.mark.parametrize(
    "factor", members(contact.AbstractRestitutionFactor), ids=lambda k: k.__name__
)
def test_a_factor_that_misses_its_restitution_by_2_per_cent_says_by_how_much(factor):
    """And no other does; what is said agrees with the relation solved by scipy."""
    for restitution in (0.03, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            law = factor(restitution=restitution)
        d = float(law.factor())
        found = returned(d) if d > 1e-4 else 1.0
        np.testing.assert_allclose(dissipation.restitution_for(d), found, atol=1e-10)
        assert len(said) == (abs(found / restitution - 1) > 0.02)
        if said:
            assert said[0].filename == __file__
            assert f"rebounds with {found:.3g}, " in str(said[0].message)


def test_a_restitution_that_is_traced_is_not_looked_at():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        slope = jax.grad(lambda e: dissipation.LankaraniNikravesh(restitution=e).factor())(0.5)
    np.testing.assert_allclose(slope, -0.75)
