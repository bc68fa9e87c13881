"""The names that users know: built from keywords, with their parts' numbers within reach.

Every wear law keeps the contract; Archard and Fouvry agree where they must.
"""

import inspect

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.laws import wear
from jaxclear.laws.contact import cylinder, dissipation, elastic
from tests.laws.contracts import WEAR_CHECKS
from tests.laws.law_family import family, members

PRODUCTS = {
    name: law
    for name, law in vars(jc.contact).items()
    if inspect.isfunction(law) and name in jc.contact.__all__
}


@pytest.mark.parametrize("name", PRODUCTS)
def test_a_name_builds_what_its_signature_says(name):
    build = PRODUCTS[name]
    assert build.__name__ == name and "Source:" in build.__doc__
    law = build(restitution=0.7) if "Marhefka" not in name else build()
    assert isinstance(law, jc.contact.ContactForce)
    assert law.remembers_impact_speed == ("Marhefka" not in name)
    for number in inspect.signature(build).parameters:
        getattr(law, number)


def test_every_law_names_its_source():
    families = (
        jc.contact.AbstractNormalLaw,
        jc.contact.AbstractElasticForce,
        jc.contact.AbstractDissipation,
        jc.friction.AbstractFrictionLaw,
        jc.wear.AbstractWearLaw,
    )
    laws = [law for each in families for law in members(each)]
    assert not [law.__name__ for law in laws if "Source:" not in inspect.getdoc(law)]


def test_parts_are_as_documented():
    bai_zhao, flores = jc.contact.BaiZhao(), jc.contact.ModifiedFlores()
    assert isinstance(bai_zhao.elastic, cylinder.BaiZhao)
    assert isinstance(bai_zhao.dissipation, dissipation.ZhiyingQishao)
    assert isinstance(flores.elastic, elastic.BallInSocket)
    assert isinstance(flores.dissipation, dissipation.Flores)
    assert jc.contact.Johnson().dissipation is None
    assert isinstance(jc.contact.Johnson(restitution=0.9).dissipation, dissipation.CarvalhoMartins)


def test_numbers_of_the_parts_are_leaves_of_the_law():
    law = jc.contact.LankaraniNikravesh(stiffness=1e9, restitution=0.9, slowest_impact=1e-4)
    where = lambda law: (law.stiffness, law.restitution, law.slowest_impact)
    changed = eqx.tree_at(where, law, tuple(jnp.asarray(x) for x in (2e9, 0.5, 1e-5)))
    assert float(changed.elastic.stiffness) == 2e9
    assert float(changed.dissipation.restitution) == 0.5
    assert float(changed.memory.slowest_impact) == 1e-5
    with pytest.raises(AttributeError, match="no modulus"):
        _ = law.modulus


ROUGH, OIL = jc.contact.Rough(jc.contact.Johnson()), jc.film.Reynolds()
Journal, Planar = jc.clearance.JournalBearing, jc.clearance.PlanarJournalBearing


def borne(gap):
    connection = {"B": jc.Connection(gap, "ground", "rotor")}
    return jc.Mechanism({"rotor": jc.Body(2.0, 1e4)}, connection)


def by_percussions():
    """A run with asperities whose contacts have no force of their own."""
    rig = borne(Planar(ROUGH, clearance=1e-4, film=OIL))
    return jc.simulate(rig, 0.1, integrator=jc.integrator.NonColliding(1e-3))


REFUSED = [
    (r"by name: Hertz\(stiffness=1000000000.0\)", lambda: jc.contact.Flores(1e9)),
    (r"by name: KelvinVoigt\(stiffness=1", lambda: jc.contact.KelvinVoigt(1e9, 10.0)),
    ("friction.Coulomb takes its numbers by name", lambda: jc.friction.Coulomb(0.1)),
    ("wear.Archard takes its numbers by name", lambda: jc.wear.Archard(1e-4)),
    ("contact.Flores has no number modulus", lambda: jc.contact.Flores(modulus=1e9)),
    ("no dissipation factor", lambda: jc.contact.Hertz(slowest_impact=1e-5)),
    ("static_speed = 1 m/s and kinetic_s", lambda: jc.friction.ThreeZone(static_speed=1.0)),
    ("static_speed = 1 m/s", lambda: jc.friction.AdamsStep(static_speed=1.0)),
    ("inner_speed = 0.001 m/s", lambda: jc.friction.Ambrosio(inner_speed=1e-3)),
    ("transition_speed = 1 m/s", lambda: jc.friction.Stribeck(transition_speed=1.0)),
    ("inner_radius = 2 m", lambda: jc.contact.Goldsmith(inner_radius=2.0, outer_radius=1.0)),
    ("mu_static 0.1 below", lambda: jc.friction.Coulomb(mu_kinetic=0.2, mu_static=0.1)),
    ("mu_static 0.1 below", lambda: jc.friction.LuGre(mu_kinetic=0.2, mu_static=0.1).coulomb()),
    ("outer radius must be the larger one", lambda: jc.stiffness.Shape(10e-3, 9.9e-3)),
    ("Shape.length", lambda: jc.stiffness.LengthOf().value(jc.stiffness.Shape(9e-3, 10e-3))),
    ("thinnest", lambda: jc.film.Reynolds(thinnest=1e-5)),
    ("below", lambda: jc.film.Vogel(scale=1.0, slope=1.0, pole=300.0, temperature=290.0)),
    ("rough itself", lambda: jc.contact.Rough(ROUGH)),
    ("law = a Rigid", lambda: jc.contact.Rough(jc.contact.Rigid())),
    (
        "asperities of .* in a clearance",
        lambda: Planar(ROUGH, clearance=1e-6, film=jc.film.Reynolds()),
    ),
    ('joint "B": contact.Rough is for a Pla.* with a film', lambda: borne(Planar(ROUGH))),
    ('joint "B": contact.Rough is for a Pla.* with a film', lambda: borne(Journal(ROUGH))),
    ('joint "B" has asperities, .*ImplicitStep', by_percussions),
]


@pytest.mark.parametrize(("sentence", "build"), REFUSED, ids=[row[0] for row in REFUSED])
def test_bad_numbers_are_refused_with_a_sentence(sentence, build):
    with pytest.raises(ValueError, match=sentence):
        build()


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


def test_a_specific_wear_rate_is_volume_per_load_and_distance():
    """10 N over 1 km at 1e-6 mm^3/(N m): a hundredth of a cubic millimetre, of any hardness."""
    for hardness in (2e9, 7e9):
        law = jc.wear.Archard.from_specific_wear(1e-6, hardness)
        assert float(law.volume_rate(10.0, 1000.0, 0.0)) == pytest.approx(0.01e-9)
        assert float(law.hardness) == hardness
