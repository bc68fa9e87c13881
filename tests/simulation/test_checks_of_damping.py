"""Explicit steps that do not follow the damping of a contact say so: its forces at an instant swing
about a mean that is right.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from benchmarks.attacks.structures import structures
from jaxclear.integrators import Check
from jaxclear.multibody.system import prepare
from jaxclear.results.response import concerned
from jaxclear.simulation.damper_steps import damper_step, damping


def test_rate_of_damping_is_the_damper_over_the_mass():
    """The worst of two looks, of each contact; nothing where it is apart or at rest."""
    depth, rate = np.array([[2e-6, 0, 1e-6], [1e-6, 0, 1e-6]]), np.array([[-1e-3, 1, 0]] * 2)
    damper, light = np.array([300.0, 7.0, 5.0]), np.array([4.0, 1.0, 1.0])
    normal = np.maximum(1e6 * depth + damper * rate, 0) * (depth > 0)
    nothing = np.zeros_like(depth)
    parts = [nothing, nothing, normal, depth, rate, 1e6 * depth, light + nothing, nothing]
    seen = np.stack(parts, axis=1)
    found = [damper_step(jnp.asarray(one), h) for one, h in zip(seen, (1e-5, 2e-5), strict=True)]
    np.testing.assert_allclose(np.max(found, axis=0), [2e-5 * 300 * 4, 0, 0])


@pytest.mark.slow
def test_forces_that_swing_on_their_damper_are_said():
    """Two bearings of a crank that were touched at 3 mm/s and are pressed by 47 N: the default step
    of a study is near the stability of their dampers, a force at an instant 60 % off, mean forces
    and wear right within 1e-4. Half the step is right, and says nothing."""
    case = structures()[17].case(2)
    state = jc.State(concentric=case.concentric)

    def run(integrator):
        return jc.simulate(
            case.mechanism, case.duration, integrator=integrator, save=201, state=state
        )

    exact = run(jc.integrator.Adaptive(rtol=1e-9, atol=1e-12))
    forces, means = (
        lambda of: np.asarray(of.contact("A").normal_force),
        lambda of: float(jc.response.MeanContactForce("A")(of)),
    )
    swinging = run(jc.integrator.FixedStep(8e-6))
    assert "damping of the contact" in swinging.result
    assert np.abs(forces(swinging) - forces(exact)).max() > 20
    assert means(swinging) == pytest.approx(means(exact), rel=1e-3)
    beyond = {check for check, flag in swinging.checks.beyond().items() if flag}
    assert beyond == {Check.DAMPER_STEP}
    assert not concerned(jc.response.MeanContactForce("A"), Check.DAMPER_STEP.concerns)
    still = run(jc.integrator.FixedStep(4e-6))
    assert still.warnings == ()
    assert np.abs(forces(still) - forces(exact)).max() < 0.2


@pytest.mark.slow
def test_friction_loss_of_forces_that_swing_on_their_damper_is_in_doubt():
    """Dampers of the flap are as fast as 1.5e8/s. Steps of 1e-7 s bound their forces by swinging:
    mean forces are right within 1e-3, what friction takes is off by 80 %."""

    def run(integrator):
        return jc.simulate(
            jc.scenes.flap(), 0.03, integrator=integrator, save=31, balance=True, throw=False
        )

    def loss(of):
        return float(of.energy_balance().friction_loss[-1])

    mean = jc.response.MeanContactForce("J1")
    exact, swinging = run(jc.integrator.ImplicitStep(1e-6)), run(jc.integrator.FixedStep(1e-7))
    assert not exact.warnings
    assert float(mean(swinging)) == pytest.approx(float(mean(exact)), rel=2e-3)
    assert loss(swinging) > 1.5 * loss(exact)
    beyond = [check for check, flag in swinging.checks.beyond().items() if flag]
    assert any(concerned(jc.response.WornVolume("J1"), check.concerns) for check in beyond)
    assert not any(concerned(mean, check.concerns) for check in beyond)


def test_a_scene_that_cannot_damp_is_not_judged_by_its_damping():
    for law in (jc.contact.Hertz(stiffness=1e9), jc.contact.CarvalhoMartins(stiffness=1e9)):
        joint = jc.clearance.BallSocket(law, socket_radius=15e-3, clearance=1e-4)
        mechanism = jc.Mechanism(
            {"ball": jc.Body(1.0, (1e-3, 1e-3, 1e-3))},
            {"S": jc.Connection(joint, "ground", "ball")},
        )
        assert damping(prepare(mechanism)) == (not law.lossless)
        assert law.lossless == (law.dissipation is None)
