"""A run either reaches its end with a finite state or says in a sentence why not; it never hands
back what is no number."""

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings

import jaxclear as jc
from jaxclear.integrators import Outcome
from jaxclear.multibody.assembly import assemble_arrays
from jaxclear.simulation.simulate import run
from tests.rigs.clearance_joints import JOINTS, USUAL, build

CORNERS = st.fixed_dictionaries(
    {
        "clearance": st.sampled_from([1e-9, 1e-6, 1e-2]),
        "stiffness": st.sampled_from([1e5, 1e9, 1e13]),
        "mu": st.sampled_from([0.0, 0.1, 2.0]),
        "transition_speed": st.sampled_from([1e-9, 1e-3, 1.0]),
        "light_mass": st.sampled_from([1e-6, 1e3]),
        "worn_depth": st.just(0.0),
    }
)
SPEEDS = st.sampled_from([0.0, 1e-6, 1.0, 1e3])
INTEGRATORS = {
    "adaptive": jc.integrator.Adaptive(max_steps=300),
    "fixed": jc.integrator.FixedStep(step=1e-6),
}
# Joints like others, or others with more: their runs go with the long tests.
LONG = {"ball", "guide", "journal", "journal_that_wears", "journal_with_collars", "planar"}


def compiled(kind, integrator):
    def whole(p, speed):
        mechanism = build(kind, p)
        start = assemble_arrays(mechanism)
        speeds = speed * jnp.linspace(0.01, 1.0, start.speeds.size)
        end = run(mechanism, start.coordinates, speeds, jnp.linspace(0.0, 1e-4, 3), integrator)
        return end.states, end.worn, end.outcome, end.ended

    return jax.jit(whole)


@pytest.mark.parametrize(
    ("kind", "integrator"),
    [
        *(
            pytest.param(kind, "adaptive", marks=pytest.mark.slow if kind in LONG else ())
            for kind in JOINTS
        ),
        pytest.param("planar", "fixed", marks=pytest.mark.slow),
        pytest.param("ball", "fixed", marks=pytest.mark.slow),
    ],
)
def test_run_ends_or_says_why(kind, integrator):
    evaluate = compiled(kind, INTEGRATORS[integrator])

    @settings(max_examples=25)
    @example(USUAL, 0.0)
    @example(
        USUAL | {"clearance": 1e-9, "stiffness": 1e13, "mu": 2.0, "transition_speed": 1e-9}, 1e3
    )
    @given(CORNERS, SPEEDS)
    def check(p, speed):
        states, worn, outcome, ended = evaluate(p, speed)
        for leaf in jax.tree.leaves((states, worn)):
            assert np.all(np.isfinite(leaf))
        assert Outcome(int(outcome)).began
        # What is found at the very end is told of the end.
        assert int(outcome) != 0 or float(ended) == 1e-4

    check()


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("kind", ["planar", "ball"])
def test_derivative_of_a_run_from_concentric_rest_is_finite(kind):
    def final(p):
        mechanism = build(kind, p)
        start = assemble_arrays(mechanism)
        times = jnp.linspace(0.0, 1e-4, 3)
        return run(
            mechanism, start.coordinates, start.speeds, times, jc.integrator.FixedStep(step=1e-5)
        ).states[-1]

    slope = jax.jit(lambda p: jax.jvp(final, (p,), (jax.tree.map(jnp.ones_like, p),))[1])
    assert np.all(np.isfinite(slope(jax.tree.map(jnp.asarray, USUAL))))


def pendulum(torque):
    return jc.Mechanism(
        {"arm": jc.Body(1.0, 0.1)},
        {"pin": jc.Connection(jc.joint.Revolute(), "ground", "arm")},
        {"motor": jc.load.JointTorque("pin", torque)},
    )


# A kernel whose every number is nan cannot be checked: such a loop is left to XLA.
@pytest.mark.filterwarnings("ignore:jaxclear runs a time loop")
class Broken(jc.load.AbstractCoordinateLoad):
    """A function of time would be refused before the run."""

    connection: str = "pin"

    def force(self, time, position, speed):
        return jnp.where(time > 5e-4, jnp.nan, 1.0), 0.0, 0.0, 0.0


def test_force_that_is_no_number_ends_the_run():
    with pytest.raises(ValueError, match='load "motor" is not finite'):
        jc.simulate(pendulum(lambda time: jnp.where(time > 5e-4, jnp.nan, 1.0)), 1e-3)
    whole = pendulum(lambda time: 1.0)
    name = next(iter(whole.connections))
    broken = whole.with_load("motor", Broken(name))
    for integrator in (jc.integrator.Adaptive(), jc.integrator.FixedStep(1e-5)):
        end = jc.simulate(broken, 1e-3, integrator=integrator, save=3, throw=False)
        assert not end.succeeded and end.result.startswith("The run ended early, after ")
        assert np.all(np.isfinite(end.states))
        with pytest.raises(jc.SimulationError, match="ended early"):
            jc.simulate(broken, 1e-3, integrator=integrator, save=3)


class Unsound(jc.wear.AbstractWearLaw):
    """A wear law that loses its number: worn volumes are not held to a tolerance, so no step is
    refused."""

    def volume_rate(self, normal_force, slip_speed, traction):
        return jnp.nan * slip_speed


def test_quantity_without_tolerance_that_is_no_number_ends_the_run():
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.Hertz(stiffness=1e9), bearing_wear=jc.Wearing(Unsound(), cells=(8, 1))
    )
    rig = jc.Mechanism({"ring": jc.Body(1.0, 1e-3)}, {"B": jc.Connection(joint, "ground", "ring")})
    end = jc.simulate(rig, 1e-3, save=3, throw=False)
    assert end.result.endswith("The state grew without bound, or became no number.")


def test_too_few_steps_end_the_run():
    few = jc.integrator.Adaptive(max_steps=3)
    end = jc.simulate(
        pendulum(lambda time: jnp.sin(1e3 * time)), 1.0, integrator=few, save=3, throw=False
    )
    assert (
        int(end.outcome) == Outcome.TOO_MANY_STEPS and Outcome.TOO_MANY_STEPS.sentence in end.result
    )


def test_mechanism_without_freedom_runs():
    driven = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(3.0))
    rig = jc.Mechanism(
        {"arm": jc.Body(1.0, 0.1)}, {"pin": jc.Connection(driven, "ground", "arm", at=(0.1, 0.0))}
    )
    end = jc.simulate(rig, 0.1, save=3)
    assert end.states.shape == (3, 0) and end.succeeded
    # rounding of one rotation
    np.testing.assert_allclose(end.body("arm").rotation[-1, 0, 0], np.cos(0.3), rtol=1e-14)
