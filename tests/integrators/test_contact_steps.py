"""Short steps in contact only: the accuracy of the fine run, fewer steps, each sample of a batch at
its own pace.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import guess
from jaxclear.simulation.simulate import run
from tests.rigs.falling_journal import touching_journal

LONG, PARTS = 1e-4, 50
SHORT = LONG / PARTS


def bouncing():
    """The falling journal in a wide bearing: three quarters of the time in flight."""
    rig = eqx.tree_at(
        lambda m: m.connections["B"].joint.contact.stiffness, touching_journal(), jnp.asarray(1e10)
    )
    return eqx.tree_at(
        lambda m: m.connections["B"].joint.contact.restitution, rig, jnp.asarray(0.9)
    )


def simulate(integrator):
    return jc.simulate(
        bouncing(), 0.05, save=6, integrator=integrator, state=jc.State(concentric=False)
    )


@pytest.mark.slow
def test_as_accurate_as_short_steps_throughout_at_a_fraction_of_the_steps():
    exact = simulate(jc.integrator.Adaptive(rtol=1e-10, atol=1e-12))
    fine = simulate(jc.integrator.FixedStep(SHORT))
    mixed = simulate(jc.integrator.FixedStep(LONG, contact_steps=PARTS))
    errors = [
        float(abs(run.body("journal").com - exact.body("journal").com).max())
        for run in (fine, mixed)
    ]
    # Flight is a parabola, which rk4 follows exactly at any step; 1e-7 m is a ten thousandth of the
    # clearance.
    assert errors[1] < 2 * errors[0] + 1e-7
    assert int(mixed.accepted_steps) < 0.6 * int(fine.accepted_steps)


def test_a_pressed_journal_does_not_chatter_in_long_steps():
    """Flights of a hard contact under load are shorter than the long step, and begin outwards: its
    forces are those of short steps throughout."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.CarvalhoMartins(stiffness=1e12, restitution=0.9), clearance=1e-4
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"load": jc.load.Force(jc.Marker("journal"), (30.0, -100.0))},
    )
    mixed, short = (
        jc.simulate(rig, 0.02, save=41, integrator=integrator)
        for integrator in (
            jc.integrator.FixedStep(LONG, contact_steps=20),
            jc.integrator.FixedStep(LONG / 20),
        )
    )
    forces = [np.asarray(run.contact("B").normal_force) for run in (mixed, short)]
    # Both have the same steps where they touch; without a look at the load they were off by two
    # thirds of the largest.
    np.testing.assert_allclose(*forces, rtol=1e-6, atol=1e-6 * forces[1].max())
    assert int(mixed.accepted_steps) < 0.85 * int(short.accepted_steps)


@pytest.mark.slow
def test_samples_keep_their_own_time():
    integrator = jc.integrator.FixedStep(LONG, contact_steps=10)

    def end(clearance):
        rig = eqx.tree_at(lambda m: m.connections["B"].joint.clearance, bouncing(), clearance)
        q, v = guess(rig)
        found = run(rig, q, v, jnp.linspace(0.0, 0.03, 3), integrator)
        return found.states[-1], found.accepted_steps

    clearances = jnp.array([0.2e-3, 0.6e-3, 1.5e-3])
    together = jax.jit(jax.vmap(end))(clearances)
    alone = [jax.jit(end)(clearance) for clearance in clearances]
    assert len(set(together[1].tolist())) == 3
    np.testing.assert_array_equal(together[1], [steps for _, steps in alone])
    # rounding, multiplied by bounces
    np.testing.assert_allclose(
        together[0], jnp.stack([state for state, _ in alone]), rtol=1e-8, atol=1e-10
    )


def test_number_of_short_steps_varies_without_compiling_again():
    rig = bouncing()
    q, v = guess(rig)
    once = eqx.debug.assert_max_traces(
        lambda i: run(rig, q, v, jnp.linspace(0.0, 1e-3, 3), i).states, max_traces=1
    )
    for parts in (5, 10.0):
        eqx.filter_jit(once)(jc.integrator.FixedStep(LONG, contact_steps=parts))


def test_a_count_of_steps_in_contact_beside_one_of_steps_per_save_is_refused():
    with pytest.raises(ValueError, match="takes contact_steps or steps_per_save, not both"):
        jc.integrator.FixedStep(contact_steps=4, steps_per_save=5)
