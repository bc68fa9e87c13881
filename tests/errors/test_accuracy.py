"""What is chosen for an accuracy keeps it, beside runs with far tighter tolerances; the same
question gets the same answer; and what cannot be asked gets a sentence."""

import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.errors.choice import Chosen
from jaxclear.simulation import simulate as simulating
from tests.rigs.accuracy_asked import CASES, share_off, truth
from tests.rigs.cells import slow_but
from tests.rigs.loaded_bearing import loaded_bearing

ASKED = 0.01
CHOICE = Chosen(jc.integrator.Adaptive(rtol=1e-9, atol=1e-11), "chosen", 0.5, 1, 1)
LIGHT = ("loaded bearing", "ideal chain")


def asked(case, accuracy=ASKED, **more):
    given = {"save": case.saves, "balance": True} | more
    return jc.simulate(case.make(), case.duration, accuracy=accuracy, **given)


@pytest.fixture(scope="module")
def bearing():
    return CASES["loaded bearing"], asked(CASES["loaded bearing"])


@pytest.mark.parametrize("name", slow_but(LIGHT, CASES))
def test_a_run_is_as_accurate_as_was_asked(name, request):
    """Places, mean forces, friction loss and wear; its own replicas say so too."""
    loaded = name == "loaded bearing"
    run = request.getfixturevalue("bearing")[1] if loaded else asked(CASES[name])
    assert share_off(run, truth(CASES[name])) <= ASKED
    assert not run.warnings and not run.verification.beyond


def test_no_choice_is_made_that_takes_longer_than_the_usual_run(monkeypatch):
    case = CASES["slider-crank"]
    usual = jc.simulate(case.make(), case.duration, save=case.saves, balance=True)
    # What is known afterwards is that the usual run is cheap.
    asked(case)
    for name in ("choose_setting", "is_usual_cheap"):
        monkeypatch.setattr(simulating, name, None)
    run = asked(case)
    np.testing.assert_array_equal(run.states, usual.states)
    assert "Run with integrator.Adaptive()" in run.verification.why


def test_a_usual_run_that_is_not_as_accurate_is_followed_by_a_choice(monkeypatch):
    monkeypatch.setattr(simulating, "choose_setting", lambda *_: CHOICE)
    case = CASES["ideal chain"]
    run, loose = asked(case, 1e-12), asked(case, 1e-2)
    assert run.verification.why == CHOICE.why
    assert int(run.accepted_steps) > 1.5 * int(loose.accepted_steps)


def test_what_is_promised_is_what_was_asked(bearing):
    """Friction that answers fast is stepped implicitly: explicit steps are sixty times the work."""
    _, run = bearing
    promised = {told.part: told.tolerance for told in run.verification.entries}
    assert promised["places"] == promised["mean_force"] == promised["losses"] == ASKED
    assert promised["gaps"] is None and promised["peak_force"] is None
    assert "Run with integrator.ImplicitStep(" in run.verification.why
    assert len(run.verification.why.split()) <= 25


def test_the_choice_is_the_same_each_time_also_without_verification(bearing):
    case, run = bearing
    alone = asked(case, verify=False)
    sentence = "Not verified: verify=False. Run with integrator.ImplicitStep("
    assert sentence in str(alone.verification)
    assert run.verification.why in str(alone.verification)
    assert (alone.states == run.states).all()


def test_more_accuracy_is_never_less_work(bearing):
    case, run = bearing
    work = [int(asked(case, x, verify=False).accepted_steps) for x in (0.2, 0.05)]
    assert work == sorted(work) and work[-1] <= int(run.accepted_steps)


def test_numbers_in_units_are_asked_by_answer_or_response(bearing):
    case, _ = bearing
    exact, force = truth(case), jc.response.MeanContactForce("B")
    by_answer = asked(case, {"mean contact force": 0.5})
    by_response = asked(case, {force: 0.5})
    for run in (by_answer, by_response):
        assert abs(float(force(run) - force(exact))) <= 0.5
        assert not run.warnings
    told = by_answer.verification.entries
    assert {each.answer for each in told if each.tolerance is not None} == {"mean contact force"}
    assert by_response.verification.entries[-1].tolerance == pytest.approx(
        0.5 / float(force(exact)), 0.1
    )


def test_an_answer_that_is_not_there_is_named(bearing):
    case, _ = bearing
    with pytest.raises(ValueError, match='no answer "mean contact forces" of this run'):
        asked(case, {"mean contact forces": 0.5})


@pytest.mark.parametrize(
    ("accuracy", "said"),
    [
        (0.0, "above 0 and below 1"),
        (1.5, "above 0 and below 1"),
        ("high", "accuracy of simulate .* is 'high'"),
        ({}, "accuracy of simulate is empty"),
        ({"mean contact force": 0.0}, "accuracy of 'mean contact force' is 0"),
        ({3: 1.0}, "what accuracy names is 3"),
    ],
)
def test_what_is_no_accuracy_gets_a_sentence(accuracy, said):
    with pytest.raises(ValueError, match=said):
        jc.simulate(loaded_bearing(20.0, None), 0.01, accuracy=accuracy)


def test_an_integrator_or_an_accuracy():
    with pytest.raises(ValueError, match="give one of the two"):
        given = {"accuracy": 0.01, "integrator": jc.integrator.Adaptive()}
        jc.simulate(loaded_bearing(20.0, None), 0.01, **given)


def test_traced_numbers_get_a_sentence():
    rig = loaded_bearing(20.0, None)
    whole = lambda time: jc.simulate(rig, time, accuracy=0.01, throw=False).ended
    with pytest.raises(ValueError, match="are traced .* give integrator="):
        jax.jit(whole)(0.01)
    share = lambda accuracy: jc.simulate(rig, 0.01, accuracy=accuracy, throw=False).ended
    with pytest.raises(ValueError, match="is being traced"):
        jax.jit(share)(0.01)


def rigid(contact, friction):
    joint = jc.clearance.PlanarJournalBearing(contact, friction)
    load = {"load": jc.load.Force(jc.Marker("journal"), (1.0, -5.0))}
    bodies = {"journal": jc.Body(1.0, 1e-4)}
    return jc.Mechanism(bodies, {"B": jc.Connection(joint, "ground", "journal")}, load)


def test_rigid_contact_is_stepped_as_it_is_stated():
    rig = rigid(jc.contact.Rigid(restitution=0.5), jc.friction.Coulomb(mu_kinetic=0.1))
    run = jc.simulate(rig, 0.05, accuracy=0.05, save=26)
    assert "Run with integrator.MoreauJean(" in run.verification.why


def test_rigid_contact_is_not_chosen_for_a_compliant_law():
    rig = rigid(jc.contact.CarvalhoMartins(stiffness=1e9), jc.friction.Coulomb(mu_kinetic=0.1))
    with pytest.raises(ValueError, match='joint "B" has set-valued friction Coulomb'):
        jc.simulate(rig, 0.05, accuracy=0.05)
