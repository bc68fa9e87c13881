"""Balls that touch all the time: friction across what they carry, wear where it presses them."""

import numpy as np
import pytest

import jaxclear as jc

MU, LOAD, RADIUS, CLEARANCE, INERTIA = 0.2, 300.0, 12e-3, 0.05e-3, 2e-3
BALL = RADIUS - CLEARANCE
GRIP = MU / np.sqrt(1 + MU**2)
LAW = jc.wear.Archard()
RATE = float(LAW.wear_coefficient / LAW.hardness)
STICKS = jc.friction.Coulomb(mu_kinetic=MU)
SMOOTH = jc.friction.CoulombTanh(mu_kinetic=MU, transition_speed=1e-2)
BRAKING = GRIP * LOAD * BALL / INERTIA
TILT, SPIN = 0.05 * BRAKING, 7.0


def socket(friction, **numbers):
    law = jc.contact.Rigid()
    sizes = {"socket_radius": RADIUS, "clearance": CLEARANCE}
    return jc.clearance.BallSocket(law, friction, **sizes, **numbers)


def spinning(joint):
    """A ball pressed down, which turns across the load and spins about it."""
    return jc.Mechanism(
        {"top": jc.Body(1.0, (INERTIA,) * 3)},
        {"S": jc.Connection(joint, "ground", "top")},
        {"load": jc.load.Force(jc.Marker("top"), (0.0, 0.0, -LOAD))},
        speeds={"S": (TILT, 0.0, SPIN)},
    )


@pytest.fixture(scope="module")
def top():
    wear = jc.Wearing(LAW, cells=(12, 12))
    return jc.simulate(
        spinning(socket(STICKS, socket_wear=wear)),
        0.1,
        integrator=jc.integrator.NonColliding(1e-3),
        save=11,
        balance=True,
    )


def test_friction_brakes_a_ball_across_its_load_and_not_about_it(top):
    """Across the load sin(arctan mu) F r / I until it rests; about the load, a point does not
    rub."""
    spin = top.body("top").spin
    left = np.maximum(TILT - BRAKING * np.asarray(top.time), 0.0)
    across = np.hypot(spin[:, 0], spin[:, 1])
    # friction turns with the body that spins: the square of half the turn in a step
    np.testing.assert_allclose(across, left, atol=TILT * (0.5e-3 * SPIN) ** 2)
    np.testing.assert_allclose(spin[:, 2], SPIN, rtol=1e-4)
    energies = top.energy_balance()
    np.testing.assert_allclose(energies.friction_loss[-1], 0.5 * INERTIA * TILT**2, rtol=1e-4)
    assert float(np.abs(energies.error).max()) < 1e-9


def test_a_ball_wears_by_archard_where_it_is_pressed(top):
    """V = k N s / H; the point that carries lies beside the load by the angle of friction, so that
    spin lets it slide too."""
    contact, volume = top.contact("S"), top.worn_volume("S", "socket")
    np.testing.assert_allclose(contact.normal_force[:5, 0], LOAD / np.sqrt(1 + MU**2), rtol=1e-9)
    np.testing.assert_allclose(contact.traction[1:5, 0], GRIP * LOAD, rtol=1e-9)
    # at rest across the load the contact lies below it again, where spin does not slide
    time = np.linspace(0.0, 0.05, 50001)
    speed = BALL * np.hypot(TILT - BRAKING * time, GRIP * SPIN)
    # and gets there through the gap
    slid = np.trapezoid(speed, time) + GRIP * CLEARANCE
    lost = RATE * LOAD / np.sqrt(1 + MU**2) * slid
    np.testing.assert_allclose(volume[-1], lost, rtol=1e-3)
    depth = top.worn_depth("S", "socket")
    assert np.all(depth[:, 8:] == 0) and np.argmax(depth.max(0)) < 3


@pytest.mark.slow
def test_balls_in_tree_and_loop_close_the_energy_balance():
    """A plate that swings on two balls, one of them on a slider; whichever way round these are."""
    joint, places = jc.joint.BallJoint(SMOOTH, radius=RADIUS), ((-0.1, 0.2), (0.1, 0.2))
    found = []
    for order in (1, -1):
        ends = [jc.Marker("ground", places[0]), jc.Marker("plate", places[0])]
        others = [jc.Marker("block"), jc.Marker("plate", places[1])]
        mechanism = jc.Mechanism(
            {
                "plate": jc.Body(2.0, (0.02, 0.01, 0.03), com=(0.03, 0.0, 0.0)),
                "block": jc.Body(0.3, (1e-3,) * 3),
            },
            {
                "L": jc.Connection(joint, *ends[::order]),
                "P": jc.Connection(jc.joint.Prismatic(), "ground", "block", at=places[1], axis="x"),
                "S": jc.Connection(joint, *others[::order]),
            },
            {"g": jc.load.Gravity((0.0, -9.81, 0.0))},
            speeds={"L": (3.0 * order, 0.0, 0.0)},
        )
        assert mechanism.topology.loops
        integrator = jc.integrator.Adaptive(rtol=1e-9, atol=1e-11)
        run = jc.simulate(mechanism, 0.3, integrator=integrator, save=11, balance=True)
        energies = run.energy_balance()
        assert float(energies.friction_loss[-1]) > 0.01
        assert float(np.abs(energies.error).max()) < 1e-8
        found.append(run.body("plate").com)
    # the other way round it sets out the other way
    np.testing.assert_allclose(*np.abs(found), atol=1e-8)
