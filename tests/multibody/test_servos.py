"""Servos against closed forms: of second order, at rest under a load, at their limit, sampled."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

J, KP, KD = 0.5, 200.0, 8.0
FINE = jc.integrator.FixedStep(1e-3, method="rk4")


def arm(servo, *, torque=None, joint=None, **given):
    """One body that turns about the ground."""
    loads = {"servo": servo} | ({} if torque is None else {"t": jc.load.JointTorque("A", torque)})
    turn = jc.joint.Revolute() if joint is None else joint
    return jc.Mechanism(
        {"a": jc.Body(1.0, J)}, {"A": jc.Connection(turn, "ground", "a")}, loads, **given
    )


def test_without_integral_it_is_a_spring_and_a_damper():
    run = jc.simulate(arm(jc.load.Servo("A", 0.3, KP, kd=KD)), 0.4, save=41, integrator=FINE)
    decay, square = KD / (2 * J), KP / J
    omega = np.sqrt(square - decay**2)
    t = np.asarray(run.time)
    wanted = 0.3 * (
        1 - np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    )
    # rk4 in steps of 1e-3 at 19 rad/s: (h omega)^4 / 120 a step
    np.testing.assert_allclose(run.coordinate("A"), wanted, atol=1e-7)


@pytest.mark.parametrize("ki", [None, 1200.0])
def test_the_integral_takes_the_error_of_a_load(ki):
    servo = jc.load.Servo("A", 0.3, KP, ki=ki, kd=20.0)
    run = jc.simulate(arm(servo, torque=-9.0), 6.0, save=3, integrator=FINE)
    left = 0.3 - float(run.coordinate("A")[-1])
    np.testing.assert_allclose(left, 9.0 / KP if ki is None else 0.0, atol=1e-9)


def test_lost_motion_behind_a_servo_is_that_of_the_motor_it_holds():
    play, stiffness, torque = 0.01, 1e4, 5.0
    gear = jc.coupling.Gear(jc.coupling.Motor(1e-3), "A", ratio=1.0, play=play, stiffness=stiffness)
    servo = jc.load.Servo("A", 0.3, KP, ki=50.0, kd=KD)
    rig = arm(servo, torque=torque, couplings={"gear": gear})
    with pytest.raises(ValueError, match='load "servo" is a controller .* "gear.motor" rests'):
        jc.positions(rig, {}, reverse_loads=True)
    # The joint is not what the encoder sees: held there the play and the twist would not show.
    with pytest.raises(ValueError, match=r'hold that: positions={"gear.motor": .* of "A"'):
        jc.positions(rig, {"A": [0.3]}, reverse_loads=True)
    at_load = rig.with_load("servo", jc.load.Servo("A", 0.3, KP, ki=50.0, kd=KD, encoder="load"))
    assert jc.positions(at_load, {"A": [0.3]}).coordinate("A") == 0.3
    held = {"gear.motor": [0.3]}
    stands = jc.positions(rig, held, reverse_loads=True)
    lost = float(jc.response.LostMotion("A")(stands))
    np.testing.assert_allclose(lost, play + 2 * torque / stiffness, rtol=1e-9)
    with pytest.raises(ValueError, match="no load of this mechanism reverses"):
        jc.positions(rig.with_load("t", None), held, reverse_loads=True)
    # Dry friction does not press at rest; without a load its lost motion would come out as 0.
    rubbing = rig.with_load("t", jc.load.JointFriction("A", torque))
    with pytest.raises(ValueError, match="no load of this mechanism reverses .*friction stay"):
        jc.positions(rubbing, held, reverse_loads=True)


def test_a_limited_torque_is_the_limit():
    servo = jc.load.Servo("A", 2.0, KP, kd=KD, torque_limit=5.0)
    run = jc.simulate(arm(servo), 0.2, save=11, integrator=FINE)
    t = np.asarray(run.time)
    np.testing.assert_allclose(run.coordinate("A"), 0.5 * 5.0 / J * t**2, atol=1e-12)


def test_a_limited_integral_does_not_wind_up():
    """Beside the same controller that goes on integrating, by scipy."""
    from scipy.integrate import solve_ivp

    ki, limit, to = 800.0, 20.0, 2.0

    def rate(t, y, winds):
        q, v, z = y
        asked = KP * (to - q) + ki * z - KD * v
        given = np.clip(asked, -limit, limit)
        return [v, given / J, (to - q) if winds or asked == given or (to - q) * asked < 0 else 0.0]

    t = np.linspace(0.0, 4.0, 401)
    tops = {}
    for winds in (True, False):
        found = solve_ivp(rate, (0, 4), [0, 0, 0], t_eval=t, args=(winds,), max_step=1e-3)
        tops[winds] = found.y[0].max() - to
    servo = jc.load.Servo("A", to, KP, ki=ki, kd=KD, torque_limit=limit)
    run = jc.simulate(arm(servo), 4.0, save=t, integrator=FINE)
    top = float(jnp.max(run.coordinate("A"))) - to
    assert top < 0.8 * tops[True]
    np.testing.assert_allclose(top, tops[False], rtol=2e-3)


def test_feedforward_and_the_rate_of_the_reference_leave_nothing_to_do():
    way = lambda t: 0.2 * jnp.sin(3.0 * t)
    needed = lambda t: -J * 0.2 * 9.0 * jnp.sin(3.0 * t)
    servo = jc.load.Servo("A", way, KP, kd=KD, feedforward=needed)
    run = jc.simulate(arm(servo, speeds={"A": 0.6}), 1.0, save=21, integrator=FINE)
    np.testing.assert_allclose(run.coordinate("A"), way(run.time), atol=1e-9)


def sampled(period, delay, ki, count, to=0.3):
    """A body without friction under a torque that is held from sample to sample, exactly."""
    q, v, z, queue, found = 0.0, 0.0, 0.0, [0.0] * delay, []
    for _ in range(count):
        found.append(q)
        queue.append(KP * (to - q) + ki * z - KD * v)
        z += period * (to - q)
        held = queue.pop(0) / J
        q, v = q + period * v + 0.5 * period**2 * held, v + period * held
    return np.array([*found, q])


@pytest.mark.parametrize(("delay", "ki"), [(0, 0.0), (1, 300.0)])
def test_a_sampled_servo_is_that_of_the_z_domain(delay, ki):
    period, count = 0.01, 60
    servo = jc.load.Servo("A", 0.3, KP, ki=ki, kd=KD, period=period, delay=delay)
    # saved at instants of sampling, and elsewhere
    times = np.sort(np.append(period * np.arange(count + 1), [0.0034, 0.0177, 0.25512]))
    run = jc.simulate(arm(servo), period * count, save=times, integrator=FINE)
    at = [int(np.argmin(np.abs(times - period * k))) for k in range(count + 1)]
    wanted = sampled(period, delay, ki, count)
    # under a constant torque rk4 is exact: rounding
    np.testing.assert_allclose(np.asarray(run.coordinate("A"))[at], wanted, atol=1e-11)


@pytest.mark.parametrize("period", [*slow(None), 0.01])
def test_derivatives_pass_through_a_servo(period):
    def place(kp):
        servo = jc.load.Servo("A", 0.3, kp, kd=KD, period=period)
        run = jc.simulate(arm(servo), 0.3, save=2, integrator=FINE, throw=False, verify=False)
        return run.coordinate("A")[-1]

    slope, value = jax.jvp(place, (KP,), (1.0,))[::-1]
    step = 1e-3
    wanted = (place(KP + step) - place(KP - step)) / (2 * step)
    # differences of rounding over 2e-3
    np.testing.assert_allclose(slope, wanted, rtol=1e-5, atol=1e-10)
    np.testing.assert_allclose(jax.grad(place)(KP), slope, rtol=1e-9)
    assert jnp.isfinite(value)


def geared(servo, torque=None, **given):
    """The same behind a motor, a gear and a shaft that twists."""
    gear = jc.coupling.Gear(jc.coupling.Motor(2e-5), "A", 100.0, stiffness=2e3, damping=20.0)
    return arm(servo, torque=torque, couplings={"gear": gear}, **given)


@pytest.mark.parametrize("encoder", [*slow("motor"), "load", None])
def test_what_the_encoder_sees_goes_to_its_place(encoder):
    load = -12.0
    servo = jc.load.Servo("A", 0.3, 400.0, ki=900.0, kd=25.0, encoder=encoder, torque_limit=90.0)
    run = jc.simulate(geared(servo, load), 8.0, save=3, integrator=jc.integrator.Adaptive())
    place, turned = run.coordinate("A")[-1], run.coordinate("gear.motor")[-1] / 100.0
    # the shaft is wound up by the load
    np.testing.assert_allclose(place - turned, load / 2e3, rtol=1e-5)
    seen = place if encoder == "load" else turned
    np.testing.assert_allclose(seen, 0.3, atol=1e-6)


def test_slopes_behind_a_limited_integral_are_nan_and_say_why():
    def end(kp):
        servo = jc.load.Servo(
            "A", lambda t: jnp.sin(8.0 * t), kp, ki=800.0, kd=3.0, torque_limit=1.0
        )
        rig = jc.Mechanism(
            {"arm": jc.Body(1.0, 0.1)},
            {"A": jc.Connection(jc.joint.Revolute(), "ground", "arm")},
            {"servo": servo},
        )
        run = jc.simulate(
            rig, 0.6, save=2, integrator=jc.integrator.Adaptive(), throw=False, verify=False
        )
        return run.coordinate("A")[-1]

    slope = jax.jacfwd(end)(40.0)
    assert jnp.isnan(slope) and "torque limit" in jc.explain_nan(slope)


def test_a_sampled_servo_that_is_unstable_says_so():
    """A double integrator J under k_d held for 0.1 s: its speed goes by 1 - 0.1 k_d / J a
    period, here by -7, to 1e42 in 5 s."""
    rig = arm(jc.load.Servo("A", 0.5, 1e-3, kd=40.0, period=0.1), speeds={"A": 1.0})
    with pytest.raises(jc.SimulationError, match="grew without bound.*sampled instants"):
        jc.simulate(rig, 5.0, save=11)
