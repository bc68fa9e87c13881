"""A push that is shorter than a step is told of, and steps that find their own length do not pass
over it. Oracle: a body on a slide that is pushed moves by the impulse over its mass."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Check
from jaxclear.simulation.load_steps import load_steps, passed_over, step_ends

MASS, FORCE, BEGIN, LASTS = 2.0, 3e4, 0.051, 3e-5
PULSE = jc.TimeTable(
    [0.0, BEGIN, BEGIN + 1e-6, BEGIN + LASTS, BEGIN + LASTS + 1e-6, 1.0],
    [0.0, 0.0, FORCE, FORCE, 0.0, 0.0],
    "linear",
)


def pushed(push):
    along = {end: jc.Marker(end, axis="x") for end in ("ground", "cart")}
    slide = jc.Connection(jc.joint.Prismatic(), *along.values())
    return jc.Mechanism(
        {"cart": jc.Body(MASS, 1.0)}, {"G": slide}, {"push": jc.load.JointTorque("G", push)}
    )


def speed(run):
    return float(run.speed("G")[-1])


def test_adaptive_does_not_pass_over_a_push_far_shorter_than_its_steps():
    run = jc.simulate(pushed(PULSE), 0.1, save=6)
    assert speed(run) == pytest.approx(FORCE * LASTS / MASS, rel=1e-5) and not run.warnings


@pytest.mark.parametrize("step", [1e-4, 5e-7])
def test_steps_longer_than_a_push_say_so(step):
    run = jc.simulate(pushed(PULSE), 0.1, save=6, integrator=jc.integrator.FixedStep(step))
    right = speed(run) == pytest.approx(FORCE * LASTS / MASS, rel=0.02)
    assert right == (step < LASTS) == (not run.warnings)
    sentence = 'of the impulse of "push"'
    assert right or [sentence in said for said in run.warnings].count(True) == 1


@pytest.mark.parametrize(("frequency", "said"), [(100.0, False), (1e4, True), (9.9e3, True)])
def test_what_vibrates_faster_than_steps_is_told(frequency, said):
    functions = {"load": lambda time: jnp.cos(2 * jnp.pi * frequency * time)}
    edges = step_ends(np.linspace(0.0, 0.1, 6), 1e-4)
    assert (passed_over(functions, edges)["load"] > Check.LOAD_STEP.limit) == said


def test_what_changes_slowly_leaves_adaptive_as_it_is():
    """And so does a drive of constant speed, of which nothing is told."""
    integrator, times = jc.integrator.Adaptive(), np.linspace(0.0, 0.1, 6)
    slow = pushed(lambda time: 5 * jnp.sin(20 * time))
    assert load_steps(slow, integrator, times) == (integrator, {})
    assert load_steps(slow, jc.integrator.FixedStep(), times).passed["push"] < 1e-9
    driven = jc.scenes.slider_crank("ideal")
    assert load_steps(driven, integrator, times) == (integrator, {})


@pytest.mark.verified
@pytest.mark.parametrize(("step", "said"), [(2e-4, True), (2e-6, False)])
def test_steps_that_meet_a_stop_midway_say_so(step, said):
    """A cart pushed against an elastic stop leaves it with the speed at which it came, and is back
    where it began after twice the time it took, and half a vibration of the stop."""
    mass, push, way, stiffness = 1.0, 50.0, 0.01, 1e8
    along = {end: jc.Marker(end, axis="x") for end in ("ground", "cart")}
    rig = jc.Mechanism(
        {"cart": jc.Body(mass, 1.0)},
        {"G": jc.Connection(jc.joint.Prismatic(), *along.values())},
        {
            "push": jc.load.JointTorque("G", push),
            "stop": jc.load.JointStop("G", upper=way, stiffness=stiffness),
        },
    )
    there, swing = (2 * way * mass / push) ** 0.5, np.pi * (mass / stiffness) ** 0.5
    duration = 4 * (2 * there + swing)
    steps = jc.integrator.FixedStep(step)
    run = jc.simulate(rig, duration, save=6, integrator=steps, verify=True)
    assert (abs(run.coordinate("G")[-1]) > 0.02 * way) == said == bool(run.warnings)


@pytest.mark.slow
def test_a_study_is_held_to_the_push_too_and_says_what_its_steps_pass_over():
    question = lambda integrator: jc.Problem(
        pushed(PULSE),
        {"speed": lambda run: run.speed("G")[-1]},
        {"mass": jc.Variable(lambda rig: rig.bodies["cart"].mass, jc.distribution.Uniform(0.1))},
        duration=0.1,
        save=6,
        integrator=integrator,
    )
    held = question(jc.integrator.Adaptive())
    found = jax.jit(held.evaluate)(held.nominal()).responses["speed"]
    assert float(found) == pytest.approx(FORCE * LASTS / MASS, rel=1e-5)
    passing = question(jc.integrator.FixedStep(1e-4))
    assert "push" in passing.doubts()[0]
