"""A rod thrown in a spherical joint with clearance, against Exudyn's hollow sphere.

Both take the approach speed at the first instant of contact; positions agree within 1e-7 m."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow_but

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata/exudyn_ball_socket.json").read_text())
TIMES = np.array(REFERENCE["time"])
LAWS = {
    "hunt_crossley_smooth": jc.contact.HuntCrossley,
    "hunt_crossley": jc.contact.HuntCrossley,
    "carvalho_martins": jc.contact.CarvalhoMartins,
}


class LinearRamp(jc.friction.AbstractSlipFriction):
    """mu |v| / v_r up to v_r, mu above: Exudyn's regularised friction, as a law defined outside the
    package."""

    mu: float
    ramp_speed: float

    def coulomb(self):
        return jc.friction.Coulomb(mu_kinetic=self.mu)

    def coefficient(self, slip_speed):
        return self.mu * jnp.minimum(slip_speed / self.ramp_speed, 1.0)


def thrown_rod(contact, friction):
    socket = jc.clearance.BallSocket(
        contact(stiffness=1e9, restitution=0.9, slowest_impact=1e-3),
        friction,
        socket_radius=0.0105,
        clearance=0.5e-3,
    )
    return jc.Mechanism(
        {"rod": jc.Body(1.63, (2e-4, 1.2225e-2, 1.2225e-2))},
        {"socket": jc.Connection(socket, "ground", jc.Marker("rod", (-0.15, 0.0, 0.0)))},
        {"gravity": jc.load.Gravity((0.0, -9.81, 0.0))},
        start={"rod": (0.1501, -2e-4, 5e-5, 1.0, 0.0, 0.0, 0.0)},
        speeds={"rod": (0.05, 0.1, 0.0, 1.0, 0.0, 2.0)},
    )


def thrown(contact, friction):
    fine = jc.integrator.Adaptive(rtol=1e-8, atol=1e-10)
    rig = thrown_rod(contact, friction)
    return jc.simulate(
        rig, TIMES[-1], save=TIMES, integrator=fine, state=jc.State(concentric=False)
    )


@pytest.mark.parametrize("case", slow_but(["hunt_crossley"], LAWS))
def test_thrown_rod_bounces_as_in_exudyn(case):
    reference = REFERENCE["cases"][case]
    mu = jnp.asarray(reference["friction"])
    trajectory = thrown(LAWS[case], LinearRamp(mu=mu, ramp_speed=jnp.asarray(1e-2)))
    com, ball = (
        trajectory.body("rod").com[1:],
        trajectory.marker("rod", (-0.15, 0.0, 0.0)).position[1:],
    )
    for name, found in (("com", com), ("ball", ball)):
        error = np.abs(np.asarray(found) - np.array(reference[name])).max()
        assert error < REFERENCE["tolerance"], f"{name}: {error:.2e} m"


def test_law_from_outside_is_the_package_s_own():
    """Ambrosio's friction from v_0 = 0 on is the same ramp; identical arithmetic up to rounding."""
    law = LinearRamp(mu=jnp.asarray(0.1), ramp_speed=jnp.asarray(1e-2))
    own = jc.friction.Ambrosio(mu_kinetic=0.1, inner_speed=0.0, outer_speed=1e-2)
    speeds = jnp.array([0.0, 1e-4, 9e-3, 1e-2, 1.0])
    np.testing.assert_allclose(law.coefficient(speeds), own.coefficient(speeds), rtol=1e-14)
