"""`simulate` where a run is traced, cannot compile, or its failure crosses to another process."""

import functools
import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Outcome
from tests.rigs.cells import slow_but

STEPS = jc.integrator.FixedStep(2e-5)
RIG = jc.scenes.slider_crank(wear=False)


def run(clearance, **options):
    rig = eqx.tree_at(lambda rig: rig.connections["B"].joint.clearance, RIG, clearance)
    return jc.simulate(rig, 2e-3, save=3, integrator=STEPS, **options)


def test_a_failure_can_be_pickled():
    few = jc.integrator.Adaptive(max_steps=5)
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
    """Nothing goes backwards through comparisons in other steps."""
    last = lambda clearance: run(clearance, throw=False, progress_bar=True).states[-1, 0]
    with pytest.raises(ValueError, match="shows its progress"):
        jax.grad(last)(2e-4)


class Push:
    """A function of time that is an object with a number."""

    def __init__(self, size):
        self.size = size

    def __call__(self, time):
        return self.size * jnp.sin(8.0 * time)


PUSHES = {
    "a number": lambda size: lambda t: size * jnp.sin(8.0 * t),
    "a dictionary": lambda size: (lambda own: lambda t: own["size"] * jnp.sin(8.0 * t))(
        {"size": size}
    ),
    "another function": lambda size: (lambda own: lambda t: own(t))(Push(size)),
    "an object": Push,
    "a method": lambda size: Push(size).__call__,
    "a part": lambda size: functools.partial(lambda own, t: own * jnp.sin(8.0 * t), size),
    "a default": lambda size: lambda t, own=size: own * jnp.sin(8.0 * t),
    "nothing": lambda size: lambda t: jnp.sin(8.0 * t),
}
PUSHED = jc.integrator.FixedStep(1e-3)


def parabola(size):
    """A drive: position, speed and acceleration follow from a function that encloses a number."""
    return jc.Mechanism(
        {"arm": jc.Body(1.0, 0.1)},
        {
            "A": jc.Connection(
                jc.joint.Revolute(drive=jc.drive.Position(lambda t: size * t**2)), "ground", "arm"
            )
        },
        {"push": jc.load.Torque(jc.Marker("arm"), lambda t: jnp.sin(t))},
    )


@pytest.mark.parametrize(("mapped", "size"), [(jax.jit, 2.0), (jax.vmap, 2.0 * np.ones(3))])
def test_a_traced_run_with_functions_of_time_is_returned_as_any_other(mapped, size):
    """Turned by a t**2 it stands at 0.01 a after 0.1 s; functions are read of it as of others."""
    simulate = lambda size: jc.simulate(parabola(size), 0.1, save=3, integrator=PUSHED, throw=False)
    run = mapped(simulate)(size)
    run = run[1] if mapped is jax.vmap else run
    np.testing.assert_allclose(run.coordinate("A")[-1], 0.02, rtol=1e-12)
    np.testing.assert_allclose(run.mechanism.loads["push"].value(0.5), np.sin(0.5))
    np.testing.assert_allclose(run.reaction("A").torque[-1, 2], 0.4 - np.sin(0.1), rtol=1e-9)


@pytest.mark.parametrize("enclosed", slow_but(("a number", "a part"), PUSHES))
def test_functions_of_time_may_enclose_numbers_that_are_traced(enclosed):
    """A batch, compiled or not, and a slope: of I w'' = M sin(8 t), which M leads."""

    def end(size):
        rig = jc.Mechanism(
            {"arm": jc.Body(1.0, 0.1)},
            {"A": jc.Connection(jc.joint.Revolute(), "ground", "arm")},
            {"push": jc.load.JointTorque("A", PUSHES[enclosed](size))},
        )
        run = jc.simulate(rig, 0.1, save=2, integrator=PUSHED, throw=False, verify=False)
        return run.coordinate("A")[-1]

    led = enclosed != "nothing"
    one = (0.1 - np.sin(0.8) / 8.0) / 8.0 / 0.1
    wanted = [one, 2.0 * one if led else one]
    sizes = jnp.array([1.0, 2.0])
    for mapped in (jax.vmap(end), jax.jit(jax.vmap(end)), jax.vmap(jax.jit(end))):
        np.testing.assert_allclose(mapped(sizes), wanted, rtol=1e-9)
    slope = jax.jvp(end, (1.0,), (1.0,))[1]
    np.testing.assert_allclose(slope, one if led else 0.0, rtol=1e-9)


def test_a_start_that_is_traced_and_does_not_close_is_no_start():
    """A rod that is too long to meet its rocker, in a batch beside one that does: outside a program
    `simulate` refuses it."""

    def ending(rod):
        revolute, marker = jc.joint.Revolute, jc.Marker
        joints = {
            "A": jc.Connection(revolute(), "ground", "crank"),
            "B": jc.Connection(revolute(), marker("crank", (0.1, 0.0)), "rod"),
            "C": jc.Connection(revolute(), marker("rod", (rod, 0.0)), marker("rocker", (0.2, 0.0))),
            "D": jc.Connection(revolute(), marker("ground", (0.3, 0.0)), "rocker"),
        }
        bodies = {name: jc.Body(1.0, 1e-2) for name in ("crank", "rod", "rocker")}
        rig = jc.Mechanism(bodies, joints, start={"A": 0.5})
        run = jc.simulate(rig, 0.01, save=3, integrator=PUSHED, throw=False)
        return run.outcome, run.ended

    outcomes, ended = jax.jit(jax.vmap(ending))(jnp.array([0.3, 0.9]))
    assert [*outcomes] == [Outcome.REACHED, Outcome.UNASSEMBLED]
    np.testing.assert_allclose(ended, [0.01, 0.0])
    assert "no start was found that closes its loops" in Outcome.UNASSEMBLED.sentence


class Falling(jc.drive.AbstractDrive):
    """A drive of a user's own, with no number of its own."""

    def motion(self, time):
        return time**2, 2.0 * time, 2.0 + 0.0 * time


def test_a_drive_of_the_users_own_may_be_built_within_a_program():
    def end(mass):
        pin = jc.Connection(jc.joint.Revolute(drive=Falling()), "ground", "arm")
        rig = jc.Mechanism({"arm": jc.Body(mass, 0.1)}, {"A": pin})
        run = jc.simulate(rig, 0.1, save=2, integrator=PUSHED, throw=False)
        return run.coordinate("A")[-1]

    np.testing.assert_allclose(jax.jit(end)(1.0), 0.01, rtol=1e-12)
