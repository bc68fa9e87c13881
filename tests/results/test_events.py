"""Touches and releases of a run against a journal that falls, strikes and bounces on one line: its
flights in closed form."""

import numpy as np
import pytest

import jaxclear as jc

GRAVITY, CLEARANCE = 9.81, 1e-3
FALL = np.sqrt(2 * CLEARANCE / GRAVITY)
RUNGS = {
    "Adaptive": jc.integrator.Adaptive(),
    "FixedStep": jc.integrator.FixedStep(5e-6),
    "contact_steps": jc.integrator.FixedStep(1e-4, contact_steps=20),
    "ImplicitStep": jc.integrator.ImplicitStep(5e-6, rebound=1.0),
}


def bouncing(contact=None):
    law = jc.contact.Flores(stiffness=1e8, restitution=0.9) if contact is None else contact
    bearing = jc.clearance.PlanarJournalBearing(law, clearance=CLEARANCE)
    return jc.Mechanism(
        {"ball": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "ball")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
    )


def run_of(integrator, save=3, events=20, **kwargs):
    saving = jc.Saving(save, events)
    return jc.simulate(bouncing(**kwargs), 0.1, save=saving, integrator=integrator)


@pytest.mark.parametrize(
    "rung", [pytest.param(n, marks=[] if n == "Adaptive" else pytest.mark.slow) for n in RUNGS]
)
def test_touches_and_releases_are_instants_of_the_run(rung):
    """Three saving times; steps of 5e-6 s and their like, within which Hermite's cubic is exact in
    flight. Each flight is as long as it takes to come back."""
    table = run_of(RUNGS[rung]).events()
    assert list(table["event"][:5]) == ["touch", "release", "touch", "release", "touch"]
    time, speed = table["time [s]"].to_numpy(), table["speed [m/s]"].to_numpy()
    assert time[0] == pytest.approx(FALL, abs=1e-8)
    assert speed[0] == pytest.approx(GRAVITY * FALL, rel=1e-4)
    flights, thrown, back = time[2::2] - time[1:-1:2], speed[1:-1:2], speed[2::2]
    # Where a release falls within a step its speed is known to what the contact does in it.
    np.testing.assert_allclose(flights, 2 * thrown / GRAVITY, rtol=2e-3)
    np.testing.assert_allclose(back, thrown, rtol=2e-3)


@pytest.mark.slow
def test_events_do_not_hang_on_the_saving_times():
    few, many = (run_of(RUNGS["Adaptive"], save).events() for save in (3, 401))
    assert len(few) == len(many)
    np.testing.assert_allclose(few["time [s]"][:6], many["time [s]"][:6], atol=1e-6)


def test_events_beyond_those_kept_are_counted():
    run = run_of(RUNGS["Adaptive"], events=2)
    whole = len(run_of(RUNGS["Adaptive"]).events())
    with pytest.warns(UserWarning, match=f"{whole - 4} touches and releases were not kept"):
        assert len(run.events("B")) == 4


def test_events_that_were_not_asked_for_are_refused():
    with pytest.raises(ValueError, match="this run kept no touches"):
        jc.simulate(bouncing(), 0.01, save=3).events()
    with pytest.raises(ValueError, match="MoreauJean notes no touches"):
        jc.simulate(bouncing(), 0.01, integrator=jc.integrator.MoreauJean(), save=jc.Saving(3, 3))
    with pytest.raises(ValueError, match="events of Saving is -1"):
        jc.Saving(3, -1)
