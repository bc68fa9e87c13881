"""The life of a bearing into which a pin is pressed one way: the volume that it loses in a turn
stays, its scar widens, so its depth slows. By the area between two circles.
"""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

import jaxclear as jc

LOAD, SPEED, RADIUS, CLEARANCE, LENGTH = 200.0, 12.0, 10e-3, 0.05e-3, 20e-3
TURN, CYCLES = 2 * math.pi / SPEED, 1e4
LAW = jc.wear.Archard()


def lost(clearance):
    """k F s / H of one turn [m3]: the journal slides at its own radius."""
    slid = 2 * math.pi * (RADIUS - clearance)
    return float(LAW.wear_coefficient / LAW.hardness) * LOAD * slid


LOST = lost(CLEARANCE)


def crescent(depth, clearance=CLEARANCE):
    """Volume [m3] lost by the bearing when the pin has sunk so deep [m]."""
    reach = clearance + depth
    half = math.acos(clearance / reach)
    return 2 * RADIUS * LENGTH * (reach * math.sin(half) - clearance * half)


def depth_of(volume):
    return brentq(lambda depth: crescent(depth) - volume, 1e-9, 1e-3)


@pytest.fixture(scope="module")
def life():
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Rigid(),
        bearing_radius=RADIUS,
        clearance=CLEARANCE,
        length=LENGTH,
        bearing_wear=jc.Wearing(LAW, cells=(288, 1)),
    )
    rig = jc.Mechanism(
        {"rotor": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(bearing, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD, 0.0))},
        speeds={"rotor": (0.0, 0.0, SPEED)},
    )
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=4.5e-5)
    asked = jc.Problem(
        rig,
        jc.response.MeanContactForce("B"),
        {"clearance": clearance},
        duration=TURN,
        save=25,
        integrator=jc.integrator.NonColliding(TURN / 96),
    )
    return jc.wear_life(asked, cycles=CYCLES, accuracy=2e-2)


def test_the_volume_of_a_cycle_stays_to_rounding_while_depth_slows(life):
    lost = [stage.settled.last.lost["B"]["bearing"] for stage in life.stages[1:]]
    np.testing.assert_allclose(lost, LOST, rtol=1e-9)
    places = np.array([0.1, 0.2, 0.4, 0.8, 1.0]) * CYCLES
    depths = np.array([float(life.over_life("depth", n)) for n in places])
    wanted = [depth_of(LOST * n) for n in places]
    # A cell of 1.25 degrees is the mean over its width, of a scar of 20 to 50; and a contact is at
    # least two cells wide.
    np.testing.assert_allclose(depths, wanted, rtol=0.05)
    rates = np.diff(depths) / np.diff(places)
    assert np.all(np.diff(rates) < 0) and rates[-1] < 0.7 * rates[0]


def test_a_life_knows_what_the_clearance_does_to_it(life):
    """More clearance is a narrower scar, which is as deep sooner: by the two circles."""
    limit = 0.7 * float(life.over_life("depth")[-1])
    found = jc.wear_life_derivatives(life, "depth", limit)["clearance"]
    step = 1e-7
    more, less = (crescent(limit, c) / lost(c) for c in (CLEARANCE + step, CLEARANCE - step))
    exact = (more - less) / (2 * step)
    assert abs(found.value - exact) < found.error < 0.1 * abs(exact)
    assert found.value == pytest.approx(exact, rel=0.05) and found.unit == "cycles/m"
