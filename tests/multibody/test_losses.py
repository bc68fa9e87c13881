"""What transmissions lose: efficiency by the direction of power, and threads against the
textbook."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

TURN = jc.joint.Revolute()
RATIO, ETA, BACK = 20.0, 0.8, 0.6
ADAPTIVE = jc.integrator.Adaptive()


def motor_drive(efficiency, loads):
    """A body behind a motor and a gear that loses power."""
    motor = jc.coupling.Motor(1e-4)
    gear = jc.coupling.Gear(motor, "A", RATIO, stiffness=400.0, damping=2.0, efficiency=efficiency)
    return jc.Mechanism(
        {"a": jc.Body(1.0, 0.05)},
        {"A": jc.Connection(TURN, "ground", "a")},
        loads,
        couplings={"gear": gear},
    )


def test_power_loses_its_share_on_its_way_to_the_load():
    torque, drag = 0.2, 0.8
    loads = {"m": jc.load.JointTorque("gear.motor", torque)}
    loads |= {"drag": jc.load.JointSpring("A", damping=drag)}
    run = jc.simulate(motor_drive(ETA, loads), 2.0, save=41, balance=True, integrator=ADAPTIVE)
    np.testing.assert_allclose(run.speed("A")[-1], ETA * RATIO * torque / drag, rtol=1e-4)
    found = run.energy_balance()
    np.testing.assert_allclose(found.error, 0.0, atol=1e-5)
    # steady: what comes in, less what the drag takes, is the loss
    rates = [np.diff(np.asarray(x)[-3:])[-1] for x in (found.input, found.damping_loss)]
    np.testing.assert_allclose(rates[0], rates[1], rtol=1e-3)


def test_power_that_comes_back_loses_its_other_share():
    torque, drag = 5.0, 0.01
    loads = {"t": jc.load.JointTorque("A", torque)}
    loads |= {"drag": jc.load.JointSpring("gear.motor", damping=drag)}
    rig = motor_drive(jc.coupling.Efficiency(ETA, BACK), loads)
    run = jc.simulate(rig, 2.0, save=3, integrator=ADAPTIVE)
    np.testing.assert_allclose(run.speed("gear.motor")[-1], BACK * torque / RATIO / drag, rtol=1e-4)


def test_a_gear_that_locks_itself_holds_without_creep():
    loads = {"t": jc.load.JointTorque("A", 5.0)}
    rig = motor_drive(jc.coupling.Efficiency(0.45, -0.2), loads)
    run = jc.simulate(rig, 20.0, save=[5.0, 20.0], integrator=ADAPTIVE)
    place = np.asarray(run.coordinate("A"))
    # its shaft winds up, and its friction gives way by less than its presliding
    assert 5.0 / 400.0 * 0.99 < place[1] < 5.0 / 400.0 + 1.1e-3 / RATIO
    np.testing.assert_allclose(place[2], place[1], atol=1e-9)


@pytest.mark.parametrize("turned_round", [*slow(False), True])
def test_a_pair_of_wheels_loses_its_share(turned_round):
    ends = [jc.Marker("ground"), jc.Marker("a")]
    gear = jc.coupling.Gear("A", "B", 3.0, stiffness=500.0, damping=3.0, efficiency=ETA)
    torque, drag = 0.5, 0.05
    rig = jc.Mechanism(
        {"a": jc.Body(0.3, 1e-3), "b": jc.Body(1.0, 2e-3)},
        {
            "A": jc.Connection(TURN, *(ends[::-1] if turned_round else ends)),
            "B": jc.Connection(TURN, jc.Marker("ground", (0.08, 0.0)), jc.Marker("b")),
        },
        {"m": jc.load.JointTorque("A", torque), "d": jc.load.JointSpring("B", damping=drag)},
        couplings={"mesh": gear},
    )
    run = jc.simulate(rig, 2.0, save=3, balance=True, integrator=ADAPTIVE)
    np.testing.assert_allclose(abs(run.speed("B")[-1]), ETA * 3.0 * torque / drag, rtol=1e-3)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-5)


# Shigley, example 8-1: square, double thread of 4 mm pitch, 32 mm outside, mu = 0.08.
LEAD, DIAMETER, MU, LOAD = 8e-3, 30e-3, 0.08, 6.4e3


def jack(turn, friction=MU, loads=None, lead=LEAD, flank=0.0):
    """A spindle that turns in the ground, and a nut that slides, under a load."""
    screw = jc.coupling.Screw(
        "S",
        lead,
        friction=friction,
        diameter=DIAMETER,
        flank_angle=flank,
        stiffness=2e8,
        damping=2e4,
    )
    return jc.Mechanism(
        {"spindle": jc.Body(2.0, (1e-2,) * 3), "nut": jc.Body(1.0, (1e-2,) * 3)},
        {
            "A": jc.Connection(turn, "ground", "spindle"),
            "S": jc.Connection(jc.joint.Cylindrical(), "spindle", "nut"),
            "N": jc.Connection(jc.joint.Prismatic(), "ground", "nut"),
        },
        {"load": jc.load.JointTorque("N", -LOAD)} | (loads or {}),
        couplings={"thread": screw},
    )


def shigley(raises, flank):
    secant = 1 / np.cos(flank)
    across, along = np.pi * MU * DIAMETER * secant, MU * LEAD * secant
    own = (LEAD + raises * across) / (np.pi * DIAMETER - raises * along)
    return 0.5 * LOAD * DIAMETER * own


@pytest.mark.parametrize(("speed", "flank"), [(-3.0, 0.0), (3.0, 0.0), (-3.0, 0.25)])
def test_a_jack_takes_the_torque_of_the_textbook(speed, flank):
    # for a spindle that turns forwards the nut, held from turning, goes back
    driven = jc.joint.Revolute(jc.drive.RampUp(speed, 0.05))
    run = jc.simulate(jack(driven, flank=flank), 0.3, save=31, balance=True, integrator=ADAPTIVE)
    moved = np.asarray(run.coordinate("N"))
    np.testing.assert_allclose(np.diff(moved)[-1], -speed * 0.01 * LEAD / (2 * np.pi), rtol=1e-4)
    raises = 1 if speed < 0 else -1
    torque = float(run.transmitted("A")[-1])
    np.testing.assert_allclose(np.sign(speed) * raises * torque, shigley(raises, flank), rtol=1e-6)
    # the thread's friction is in what it does: it carries the load, and turns the nut as the drive
    thread = run.reaction("thread")
    np.testing.assert_allclose(thread.force[-1, 2], LOAD, rtol=1e-6)
    np.testing.assert_allclose(thread.torque[-1, 2], torque, rtol=1e-6)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-3)


def test_a_screw_that_locks_itself_holds_its_load_and_one_that_does_not_lets_it_down():
    run = jc.simulate(jack(TURN, friction=0.12), 2.0, save=3, integrator=ADAPTIVE)
    turned = np.asarray(run.coordinate("A"))
    assert abs(turned[1]) < 2e-5 / (0.5 * DIAMETER)
    np.testing.assert_allclose(turned[2], turned[1], atol=1e-9)
    run = jc.simulate(jack(TURN, friction=0.02), 0.05, save=3, integrator=ADAPTIVE)
    assert abs(float(run.coordinate("A")[-1])) > 0.3


@pytest.mark.parametrize(
    "integrator", [ADAPTIVE, pytest.param(jc.integrator.ImplicitStep(5e-5), marks=pytest.mark.slow)]
)
def test_a_motor_behind_a_gear_with_an_error_moves_its_load_by_it(integrator):
    error = lambda turn: 0.02 * jnp.sin(2 * turn)
    gear = jc.coupling.Gear(
        jc.coupling.Motor(1e-4), "A", RATIO, stiffness=4e3, damping=4.0, transmission_error=error
    )
    rig = jc.Mechanism(
        {"a": jc.Body(1.0, 0.05)},
        {"A": jc.Connection(TURN, "ground", "a")},
        couplings={"gear": gear},
        speeds={"A": 3.0, "gear.motor": 3.0 * RATIO * (1 + 2 * 0.02 / RATIO)},
    )
    run = jc.simulate(rig, 2.0, save=41, balance=True, integrator=integrator)
    turned, motor = np.asarray(run.coordinate("A")), np.asarray(run.coordinate("gear.motor"))
    # the shaft is a thousandth of what the error is
    np.testing.assert_allclose(motor, RATIO * turned + error(turned), atol=5e-5)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-6)


def test_rigid_flanks_follow_the_error_of_their_gear():
    error, play = lambda turn: 0.02 * jnp.sin(2 * turn), 2e-4
    backlash = jc.clearance.Backlash(play, restitution=0.5)
    motor = jc.coupling.Motor(1e-4)
    gear = jc.coupling.Gear(motor, "A", RATIO, play=backlash, transmission_error=error)
    rig = jc.Mechanism(
        {"a": jc.Body(1.0, 0.05)},
        {"A": jc.Connection(TURN, "ground", "a")},
        {"t": jc.load.JointTorque("gear.motor", 0.01)},
        couplings={"gear": gear},
        speeds={"A": 3.0, "gear.motor": 3.0 * RATIO * (1 + 2 * 0.02 / RATIO)},
    )
    run = jc.simulate(rig, 0.5, save=6, integrator=jc.integrator.MoreauJean(2e-4), verify=False)
    turned, motor = np.asarray(run.coordinate("A")), np.asarray(run.coordinate("gear.motor"))
    between = motor - RATIO * turned - np.asarray(error(turned))
    # the motor pushes: one flank presses, but for what a step opens it
    np.testing.assert_allclose(between[1:], 0.5 * RATIO * play, rtol=5e-3)
