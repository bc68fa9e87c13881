"""Wear of joints that always touch: Archard's volume by the reaction, and its place in the gap."""

import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

LOAD, SPEED, RADIUS, CLEARANCE, LENGTH = 200.0, 12.0, 10e-3, 0.05e-3, 20e-3
JOURNAL = RADIUS - CLEARANCE
LAW = jc.wear.Archard()
RATE = float(LAW.wear_coefficient / LAW.hardness)
DURATION, SAVES = 0.5, 51
TURNED = SPEED * DURATION


def turning(kind, law=None, load=LOAD, **wearing):
    """A journal that turns, pressed down by a constant load."""
    joint = kind(
        jc.contact.HuntCrossley(stiffness=1e9, restitution=0.1) if law is None else law,
        bearing_radius=RADIUS,
        clearance=CLEARANCE,
        length=LENGTH,
        **{surface: jc.Wearing(LAW, cells=(48, 4)) for surface in wearing},
    )
    planar = kind is jc.clearance.PlanarJournalBearing
    return jc.Mechanism(
        {"rotor": jc.Body(1.0, 1e-3 if planar else (1e-3,) * 3)},
        {"B": jc.Connection(joint, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -load, 0.0))},
        speeds={"rotor": (0.0, 0.0, SPEED) if planar else (0.0, 0.0, 0.0, 0.0, 0.0, SPEED)},
    )


def run(rig, integrator):
    return jc.simulate(rig, DURATION, save=SAVES, integrator=integrator)


@pytest.fixture(scope="module")
def planar():
    return run(
        turning(jc.clearance.PlanarJournalBearing, bearing_wear=True),
        jc.integrator.NonColliding(1e-3),
    )


def test_a_loaded_bearing_that_always_touches_wears_by_archard(planar):
    """V = k F s / H, to rounding, all of it below the load."""
    volume = planar.worn_volume("B", "bearing")
    np.testing.assert_allclose(volume[-1], RATE * LOAD * JOURNAL * TURNED, rtol=1e-9)
    np.testing.assert_allclose(np.diff(volume), volume[-1] / (SAVES - 1), rtol=1e-6)
    depth = planar.worn_depth("B", "bearing")[:, 0]
    place = (np.arange(48) + 0.5) * 2 * np.pi / 48
    assert np.all(np.cos(place + 0.5 * np.pi)[depth > 0] > 0)
    area = 2 * np.pi * RADIUS * LENGTH / 48
    np.testing.assert_allclose(depth.sum() * area, volume[-1], rtol=1e-12)


SOFT, STIFF = 5e8, 1e10


def hertz(stiffness):
    return jc.contact.HuntCrossley(stiffness=stiffness, restitution=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "law", "load"),
    [
        (jc.clearance.PlanarJournalBearing, hertz(SOFT), 2000.0),
        (jc.clearance.PlanarJournalBearing, hertz(STIFF), 200.0),
        (jc.clearance.JournalBearing, hertz(STIFF), 2000.0),
        (jc.clearance.JournalBearing, jc.contact.Liu(restitution=0.1), 2000.0),
    ],
)
def test_a_loaded_bearing_wears_as_deep_as_its_contact_law_lets_it_sink(kind, law, load):
    """The compliant bearing, seated, is the oracle; a contact two cells wide would wear 2 to 12
    times as deep."""
    rig = turning(kind, law=law, load=load, bearing_wear=True)
    asked = {"duration": 0.1, "save": 101}
    rigid = jc.simulate(rig, integrator=jc.integrator.NonColliding(1e-3), **asked)
    seated = jc.resting_state(rig)
    compliant = jc.simulate(
        rig, integrator=jc.integrator.Adaptive(rtol=1e-8, atol=1e-11), state=seated, **asked
    )
    found, wanted = (float(run.worn_depth("B", "bearing").max()) for run in (rigid, compliant))
    volumes = [float(run.worn_volume("B", "bearing")[-1]) for run in (rigid, compliant)]
    assert found / volumes[0] == pytest.approx(wanted / volumes[1], rel=1e-3)


