"""What only a second look can tell of runs in rigid contact, of friction that sticks, of elastic
impacts, and of where bodies are."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from benchmarks.claims import extremes
from jaxclear.integrators import Check
from jaxclear.integrators.figures import Figure
from jaxclear.simulation import doubts, two_runs
from tests.rigs.attacked import run_of

MASS, LOAD, PUSH, MU, SPEED = 1.0, 100.0, 9.0, 0.1, 1e-3


def beyond(run):
    return {check for check, flag in run.checks.beyond().items() if flag}


@pytest.fixture(scope="module")
def pushed():
    """A slider that friction stops against a push, in a joint that always touches."""
    guide = jc.clearance.SliderGuide(
        jc.contact.CarvalhoMartins(stiffness=1e9),
        jc.friction.Coulomb(mu_kinetic=MU),
        width=0.02,
        length=0.04,
        clearance=1e-4,
    )
    ends = jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
    rig = jc.Mechanism(
        {"slider": jc.Body(MASS, 1e-3)},
        {"G": jc.Connection(guide, *ends)},
        {"load": jc.load.Force(jc.Marker("slider"), (PUSH, -LOAD))},
        speeds={"slider": (SPEED, 0.0, 0.0)},
    )

    def run(step, balance=True):
        integrator = jc.integrator.NonColliding(step)
        return jc.simulate(rig, 0.01, save=6, integrator=integrator, balance=balance)

    return run


def lost(run):
    return float(run.energy_balance().friction_loss[-1])


@pytest.mark.slow
def test_friction_that_stops_slip_within_a_step_is_said_where_its_loss_is_asked_for(pushed):
    """Beside a slide to rest by hand."""
    friction = MU * LOAD
    exact = friction * SPEED**2 / (2 * (friction - PUSH) / MASS)
    found, right = pushed(7e-4), pushed(2e-5)
    assert abs(lost(found) / exact - 1) > 0.05 and Check.FRICTION_LOSS in beyond(found)
    assert "what friction takes or wears changes by" in found.result
    assert lost(right) == pytest.approx(exact, rel=0.01) and right.warnings == ()
    assert Check.FRICTION_LOSS not in pushed(7e-4, balance=False).checks.figures


def test_what_friction_takes_is_compared_with_the_energies_where_it_is_next_to_nothing(pushed):
    run = pushed(2e-5)
    place = run.history.layout().energy_start

    def apart(loss):
        states = run.states.at[-1, place + two_runs.ENERGIES.index("friction_loss")].set(loss)
        most = np.abs(np.asarray(states)[:, place:]).max()
        other = dataclasses.replace(run, history=dataclasses.replace(run.history, states=states))
        return two_runs._friction_loss_apart(other, other), most, other

    nothing, most, still = apart(0.0)
    assert nothing == 0.0
    _, _, little = apart(0.1 * two_runs.LEAST_LOSS * most)
    assert two_runs._friction_loss_apart(still, little) == pytest.approx(0.1, rel=1e-3)


@pytest.fixture(scope="module")
def guided():
    """A slider in a guide with rigid contact; numbers alone differ."""
    joint = extremes.JOINTS["guide"][0]

    def run(step, **varied):
        case = joint(extremes.USUAL | varied)
        integrator = jc.integrator.MoreauJean(step)
        return jc.simulate(
            case.mechanism,
            case.duration,
            integrator=integrator,
            save=extremes.SAVES,
            state=jc.State(concentric=True),
            balance=True,
        )

    return run


@pytest.mark.slow
def test_friction_in_rigid_contact_that_hangs_on_the_step_is_said(guided):
    """Steps of impacts that stop a slider: beside steps 160 times as short a sixth is off."""
    exact = lost(guided(1.25e-6, mu=1.5))
    found, right = guided(2e-4, mu=1.5), guided(1.25e-5, mu=1.5)
    assert abs(lost(found) / exact - 1) > 0.1 and Check.FRICTION_LOSS in beyond(found)
    assert lost(right) == pytest.approx(exact, rel=0.05)
    assert not beyond(right) & {Check.FRICTION_LOSS, Check.MEAN_FORCE}


@pytest.mark.slow
def test_what_friction_takes_in_impacts_of_two_corners_does_not_hang_on_their_order(guided):
    """By a third it did, in every step too long to tell the corners apart."""
    varied = {"mu": 1.5, "restitution": 0.01, "stiffness": 1e12}
    losses = [lost(guided(step, **varied)) for step in (1e-4, 6e-6)]
    assert losses[0] == pytest.approx(losses[1], rel=0.02)


@pytest.mark.parametrize(
    ("contact", "doubted"),
    [
        (jc.contact.CarvalhoMartins(restitution=0.9), False),
        (jc.contact.CarvalhoMartins(restitution=1.0), True),
        (jc.contact.Hertz(), True),
        (jc.contact.KelvinVoigt(), False),
    ],
    ids=["lossy", "restitution 1", "lossless", "without restitution"],
)
def test_elastic_impacts_are_always_in_doubt(contact, doubted):
    bearing = jc.clearance.PlanarJournalBearing(contact, bearing_radius=0.01, clearance=1e-4)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)}, {"B": jc.Connection(bearing, "ground", "journal")}
    )
    steps = jc.integrator.FixedStep()
    checks = jc.integrator.Checks()
    run = SimpleNamespace(mechanism=rig, formulation=steps.formulation, checks=checks)
    assert doubts.in_doubt(run, steps) == doubted


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["semi_implicit", "ImplicitStep"])
def test_where_a_fast_body_is_after_many_turns_is_said(rung):
    """Its journal's force is right, and windows too short to tell."""
    case = extremes.JOINTS["ball"][0](extremes.USUAL | {"speed": 1e4})

    def run(integrator):
        return jc.simulate(
            case.mechanism, case.duration, integrator=integrator, save=extremes.SAVES
        )

    found = run(extremes.rungs()[rung].integrator)
    exact = run(jc.integrator.Adaptive(rtol=1e-9, atol=1e-11))
    places = [np.asarray(each.body("arm").com) for each in (found, exact)]
    way = np.abs(places[1] - places[1][0]).max()
    assert np.abs(places[0] - places[1]).max() > 0.02 * way
    assert Check.HALVED_MOTION in beyond(found)


