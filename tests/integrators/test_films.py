"""Journals on films: every integrator that has them, what runs report of them, what is refused."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

PATH = Path(__file__).parents[1] / "refdata" / "journal_films.json"
MOTION = json.loads(PATH.read_text())["motion"]["cases"]
MASS, RADIUS, LENGTH, CLEARANCE, SPIN = 2.0, 10e-3, 10e-3, 0.1e-3, 200.0
DRY = jc.contact.Hertz(stiffness=1e10)


def rotor(film, clearance=CLEARANCE, start=(0.3, -0.5), load=MASS * 9.81, spin=SPIN, push=0.0):
    """A rigid rotor on a film under a load along -y."""
    sizes = {"bearing_radius": RADIUS, "clearance": clearance, "length": LENGTH}
    gap = jc.clearance.PlanarJournalBearing(DRY, **sizes, film=film)
    return jc.Mechanism(
        {"rotor": jc.Body(MASS, 1e4)},
        {"B": jc.Connection(gap, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -load))},
        start={"rotor": (start[0] * clearance, start[1] * clearance, 0.0)},
        speeds={"rotor": (push, 0.0, spin)},
    )


def turning_load(case):
    """A rotor of the reference under a still and a turning load."""
    film = jc.film.ShortHalfFilm(viscosity=case["mu"])
    sizes = {"bearing_radius": case["R"], "clearance": case["c"], "length": case["L"]}
    gap = jc.clearance.PlanarJournalBearing(DRY, **sizes, film=film)
    turning, rate, still = case["turning"], case["rate"], case["still"]
    load = lambda t: (turning * jnp.cos(rate * t), turning * jnp.sin(rate * t) - still)
    x, y = (c * case["c"] for c in case["start"])
    return jc.Mechanism(
        {"rotor": jc.Body(case["m"], 1e4)},
        {"B": jc.Connection(gap, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), load)},
        start={"rotor": (x, y, 0.0)},
        speeds={"rotor": (0.0, 0.0, case["w"])},
    )


# Over c/m of 7e6 1/s: implicit steps of 1e-3 s are 2e5 times its time constant.
RUNGS = {
    "adaptive": ("rotating", jc.integrator.Adaptive(), 1e-6),
    "fixed": ("rotating", jc.integrator.FixedStep(2e-6), 1e-6),
    "implicit": ("rotating", jc.integrator.ImplicitStep(1e-4), 4e-4),
    "implicit, stiff": ("stiff", jc.integrator.ImplicitStep(1e-3), 1e-3),
    "implicit, stiff, no bias": ("stiff", jc.integrator.ImplicitStep(1e-4, rebound=1.0), 2e-5),
}


SLOW = pytest.mark.slow


def each(names, *fast):
    """These names, those that are not fast marked slow."""
    return [pytest.param(name, marks=() if name in fast else SLOW) for name in names]


@pytest.mark.parametrize("rung", each(RUNGS, "adaptive", "implicit, stiff"))
def test_a_journal_goes_as_scipy_has_it(rung):
    name, integrator, near = RUNGS[rung]
    case = MOTION[name]
    options = {"save": case["saves"], "balance": True, "integrator": integrator, "verify": False}
    run = jc.simulate(turning_load(case), case["T"], **options)
    offset = np.asarray(run.contact("B").offset)[:, :2] / case["c"]
    np.testing.assert_allclose(offset, case["places_over_clearance"], rtol=0, atol=near)
    balance = run.energy_balance()
    assert abs(balance.error).max() < 6e-3 * balance.damping_loss[-1]


def test_reports_contain_the_film():
    """In the steady state the film carries the load; its torque and its power agree."""
    film = jc.film.Reynolds(viscosity=0.04)
    fixed = jc.integrator.FixedStep(1e-5)
    run = jc.simulate(rotor(film), 0.3, save=4, balance=True, integrator=fixed, verify=False)
    load = [0.0, MASS * 9.81, 0.0]
    for force in (run.contact("B").force, run.reaction("B").force, run.reaction("B.film").force):
        np.testing.assert_allclose(force[-1], load, atol=2e-3 * load[1])
    assert (run.contact("B").normal_force == 0).all()
    (x, y, _), torque = run.contact("B").offset[-1], run.contact("B").torque[-1, 2]
    e = np.hypot(x, y) / CLEARANCE
    shear = 2 * np.pi * 0.04 * RADIUS**3 * LENGTH * SPIN / (CLEARANCE * np.sqrt(1 - e * e))
    assert float(-torque) == pytest.approx(shear + 0.5 * float(x) * load[1], rel=2e-3)
    assert float(jc.response.ThinnestFilm("B")(run)) == pytest.approx(
        CLEARANCE * (1 - np.hypot(*np.asarray(run.contact("B").offset)[:, :2].T / CLEARANCE).max())
    )
    # Where nothing moves but the spin, the film takes what its torque takes.
    power = jc.response.FilmFriction("B")
    end = jc.simulate(rotor(film, start=(x / CLEARANCE, y / CLEARANCE)), 1e-3, save=9, verify=False)
    assert float(power(end)) == pytest.approx(float(-torque) * SPIN, rel=5e-3)


@pytest.mark.parametrize("way", each(("adaptive", "fixed", "implicit"), "fixed"))
def test_a_film_takes_all_of_a_push_between_two_saving_times(way):
    """Its power at saving times said 150 times too much of a slider-crank that began with one."""
    film = jc.film.Reynolds(viscosity=0.05)
    pushed = rotor(film, start=(0.0, 0.0), load=0.0, spin=0.0, push=0.02)
    integrator = {
        "adaptive": jc.integrator.Adaptive(),
        "fixed": jc.integrator.FixedStep(2e-5),
        "implicit": jc.integrator.ImplicitStep(2e-5, rebound=1.0),
    }[way]
    run = jc.simulate(pushed, 0.05, save=3, integrator=integrator, verify=False)
    taken = float(jc.response.FilmFriction("B")(run)) * 0.05
    assert taken == pytest.approx(0.5 * MASS * 0.02**2, rel=1e-3)


def test_a_stiff_film_is_reported_at_the_speed_to_which_its_steps_lead():
    """Speeds within steps alternate about it; the force at a saved instant is the load's."""
    case = MOTION["stiff"]
    implicit = jc.integrator.ImplicitStep(1e-4)
    run = jc.simulate(turning_load(case), 0.05, save=11, integrator=implicit, verify=False)
    angle = case["rate"] * np.asarray(run.time)
    load = case["turning"] * np.cos(angle), case["turning"] * np.sin(angle) - case["still"]
    for force, against in zip(run.contact("B").force.T, load, strict=False):
        np.testing.assert_allclose(force[1:], -against[1:], atol=5e-3 * case["turning"])


