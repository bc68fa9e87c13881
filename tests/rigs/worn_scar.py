"""A pin pressed into a bearing one way: a turn takes as much volume however deep the scar, which
widens, so its depth slows. By the area between two circles."""

import math

from scipy.optimize import brentq

import jaxclear as jc

LOAD, SPEED, RADIUS, LENGTH = 200.0, 12.0, 10e-3, 20e-3
TURN, LAW = 2 * math.pi / SPEED, jc.wear.Archard()


def lost(clearance: float) -> float:
    """k F s / H of one turn [m3]: the journal slides at its own radius."""
    slid = 2 * math.pi * (RADIUS - clearance)
    return float(LAW.wear_coefficient / LAW.hardness) * LOAD * slid


def crescent(depth: float, clearance: float, radius: float = RADIUS) -> float:
    """Volume [m3] that a wall of this radius has lost when the pin has sunk so deep [m]."""
    reach = clearance + depth
    half = math.acos(clearance / reach)
    return 2 * radius * LENGTH * (reach * math.sin(half) - clearance * half)


def depth_of(volume: float, clearance: float) -> float:
    """The depth [m] of a scar of such a volume [m3]."""
    return brentq(lambda depth: crescent(depth, clearance) - volume, 1e-9, 1e-3)


def scar(clearance: float, cells: int, journal: bool = False) -> jc.Problem:
    """One turn of the pin; `journal`: it wears, too."""
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.Rigid(),
        bearing_radius=RADIUS,
        clearance=clearance,
        length=LENGTH,
        bearing_wear=jc.Wearing(LAW, cells=(cells, 1)),
        journal_wear=jc.Wearing(LAW, cells=(cells, 1)) if journal else None,
    )
    rig = jc.Mechanism(
        {"rotor": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(joint, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD, 0.0))},
        speeds={"rotor": (0.0, 0.0, SPEED)},
    )
    where = lambda rig: rig.connections["B"].joint.clearance
    return jc.Problem(
        rig,
        jc.response.MeanContactForce("B"),
        {"clearance": jc.Variable(where, tolerance=4.5e-5)},
        duration=TURN,
        save=25,
        integrator=jc.integrator.NonColliding(TURN / 96),
    )
