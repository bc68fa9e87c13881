"""A study keeps what a run keeps: saving times, and touches and releases in between."""

import jax
import numpy as np
import pytest

import jaxclear as jc


def fall():
    """A journal that falls through its play."""
    law = jc.contact.KelvinVoigt(stiffness=1e6, damping=1e2, onset_depth=1e-8)
    joint = jc.clearance.PlanarJournalBearing(law, clearance=1e-3)
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        {"g": jc.load.Gravity()},
    )


MASS = {"mass": jc.Variable(lambda m: m.bodies["journal"].mass, tolerance=0.1)}
KEPT = {"save": jc.Saving(3, events=8)}


@pytest.mark.slow
def test_touches_of_a_sample_are_those_of_its_run():
    how, touches = (
        {"integrator": jc.integrator.FixedStep(1e-4)} | KEPT,
        lambda run: run.noted.counts.sum(),
    )
    problem = jc.Problem(fall(), touches, MASS, duration=0.05, **how)
    (found,) = jax.jit(problem.evaluate)(problem.nominal()).responses.values()
    assert float(found) == len(jc.simulate(fall(), 0.05, **how).events()) > 0


def test_events_of_an_integrator_that_notes_none_are_refused():
    how = {"integrator": jc.integrator.NonColliding()} | KEPT
    with pytest.raises(ValueError, match="NonColliding notes no touches"):
        jc.Problem(fall(), lambda run: run.time[-1], MASS, duration=np.float64(0.05), **how)
