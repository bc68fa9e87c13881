"""Every drive: speed and acceleration are the derivatives of its position."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.drive import AbstractDrive
from tests.components.test_ideal_joints import members

EXAMPLES = {
    "ConstantSpeed": jc.drive.ConstantSpeed(3.0, 0.2),
    "Held": jc.drive.Held(0.7),
    "Harmonic": jc.drive.Harmonic(0.3, 2.0, 0.1, 0.05),
    "RampUp": jc.drive.RampUp(5.0, 0.4, 0.1),
    "Position": jc.drive.Position(lambda time: jnp.sin(3 * time) + time**3),
    "Speed": jc.drive.Speed(lambda time: jnp.cos(2 * time) * jnp.exp(-time), 0.3),
}


@pytest.mark.parametrize(
    "kind",
    sorted(members(AbstractDrive), key=lambda kind: kind.__name__),
    ids=lambda kind: kind.__name__,
)
def test_speed_and_acceleration_are_derivatives(kind):
    motion = jax.jit(
        lambda time: jnp.stack(
            [jnp.asarray(x, float) for x in EXAMPLES[kind.__name__].motion(time)]
        )
    )
    step = 1e-5
    for time in (0.03, 0.21, 0.39, 0.41, 1.7):
        change = (motion(time + step) - motion(time - step)) / (2 * step)
        # central differences: step^2/6 times third derivatives of order 100, and rounding over the
        # step
        np.testing.assert_allclose(change[:2], motion(time)[1:], rtol=1e-7, atol=3e-9)
        exact = jax.jvp(motion, (time,), (1.0,))[1]
        np.testing.assert_allclose(exact[:2], motion(time)[1:], rtol=1e-12, atol=1e-12)


def test_ramp_joins_smoothly():
    ramp = EXAMPLES["RampUp"]
    for time in (0.0, 0.4):
        before, after = (
            np.array(ramp.motion(jnp.asarray(time + shift))) for shift in (-1e-9, 1e-9)
        )
        # position and speed are continuous, the acceleration of a cubic step is zero at either end
        np.testing.assert_allclose(before, after, atol=1e-6)
    np.testing.assert_allclose(ramp.motion(0.4)[0], 0.1 + 5.0 * 0.2, rtol=1e-14)


def test_prescribed_speed_integrates_to_its_position():
    drive = EXAMPLES["Speed"]
    for time in (0.0, 0.3, 2.0):
        # integral of cos(2 t) exp(-t)
        closed = (np.exp(-time) * (2 * np.sin(2 * time) - np.cos(2 * time)) + 1) / 5
        # Gauss-Legendre of order 16 on an analytic function
        np.testing.assert_allclose(drive.motion(time)[0], 0.3 + closed, rtol=1e-13)


@pytest.mark.parametrize(
    ("drive", "angle"),
    [
        (jc.drive.Position(lambda t: 0.5), 0.5),
        (jc.drive.Position(lambda t: 2.0 * t), 0.02),
        (jc.drive.Speed(lambda t: 3.0), 0.03),
        (jc.drive.Speed(jnp.sin), 1 - np.cos(0.01)),
    ],
    ids=["constant place", "place", "constant speed", "speed"],
)
def test_functions_of_time_drive_a_mechanism(drive, angle):
    crank = jc.Mechanism(
        {"crank": jc.Body(mass=1.0, inertia=1e-2, com=(1.0, 0.0))},
        {"O": jc.Connection(jc.joint.Revolute(drive=drive), "ground", "crank")},
    )
    end = jc.simulate(crank, 0.01, save=3).body("crank").com[-1]
    np.testing.assert_allclose(end, (np.cos(angle), np.sin(angle), 0.0), atol=1e-12)


def test_a_torque_may_be_a_function_that_returns_a_number():
    inertia, torque = 0.5, 2.0
    wheel = jc.Mechanism(
        {"wheel": jc.Body(mass=1.0, inertia=inertia)},
        {"O": jc.Connection(jc.joint.Revolute(), "ground", "wheel")},
        {"motor": jc.load.Torque(jc.Marker("wheel"), lambda t: torque)},
    )
    turned = jc.simulate(wheel, 0.1, save=3).coordinate("O")[-1]
    np.testing.assert_allclose(turned, 0.5 * torque / inertia * 0.1**2, rtol=1e-9)