def test_the_first_depth_is_that_of_hertz_pressure_over_the_width_of_the_contact():
    """h = 2 V / (pi R L a) in the middle, a^2 = indentation/clearance: rootlike pressure."""
    rig = turning(jc.clearance.PlanarJournalBearing, law=hertz(STIFF), bearing_wear=True)
    found = jc.simulate(rig, 0.1, save=101, integrator=jc.integrator.NonColliding(1e-3))
    half_width = np.sqrt((LOAD / STIFF) ** (2 / 3) / CLEARANCE)
    volume = float(found.worn_volume("B", "bearing")[-1])
    wanted = 2 * volume / (np.pi * RADIUS * LENGTH * half_width)
    assert float(found.worn_depth("B", "bearing").max()) == pytest.approx(wanted, rel=0.08)


@pytest.mark.parametrize("outer", ["ground", *slow("rotor")])
def test_a_journal_slides_as_its_centre_goes_round_too(outer):
    """A journal that turns slides at its own radius, one in a bearing that turns at the bearing's:
    V = k F r w t / H; here the clearance is a tenth of the radius."""
    wide, integrator = 0.1 * RADIUS, jc.integrator.NonColliding(1e-3)
    joint = jc.clearance.PlanarJournalBearing(
        hertz(STIFF),
        bearing_radius=RADIUS,
        clearance=wide,
        length=LENGTH,
        bearing_wear=jc.Wearing(LAW, cells=(48, 1)),
    )
    inner = {"ground": "rotor", "rotor": "ground"}[outer]
    rig = jc.Mechanism(
        {"rotor": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(joint, outer, inner)},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD, 0.0))},
        speeds={"rotor": (0.0, 0.0, SPEED)},
    )
    found = jc.simulate(rig, 0.1, save=21, integrator=integrator)
    radius = RADIUS if outer == "rotor" else RADIUS - wide
    wanted = RATE * LOAD * radius * SPEED * 0.1
    # where the centre was before the first step nobody knows
    assert float(found.worn_volume("B", "bearing")[-1]) == pytest.approx(wanted, rel=2e-3)


@pytest.mark.slow
def test_rigid_contact_wears_as_deep_as_its_contact_law_lets_it_sink():
    """The compliant bearing, seated, is the oracle; two cells wide it would wear twice as
    deep."""
    rig = turning(
        jc.clearance.PlanarJournalBearing, law=hertz(SOFT), load=2000.0, bearing_wear=True
    )
    asked = {"duration": 0.02, "save": 41, "state": jc.resting_state(rig)}
    runs = [
        jc.simulate(rig, integrator=one, **asked)
        for one in (jc.integrator.MoreauJean(1e-4), jc.integrator.Adaptive(rtol=1e-8, atol=1e-11))
    ]
    shares = [
        float(run.worn_depth("B", "bearing").max() / run.worn_volume("B", "bearing")[-1])
        for run in runs
    ]
    assert shares[0] == pytest.approx(shares[1], rel=0.02)


@pytest.mark.slow
def test_the_quiet_compliant_bearing_wears_as_much(planar):
    rig = turning(jc.clearance.PlanarJournalBearing, bearing_wear=True)
    compliant = run(rig, jc.integrator.ImplicitStep(1e-5))
    found, wanted = (one.worn_volume("B", "bearing") for one in (planar, compliant))
    # A journal that gives way slides at its radius less half of what it gives way.
    depth = float(compliant.contact("B").indentation[-1, 0])
    slower = (JOURNAL - 0.5 * depth) / JOURNAL
    # once the fall through the play is over
    lost = slower * (found[-1] - found[20])
    np.testing.assert_allclose(lost, wanted[-1] - wanted[20], rtol=1e-4)


@pytest.mark.slow
def test_a_journal_that_turns_under_a_constant_load_wears_evenly():
    rig = turning(jc.clearance.JournalBearing, journal_wear=True, bearing_wear=True)
    found = run(rig, jc.integrator.NonColliding(1e-3))
    volume = float(found.worn_volume("B", "journal")[-1])
    np.testing.assert_allclose(volume, RATE * LOAD * JOURNAL * TURNED, rtol=1e-9)
    depth = found.worn_depth("B", "journal")
    turned = (np.arange(48) + 0.5) * 2 * np.pi / 48
    # it has not turned a whole turn: below the load at first, then 6 rad further round
    even = volume / (TURNED * (RADIUS - CLEARANCE) * LENGTH)
    backwards = np.mod(-0.5 * np.pi - turned, 2 * np.pi)
    middle = (backwards > 0.6) & (backwards < TURNED - 0.6)
    # a saving interval goes through an arc of nearly one cell
    np.testing.assert_allclose(depth[middle], even, rtol=0.08)
