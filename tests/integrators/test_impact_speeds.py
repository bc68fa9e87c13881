"""Impact speeds are taken at the touch: restitution is the law's own on every rung, whatever the
speed, the clearance and the saving times; steps converge through impacts at their order.
"""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import jaxclear as jc
from jaxclear.laws.contact import dissipation
from jaxclear.multibody.assembly import guess
from jaxclear.simulation.simulate import run
from tests.laws.law_family import members
from tests.laws.test_restitution import returned

KVAERNO = diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-6, atol=1e-8))
STIFFNESS, MASS, CLEARANCE = 1e9, 0.3, 0.5e-3


def damped(factor):
    """A law with this factor d: Hunt and Crossley's d = 3/2 (1 - c_e), whatever c_e that takes."""
    law = jc.contact.HuntCrossley(stiffness=STIFFNESS, restitution=0.9)
    return eqx.tree_at(lambda law: law.dissipation.restitution, law, 1 - 2 / 3 * factor)


def thrown(contact, speed=0.1, clearance=CLEARANCE):
    """A journal thrown from near the middle of its bearing, straight at the wall."""
    joint = jc.clearance.PlanarJournalBearing(contact, bearing_radius=0.5, clearance=clearance)
    return jc.Mechanism(
        {"journal": jc.Body(MASS, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        start={"journal": (0.06e-3, 0.08e-3, 0.0)},
        speeds={"journal": (0.6 * speed, 0.8 * speed, 0.0)},
    )


def contact_time(speed):
    """Duration [s] of an elastic Hertzian impact."""
    return 3.21 * (MASS / (STIFFNESS * jnp.sqrt(speed))) ** 0.4


def test_every_law_that_remembers_damps_by_its_factor_over_the_impact_speed():
    """So the engine sees nothing of a law but its factor."""
    for law in members(dissipation.AbstractRestitutionFactor):
        factor = law(restitution=0.7)
        found = factor.relative_damping(jnp.asarray(-0.3), jnp.asarray(0.2))
        np.testing.assert_allclose(found, -1.5 * factor.factor(), rtol=1e-14)


def factors():
    """d of every law with a memory, at two restitutions."""
    found = [
        float(law(restitution=restitution).factor())
        for law in members(dissipation.AbstractRestitutionFactor)
        if law.__module__ == dissipation.__name__
        for restitution in (0.9, 0.5)
    ]
    return np.array(found)


RUNGS = {
    "Adaptive": jc.integrator.Adaptive(),
    "FixedStep": jc.integrator.FixedStep(),
    "short steps in contact": jc.integrator.FixedStep(4e-5, contact_steps=4),
    "on groups": jc.integrator.FixedStep(method="munthe_kaas4"),
    "ImplicitStep": jc.integrator.ImplicitStep(1e-5, rebound=1.0),
}


@pytest.mark.parametrize("rung", RUNGS)
def test_restitution_is_the_law_s_within_a_thousandth(rung):
    """0.01 to 10 m/s, every law with a memory at two restitutions, at the defaults of its rung (an
    implicit step is told to resolve the impact). Ten m/s cross the clearance in 50 us: a state that
    followed the approach speed would lag.
    """
    q, v = guess(thrown(damped(0.1), 1.0))

    def rebound(factor, speed):
        rig = thrown(damped(factor), 1.0)
        # The second wall is twice the clearance away.
        duration = CLEARANCE / speed + 1.3 * contact_time(speed)
        times = jnp.linspace(0.0, 1.0, 33) * (duration + CLEARANCE / speed)
        states = run(rig, q, speed * v, times, RUNGS[rung]).states
        return jnp.max(-states[:, 3:5] @ v[:2]) / speed

    cases = [part.ravel() for part in np.meshgrid(factors(), [0.01, 0.1, 1.0, 3.0, 10.0])]
    found = np.asarray(jax.jit(jax.vmap(rebound))(*cases))
    wanted = np.array([returned(factor) for factor in cases[0]])
    np.testing.assert_allclose(found, wanted, rtol=1e-3)
