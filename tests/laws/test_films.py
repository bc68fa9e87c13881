"""Films: against Reynolds' equation in two dimensions, closed forms of textbooks, and the laws that
every film keeps to.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.laws.law_family import members

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata" / "journal_films.json").read_text())[
    "impedance"
]
FITTED = {"reynolds": jc.film.Reynolds(), "half": jc.film.HalfFilm()}
SHORT = jc.film.ShortHalfFilm()
FILMS = [(law.__name__, law()) for law in members(jc.film.AbstractFilm)]
film = pytest.mark.parametrize(("name", "law"), FILMS, ids=[name for name, _ in FILMS])


def wedge(law, e, slenderness):
    """(load, attitude [deg]) of a film that is only sheared round, at unit squeeze speed."""
    along, across = map(float, law.force(e, 0.0, -1.0, slenderness))
    return np.hypot(along, across), np.degrees(np.arctan2(-across, along))


@pytest.mark.parametrize("name", FITTED)
def test_a_fitted_film_is_that_of_reynolds_equation(name):
    rows = dict(zip(REFERENCE["columns"], np.transpose(REFERENCE["rows"]), strict=True))
    closing, across = rows["v_r"], rows["v_t"]
    e, slender = rows["eccentricity"], rows["length_over_diameter"]
    found = jax.jit(jax.vmap(FITTED[name].force))(e, closing, across, slender)
    errors = [x - rows[f"W_{axis}_{name}"] for axis, x in zip("rt", found, strict=True)]
    scale = [np.sqrt(rows[f"c_{2 * axis}_full"]) for axis in "rt"]
    x, y = scale[0] * closing, scale[1] * across
    closes = np.abs(np.arctan2(y, x)) < np.radians(137)
    size = np.hypot(rows[f"W_r_{name}"], rows[f"W_t_{name}"])
    relative = np.hypot(*errors) / size
    assert relative[closes & (e <= 0.99)].max() < 0.01
    assert np.median(relative[closes]) < 1.5e-3
    natural = np.hypot(errors[0] / scale[0], errors[1] / scale[1]) / np.hypot(x, y)
    assert natural.max() < 5e-3


def test_the_short_half_film_is_ocvirks():
    for e in (0.1, 0.5, 0.83282, 0.95):
        load, attitude = wedge(SHORT, e, 0.2)
        # W = mu w R L^3 e / (4 c^2 q^2) sqrt(16 e^2 + pi^2 q), of squeeze speed w c e / 2
        q = 1 - e * e
        ocvirk = 0.2**3 / (3 * q * q) * np.sqrt(16 * e * e + np.pi**2 * q)
        assert load == pytest.approx(ocvirk, rel=1e-12)
        expected = np.degrees(np.arctan(np.pi * np.sqrt(q) / (4 * e)))
        assert attitude == pytest.approx(expected, rel=1e-12)
    assert wedge(SHORT, 0.83282, 0.2)[1] == pytest.approx(27.566, abs=1e-3)


def test_squeeze_times_of_the_short_half_film():
    """T(0.5) and T(0.9) of eps arccos(-eps)/(1 - eps^2)^1.5 + eps^2/(1 - eps^2)."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for e, expected in ((0.5, 1.9455994), (0.9, 33.5017012)):
        places = 0.5 * e * (nodes + 1)
        force, _ = SHORT.force(jnp.asarray(places), 1.0, 0.0, 1.0)
        assert float(0.5 * e * weights @ force * 3 / 2) == pytest.approx(expected, rel=3e-8)


def test_stiffness_and_damping_of_the_short_bearing_are_friswells():
    """Friswell, Penny, Garvey & Lees 2010, Dynamics of Rotating Machines, sec. 5.5.1."""
    e, film = 0.4, jc.film.ShortHalfFilm()

    def force(z):
        x, y, u, v = z
        r = jnp.hypot(x, y)
        i, j = x / r, y / r
        u, v = u + 0.5 * y, v - 0.5 * x
        along, across = film.force(r, u * i + v * j, v * i - u * j, 1.0)
        return -jnp.stack([along * i - across * j, along * j + across * i])

    start = jnp.array([e, 0.0, 0.0, 0.0])
    load, jacobian = jax.jit(lambda z: (force(z), jax.jacfwd(force)(z)))(start)
    load = np.asarray(load)
    size = np.hypot(*load)
    # In axes whose first is against the load's side: u across, v along the load.
    turn = np.stack([[load[1], -load[0]], load]) / size
    jacobian = -np.asarray(jacobian) / size
    stiffness, damping = (turn @ part @ turn.T for part in (jacobian[:, :2], jacobian[:, 2:]))
    h0 = 1 / (np.pi**2 * (1 - e**2) + 16 * e**2) ** 1.5
    root, pi2 = np.sqrt(1 - e**2), np.pi**2
    k = {
        "uu": 4 * (pi2 * (2 - e**2) + 16 * e**2),
        "uv": np.pi * (pi2 * (1 - e**2) ** 2 - 16 * e**4) / (e * root),
        "vu": -np.pi * (pi2 * (1 - e**2) * (1 + 2 * e**2) + 32 * e**2 * (1 + e**2)) / (e * root),
        "vv": 4 * (pi2 * (1 + 2 * e**2) + 32 * e**2 * (1 + e**2) / (1 - e**2)),
    }
    c = {
        "uu": 2 * np.pi * root * (pi2 * (1 + 2 * e**2) - 16 * e**2) / e,
        "uv": -8 * (pi2 * (1 + 2 * e**2) - 16 * e**2),
        "vv": 2 * np.pi * (pi2 * (1 - e**2) ** 2 + 48 * e**2) / (e * root),
    }
    np.testing.assert_allclose(abs(stiffness[0, 0]), h0 * k["uu"], rtol=1e-10)
    np.testing.assert_allclose(abs(stiffness[1, 1]), h0 * k["vv"], rtol=1e-10)
    mixed = sorted(abs(stiffness[[0, 1], [1, 0]]))
    np.testing.assert_allclose(mixed, sorted(h0 * abs(k[x]) for x in ("uv", "vu")), rtol=1e-10)
    np.testing.assert_allclose(damping[0, 0], h0 * c["uu"], rtol=1e-10)
    np.testing.assert_allclose(damping[1, 1], h0 * c["vv"], rtol=1e-10)
    np.testing.assert_allclose(abs(damping[0, 1]), h0 * abs(c["uv"]), rtol=1e-10)


