"""A slider-crank with a rod that bends and stretches, against Exudyn's cables by absolute nodal
coordinates: where the slider is, and the middle of the rod.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import jaxclear as jc

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata/exudyn_flexible_rod.json").read_text())
TIMES = np.array(REFERENCE["time"])
CRANK, ROD, SPEED = 0.05, 0.12, 150.0


def slider_crank(segments):
    rod = jc.Beam(
        ROD,
        jc.section.Circle(6e-3),
        jc.Material(200e9, 0.3),
        density=7850.0,
        segments=segments,
        damping=0.02,
        stretches=True,
    )
    drive = jc.drive.ConstantSpeed(SPEED)
    rail = jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
    connections = {
        "O": jc.Connection(jc.joint.Revolute(drive=drive), "ground", "crank"),
        "A": jc.Connection(jc.joint.Revolute(), jc.Marker("crank", (CRANK, 0.0)), "rod"),
        "B": jc.Connection(jc.joint.Revolute(), jc.Marker("rod", (ROD, 0.0)), "slider"),
        "G": jc.Connection(jc.joint.Prismatic(), *rail),
    }
    bodies = {"crank": jc.Body(0.3, 1e-4), "rod": rod, "slider": jc.Body(0.14, 1e-4)}
    return jc.Mechanism(bodies, connections, guess={"G": CRANK + ROD})


def turn(segments):
    """How far the slider is from that of a rigid rod, and the middle of the rod from its chord."""
    step = jc.integrator.ImplicitStep(TIMES[-1] / 4800)
    run = jc.simulate(slider_crank(segments), TIMES[-1], save=TIMES, integrator=step, verify=False)
    rigid = CRANK * np.cos(SPEED * TIMES) + np.sqrt(ROD**2 - (CRANK * np.sin(SPEED * TIMES)) ** 2)
    pin, middle, end = (
        np.asarray(run.marker("rod", (place * ROD, 0.0)).position)[-len(TIMES) :, :2]
        for place in (0.0, 0.5, 1.0)
    )
    chord = (end - pin) / np.linalg.norm(end - pin, axis=1)[:, None]
    away = middle - pin
    return (
        np.asarray(run.coordinate("G"))[-len(TIMES) :] - rigid,
        chord[:, 0] * away[:, 1] - chord[:, 1] * away[:, 0],
    )


@pytest.mark.slow
def test_flexible_rod_moves_as_in_exudyn():
    coarse, fine = turn(4), turn(8)
    for name, rough, close in zip(("slider", "middle"), coarse, fine, strict=True):
        found = close + (close - rough) / 3  # order two in 1 / segments
        assert np.abs(found - REFERENCE[name]).max() < REFERENCE["tolerance"], name
        assert np.abs(REFERENCE[name]).max() > 20 * REFERENCE["tolerance"]
