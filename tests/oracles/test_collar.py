"""A journal that comes down on its collar: at rest the collar carries the weight where it stands,
on the axis or beside it, as statics asks."""

import numpy as np
import pytest

import jaxclear as jc

MASS, GRAVITY, RADIUS, AXIAL = 1.0, 9.81, 14e-3, 1e-4
FINE = jc.integrator.Adaptive(rtol=1e-9, atol=1e-12)


def standing(beside):
    """A journal whose weight acts so far [m] beside its upright axis."""
    law = jc.contact.Gonthier(stiffness=1e8, restitution=0.3)
    collars = jc.clearance.Flange(law, radius=RADIUS, clearance=AXIAL)
    joint = jc.clearance.JournalBearing(law, clearance=1e-4, flange=collars)
    return jc.Mechanism(
        {"rotor": jc.Body(MASS, (1e-3, 1.5e-3, 1.2e-3), (beside, 0.0, 0.0))},
        {"B": jc.Connection(joint, "ground", "rotor")},
        {"gravity": jc.load.Gravity((0.0, 0.0, -GRAVITY))},
    )


@pytest.mark.slow
@pytest.mark.parametrize("beside", [0.0, 1e-3, 5e-3])
def test_journal_comes_to_stand_on_its_collar(beside):
    """`Adaptive` at its default reaches the end, and says what tight tolerances say."""
    run, fine = (
        jc.simulate(standing(beside), 0.1, save=1001, integrator=integrator)
        for integrator in (jc.integrator.Adaptive(max_steps=20_000), FINE)
    )
    assert run.succeeded and not run.warnings
    forces, wanted = (np.asarray(one.contact("B").normal_force) for one in (run, fine))
    np.testing.assert_allclose(forces.mean(axis=0), wanted.mean(axis=0), atol=1e-3 * MASS * GRAVITY)
    # where the tilt says that the collar touches, an ellipse of semi-axes R and a
    tilt = np.asarray(run.body("rotor").rotation)[-500:, 0, 2]
    lever = RADIUS**2 * tilt / np.hypot(RADIUS * tilt, 1e-3 * AXIAL)
    np.testing.assert_allclose(forces[-500:, 3].mean(), MASS * GRAVITY, rtol=1e-4)
    torque = (forces[-500:, 3] * lever).mean()
    np.testing.assert_allclose(torque, MASS * GRAVITY * beside, rtol=1e-2)