@pytest.mark.slow
def test_a_light_body_that_crosses_its_clearance_within_a_step_is_said():
    """A ball between its socket and an arm of a hundred tonnes: the mean force is twice what it
    should be."""
    case = extremes.JOINTS["ball"][0](extremes.USUAL | {"mass ratio": 1e5})
    run, exact = (
        jc.simulate(
            case.mechanism,
            case.duration,
            integrator=jc.integrator.MoreauJean(step),
            save=extremes.SAVES,
            state=jc.State(concentric=case.concentric),
            throw=False,
        )
        for step in (1e-4, 3e-6)
    )
    forces = [float(jc.response.MeanContactForce("B")(each)) for each in (run, exact)]
    assert abs(forces[0] / forces[1] - 1) > 0.2
    assert {Check.MEAN_FORCE, Check.PARTED_FORCE} <= beyond(run)


@pytest.mark.parametrize("drift", [0.004, 0.02])
def test_bodies_that_drift_bring_rigid_steps_in_doubt(drift):
    """Also where nothing opens and nothing rubs."""
    joint = jc.Connection(jc.joint.Revolute(), "ground", "arm")
    rig = jc.Mechanism({"arm": jc.Body(1.0, 1e-4)}, {"A": joint})
    figure = Figure(jnp.array([drift]), jnp.zeros(1), ("",))
    steps = jc.integrator.NonColliding()
    run = SimpleNamespace(
        mechanism=rig,
        formulation=steps.formulation,
        history=SimpleNamespace(balanced=False),
        checks=jc.integrator.Checks.of({Check.HALVED_MOTION: figure}),
    )
    assert doubts.in_doubt(run, steps) == (drift > doubts.DOUBTS[Check.HALVED_MOTION])


@pytest.mark.slow
def test_what_two_parted_runs_agree_in_by_chance_is_said():
    """Shorter and shorter steps of rigid contact go on to disagree by more than is promised in the
    mean force of impacts that take no energy."""
    case = extremes.JOINTS["guide"][0](extremes.USUAL | extremes.CORNERS[3])
    runs = [
        jc.simulate(case.mechanism, 0.05, save=6, integrator=jc.integrator.MoreauJean(step))
        for step in (1e-4, 2.5e-5, 3e-6)
    ]
    answers = list(map(jc.response.MeanContactForce("B"), runs))
    assert max(answers) > 1.03 * min(answers) and Check.PARTED_FORCE in beyond(runs[0])


@pytest.mark.slow
def test_mean_forces_of_rigid_paths_that_have_parted_are_said():
    """A slider-crank whose journal is four fifths of its clearance elsewhere: the mean force is
    13 % off, and changes by 1.7 % where steps are a quarter as long."""
    found = run_of(14, 35, jc.integrator.MoreauJean(2.49e-5))
    exact = run_of(14, 35, jc.integrator.MoreauJean(1e-6))
    (name,) = found.formulation.contact_joints(found.mechanism)
    forces = [float(jc.response.MeanContactForce(name)(run)) for run in (found, exact)]
    assert abs(forces[0] / forces[1] - 1) > 0.1
    assert Check.PARTED_FORCE in beyond(found)
