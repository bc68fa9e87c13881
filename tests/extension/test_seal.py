"""A seal of a stranger (viscous, with a Coulomb part) whose shaft a detent holds."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxclear as jc
from jaxclear import Scalar, quantity

INERTIA, VISCOUS, DRY, DETENT, TEETH, SPEED, TIME = 0.02, 0.03, 0.05, 0.08, 4, 6.0, 0.7


class Seal(jc.load.AbstractStateLoad):
    """Torque -viscous w - dry sign(w) - detent sin(teeth q) on the coordinate q of a joint."""

    connection: str = eqx.field(static=True)
    viscous: Scalar = quantity(unit="N m s/rad", meaning="torque by speed", at_least=0)
    dry: Scalar = quantity(unit="N m", meaning="dry friction", at_least=0)
    detent: Scalar = quantity(unit="N m", meaning="largest torque of the detent", at_least=0)
    teeth: int = eqx.field(static=True, default=TEETH)

    @property
    def rubbing(self):
        return jc.load.JointFriction(self.connection, self.dry, presliding=1e-4, settling_time=1e-4)

    def coordinates(self):
        return (self.connection,)

    def states(self):
        return self.rubbing.states()

    def dry_friction(self):
        return self.dry

    def smooth_force(self, time, position, speed):
        torque = -self.viscous * speed - self.detent * jnp.sin(self.teeth * position)
        stored = self.detent / self.teeth * (1 - jnp.cos(self.teeth * position))
        return torque, stored, self.viscous * speed * speed, 0

    def effect(self, time, positions, speeds, states):
        torque, *energies = self.smooth_force(time, *positions, *speeds)
        rubs = self.rubbing.effect(time, positions, speeds, states)
        stored, lost = energies[0] + rubs.stored, energies[1] + rubs.dissipated
        return jc.load.CoordinateEffect((torque + rubs.forces[0],), rubs.rates, stored, lost, 0)


def shaft(dry=DRY):
    bodies = {"shaft": jc.Body(1.0, INERTIA)}
    joints = {"J": jc.Connection(jc.joint.Revolute(), "ground", "shaft")}
    loads = {"seal": Seal("J", VISCOUS, dry, DETENT)}
    return jc.Mechanism(bodies, joints, loads, speeds={"J": SPEED})


def turned(dry=DRY):
    """Angle, speed and torque of the seal until the shaft first stands."""
    torque = lambda q, w: -VISCOUS * w - dry - DETENT * np.sin(TEETH * q)
    rate = lambda t, y: (y[1], torque(*y) / INERTIA)
    times = np.linspace(0.0, TIME, 8)
    angle, speed = solve_ivp(rate, (0, TIME), (0, SPEED), t_eval=times, rtol=1e-11, atol=1e-13).y
    return angle, speed, torque(angle, speed)


RUNGS = {
    "adaptive": (jc.integrator.Adaptive(rtol=1e-8, atol=1e-10), 1e-4),
    "fixed": (jc.integrator.FixedStep(2e-5), 1e-4),
    "implicit": (jc.integrator.ImplicitStep(2e-4), 1e-3),
    "rigid": (jc.integrator.MoreauJean(2e-4), 1e-3),
    "permanent": (jc.integrator.NonColliding(2e-4), 1e-3),
}


@pytest.mark.parametrize("rung", RUNGS)
def test_every_integrator_follows_a_seal_with_a_detent(rung):
    integrator, near = RUNGS[rung]
    run = jc.simulate(shaft(), TIME, save=8, balance=True, integrator=integrator, verify=False)
    angle, speed, torque = turned()
    assert speed[-1] > 0
    np.testing.assert_allclose(run.coordinate("J"), angle, atol=near * angle[-1])
    np.testing.assert_allclose(run.transmitted("seal"), torque, atol=2e-2 * DRY)
    assert abs(run.energy_balance().error).max() < 10 * near * 0.5 * INERTIA * SPEED**2


@pytest.mark.slow
def test_a_batch_and_a_derivative_by_a_number_of_the_seal():
    def end(dry):
        fixed = jc.integrator.FixedStep(1e-4)
        options = {"save": 2, "integrator": fixed, "verify": False, "throw": False}
        return jc.simulate(shaft(dry), TIME, **options).coordinate("J")[-1]

    ends = [turned(dry)[0][-1] for dry in (DRY, DRY - 1e-4, DRY + 1e-4)]
    both = jax.jit(jax.vmap(end))(jnp.array([DRY, DRY - 1e-4]))
    np.testing.assert_allclose(both, ends[:2], rtol=1e-4)
    slope = (ends[2] - ends[1]) / 2e-4
    assert float(jax.jit(jax.jacfwd(end))(DRY)) == pytest.approx(slope, rel=2e-3)
