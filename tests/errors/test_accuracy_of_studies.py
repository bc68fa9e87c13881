"""A problem that asks for an accuracy of its responses has an integrator that keeps it, chosen
once; and arguments that meant other things by that word go on by their old names for a version."""

import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies import chosen_integrator
from tests.rigs.loaded_bearing import loaded_bearing

DURATION, SAVES = 0.01, 41
FORCE, WEAR = jc.response.MeanContactForce("B"), jc.response.WornVolume("B")


def problem(**more):
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=1e-6)
    return jc.Problem(
        loaded_bearing(500.0, jc.friction.Stribeck()),
        {"force": FORCE, "wear": WEAR},
        {"clearance": clearance},
        duration=DURATION,
        save=SAVES,
        **more,
    )


@pytest.fixture(scope="module")
def asked():
    return problem(accuracy=0.01)


@pytest.fixture(scope="module")
def exact():
    tight = jc.integrator.Adaptive(rtol=1e-10, atol=1e-13)
    given = {"integrator": tight, "save": SAVES, "verify": False}
    return jc.simulate(loaded_bearing(500.0, jc.friction.Stribeck()), DURATION, **given)


def test_responses_are_as_accurate_as_was_asked(asked, exact):
    found = jax.jit(asked.evaluate)(asked.nominal()).responses
    assert asked.accuracy == 0.01 and "ImplicitStep(" in asked.why_integrator
    np.testing.assert_allclose(found["force"], FORCE(exact), rtol=0.01)
    np.testing.assert_allclose(found["wear"], WEAR(exact), rtol=0.01)


def test_numbers_are_in_units_and_by_name(exact):
    """Of the force alone, which steps four times as long tell."""
    coarse = problem(accuracy={"force": 5.0})
    found = float(jax.jit(coarse.evaluate)(coarse.nominal()).responses["force"])
    assert abs(found - float(FORCE(exact))) <= 5.0
    assert coarse.accuracy == (("force", 5.0),)


def test_a_study_tells_why_its_steps_are_as_they_are(asked):
    """And all of its samples take them."""
    assert asked.description.remark == asked.why_integrator
    assert len(asked.why_integrator.split()) <= 25
    step = float(asked.integrator.step)
    assert f"ImplicitStep(step={step:.9g}, rebound=1)" in asked.why_integrator


def test_the_same_integrator_given_is_the_same_problem(asked):
    """Folders of a study that was asked for an accuracy open by the integrator that was chosen."""
    given = problem(integrator=asked.integrator)
    assert set(asked.parts()) == set(given.parts())
    assert float(given.parts()["integrator"].step) == float(asked.parts()["integrator"].step)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"accuracy": -0.1}, "accuracy of a Problem .* is -0.1; it must be .* above 0 and below 1"),
        ({"accuracy": {}}, "accuracy of a Problem is empty"),
        ({"accuracy": {"forces": 1.0}}, 'no response "forces" in this problem'),
        ({"accuracy": {"force": -1.0}}, "accuracy of 'force' is -1"),
        ({"accuracy": 0.1, "integrator": jc.integrator.FixedStep()}, "give one of the two"),
    ],
)
def test_what_is_no_accuracy_gets_a_sentence(more, said):
    with pytest.raises(ValueError, match=said):
        problem(**more)


def test_a_guess_that_takes_many_steps_is_replaced_by_a_choice(monkeypatch):
    """Unasked no run is made, unless that pays."""
    guess = problem()
    assert guess.accuracy is None and "too fast for the usual explicit" in guess.why_integrator
    monkeypatch.setattr(chosen_integrator, "DEAR", 100)
    chosen = problem()
    assert chosen.accuracy == chosen_integrator.UNASKED
    assert "the cheapest setting tried" in chosen.why_integrator


def test_a_study_is_held_to_what_was_asked(asked):
    """Replicas of its samples are beside a share of the root mean square."""
    assert asked.description.responses["force"].tolerance(500.0) == 5.0
    units = problem(accuracy={"force": 5.0})
    known = units.description.responses
    assert known["force"].tolerance(500.0) == 5.0 and known["wear"].tolerance(1.0) is None