@pytest.mark.parametrize("e", [0.2, 0.5, 0.8])
def test_a_long_half_film_approaches_sommerfelds(e):
    """At L/D 4 ends cost an eighth to a quarter of an infinitely long one's load, less where the
    film is short round the bearing; at L/D 0.1 it is the short one."""
    load, attitude = wedge(FITTED["half"], e, 4.0)
    long = 4.0 * 2 * np.sqrt(np.pi**2 - e**2 * (np.pi**2 - 4)) / ((2 + e**2) * (1 - e**2))
    assert 0.75 < load / long < 0.9
    assert attitude == pytest.approx(
        np.degrees(np.arctan(np.pi * np.sqrt(1 - e**2) / (2 * e))), abs=2.0
    )
    short, angle = wedge(SHORT, e, 0.1)
    load, attitude = wedge(FITTED["half"], e, 0.1)
    assert load / short == pytest.approx(1.0, abs=0.05)
    assert attitude == pytest.approx(angle, abs=1.0)


@film
def test_a_film_never_gives_energy_and_is_linear_in_the_speed(name, law):
    e = 1 - np.logspace(0, -2.9, 25)
    angle, slender = np.linspace(-np.pi, np.pi, 61), np.array([0.1, 0.5, 1.0, 4.0])
    e, angle, slender = (x.ravel() for x in np.meshgrid(e, angle, slender))
    closing, across = np.cos(angle), np.sin(angle)
    force = jax.jit(jax.vmap(law.force))
    along, beside = map(np.asarray, force(e, closing, across, slender))
    assert (along * closing + beside * across).min() >= 0
    mirrored = force(e, closing, -across, slender)
    np.testing.assert_allclose(mirrored[1], -beside, atol=1e-9 * abs(beside).max())
    np.testing.assert_allclose(force(e, 3e-9 * closing, 3e-9 * across, slender)[0], 3e-9 * along)


@film
def test_a_film_is_regular_at_the_centre_and_at_rest(name, law):
    forces = lambda e, u, v: jnp.stack(law.force(e, u, v, 0.8))
    both = lambda *place: [way(forces, (0, 1, 2))(*place) for way in (jax.jacfwd, jax.jacrev)]
    places = np.array([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)])
    slopes = jax.jit(jax.vmap(both))(*places.T)
    assert all(np.all(np.isfinite(slope)) for slope in jax.tree.leaves(slopes))
    # At the centre all directions are alike.
    still, along, turned = jax.jit(jax.vmap(forces))(
        *np.array([[0, 0, 0], [0, 1, 0], [0, 0.6, 0.8]]).T
    )
    assert np.all(still == 0)
    np.testing.assert_allclose(turned / np.array([0.6, 0.8]), float(along[0]))


@film
def test_films_do_not_get_thinner_than_their_least_thickness(name, law):
    e = jnp.array([0.0, 0.5, 0.998, 0.9985, 1.0, 1.2])
    expected = [0.0, 0.5, 0.998, 1 - (1e-3 + 1.5e-3**2 / 4e-3), 0.999, 0.999]
    np.testing.assert_allclose(jax.vmap(law.floored)(e), expected, rtol=1e-12)


def test_the_viscosity_of_vogel():
    """ISO VG 46: 0.0407 Pa s at 40 degC by these numbers."""
    oil = jc.film.Vogel(scale=6.4e-5, slope=1030.0, pole=153.6, temperature=313.15)
    expected = 6.4e-5 * np.exp(1030.0 / (313.15 - 153.6))
    assert float(oil.value()) == pytest.approx(expected, rel=1e-12)
    gap = jc.clearance.PlanarJournalBearing(
        jc.contact.Hertz(), film=jc.film.Reynolds(viscosity=oil)
    )
    assert float(gap.gap_load("B").law.viscosity) == pytest.approx(expected, rel=1e-12)
