"""A slider-crank with a rod that bends and stretches, against Exudyn's cables by absolute nodal
coordinates: where the slider is, and the middle of the rod, with ideal joints and with a loose pin.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import jaxclear as jc

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata/exudyn_flexible_rod.json").read_text())
TIMES = np.array(REFERENCE["time"])
CRANK, ROD, SPEED = 0.05, 0.12, 150.0


LOOSE = REFERENCE["loose"]


def slider_crank(segments, loose=False):
    rod = jc.Beam(
        ROD,
        jc.section.Circle(6e-3),
        jc.Material(200e9, 0.3),
        density=7850.0,
        segments=segments,
        damping=0.02,
        stretches=True,
    )
    pin = jc.clearance.PlanarJournalBearing(
        jc.contact.Linear(stiffness=LOOSE["stiffness"]),
        bearing_radius=5e-3,
        clearance=LOOSE["clearance"],
    )
    drive = jc.drive.ConstantSpeed(SPEED)
    rail = jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
    connections = {
        "O": jc.Connection(jc.joint.Revolute(drive=drive), "ground", "crank"),
        "A": jc.Connection(jc.joint.Revolute(), jc.Marker("crank", (CRANK, 0.0)), "rod"),
        "B": jc.Connection(
            pin if loose else jc.joint.Revolute(), jc.Marker("rod", (ROD, 0.0)), "slider"
        ),
        "G": jc.Connection(jc.joint.Prismatic(), *rail),
    }
    bodies = {"crank": jc.Body(0.3, 1e-4), "rod": rod, "slider": jc.Body(0.14, 1e-4)}
    return jc.Mechanism(bodies, connections, guess={"G": CRANK + ROD})


def turn(segments, loose=False):
    """How far the slider is from that of a rigid rod, and the middle of the rod from its chord."""
    times = TIMES * LOOSE["share of the turn"] if loose else TIMES
    step = jc.integrator.ImplicitStep(times[-1] / 4800, rebound=1.0)
    rig = slider_crank(segments, loose)
    run = jc.simulate(rig, times[-1], save=times, integrator=step, verify=False)
    rigid = CRANK * np.cos(SPEED * times) + np.sqrt(ROD**2 - (CRANK * np.sin(SPEED * times)) ** 2)
    pin, middle, end = (
        np.asarray(run.marker("rod", (place * ROD, 0.0)).position)[-len(times) :, :2]
        for place in (0.0, 0.5, 1.0)
    )
    chord = (end - pin) / np.linalg.norm(end - pin, axis=1)[:, None]
    away = middle - pin
    return (
        np.asarray(run.coordinate("G"))[-len(times) :] - rigid,
        chord[:, 0] * away[:, 1] - chord[:, 1] * away[:, 0],
    )


@pytest.mark.slow
def test_flexible_rod_moves_as_in_exudyn():
    coarse, fine = turn(4), turn(8)
    for name, rough, close in zip(("slider", "middle"), coarse, fine, strict=True):
        found = close + (close - rough) / 3  # order two in 1 / segments
        assert np.abs(found - REFERENCE[name]).max() < REFERENCE["tolerance"], name
        assert np.abs(REFERENCE[name]).max() > 20 * REFERENCE["tolerance"]


@pytest.mark.slow
def test_a_loose_pin_meets_a_flexible_rod_as_in_exudyn():
    for name, found in zip(("slider", "middle"), turn(8, True), strict=True):
        wanted = np.array(REFERENCE[f"loose {name}"])
        assert np.abs(found - wanted).max() < REFERENCE["loose tolerance"], name
