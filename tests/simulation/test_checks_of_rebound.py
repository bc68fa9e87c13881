"""Where an impact falls within a step, its restitution is that of the step: said where that is not
the law's, and not where it is."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Check
from jaxclear.multibody.assembly import guess
from jaxclear.simulation.simulate import run

K, MASS, SPEED, WAY = 1e9, 0.3, 0.01, 0.4e-3
PLACES = 8
# Duration [s] of an elastic Hertzian impact.
CONTACT = 3.21 * (MASS / (K * SPEED**0.5)) ** 0.4


@pytest.fixture(scope="module")
def thrown():
    """(restitution, steps to an impact, rebound) -> how fast journals come back from a wall that
    they touch at several places of a step, and the figure of each."""
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.Gonthier(stiffness=K), bearing_radius=0.5, clearance=0.5e-3
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(MASS, 1e-4)}, {"B": jc.Connection(joint, "ground", "journal")}
    )
    q, _ = guess(rig)

    @eqx.filter_jit
    def go(restitution, share, rebound):
        law = lambda rig: rig.connections["B"].joint.contact.dissipation.restitution
        tried = eqx.tree_at(law, rig, restitution)
        step = CONTACT / share
        times = jnp.linspace(0.0, 1.0, 41) * (WAY / SPEED + 2 * CONTACT + 4 * step)

        def one(place):
            start = q.at[0].add(0.5e-3 - WAY - place * step * SPEED)
            speed = jnp.array([SPEED, 0.0, 0.0])
            found = run(
                tried, start, speed, times, jc.integrator.ImplicitStep(step, rebound=rebound)
            )
            return -found.states[-1, 3] / SPEED, found.checks.figures[Check.REBOUND_STEP].worst[0]

        return jax.vmap(one)(jnp.linspace(0.0, 1.0, PLACES, endpoint=False))

    return lambda *numbers: tuple(map(np.asarray, go(*map(jnp.asarray, numbers))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("restitution", "share", "rebound"),
    [(0.2, 0.5, 0.95), (0.6, 0.5, 0.95), (0.9, 0.5, 0.5), (0.2, 2.0, 0.95)],
)
def test_an_impact_within_a_step_says_that_its_restitution_is_the_steps(
    thrown, restitution, share, rebound
):
    """Some of the impacts of a run meet the step early: they say so for all."""
    back, figure = thrown(restitution, share, rebound)
    off = np.abs(back / restitution - 1).max()
    assert off > Check.REBOUND_STEP.limit
    assert figure.max() > Check.REBOUND_STEP.limit
    assert 0.4 < figure.max() / off < 4


@pytest.mark.parametrize(
    ("restitution", "share", "rebound"),
    [(0.9, 0.5, 0.95), (0.9, 5.0, 0.95), (0.6, 8.0, 0.95), (0.2, 8.0, 0.95)],
)
def test_where_the_restitution_is_the_law_s_nothing_is_said(thrown, restitution, share, rebound):
    back, figure = thrown(restitution, share, rebound)
    assert np.abs(back / restitution - 1).max() < Check.REBOUND_STEP.limit
    assert figure.max() < Check.REBOUND_STEP.limit
