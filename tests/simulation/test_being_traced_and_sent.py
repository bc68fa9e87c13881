"""`simulate` where a run is traced, cannot compile, or its failure crosses to another process."""

import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

STEPS = jc.integrator.FixedStep(2e-5)
RIG = jc.scenes.slider_crank(wear=False)


def run(clearance, **options):
    rig = eqx.tree_at(lambda rig: rig.connections["B"].joint.clearance, RIG, clearance)
    return jc.simulate(rig, 2e-3, save=3, integrator=STEPS, **options)


def test_a_failure_can_be_pickled():
    few = jc.integrator.Adaptive(most_steps=5)
    with pytest.raises(jc.SimulationError) as caught:
        jc.simulate(RIG, 2e-3, save=3, integrator=few)
    copy = pickle.loads(pickle.dumps(caught.value))
    assert str(copy) == str(caught.value) == caught.value.trajectory.result
    np.testing.assert_array_equal(copy.trajectory.time, caught.value.trajectory.time)


@pytest.mark.slow
def test_under_a_transformation_it_names_what_to_do():
    with pytest.raises(ValueError, match="throw=False"):
        jax.jit(lambda clearance: run(clearance).time)(2e-4)


def test_under_a_transformation_without_throwing_it_is_the_same_run():
    traced = jax.jit(lambda clearance: run(clearance, throw=False).states)(2e-4)
    np.testing.assert_allclose(traced, run(2e-4).states, rtol=1e-12, atol=1e-15)


def test_without_compilation_it_says_so():
    with jax.disable_jit(), pytest.raises(ValueError, match="disable_jit"):
        run(2e-4)


def test_backwards_a_run_that_shows_its_progress_says_what_to_do():
    """Its derivatives are compared with those in other steps, which nothing goes backwards through;
    what tells of it is still told."""
    last = lambda clearance: run(clearance, throw=False, progress_bar=True).states[-1, 0]
    with pytest.raises(ValueError, match="shows its progress"):
        jax.grad(last)(2e-4)


def test_functions_of_time_may_enclose_numbers_of_a_batch():
    def end(size):
        rig = jc.Mechanism(
            {"arm": jc.Body(1.0, 0.1)},
            {"A": jc.Connection(jc.joint.Revolute(), "ground", "arm")},
            {"push": jc.load.JointTorque("A", lambda t: size * jnp.sin(8.0 * t))},
        )
        steps = jc.integrator.FixedStep(1e-3)
        run = jc.simulate(rig, 0.1, save=2, integrator=steps, throw=False, verify=False)
        return run.coordinate("A")[-1]

    found = jax.vmap(end)(jnp.array([1.0, 2.0]))
    np.testing.assert_allclose(found, [end(1.0), end(2.0)], rtol=1e-12)
