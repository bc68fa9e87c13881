"""A study whose samples are in doubt has its nominal one gone through again, and says what is off:
bounces each of which is nearly right lead elsewhere, which no figure of a sample tells."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Check, Checks
from jaxclear.integrators.figures import Figure
from jaxclear.simulation import doubts
from jaxclear.studies import problem as problems
from tests.rigs.bouncing_journal import CLEARANCE, LEFT_THERE, falling

LAW = jc.contact.Flores(stiffness=1e10, restitution=0.98)


def bounces(step):
    return jc.Problem(
        falling(LAW),
        {
            "place": lambda run: run.coordinate("journal")[-1, 1],
            "force": jc.response.MeanContactForce("B"),
        },
        {"clearance": jc.Variable(CLEARANCE, tolerance=1e-5)},
        duration=2.0,
        integrator=jc.integrator.FixedStep(step),
        save=51,
        state=LEFT_THERE,
    )


@pytest.fixture(scope="module")
def study():
    return jc.monte_carlo(bounces(6e-5), 32, chunk=32)


def test_what_is_off_in_all_samples_is_said(study):
    """By 7 % of the clearance, where 3 % are the limit, while no sample says so."""
    assert set(study.nominal.figures) == {Check.PLACE_IN_GAP}
    assert Check.PLACE_IN_GAP not in study.checks.figures
    (said,) = study.doubts
    assert said.startswith("A second look at the nominal sample: With steps a quarter as long")
    assert said in study.sentence()


def test_steps_that_are_right_say_nothing(study):
    found = jc.monte_carlo(bounces(3e-5), 32)
    assert doubts.many_in_doubt(found.checks, opens=True)
    assert found.doubts == () and found.sentence().startswith("32 samples, 0 failed")
    assert found.nominal.figures[Check.PLACE_IN_GAP].worst.max() < 0.03


def test_samples_that_warn_of_impacts_hear_that_the_nominal_ones_are_right(study):
    """The nominal run's places agree: a study tells it beside how many samples warn."""
    right = Checks.of({Check.PLACE_IN_GAP: Figure(np.array([0.0123]), np.zeros(1), ("B",))})
    steep = Figure(np.full((32, 1), 0.4), np.zeros((32, 1)), ("B",))
    warned = dataclasses.replace(study, checks=Checks.of({Check.IMPACT_STEP: steep}), nominal=right)
    assert warned.sentence() == (
        "32 samples, 0 failed, 32 with warnings (impact step in 32). The nominal sample was gone "
        "through again with steps a quarter as long: its places in gaps agree within 0.012 of the "
        "clearance, so that its impacts are right, whatever their steps."
    )
    for other in ({"nominal": Checks()}, {"nominal": study.nominal}, {"checks": Checks()}):
        assert "agree within" not in dataclasses.replace(warned, **other).sentence()


def test_a_campaign_has_its_nominal_sample_looked_at_once(study, tmp_path, monkeypatch):
    """It says what the plain study says; so does its folder, without the problem too."""
    found = jc.campaign(study.problem, 32, folder=tmp_path)

    def look(*_):
        raise AssertionError("gone through again")

    monkeypatch.setattr(problems, "found_in_one", look)
    again = jc.campaign(study.problem, 32, folder=tmp_path)
    for one in (found, again, jc.open_campaign(tmp_path)):
        assert one.sentence() == study.sentence()
        assert one.sample.doubts == study.doubts


def test_a_study_without_doubts_is_not_looked_at(study, monkeypatch):
    def look(*_):
        raise AssertionError("gone through again")

    monkeypatch.setattr(problems, "found_in_one", look)
    quiet = study.checks.figures[Check.IMPACT_STEP]
    little = dataclasses.replace(quiet, worst=jnp.full_like(quiet.worst, 0.003))
    calm = Checks.of(study.checks.figures | {Check.IMPACT_STEP: little})
    assert not study.problem.second_look(calm).figures
    with pytest.raises(AssertionError, match="again"):
        study.problem.second_look(study.checks)


@pytest.mark.slow
def test_a_derivative_of_what_is_off_says_so(study):
    found = jc.sensitivity(study.problem, sample=study, difference_samples=32)
    place, force = (found.derivatives[name, "clearance"].verdict for name in ("place", "force"))
    assert study.doubts[0] in place and "second look" not in force
