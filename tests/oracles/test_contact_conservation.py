"""What contact may and may not change: momentum, energy, and the speed of a rebound.

Closed forms only. For every force f(delta) (1 + d rate / v0) the rebound e obeys (1 + d) = (1 - d
e) exp(d (1 + e)), for any f (see `jaxclear.laws.contact.dissipation`), so one bounce checks
geometry, law, memory and losses at once."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxclear as jc

FINE = {"rtol": 1e-10, "atol": 1e-13}


def colliding_pair():
    """Two floating bodies, the journal of one tumbling in the bearing of the other."""
    law = jc.contact.CarvalhoMartins(stiffness=1e9, restitution=0.7)
    friction = jc.friction.ThreeZone(mu_static=0.3, mu_kinetic=0.2)
    sizes = {"bearing_radius": 10e-3, "clearance": 0.3e-3, "length": 20e-3}
    collars = jc.clearance.Flange(law, friction)
    bearing = jc.clearance.JournalBearing(law, friction, flange=collars, **sizes)
    ends = jc.Marker("block", (0.05, 0.01, -0.02)), jc.Marker("pin", (0.0, 0.0, 0.03))
    speeds = {"hold": (0.1, -0.2, 0.05, 0.5, 1.0, -0.5), "pin": (-0.2, 0.3, 0.1, 1.0, -2.0, 15.0)}
    return jc.Mechanism(
        {
            "block": jc.Body(1.5, (2e-3, 3e-3, 4e-3, 1e-4, -2e-4, 3e-4), (0.01, 0.0, 0.02)),
            "pin": jc.Body(0.5, (4e-4, 5e-4, 3e-4)),
        },
        {
            "hold": jc.Connection(jc.joint.Free(), "ground", "block"),
            "pair": jc.Connection(bearing, *ends),
        },
        start={"pin": (0.05, 0.01, -0.05)},
        speeds=speeds,
    )


def thrown(rig, duration, save):
    """A run whose journal begins where it was put."""
    how = {"integrator": jc.integrator.Adaptive(**FINE), "balance": True}
    return jc.simulate(rig, duration, save=save, state=jc.State(concentric=False), **how)


@pytest.fixture(scope="module")
def collision():
    return thrown(colliding_pair(), 0.02, 41)


INERTIA = {
    "block": (1.5, np.array([[2e-3, 1e-4, -2e-4], [1e-4, 3e-3, 3e-4], [-2e-4, 3e-4, 4e-3]])),
    "pin": (0.5, np.diag([4e-4, 5e-4, 3e-4])),
}


@pytest.mark.slow
def test_floating_pair_keeps_its_momentum_through_collisions(collision):
    """Linear and angular momentum about the ground's origin, to rounding."""
    linear, angular = np.zeros((41, 3)), np.zeros((41, 3))
    for name, (mass, inertia) in INERTIA.items():
        history = collision.body(name)
        rotation = np.asarray(history.rotation)
        own = np.einsum("tij,jk,tlk,tl->ti", rotation, inertia, rotation, history.spin)
        linear += mass * np.asarray(history.velocity)
        angular += own + mass * np.cross(history.com, history.velocity)
    contact = collision.contact("pair")
    assert (np.asarray(contact.normal_force) > 0).any(axis=0).sum() >= 2, (
        "the case must collide in more than one place"
    )
    np.testing.assert_allclose(linear, np.broadcast_to(linear[0], linear.shape), atol=1e-13)
    np.testing.assert_allclose(angular, np.broadcast_to(angular[0], angular.shape), atol=1e-14)


@pytest.mark.slow
def test_energy_lost_in_collisions_is_the_losses_energy(collision):
    """Kinetic energy = start - contact loss - friction loss - stored, to 1e-9 of the start's."""
    energy = collision.energy_balance()
    start = float(energy.kinetic[0])
    assert float(energy.contact_loss[-1]) > 1e-3 * start
    assert float(energy.friction_loss[-1]) > 1e-3 * start
    assert float(jnp.abs(energy.error).max()) < 1e-9 * start


