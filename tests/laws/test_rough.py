"""Rough journals: asperities against the integral of Greenwood and Tripp's pressure, and Stribeck's
curve of a journal that they and a film carry.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import jaxclear as jc
from jaxclear.laws.stiffness import fitted
from tests.rigs.cells import slow

PATH = Path(__file__).parents[1] / "refdata" / "journal_films.json"
STRIBECK = json.loads(PATH.read_text())["stribeck"]
AT = STRIBECK["at"]
SIGMA, R, L, C, LOAD = (AT[name] for name in ("sigma", "R", "L", "c", "load"))
SIZES = {"bearing_radius": R, "clearance": C, "length": L}
ROUGH = jc.contact.Rough(
    jc.contact.Johnson(modulus=AT["E_star"]),
    roughness=SIGMA,
    crowding=AT["eta_beta_sigma"],
    sharpness=AT["sigma_over_beta"],
    modulus=AT["E_star"],
)
OIL = jc.film.Reynolds(viscosity=AT["viscosity"])
RUBBING = jc.friction.CoulombTanh(mu_kinetic=AT["mu_boundary"], transition_speed=1e-3)
GAP = jc.clearance.PlanarJournalBearing(ROUGH, RUBBING, **SIZES, film=OIL)
FILM, LAW = GAP.gap_load("B"), fitted(ROUGH, GAP.contact_laws()[0].shape)


@pytest.mark.parametrize("thickness", [0.2e-6, 0.5e-6, 1e-6, 1.5e-6])
def test_asperities_carry_the_integral_of_their_pressure(thickness):
    """K F_5/2(h/sigma) around the journal, by quadrature; K of Greenwood and Tripp 1970."""
    density = lambda s: np.exp(-0.5 * s * s) / np.sqrt(2 * np.pi)

    def pressure(angle):
        u = (C - (C - thickness) * np.cos(angle)) / SIGMA
        part = quad(lambda s: (s - u) ** 2.5 * density(s), u, u + 12, epsabs=0, epsrel=1e-9)[0]
        return part * np.cos(angle)

    around = quad(pressure, -0.7, 0.7, epsrel=1e-7, limit=200)[0]
    crowding, sharpness = AT["eta_beta_sigma"], AT["sigma_over_beta"]
    stiffness = 16 * np.sqrt(2) / 15 * np.pi * crowding**2 * AT["E_star"] * np.sqrt(sharpness)
    force = float(LAW.normal_force(LAW.reach - thickness, 0.0, 0.0))
    # The closed form replaces 1 - cos by its parabola.
    assert force == pytest.approx(R * L * stiffness * around, rel=4.5e-3)


def test_smooth_parts_press_once_they_touch():
    smooth = fitted(ROUGH.law, GAP.contact_laws()[0].shape)

    @jax.jit
    @jax.vmap
    def forces(depth):
        deep = LAW.reach + depth
        return LAW.elastic_force(deep) - LAW.asperity_force(deep), smooth.elastic_force(depth)

    np.testing.assert_allclose(*forces(np.array([-1e-6, 0.0, 1e-6])), rtol=1e-9, atol=1e-9)


@jax.jit
def steady(speed):
    """(film thickness, share of the asperities, coefficient of friction) at a speed, of a journal
    that does not move; rubbing is left out of the balance of forces."""

    def parts(thickness):
        e = C - thickness
        along, across = FILM.squeeze_force((e, 0.0), (0.0, -0.5 * speed * e))
        rough = LAW.normal_force(LAW.reach - thickness, 0.0, 0.0)
        torque = FILM.shear_torque((e, 0.0), speed) + 0.5 * e * across
        return jnp.hypot(along - rough, across), rough, torque

    def halve(_, ends):
        middle = 0.5 * sum(ends)
        heavy = parts(middle)[0] > LOAD
        return jnp.where(heavy, middle, ends[0]), jnp.where(heavy, ends[1], middle)

    low, _ = jax.lax.fori_loop(0, 50, halve, (jnp.asarray(1e-8), jnp.asarray(0.99 * C)))
    _, rough, torque = parts(low)
    return low, rough / LOAD, (torque + AT["mu_boundary"] * rough * R) / (LOAD * R)


def test_stribecks_curve():
    rows = dict(zip(STRIBECK["columns"], np.transpose(STRIBECK["rows"]), strict=True))
    thickness, share, friction = jax.vmap(steady)(jnp.asarray(rows["w rad/s"]))
    mixed = rows["asperity share"] > 0.01
    reference = rows["friction coefficient"]
    # Theirs floors the film otherwise: up to 6 % where it is as thin as the asperities are high.
    np.testing.assert_allclose(1e6 * thickness, rows["h um"], rtol=0.04)
    np.testing.assert_allclose(share, rows["asperity share"], atol=0.04)
    np.testing.assert_allclose(friction[mixed], reference[mixed], rtol=0.07)
    np.testing.assert_allclose(friction[~mixed], reference[~mixed], rtol=3e-3)
    assert friction.argmin() == reference.argmin() and 0 < friction.argmin() < len(friction) - 1


def rotor(speed, mass, start, gap=GAP):
    return jc.Mechanism(
        {"rotor": jc.Body(mass, 1e4)},
        {"B": jc.Connection(gap, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD))},
        start={"rotor": (*start, 0.0)},
        speeds={"rotor": (0.0, 0.0, speed)},
    )


# So heavy that explicit steps resolve the film, which settles all the same.
RUNGS = {
    "fixed": (jc.integrator.FixedStep(1e-4), 2e5),
    "adaptive": (jc.integrator.Adaptive(), 2e5),
    "implicit": (jc.integrator.ImplicitStep(3e-4), 2.0),
}


@pytest.mark.parametrize("rung", ["implicit", *slow("fixed", "adaptive")])
def test_a_journal_rests_on_its_film_and_its_asperities(rung):
    """At 5 rad/s, by friction of the contact on the asperities' load alone."""
    integrator, mass = RUNGS[rung]
    thickness, share, friction = map(float, steady(5.0))
    start = (C - thickness) * np.array([0.2882, -0.9576])
    options = {"save": 9, "integrator": integrator, "verify": False, "balance": True}
    run = jc.simulate(rotor(5.0, mass, start), 1.0, **options)
    contact = run.contact("B")
    film = C - np.hypot(*np.asarray(contact.offset)[-1, :2])
    # Rubbing, 0.12 of 6 % of the load, turns the balance of forces.
    assert film == pytest.approx(thickness, rel=5e-3)
    assert float(contact.normal_force[-1, 0]) == pytest.approx(share * LOAD, rel=2e-2)
    assert float(-contact.torque[-1, 2]) == pytest.approx(friction * LOAD * R, rel=1e-2)
    np.testing.assert_allclose(contact.force[-1], [0.0, LOAD, 0.0], atol=2e-3 * LOAD)
    rubbed = AT["mu_boundary"] * contact.normal_force[-1, 0]
    assert float(contact.traction[-1, 0]) == pytest.approx(float(rubbed), rel=1e-6)
    balance = run.energy_balance()
    assert abs(balance.error).max() < 6e-3 * (balance.damping_loss + balance.friction_loss)[-1]


def test_the_film_under_asperities_is_not_thinner_than_their_mean_gap():
    assert float(FILM.law.thinnest) == pytest.approx(SIGMA / np.sqrt(2 * np.pi) / C, rel=1e-12)
    smooth = jc.clearance.PlanarJournalBearing(ROUGH.law, **SIZES, film=OIL)
    assert float(smooth.gap_load("B").law.thinnest) == 1e-3
