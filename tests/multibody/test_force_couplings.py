"""Couplings that are forces: freewheels, ropes and cams against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

TURN = jc.joint.Revolute()
HELD = jc.joint.Revolute(jc.drive.ConstantPosition(0.0))
J, G = 0.02, 9.81
ADAPTIVE = jc.integrator.Adaptive(rtol=1e-9, atol=1e-11)


def shafts(first, coupling, loads=None, **given):
    """Two shafts on the ground."""
    return jc.Mechanism(
        {"a": jc.Body(0.3, J), "b": jc.Body(0.3, J)},
        {"A": jc.Connection(first, "ground", "a"), "B": jc.Connection(TURN, "ground", "b")},
        loads or {},
        couplings={"c": coupling},
        **given,
    )


CLUTCH = jc.coupling.OneWay("A", "B", stiffness=2e3, damping=4.0)


def test_a_backstop_holds_without_creep():
    rig = shafts(HELD, CLUTCH, {"l": jc.load.JointTorque("B", -6.0)})
    run = jc.simulate(rig, 100.0, save=[1.0, 50.0, 100.0], integrator=ADAPTIVE)
    turned = np.asarray(run.coordinate("B"))[1:]
    np.testing.assert_allclose(turned, -6.0 / 2e3, rtol=1e-6)
    assert np.ptp(turned) < 1e-9


def test_what_overtakes_is_free_until_it_is_caught():
    fast, slow, brake = 30.0, 10.0, -4.0
    driven = jc.joint.Revolute(jc.drive.ConstantSpeed(slow))
    loads = {"l": jc.load.JointTorque("B", brake)}
    rig = shafts(driven, CLUTCH, loads, speeds={"B": fast})
    run = jc.simulate(rig, 0.3, save=301, balance=True, integrator=ADAPTIVE)
    t, speed = np.asarray(run.time), np.asarray(run.speed("B"))
    caught = J * (fast - slow) / -brake
    free = t < caught
    np.testing.assert_allclose(speed[free], fast + brake / J * t[free], rtol=1e-7)
    np.testing.assert_allclose(speed[-1], slow, rtol=1e-5)
    # then the drive carries the brake, and has brought all that is lost
    sent = run.transmitted("c")
    np.testing.assert_allclose(sent[free], 0.0, atol=1e-12)
    np.testing.assert_allclose([sent[-1], run.transmitted("A")[-1]], -brake, rtol=1e-4)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-6)


def hoist(**given):
    """A weight on a slide, on a rope over a pulley that is held."""
    rope = jc.coupling.Rope(("A", "B"), (0.1, -1.0), stiffness=5e3, damping=40.0)
    return jc.Mechanism(
        {"a": jc.Body(0.3, J), "b": jc.Body(2.0, 0.01)},
        {
            "A": jc.Connection(HELD, "ground", "a"),
            "B": jc.Connection(jc.joint.Prismatic(), "ground", "b", axis="y"),
        },
        {"g": jc.load.Gravity((0.0, -G))},
        couplings={"rope": rope},
        **given,
    )


def test_a_slack_rope_does_not_push():
    run = jc.simulate(hoist(speeds={"B": 3.0}), 0.5, save=51, balance=True, integrator=ADAPTIVE)
    t = np.asarray(run.time)
    # the rope's length does not count while the weight is above
    np.testing.assert_allclose(run.coordinate("B"), 3.0 * t - 0.5 * G * t**2, atol=1e-9)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-8)


MASS, RATE, PRELOAD, LIFT = 0.4, 900.0, 20.0, 0.005


def valve(speed, friction=None):
    """A follower on an eccentric (a harmonic cam), pressed by a spring."""
    profile = lambda turn: LIFT * (1 - jnp.cos(turn))
    sliding = {} if friction is None else {"friction": friction, "base_radius": 0.02}
    return jc.Mechanism(
        {"cam": jc.Body(0.5, 1e-3), "valve": jc.Body(MASS, 1e-4)},
        {
            "A": jc.Connection(jc.joint.Revolute(jc.drive.ConstantSpeed(speed)), "ground", "cam"),
            "B": jc.Connection(jc.joint.Prismatic(), "ground", "valve", axis="y"),
        },
        {"spring": jc.load.JointSpring("B", RATE, rest=-PRELOAD / RATE)},
        couplings={
            "contact": jc.coupling.Cam("A", "B", profile, stiffness=2e7, damping=2e3, **sliding)
        },
        start={"B": -1e-6},
    )


@pytest.mark.parametrize("share", [0.97, 1.03])
def test_a_follower_lifts_off_at_the_speed_of_its_formula(share):
    # m e w^2 = F_0 + 2 k e at the top
    limit = np.sqrt((PRELOAD + 2 * RATE * LIFT) / (MASS * LIFT))
    rig = valve(share * limit)
    duration = 1.2 * np.pi / (share * limit)
    run = jc.simulate(rig, duration, save=401, integrator=jc.integrator.Adaptive())
    turned = np.asarray(run.coordinate("A"))
    gap = np.asarray(run.coordinate("B")) - LIFT * (1 - np.cos(turned))
    # what presses it in is at most 60 N on 2e7 N/m
    assert (gap[turned > 2.0].max() > 1e-6) == (share > 1)


def test_a_flat_face_brakes_the_cam():
    speed, mu = 20.0, 0.1
    run = jc.simulate(
        valve(speed, mu), 2 * np.pi / speed, save=201, balance=True, integrator=ADAPTIVE
    )
    turned = np.asarray(run.coordinate("A"))
    lift = LIFT * (1 - np.cos(turned))
    force = PRELOAD + RATE * lift + MASS * LIFT * speed**2 * np.cos(turned)
    slope = LIFT * np.sin(turned)
    wanted = force * slope + mu * force * (0.02 + lift)
    torque = np.asarray(run.transmitted("A"))
    # the start swings a little on the contact's stiffness
    np.testing.assert_allclose(torque[40:], wanted[40:], rtol=0.01, atol=1e-4)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-6)
