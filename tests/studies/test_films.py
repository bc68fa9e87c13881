"""Studies of a journal that settles on its film: accuracy, spread, the cheapest clearance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import jaxclear as jc

R, L, C, LOAD, SPIN, VISCOSITY = 10e-3, 20e-3, 21.6e-6, 300.0, 100.0, 0.03
OIL = jc.film.Reynolds(viscosity=VISCOSITY)
THINNEST = jc.response.ThinnestFilm("B")


def steady():
    """A heavily loaded journal, which finds its place from the middle within 0.2 s."""
    gap = jc.clearance.PlanarJournalBearing(
        jc.contact.Hertz(), bearing_radius=R, clearance=C, length=L, film=OIL
    )
    return jc.Mechanism(
        {"rotor": jc.Body(2.0, 1e4)},
        {"B": jc.Connection(gap, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD))},
        speeds={"rotor": (0.0, 0.0, SPIN)},
    )


@jax.jit
def steady_film(clearance):
    """Film thickness [m] of a journal that does not move: the law's wedge carries the load."""
    size = 12 * VISCOSITY * R * (R / clearance) ** 3 * 0.5 * SPIN * clearance

    def halve(_, ends):
        middle = 0.5 * sum(ends)
        carried = size * middle * jnp.hypot(*OIL.force(middle, 0.0, -1.0, L / (2 * R)))
        low = carried < LOAD
        return jnp.where(low, middle, ends[0]), jnp.where(low, ends[1], middle)

    ratio, _ = jax.lax.fori_loop(0, 50, halve, (jnp.asarray(0.01), jnp.asarray(0.999)))
    return clearance * (1 - ratio)


def end_of_film(run):
    """Film thickness as the run ends."""
    clearance = run.mechanism.connections["B"].joint.clearance
    return clearance - jnp.hypot(*run.contact("B").offset[-1, :2])


def problem(**options):
    clearance = jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=5e-6)
    return jc.Problem(
        steady(), {"film": end_of_film}, {"c": clearance}, duration=0.2, save=3, **options
    )


def test_the_accuracy_of_a_film():
    run = jc.simulate(steady(), 0.2, save=21, accuracy={THINNEST: 5e-8})
    tight = jc.simulate(
        steady(), 0.2, save=21, integrator=jc.integrator.Adaptive(rtol=1e-7), verify=False
    )
    assert float(THINNEST(run)) == pytest.approx(float(THINNEST(tight)), abs=5e-8)
    assert float(end_of_film(run)) == pytest.approx(float(steady_film(C)), rel=1e-3)


def test_the_spread_of_a_film():
    """Each sample is the steady film of its clearance, also beyond the best clearance."""
    study = jc.monte_carlo(problem(integrator=jc.integrator.ImplicitStep(1e-3)), samples=64)
    clearances, films = np.asarray(study.values[:, 0]), np.asarray(study.responses["film"])
    np.testing.assert_allclose(films, jax.vmap(steady_film)(clearances), rtol=3e-3)


@pytest.mark.slow
def test_the_cheapest_clearance_that_keeps_its_film():
    """A film above 8.8 um in 99.9 % of the bearings, clearances normal, cut off at 3 deviations:
    the tolerance fills the clearances that keep it, whose middle is above the best clearance."""
    solved = problem(integrator=jc.integrator.ImplicitStep(1e-3))
    answer = jc.design(
        solved,
        {"c": jc.cost.Reciprocal(1e-5)},
        jc.limit.Probability("film", below=8.8e-6, at_most=1e-3),
        nominal={"c": (14e-6, 30e-6)},
        tolerance={"c": (1e-6, 12e-6)},
    )
    clearances = np.linspace(8e-6, 40e-6, 3201)
    films = np.asarray(jax.vmap(steady_film)(clearances))
    keeping = clearances[films >= 8.8e-6]
    # Of the share of a normal distribution that is cut off, 0.27 %, and 0.1 % of the rest.
    cut = norm.sf(3.0)
    deviations = norm.isf(cut + 0.5e-3 * (1 - 2 * cut))
    half = 0.5 * (keeping[-1] - keeping[0])
    assert answer.holds
    assert answer.nominal["c"] == pytest.approx(0.5 * (keeping[0] + keeping[-1]), rel=0.03)
    # The share keeps its bound by its error, and so the tolerance is up to twice that narrower.
    error = float(answer.round.check.excess_errors[0])
    assert error < 0.07
    assert -2 * error < answer.tolerances["c"] * deviations / (3 * half) - 1 < 0.02
    assert answer.nominal["c"] > clearances[films.argmax()]
