"""Loops that are closed anew after every step: no drift, the same motion, and no use to error
control.
"""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import assemble
from jaxclear.simulation.simulate import run


def four_bar(stabilisation):
    whole = jc.scenes.four_bar("ideal")
    return jc.Mechanism(
        whole.bodies,
        whole.connections,
        whole.loads,
        guess={"A": 0.81, "D": 1.32},
        stabilisation=stabilisation,
    )


@pytest.fixture(scope="module")
def exact():
    return jc.simulate(
        four_bar(jc.Baumgarte(10.0, 10.0)),
        1.0,
        save=11,
        integrator=jc.integrator.Adaptive(rtol=1e-10, atol=1e-12),
    )


STEPS = {
    "rk4": (jc.integrator.FixedStep(1e-3), 1e-8),
    "implicit": (jc.integrator.ImplicitStep(1e-3), 1e-3),
    "rigid": (jc.integrator.MoreauJean(1e-3), 1e-3),
    "non-colliding": (jc.integrator.NonColliding(1e-3), 1e-3),
}


@pytest.mark.parametrize("name", STEPS)
def test_loops_stay_closed_to_rounding_and_the_motion_is_the_same(name, exact):
    integrator, close = STEPS[name]
    found = jc.simulate(four_bar(jc.Projection()), 1.0, save=11, integrator=integrator)
    assert max(float(part.max()) for part in found.drift().values()) < 1e-13
    # The motion is driven, so all that differs is where the loop is off and the error of a step in
    # the angles.
    np.testing.assert_allclose(found.body("follower").com, exact.body("follower").com, atol=close)


def test_without_it_the_loop_drifts():
    found = jc.simulate(four_bar(None), 1.0, save=11, integrator=jc.integrator.FixedStep(1e-3))
    assert max(float(part.max()) for part in found.drift().values()) > 1e-11


@pytest.mark.slow
def test_derivatives_are_those_of_the_projected_run():
    """With respect to the crank's speed, on which every angle hangs: forward, reverse, and central
    differences.
    """
    rig = four_bar(jc.Projection())
    start = assemble(rig)
    speed, times = 10.0, np.linspace(0.0, 0.05, 3)

    def end(speed):
        faster = eqx.tree_at(lambda m: m.connections["O"].joint.drive.speed, rig, speed)
        scaled = start.speeds * speed / 10.0
        integrator = jc.integrator.FixedStep(steps_per_save=25)
        return run(faster, start.coordinates, scaled, times, integrator).states[-1]

    forward = jax.jit(jax.jacfwd(end))(speed)
    plain, width = jax.jit(end), 1e-3
    difference = (plain(speed + width) - plain(speed - width)) / (2 * width)
    assert float(abs(forward).min()) > 1e-3
    # curvature width^2, and rounding of 1e-15 / width
    np.testing.assert_allclose(forward, difference, rtol=1e-7)
    np.testing.assert_allclose(jax.jit(jax.jacrev(end))(speed), forward, rtol=1e-10)


def test_error_control_is_refused():
    with pytest.raises(ValueError, match="projection, which integrator.Adaptive"):
        jc.simulate(four_bar(jc.Projection()), 1.0)


def test_what_stabilises_is_checked():
    with pytest.raises(ValueError, match="jaxclear.Projection, or None"):
        four_bar(3.0)
