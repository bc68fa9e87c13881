"""Free flight, impact and contact: instants in closed form, and the definition that parts impact
from contact.

Touches and releases of a run against a journal that falls, strikes and bounces on one line: its
flights in closed form."""

import equinox as eqx
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.results.modes import Mode
from tests.rigs.cells import slow, slow_but
from tests.rigs.refusals import refusals

MASS, STIFFNESS, SPEED, CLEARANCE = 1.0, 1e7, 0.1, 1e-4
LASTS = np.pi * np.sqrt(MASS / STIFFNESS)


def journal(load=None, contact=None, **law):
    """A journal in a linear wall, thrown from the middle along x, or pulled there from rest."""
    contact = contact or jc.contact.KelvinVoigt(stiffness=STIFFNESS, **law)
    gap = {"bearing_radius": 10e-3, "clearance": CLEARANCE}
    joint = jc.clearance.PlanarJournalBearing(contact, None, **gap)
    loads = {} if load is None else {"load": jc.load.Force(jc.Marker("journal"), (load, 0.0, 0.0))}
    return jc.Mechanism(
        {"journal": jc.Body(MASS, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        loads,
        speeds={"journal": (SPEED if load is None else 0.0, 0.0, 0.0)},
    )


TIGHT = jc.integrator.Adaptive(rtol=1e-10, atol=1e-14)


def phases(rig, duration, saves):
    return jc.simulate(rig, duration, save=saves, integrator=TIGHT).modes("B")


@pytest.mark.slow
@pytest.mark.parametrize("saves", [*slow(1001), 51])
def test_instants_of_elastic_impacts(saves):
    """Straight flights of two clearances, and half a swing in the wall."""
    flight = 2 * CLEARANCE / SPEED
    found = phases(journal(damping=0.0), 4.0 * (flight + LASTS), saves)
    modes, starts = list(found["mode"]), found["from [s]"].to_numpy()
    assert modes[:5] == ["free flight", "impact"] * 2 + ["free flight"]
    first = CLEARANCE / SPEED
    wanted = [0.0, first, first + LASTS, first + LASTS + flight, first + 2 * LASTS + flight]
    within = 1e-6 if saves == 1001 else 1e-2
    np.testing.assert_allclose(starts[:5], wanted, atol=within * LASTS)
    np.testing.assert_allclose(found["approach speed [m/s]"][1], SPEED, rtol=10 * within)


@pytest.mark.slow
def test_instants_of_a_run_with_events_do_not_hang_on_its_saves():
    """Two saving intervals, each longer than two flights and an impact: by events the instants are
    those of the steps; without them a run says whose they are."""
    flight, first = 2 * CLEARANCE / SPEED, CLEARANCE / SPEED
    rig, duration = journal(damping=0.0), 4.0 * (flight + LASTS)
    run = jc.simulate(rig, duration, save=jc.Saving(3, events=9), integrator=TIGHT)
    found = run.modes("B")
    assert list(found["mode"]) == ["free flight", "impact"] * 4 + ["free flight"]
    assert list(found["start known by"]) == ["start of the run"] + ["event"] * 8
    lengths = np.diff(found["from [s]"])
    wanted = [first, LASTS, *[flight, LASTS] * 3]
    np.testing.assert_allclose(lengths, wanted, atol=1e-6 * LASTS)
    np.testing.assert_allclose(found["approach speed [m/s]"][1::2], SPEED, rtol=1e-6)
    np.testing.assert_array_equal(found["from [s]"][1:], run.events("B")["time [s]"])
    assert "within its steps" in found.attrs["instants"]
    by_saves = eqx.tree_at(lambda r: r.noted, run, None)
    assert "between the saving times" in by_saves.modes("B").attrs["instants"]
    assert "between the saving times" in by_saves.combined_modes().attrs["instants"]


@pytest.mark.slow
def test_where_events_were_not_kept_the_saves_tell():
    """One event of four is kept: the rest of the interval is told by saves, with a warning."""
    duration = 4.0 * (2 * CLEARANCE / SPEED + LASTS)
    saving = jc.Saving(3, events=1)
    run = jc.simulate(journal(damping=0.0), duration, save=saving, integrator=TIGHT)
    with pytest.warns(UserWarning, match="6 touches and releases were not kept"):
        known = list(run.modes("B")["start known by"])
    assert known == ["start of the run", *["event", "saving times"] * 2]


@pytest.mark.slow
def test_what_lasts_is_contact():
    """Under a load a journal comes back from its first impacts less and less, then stays."""
    found = phases(journal(20.0, damping=600.0), 0.05, 2001)
    modes = list(found["mode"])
    assert modes[0] == Mode.FREE_FLIGHT.label and modes[1] == Mode.IMPACT.label
    assert modes[-1] == Mode.CONTACT.label and modes.count(Mode.CONTACT.label) == 1
    lasting = found.iloc[-1]
    assert lasting["to [s]"] - lasting["from [s]"] > 0.02


def test_an_impact_without_rebound_ends_when_the_journal_stands():
    """With a damper that takes all, impact is followed by contact at once; so it is of rigid
    contact, which is known to an interval."""
    found = phases(journal(20.0, damping=2e4), 0.02, 2001)
    assert list(found["mode"]) == ["free flight", "impact", "contact"]
    impact = found.iloc[1]
    # The approach falls as exp(-damping t / mass), to a twentieth.
    assert impact["to [s]"] - impact["from [s]"] == pytest.approx(np.log(20) / 2e4, rel=0.5)
    rigid = journal(20.0, jc.contact.Rigid(restitution=0.0))
    run = jc.simulate(rigid, 0.02, save=201, integrator=jc.integrator.MoreauJean(1e-5))
    assert list(run.modes("B")["mode"]) == ["free flight", "impact", "contact"]


@pytest.mark.slow
def test_modes_side_by_side_change_where_one_does():
    rig = jc.scenes.flap()
    run = jc.simulate(rig, 0.02, save=2001, integrator=jc.integrator.ImplicitStep(2e-6))
    both = run.combined_modes("J1", "J2")
    starts = sorted({*run.modes("J1")["from [s]"], *run.modes("J2")["from [s]"]})
    np.testing.assert_array_equal(both["from [s]"], starts)
    for name in ("J1", "J2"):
        own = run.modes(name)
        for _, row in both.iterrows():
            middle = 0.5 * (row["from [s]"] + row["to [s]"])
            inside = own[(own["from [s]"] <= middle) & (own["to [s]"] >= middle)]
            assert list(inside["mode"]) == [row[name]]


GRAVITY, PLAY = 9.81, 1e-3
FALL = np.sqrt(2 * PLAY / GRAVITY)
RUNGS = {
    "Adaptive": jc.integrator.Adaptive(),
    "FixedStep": jc.integrator.FixedStep(5e-6),
    "contact_steps": jc.integrator.FixedStep(1e-4, contact_steps=20),
    "ImplicitStep": jc.integrator.ImplicitStep(5e-6, rebound=1.0),
}


def bouncing():
    law = jc.contact.Flores(stiffness=1e8, restitution=0.9)
    bearing = jc.clearance.PlanarJournalBearing(law, clearance=PLAY)
    return jc.Mechanism(
        {"ball": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "ball")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
    )


def run_of(integrator, save=3, events=20):
    return jc.simulate(bouncing(), 0.1, save=jc.Saving(save, events), integrator=integrator)


@pytest.mark.parametrize("rung", slow_but(["Adaptive"], RUNGS))
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


def test_events_beyond_those_kept_are_counted():
    run = run_of(RUNGS["Adaptive"], events=2)
    whole = len(run_of(RUNGS["Adaptive"]).events())
    with pytest.warns(UserWarning, match=f"{whole - 4} touches and releases were not kept"):
        assert len(run.events("B")) == 4


test_events_that_were_not_asked_for_are_refused = refusals(
    {
        "this run kept no touches": lambda: jc.simulate(bouncing(), 0.01, save=3).events(),
        "MoreauJean notes no touches": lambda: jc.simulate(
            bouncing(), 0.01, integrator=jc.integrator.MoreauJean(), save=jc.Saving(3, 3)
        ),
        "events of Saving is -1": lambda: jc.Saving(3, -1),
    }
)