def oiled(film, clearance=0.1e-3):
    """A slider-crank at 5000 rpm, oiled between rod and slider."""
    gap = jc.clearance.PlanarJournalBearing(
        DRY, bearing_radius=10e-3, clearance=clearance, length=20e-3, film=film
    )
    return jc.scenes.slider_crank(gap, crank_speed=5000 * np.pi / 30)


# By clearance: thinnest film, and how far the orbits are apart, over the clearance. The method
# leaves out the inertia of the journal's motion in its gap: steps of a quarter change 1e-4, half
# the clearance divides 0.045 by 20.
@SLOW
@pytest.mark.parametrize(
    ("clearance", "film", "near"), [(1e-4, 9.382e-6, 0.05), (5e-5, 18.01e-6, 3e-3)]
)
def test_the_mobility_method_has_the_thinnest_film_of_the_full_motion(clearance, film, near):
    scene = oiled(jc.film.Reynolds(viscosity=0.1), clearance)
    thinnest = jc.response.ThinnestFilm("B")
    cheap, full = jc.integrator.NonColliding(2e-5), jc.integrator.Adaptive()
    options = {"save": 601, "verify": False}
    quasi, true = (jc.simulate(scene, 0.024, integrator=x, **options) for x in (cheap, full))
    assert float(thinnest(true)) == pytest.approx(film, rel=2e-3)
    assert float(thinnest(quasi)) == pytest.approx(float(thinnest(true)), rel=3e-3)
    # After the start, from the middle of the gap, the orbits agree.
    orbits = [np.asarray(run.contact("B").offset)[300:, :2] for run in (quasi, true)]
    np.testing.assert_allclose(*orbits, rtol=0, atol=near * clearance)
    assert (quasi.contact("B").normal_force == 0).all()


