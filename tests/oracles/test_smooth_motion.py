"""Motion without contact against closed forms: pendulum, free rigid body, and the derivative of a
pendulum's place.

Bounds are a few times the integrator's rtol of 1e-11 over the run."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

import jaxclear as jc
from jaxclear.simulation.simulate import run

GRAVITY = 9.81
PRECISE = {"rtol": 1e-11, "atol": 1e-13}


def pendulum(length, angle):
    """A bar of 2 kg held at one end, centre at half of the length; `angle` from the downward
    vertical."""
    bar = jc.Body(2.0, 2.0 * length**2 / 12, (0.0, -0.5 * length))
    return jc.Mechanism(
        {"bar": bar},
        {"pin": jc.Connection(jc.joint.Revolute(), "ground", "bar")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        start={"pin": angle},
    )


def test_pendulum_has_the_period_of_the_elliptic_integral():
    """q = 2 asin(k sn(K - w t, k)), k = sin(q0/2), w^2 = g/(2 L/3): swings of 170 degrees, one
    period."""
    length, angle = 0.8, np.deg2rad(170.0)
    k, w = np.sin(angle / 2), np.sqrt(GRAVITY / (2 * length / 3))
    quarter = ellipk(k * k) / w
    times = quarter * np.linspace(0.25, 4.0, 16)
    trajectory = jc.simulate(
        pendulum(length, angle), times[-1], save=times, integrator=jc.integrator.Adaptive(**PRECISE)
    )
    wanted = 2 * np.arcsin(k * ellipj(w * (quarter - times), k * k)[0])
    np.testing.assert_allclose(trajectory.coordinate("pin")[1:], wanted, atol=1e-9)


def spinning_box(spin):
    return jc.Mechanism(
        {"box": jc.Body(1.0, (1.0, 2.0, 2.5), (0.1, -0.2, 0.3))},
        {"hold": jc.Connection(jc.joint.Free(), "ground", "box")},
        speeds={"hold": (*-np.cross(spin, (0.1, -0.2, 0.3)), *spin)},
    )


def test_free_body_spins_as_euler_s_equations_say():
    """Body-axis spin by Jacobi's functions (Landau & Lifshitz, Mechanics, par. 37), momentum and
    energy kept."""
    inertia = np.array([1.0, 2.0, 2.5])
    energy2, momentum2 = (
        30.0,
        63.0,
    )  # twice the energy, squared momentum, with I2 energy2 < momentum2 < I3 energy2
    i1, i2, i3 = inertia
    first = np.sqrt((energy2 * i3 - momentum2) / (i1 * (i3 - i1)))
    second = np.sqrt((energy2 * i3 - momentum2) / (i2 * (i3 - i2)))
    third = np.sqrt((momentum2 - energy2 * i1) / (i3 * (i3 - i1)))
    pace = np.sqrt((i3 - i2) * (momentum2 - energy2 * i1) / (i1 * i2 * i3))
    modulus = (i2 - i1) * (energy2 * i3 - momentum2) / ((i3 - i2) * (momentum2 - energy2 * i1))
    times = np.linspace(0.1, 4.0, 40)
    sn, cn, dn, _ = ellipj(pace * times, modulus)
    wanted = np.stack([first * cn, second * sn, third * dn], axis=1)
    spin = np.array([first, 0.0, third])
    trajectory = jc.simulate(
        spinning_box(spin), 4.0, save=times, integrator=jc.integrator.Adaptive(**PRECISE)
    )
    history = trajectory.body("box")
    own = np.einsum("tji,tj->ti", history.rotation, history.spin)
    np.testing.assert_allclose(own[1:], wanted, atol=1e-8)
    momentum = np.einsum("tij,tj->ti", history.rotation, own * inertia)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-8)
    np.testing.assert_allclose(np.sum(own**2 * inertia, axis=1), energy2, rtol=1e-9)
    np.testing.assert_allclose(history.com[-1], history.com[0], atol=1e-9)


def pendulum_by_length(length, angle, time):
    """Angle and its derivative by the length, of the pendulum's own equation and its variation."""
    w2 = GRAVITY / (2 * length / 3)

    def field(_, y):
        q, v, dq, dv = y
        return [v, -w2 * np.sin(q), dv, -w2 * np.cos(q) * dq + w2 / length * np.sin(q)]

    y = solve_ivp(field, (0.0, time), [angle, 0.0, 0.0, 0.0], "DOP853", rtol=1e-12, atol=1e-13).y[
        :, -1
    ]
    return y[0], y[2]


def test_derivative_of_a_pendulum_s_tip_by_its_length():
    """Place of the tip (L sin q, -L cos q) after 1 s, by L, forward through 1000 Runge-Kutta steps:
    1e-8 m/m."""
    length, angle = 0.8, 2.0

    def tip(length):
        rig = pendulum(length, angle)
        fixed = jc.integrator.FixedStep(step=1e-3)
        return (
            run(rig, jnp.array([angle]), jnp.zeros(1), jnp.array([0.0, 1.0]), fixed)
            .marker("bar", (0.0, -length))
            .position[-1]
        )

    q, by_length = pendulum_by_length(length, angle, 1.0)
    found = jax.jit(jax.jacfwd(tip))(length)
    along, across = np.array([np.sin(q), -np.cos(q), 0.0]), np.array([np.cos(q), np.sin(q), 0.0])
    np.testing.assert_allclose(found, along + length * by_length * across, atol=1e-8)


@pytest.mark.slow
def test_reverse_derivative_through_fixed_steps_is_the_forward_one():
    """A fixed number of steps lets reverse mode pass."""

    def end(angle):
        rig = pendulum(0.8, angle)
        fixed = jc.integrator.FixedStep(steps_per_save=50)
        return run(rig, jnp.array([angle]), jnp.zeros(1), jnp.array([0.0, 0.5]), fixed).coordinate(
            "pin"
        )[-1]

    np.testing.assert_allclose(jax.grad(end)(1.0), jax.jacfwd(end)(1.0), rtol=1e-10)


def test_steps_that_divide_the_interval_reach_its_end():
    """10 000 steps of the largest size fill the interval but for a remainder of rounding: no
    failure."""
    fine = jc.integrator.Adaptive(largest_step=1e-6)
    times = [1e-2, 2e-2, 3e-2]
    assert jc.simulate(pendulum(0.8, 0.1), times[-1], save=times, integrator=fine).succeeded
