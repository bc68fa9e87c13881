"""The integrator of a study that asks for none: as right as an error-controlled run where friction
is faster than an explicit step, and the usual explicit steps elsewhere."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.usual_integrator import usual_integrator
from tests.rigs.loaded_bearing import loaded_bearing, losses

DURATION, SAVES = 0.01, 41
# What the default promises; the references agree to 1e-3.
WITHIN = 0.02
TIGHT = jc.integrator.Adaptive(rtol=1e-8, atol=1e-12)
FORCE_LAWS = {
    name: law
    for name, law in vars(jc.friction).items()
    if isinstance(law, type)
    and issubclass(law, jc.friction.AbstractFrictionLaw)
    and not name.startswith("Abstract")
    and not law.set_valued
}


def run_of(rig, integrator):
    return jc.simulate(rig, DURATION, integrator=integrator, save=SAVES, balance=True)


def problem(rig, **rest):
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=1e-6)
    return jc.Problem(
        rig,
        {"place": lambda run: run.states[-1, 0]},
        {"clearance": clearance},
        duration=DURATION,
        save=SAVES,
        **rest,
    )


def assert_loses_what_a_tight_run_loses(rig):
    usual, _ = usual_integrator(rig, DURATION)
    np.testing.assert_allclose(
        losses(run_of(rig, usual)), losses(run_of(rig, TIGHT)), rtol=WITHIN, atol=1e-30
    )


@pytest.mark.parametrize("load", [20.0, 500.0, 5000.0])
@pytest.mark.parametrize("law", ["Stribeck", "Dahl"])
def test_loaded_bearing_loses_what_a_tight_run_loses(law, load):
    """Friction loss, worn volume and depth of a journal that creeps; explicit steps of 2e-5 s were
    off by up to 4000 times."""
    assert_loses_what_a_tight_run_loses(loaded_bearing(load, FORCE_LAWS[law]()))


@pytest.mark.slow
@pytest.mark.parametrize("law", FORCE_LAWS)
@pytest.mark.parametrize("radius", [5e-3, 10e-3, 50e-3])
@pytest.mark.parametrize("load", [20.0, 100.0, 500.0, 5000.0])
@pytest.mark.parametrize("sliding", [False, True])
def test_every_loaded_bearing_loses_what_a_tight_run_loses(law, radius, load, sliding):
    rig = loaded_bearing(load, FORCE_LAWS[law](), radius=radius, sliding=sliding)
    assert_loses_what_a_tight_run_loses(rig)


def test_steps_stay_explicit_where_friction_is_slow_or_absent():
    for rig in (jc.scenes.slider_crank(), jc.scenes.slider_crank(friction=False)):
        asked = problem(rig)
        assert isinstance(asked.integrator, jc.integrator.FixedStep)
        assert asked.why_integrator == ""


def test_a_study_says_why_its_steps_are_implicit():
    asked = problem(loaded_bearing(500.0, jc.friction.Stribeck()))
    assert isinstance(asked.integrator, jc.integrator.ImplicitStep)
    assert 'friction in joint "B"' in asked.why_integrator
    chosen = problem(loaded_bearing(500.0, jc.friction.Stribeck()), integrator=TIGHT)
    assert chosen.why_integrator == ""


@pytest.mark.parametrize("law", ["LuGre", "Dahl"])
def test_bristles_run_by_default(law):
    """Deflections settle within 1e-6 m of sliding: an explicit step of 2e-5 s was not a number
    from the first instant on."""
    asked = problem(jc.scenes.slider_crank(friction=FORCE_LAWS[law]()))
    assert isinstance(asked.integrator, jc.integrator.ImplicitStep)
    result = asked.evaluate(asked.nominal())
    assert int(result.outcome) == jc.integrator.Outcome.REACHED
    assert jnp.isfinite(result.responses["place"])


@pytest.mark.parametrize("law", ["LuGre", "Dahl"])
def test_explicit_steps_through_bristles_say_that_it_is_they(law):
    """The sentence named no law; the step it names resolves them."""
    rig = jc.scenes.slider_crank(friction=FORCE_LAWS[law]())
    with pytest.raises(jc.SimulationError) as caught:
        jc.simulate(rig, 0.05, integrator=jc.integrator.FixedStep(), save=5)
    assert f'"B" has friction.{law}' in str(caught.value) and "ImplicitStep" in str(caught.value)
    step = float(str(caught.value).split("at most ")[1].split(" s ")[0])
    assert 0 < step < 2e-5


def test_a_sample_says_why_its_steps_are_implicit():
    sample = jc.monte_carlo(problem(loaded_bearing(500.0, jc.friction.Stribeck())), 2)
    assert sample.sentence().endswith(sample.problem.why_integrator)
    assert 'friction in joint "B"' in sample.sentence()


def test_a_harder_load_asks_for_shorter_steps():
    steps = [
        float(usual_integrator(loaded_bearing(load, jc.friction.Stribeck()), DURATION)[0].step)
        for load in (500.0, 5000.0, 50000.0)
    ]
    assert steps[0] >= steps[1] > steps[2]