@SLOW
@pytest.mark.parametrize(
    "integrator",
    [jc.integrator.FixedStep(2e-5), jc.integrator.ImplicitStep(1e-4)],
    ids=["fixed", "implicit"],
)
def test_a_batch_and_derivatives_by_numbers_of_a_film(integrator):
    """By clearance, viscosity and load, in steps whose film is stiff and not."""

    def end(numbers):
        viscosity, clearance, load = numbers
        rig = rotor(jc.film.Reynolds(viscosity=viscosity), clearance, load=load)
        options = {"save": 2, "integrator": integrator, "verify": False, "throw": False}
        return jc.simulate(rig, 0.02, **options).body("rotor").com[-1, :2]

    numbers = np.array([0.04, CLEARANCE, MASS * 9.81])
    slopes = jax.jit(jax.jacfwd(end))(numbers)
    moves = np.diag(1e-5 * numbers)
    ahead, behind = np.split(
        jax.jit(jax.vmap(end))(np.vstack([numbers + moves, numbers - moves])), 2
    )
    wanted = (ahead - behind).T / (2e-5 * numbers)
    np.testing.assert_allclose(slopes, wanted, rtol=2e-4, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"length": 1e-3}, "length of 0.05 diameters"),
        ({"roundness": (jc.clearance.Lobes(2, cosine=1e-6),)}, "round bore"),
        ({"bearing_wear": jc.Wearing(jc.wear.Archard())}, "bore as made"),
    ],
)
def test_a_film_in_a_bearing_for_which_it_is_not_made_is_refused(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.clearance.PlanarJournalBearing(DRY, film=jc.film.Reynolds(), **options)


def test_rigid_steps_refuse_a_film():
    with pytest.raises(ValueError, match='"B" has a film, which .*MoreauJean'):
        jc.simulate(rotor(jc.film.Reynolds()), 0.01, integrator=jc.integrator.MoreauJean(1e-4))


def test_responses_of_films_refuse_a_dry_joint():
    run = jc.simulate(rotor(None), 1e-4, save=2, integrator=jc.integrator.FixedStep(1e-5))
    for response in (jc.response.ThinnestFilm("B"), jc.response.FilmFriction("B")):
        with pytest.raises(ValueError, match='"B" has no film'):
            response(run)


def test_a_run_shows_the_force_of_its_film_in_the_place_of_contacts_that_never_touch():
    """In the steady state the film carries the load; no tolerance is infinite."""
    film = jc.film.Reynolds(viscosity=0.04)
    step = jc.integrator.ImplicitStep(1e-4)
    run = jc.simulate(rotor(film), 0.3, save=51, integrator=step, verify=True)
    table = run.verification.table()
    values = dict(zip(table["quantity"], table["value"], strict=True))
    (force,) = (value for name, value in values.items() if "mean film force" in name)
    assert force == pytest.approx(MASS * 9.81, rel=1e-2)
    size = np.linalg.norm(run.reaction("B.film").force, axis=1)
    assert force == pytest.approx(np.trapezoid(size, run.time) / 0.3, rel=1e-9)
    assert "contact force" not in str(run) and "inf" not in str(run)


def test_a_film_too_stiff_for_explicit_steps_is_named_with_the_steps_that_need_no_shorter_ones():
    rig = rotor(jc.film.Reynolds(viscosity=40.0))
    with pytest.raises(jc.SimulationError, match=r'film of "B".*integrator\.ImplicitStep'):
        jc.simulate(rig, 5e-3, save=6, integrator=jc.integrator.FixedStep(1e-3))
