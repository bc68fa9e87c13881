"""Impacts captured as events: restitution is the law's own to the solver's tolerance, whatever
`memory_time`.
"""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import guess
from jaxclear.simulation.simulate import run

KVAERNO = diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-6, atol=1e-8))


def thrown(restitution, memory_time, speed=0.1):
    """A journal thrown from the middle of its bearing; Gonthier's law returns exactly its
    coefficient.
    """
    law = jc.contact.Gonthier(stiffness=1e9, restitution=restitution, memory_time=memory_time)
    joint = jc.clearance.PlanarJournalBearing(law, clearance=0.1e-3)
    speeds = {"journal": (0.6 * speed, 0.8 * speed, 0.0)}
    return jc.Mechanism(
        {"journal": jc.Body(0.3, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        speeds=speeds,
    )


def rebound(rig, integrator, save=2):
    end = jc.simulate(rig, 2.6e-3, save=save, integrator=integrator, start_concentric=False)
    return float(-end.body("journal").velocity[-1, :2] @ jnp.array([0.6, 0.8]) / 0.1)


def test_restitution_is_the_law_s_own_whatever_the_memory_time():
    """A batch: impacts at different times, speeds and memories, each captured by itself."""
    integrator = jc.integrator.Adaptive(rtol=1e-9, atol=1e-11, capture_impacts=True)
    q, v = guess(thrown(0.5, 1.0))

    def end(restitution, memory_time, share):
        law = lambda m: m.connections["B"].joint.contact
        where = lambda m: (law(m).restitution, law(m).memory_time)
        rig = eqx.tree_at(where, thrown(0.5, 1.0), (restitution, memory_time))
        return run(rig, q, share * v, jnp.linspace(0.0, 4e-3, 3), integrator).states[-1, 3:5]

    cases = jnp.array(
        [(e, m, s) for e in (0.5, 0.9) for m in (1e-7, 1e-4, 10.0) for s in (0.6, 1.0)]
    )
    speeds = jax.jit(jax.vmap(end))(*cases.T)
    found = -(speeds @ v[:2]) / (v[:2] @ v[:2]) / cases[:, 2]
    np.testing.assert_allclose(found, cases[:, 0], atol=1e-6)


@pytest.mark.slow
def test_implicit_solver_captures_them_too():
    implicit = jc.integrator.Adaptive(KVAERNO, rtol=1e-9, atol=1e-11, capture_impacts=True)
    assert rebound(thrown(0.5, 10.0), implicit) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.slow
def test_saving_times_within_the_impact_change_nothing():
    explicit = jc.integrator.Adaptive(rtol=1e-9, atol=1e-11, capture_impacts=True)
    assert rebound(thrown(0.5, 10.0), explicit, save=27) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.FixedStep(2e-6, capture_impacts=True),
        jc.integrator.ImplicitStep(2e-6, rebound=1.0, capture_impacts=True),
    ],
    ids=["FixedStep", "ImplicitStep"],
)
def test_fixed_steps_take_the_speed_of_the_step_that_closes(integrator):
    """Free flight at constant speed: exact but for the steps' own error in the contact, of order 2
    for the implicit ones.
    """
    assert rebound(thrown(0.5, 10.0), integrator) == pytest.approx(0.5, abs=1e-4)


def test_too_many_impacts_end_the_run_with_a_sentence():
    few = jc.integrator.Adaptive(capture_impacts=True, most_impacts=1)
    end = jc.simulate(
        thrown(0.9, 1e-4), 0.1, save=2, integrator=few, start_concentric=False, throw=False
    )
    assert (
        not end.succeeded
        and "number of captured impacts between two saved times was used up" in end.result
    )
    with pytest.raises(ValueError, match="most_impacts of integrator.Adaptive is 0"):
        jc.integrator.Adaptive(most_impacts=0)


def test_law_without_memory_has_nothing_to_capture():
    joint = jc.clearance.PlanarJournalBearing(jc.contact.Hertz(stiffness=1e9), clearance=0.1e-3)
    speeds = {"journal": (0.06, 0.08, 0.0)}
    rig = jc.Mechanism(
        {"journal": jc.Body(0.3, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        speeds=speeds,
    )
    assert rebound(
        rig, jc.integrator.Adaptive(rtol=1e-9, atol=1e-11, capture_impacts=True)
    ) == pytest.approx(1.0, abs=1e-6)
