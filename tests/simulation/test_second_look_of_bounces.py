"""Impacts that take little or no energy hand what they are off by on to the next ones: a second
look comes sooner there, of `Adaptive` too."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from benchmarks.attacks.structures import structures
from benchmarks.claims import extremes
from jaxclear.integrators import Check, Checks
from jaxclear.integrators.figures import Figure
from jaxclear.results.response import concerned
from jaxclear.simulation import doubts, second_look
from jaxclear.simulation.bounciness import restitution_at


def beyond(run):
    return {check for check, flag in run.checks.beyond().items() if flag}


def across(run, joint):
    """Offset in a joint beside its clearance."""
    clearance = float(run.mechanism.connections[joint].joint.clearance)
    return np.asarray(run.contact(joint).offset)[:, 0] / clearance


@pytest.mark.parametrize(
    ("restitution", "rise", "doubted"),
    [(0.5, 0.015, False), (0.9, 0.015, False), (0.95, 0.015, True), (0.95, 0.008, False)],
)
def test_bouncy_impacts_are_in_doubt_sooner(restitution, rise, doubted):
    contact = jc.contact.CarvalhoMartins(restitution=restitution)
    bearing = jc.clearance.PlanarJournalBearing(contact, bearing_radius=0.01, clearance=1e-4)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)}, {"B": jc.Connection(bearing, "ground", "journal")}
    )
    checks = Checks.of({Check.IMPACT_STEP: Figure(np.array([rise]), np.zeros(1), ("B",))})
    compliant = jc.integrator.FixedStep().formulation
    run = SimpleNamespace(mechanism=rig, formulation=compliant, checks=checks)
    assert doubts.in_doubt(run, jc.integrator.FixedStep()) == doubted
    # Steps of low order from half of that on.
    low = jc.integrator.FixedStep(1e-5, "heun")
    assert doubts.in_doubt(run, low) == (doubted or rise > 0.01)


@pytest.mark.parametrize(
    ("steps", "restitution", "bearings", "doubted"),
    [(400, 0.95, 1, False), (500, 0.95, 1, True), (500, 0.9, 1, False), (500, 0.5, 2, True)],
)
def test_many_bouncy_impacts_are_in_doubt(steps, restitution, bearings, doubted):
    """Steps that end at saving times tell of no impact; several bearings pass impacts on."""
    contact = jc.contact.CarvalhoMartins(restitution=restitution)
    bearing = jc.clearance.PlanarJournalBearing(contact, bearing_radius=0.01, clearance=1e-4)
    names = [f"journal {k}" for k in range(bearings)]
    rig = jc.Mechanism(
        {name: jc.Body(1.0, 1e-4) for name in names},
        {f"B{name}": jc.Connection(bearing, "ground", name) for name in names},
    )
    run = SimpleNamespace(
        mechanism=rig,
        formulation=jc.integrator.Adaptive().formulation,
        checks=Checks(),
        accepted_steps=steps,
        time=np.zeros(201),
    )
    assert doubts.in_doubt(run, jc.integrator.Adaptive()) == doubted


@pytest.mark.parametrize(
    "law",
    [
        jc.contact.AdamsImpact(stiffness=1.6e9, damping=25.6),
        jc.contact.AdamsImpact(stiffness=1e9, damping=200.0),
        jc.contact.KelvinVoigt(stiffness=1e8, damping=300.0),
        jc.contact.MarhefkaOrin(stiffness=1e9, loss_per_speed=0.3),
    ],
)
def test_restitution_of_laws_that_prescribe_none_is_that_of_their_impacts(law):
    """Of a mass that strikes a wall, in 20 000 steps of symplectic Euler. Losses as if at the speed
    of an elastic impact: to second order, a hundredth at 0.8."""
    mass, speed, step = 0.24, 0.6, 5e-8

    def move(carry, _):
        depth, rate, deepest = carry
        rate = rate - step * law.normal_force(depth, rate, speed) / mass
        depth = depth + step * rate
        return (depth, rate, jnp.maximum(deepest, depth)), None

    (_, rate, deepest), _ = jax.lax.scan(move, (0.0, speed, 0.0), None, 20_000)
    found = restitution_at(law, float(deepest), mass)
    assert found == pytest.approx(-float(rate) / speed, abs=0.01)


@pytest.mark.parametrize(
    ("rtol", "tighter"), [(1e-7, 1 / 256), (3e-4, 1e-3 / 256), (1e-10, 1e-2), (1e-13, 1.0)]
)
def test_adaptive_is_looked_at_again_at_tighter_tolerances(rtol, tighter):
    """Beside those that count where joints have clearance, and not within rounding."""
    integrator = jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol)
    finer = second_look._in_steps(None, integrator, second_look.FINER)
    assert float(finer.rtol) == pytest.approx(rtol * tighter)
    assert float(finer.atol) == pytest.approx(1e-2 * rtol * tighter)


def test_places_of_bodies_are_no_matter_of_a_force():
    place, force = jc.response.FinalCoordinate("G"), jc.response.MeanContactForce("G")
    concerns = Check.BODY_PLACES.concerns
    assert concerned(place, concerns) and not concerned(force, concerns)


@pytest.mark.slow
def test_a_peak_that_falls_between_steps_is_said():
    """Of one impact of a pushed slider implicit steps saw a third of the peak force; its mean force
    is right."""
    case, run = structures()[22].case(7), {}
    for name, integrator in (
        ("exact", jc.integrator.Adaptive(rtol=1e-10, atol=1e-12)),
        ("too long", jc.integrator.ImplicitStep(1.2e-4)),
        ("short", jc.integrator.ImplicitStep(1e-5)),
    ):
        run[name] = jc.simulate(case.mechanism, case.duration, integrator=integrator, save=201)
    peaks = {name: float(jc.response.PeakContactForce("G")(each)) for name, each in run.items()}
    assert peaks["too long"] < 0.5 * peaks["exact"]
    assert peaks["short"] == pytest.approx(peaks["exact"], rel=0.2)
    assert Check.DEEPEST in beyond(run["too long"]) and Check.DEEPEST not in beyond(run["short"])


@pytest.mark.slow
def test_where_a_slider_is_after_a_hundred_bouncy_impacts_is_said_by_adaptive():
    """No tolerance of double precision tells where it is: two a hundredfold apart disagree."""
    case = structures()[22].case(9)
    runs = [
        jc.simulate(case.mechanism, case.duration, integrator=integrator, save=201)
        for integrator in (
            jc.integrator.Adaptive(rtol=1e-9, atol=1e-11),
            jc.integrator.Adaptive(rtol=1e-11, atol=1e-13),
            jc.integrator.Adaptive(),
        )
    ]
    exact, default = across(runs[1], "G"), across(runs[2], "G")
    assert np.abs(across(runs[0], "G") - exact).max() > 0.03
    assert np.abs(default - exact).max() > 0.03
    assert beyond(runs[2]) == {Check.PLACE_IN_GAP}


@pytest.mark.slow
def test_where_a_double_pendulum_is_after_forty_bouncy_impacts_is_said_by_adaptive():
    """Restitution is 0.936, and what one joint is off by throws the other."""
    case = structures()[13].case(12)
    exact, default, loose = (
        jc.simulate(case.mechanism, case.duration, integrator=integrator, save=201)
        for integrator in (
            jc.integrator.Adaptive(rtol=1e-10, atol=1e-12),
            jc.integrator.Adaptive(),
            jc.integrator.Adaptive(rtol=2.5e-5, atol=2.5e-7),
        )
    )
    offset = lambda run: np.asarray(run.contact("C").offset)[:, :2]
    clearance = float(case.mechanism.connections["C"].joint.clearance)
    apart = [offset(run) - offset(exact) for run in (default, loose)]
    off = [np.linalg.norm(each, axis=1).max() / clearance for each in apart]
    assert off[0] > 0.03 and off[1] > 0.3
    assert Check.PLACE_IN_GAP in beyond(default) & beyond(loose)


@pytest.mark.slow
def test_a_pendulum_off_in_its_gap_after_many_bouncy_impacts_is_said():
    """Indentations rise by 3 % of the largest in a step, and restitution is 0.976."""
    case = structures()[12].case(5)
    exact, run = (
        jc.simulate(case.mechanism, case.duration, integrator=integrator, save=201)
        for integrator in (
            jc.integrator.Adaptive(rtol=1e-10, atol=1e-12),
            jc.integrator.FixedStep(),
        )
    )
    assert np.abs(across(run, "B") - across(exact, "B")).max() > 0.03
    assert beyond(run) == {Check.PLACE_IN_GAP}


@pytest.mark.slow
def test_where_a_slider_is_after_elastic_impacts_is_said_by_adaptive_too():
    """A fortieth of the clearance off by `Adaptive`, two thirds by steps of rk4."""
    case = extremes.JOINTS["guide"][0](extremes.USUAL | {"restitution": 1.0})
    exact, default, fixed = (
        jc.simulate(case.mechanism, case.duration, integrator=integrator, save=6)
        for integrator in (
            jc.integrator.Adaptive(rtol=1e-11, atol=1e-13),
            jc.integrator.Adaptive(),
            jc.integrator.FixedStep(),
        )
    )
    off = [np.abs(across(run, "B") - across(exact, "B")).max() for run in (default, fixed)]
    assert off[0] > 0.02 and off[1] > 0.3
    assert beyond(default) == {Check.PLACE_IN_GAP}
    assert {Check.PLACE_IN_GAP, Check.BODY_PLACES} <= beyond(fixed)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["Adaptive", "FixedStep", "ImplicitStep"])
def test_a_lightly_damped_journal_that_is_elsewhere_in_its_gap_says_so(integrator):
    """Its law prescribes no restitution, which is 0.98. Implicit steps of any length wear off twice
    what is right."""
    case = structures()[2].case(14)
    rungs = {
        "Adaptive": jc.integrator.Adaptive(),
        "FixedStep": jc.integrator.FixedStep(),
        "ImplicitStep": jc.integrator.ImplicitStep(1.6e-5),
    }
    exact, run = (
        jc.simulate(case.mechanism, case.duration, integrator=own, save=201)
        for own in (jc.integrator.Adaptive(rtol=1e-10, atol=1e-12), rungs[integrator])
    )
    worn = [float(one.worn_volume("B", "bearing")[-1]) for one in (exact, run)]
    assert np.abs(across(run, "B") - across(exact, "B")).max() > 0.3
    assert abs(worn[1] / worn[0] - 1) > 0.04
    said = Check.PLACE_IN_GAP if integrator != "ImplicitStep" else Check.HALVED_WEAR
    assert said in beyond(run)


@pytest.mark.slow
def test_a_journal_that_its_friction_whirls_about_is_looked_at_again():
    """Its mean force is 65 % off; no figure of its own run is beyond its limit."""
    case = structures()[3].case(15)
    exact, run = (
        jc.simulate(case.mechanism, case.duration, integrator=own, save=201)
        for own in (jc.integrator.Adaptive(), jc.integrator.FixedStep())
    )
    means = [float(jc.response.MeanContactForce("B")(one)) for one in (exact, run)]
    assert means[1] > 1.5 * means[0] and Check.MEAN_FORCE in beyond(run)