def bounce(law):
    """A journal thrown from the middle of its bearing against the wall."""
    bearing = jc.clearance.PlanarJournalBearing(law, clearance=0.1e-3)
    rig = jc.Mechanism(
        {"journal": jc.Body(0.3, 1e-4)},
        {"bearing": jc.Connection(bearing, "ground", "journal")},
        speeds={"journal": (0.06, 0.08, 0.0)},
    )
    return thrown(rig, 2.6e-3, 2)


def rebound(damping):
    """e of d, by root finding apart from the package's formulas."""
    equation = lambda e: np.log1p(damping) - np.log1p(-damping * e) - damping * (1 + e)
    return brentq(equation, 1e-6, min(1, 1 / damping) - 1e-9)


@pytest.mark.parametrize(
    "name", ["HuntCrossley", "LankaraniNikravesh", "CarvalhoMartins", "Gonthier"]
)
@pytest.mark.parametrize("restitution", [0.5, 0.9])
def test_bouncing_journal_leaves_with_the_law_s_restitution(name, restitution):
    """Rebound within 1e-8."""
    law = getattr(jc.contact, name)(stiffness=1e9, restitution=restitution)
    trajectory = bounce(law)
    speed = np.asarray(trajectory.body("journal").velocity)[-1, :2]
    wanted, kind = restitution, getattr(jc.contact.dissipation, name)
    if name != "Gonthier":
        wanted = rebound(float(kind(restitution=restitution).factor()))
    np.testing.assert_allclose(speed, -wanted * np.array([0.06, 0.08]), rtol=1e-8)
    energy = trajectory.energy_balance()
    lost = energy.kinetic[0] - energy.kinetic[-1]
    np.testing.assert_allclose(energy.contact_loss[-1], lost, atol=1e-8 * float(energy.kinetic[0]))


def test_remembered_speed_survives_a_long_flight():
    """0.5 m of free flight at constant speed: nothing limits the step."""
    law = jc.contact.CarvalhoMartins(stiffness=1e9, restitution=0.5)
    bearing = jc.clearance.PlanarJournalBearing(law, bearing_radius=0.6, clearance=0.5)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 0.01)},
        {"bearing": jc.Connection(bearing, "ground", "journal")},
        speeds={"journal": (0.5, 0.0, 0.0)},
    )
    run = jc.simulate(rig, 1.6, save=3, state=jc.State(concentric=False))
    np.testing.assert_allclose(run.body("journal").velocity[-1, 0], -0.5 * 0.5, rtol=1e-3)


def busy_slider_crank():
    """Crank driven from rest, clearance at the slider, every kind of load."""
    law = jc.contact.CarvalhoMartins(stiffness=1e9, restitution=0.8)
    bearing = jc.clearance.PlanarJournalBearing(
        law, jc.friction.ThreeZone(mu_static=0.2, mu_kinetic=0.1), clearance=0.2e-3
    )
    base = jc.scenes.slider_crank(bearing, drive=jc.drive.RampUp(50.0, 0.02))
    slider, wall = jc.Marker("slider"), jc.Marker("ground", (0.3, 0.1))
    loads = {
        "elbow": jc.load.JointSpring("A", stiffness=0.5, damping=1e-3),
        "rail": jc.load.JointSpring("G", damping=2.0),
        "tie": jc.load.Spring(wall, slider, 200.0, 0.1, 1.0),
        "push": jc.load.Force(slider, lambda time: (5.0 * jnp.sin(60.0 * time), 0.0)),
        "twist": jc.load.JointTorque("A", lambda time: 0.1 * jnp.cos(40.0 * time)),
    }
    return jc.Mechanism(base.bodies, base.connections, base.loads | loads, start={"G": 0.17})


@pytest.mark.slow
def test_energy_balance_closes_with_everything_switched_on():
    """1e-9 of the energy put in; the energies are integrated beside the motion and do not choose
    the steps."""
    fine = jc.integrator.Adaptive(**FINE)
    trajectory = jc.simulate(busy_slider_crank(), 0.1, save=101, integrator=fine, balance=True)
    energy = trajectory.energy_balance()
    for losses in (energy.contact_loss, energy.friction_loss, energy.damping_loss):
        assert float(losses[-1]) > 1e-6
    scale = float(jnp.abs(energy.input).max())
    error = float(jnp.abs(energy.error).max()) / scale
    assert error < 1e-9
