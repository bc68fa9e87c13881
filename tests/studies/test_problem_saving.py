"""A study keeps what a run keeps: saving times, and touches and releases in between."""

import jax
import numpy as np
import pytest

import jaxclear as jc

RIGID = jc.contact.KelvinVoigt(stiffness=1e6, damping=1e2, onset_depth=1e-8)


def fall():
    """A journal that falls through its play."""
    joint = jc.clearance.PlanarJournalBearing(RIGID, clearance=1e-3)
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        {"g": jc.load.Gravity()},
    )


@pytest.mark.slow
def test_touches_of_a_sample_are_those_of_its_run():
    saving = jc.Saving(3, events=8)
    integrator = jc.integrator.FixedStep(1e-4)
    problem = jc.Problem(
        fall(),
        lambda run: run.noted.counts.sum(),
        {"mass": jc.Variable(lambda m: m.bodies["journal"].mass, tolerance=0.1)},
        duration=0.05,
        integrator=integrator,
        save=saving,
    )
    found = jax.jit(problem.evaluate)(problem.nominal())
    alone = jc.simulate(fall(), 0.05, integrator=integrator, save=saving)
    assert float(next(iter(found.responses.values()))) == len(alone.events()) > 0


def test_events_of_an_integrator_that_notes_none_are_refused():
    with pytest.raises(ValueError, match="NonColliding notes no touches"):
        jc.Problem(
            fall(),
            lambda run: run.time[-1],
            {"mass": jc.Variable(lambda m: m.bodies["journal"].mass, tolerance=0.1)},
            duration=np.float64(0.05),
            integrator=jc.integrator.NonColliding(),
            save=jc.Saving(3, events=8),
        )
